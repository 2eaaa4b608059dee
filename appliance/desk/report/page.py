"""Page of a report: its layout on a screen and on paper, without any request to other servers.

* ``page``, ``write_report``: the page.
* ``interactive_view``: the surface in a browser: plotly's own JavaScript within the page, fed with numbers as base64,
  and buttons to colour it.
* ``colour_bar``, ``net``: the legend of a colouring, and the graph of the scans.
"""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.base import Page, histogram, minus, needed, number_text
from appliance.desk.report.content import (
    Report,
    ReportBudget,
    ReportNominal,
    ReportPair,
    ReportScan,
    ReportVerdict,
    Vector,
)
from appliance.desk.report.drawn_surface import Colouring, DrawnSurface, surface_to_draw, thin_out
from appliance.desk.report.still import still, view_direction
from appliance.measure import Grade
from appliance.store import LocalFileSystem

_DISTANCE = 2.0
"""Distance of the eye from the middle of the scene, in plotly's units of the scene's size."""

_SCRIPT = """
(function () {
  var kinds = {f4: Float32Array, i4: Int32Array};
  var data = JSON.parse(document.getElementById('surface-data').textContent, function (name, value) {
    if (!value || !value.bdata) { return value; }
    var text = atob(value.bdata), bytes = new Uint8Array(text.length);
    for (var k = 0; k < text.length; k++) { bytes[k] = text.charCodeAt(k); }
    return new kinds[value.dtype](bytes.buffer);
  });
  var plot = document.getElementById('turned');
  var key = data.trace.type === 'mesh3d' ? '' : 'marker.';
  function look(k) {
    var c = data.colourings[k], change = {};
    change[key + (key ? 'color' : 'intensity')] = [c.values];
    change[key + 'colorscale'] = [c.scale];
    change[key + 'cmin'] = [c.low];
    change[key + 'cmax'] = [c.high];
    Plotly.restyle(plot, change);
    document.querySelectorAll('.colouring').forEach(function (one) {
      one.hidden = Number(one.dataset.colouring) !== k;
    });
    document.querySelectorAll('.look').forEach(function (one) {
      one.setAttribute('aria-pressed', String(Number(one.dataset.colouring) === k));
    });
  }
  document.querySelectorAll('.look').forEach(function (one) {
    one.addEventListener('click', function () { look(Number(one.dataset.colouring)); });
  });
  // A browser without WebGL keeps the still picture, which is in the page anyway.
  try {
    var canvas = document.createElement('canvas');
    if (!(canvas.getContext('webgl') || canvas.getContext('webgl2'))) { throw new Error('no WebGL'); }
    // ShownSurface first: what has no size yet would be drawn in plotly's default one.
    document.body.classList.add('turning');
    Plotly.newPlot(plot, [data.trace], data.layout, {displaylogo: false, responsive: true,
      modeBarButtons: [['toImage', 'zoom3d', 'pan3d', 'orbitRotation', 'resetCameraDefault3d']]}).then(function () { look(0); });
  } catch (error) {
    document.body.classList.remove('turning');
  }
})();
"""


def interactive_view(drawn: DrawnSurface, up: Vector) -> tuple[str, str]:
    """Return the element of the surface with its buttons, and the scripts that fill it.

    Raises MissingLibraryError where plotly is absent.
    """
    library = needed("plotly.offline", "plotly", "a page with a surface that can be turned")
    buttons = "".join(
        f'<button type="button" class="look" data-colouring="{k}" aria-pressed="{"true" if k == 0 else "false"}">{colouring.name}</button>'
        for k, colouring in enumerate(drawn.colourings)
    )
    content = {
        "trace": _trace(drawn),
        "layout": _layout(drawn, up),
        "colourings": [_as_json(colouring) for colouring in drawn.colourings],
    }
    # "</script>" in a text would end the element: every "<" is written as its number.
    text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    scripts = (
        f'<script type="application/json" id="surface-data">{text}</script>\n<script>{library.get_plotlyjs()}</script>\n'
        f"<script>{_SCRIPT}</script>"
    )
    return f'<div class="looks" role="group" aria-label="Colours">{buttons}</div><div id="turned"></div>', scripts


def _trace(drawn: DrawnSurface) -> dict[str, Any]:
    first = drawn.colourings[0]
    places = {axis: _pack(drawn.points_mm[:, k], "<f4") for k, axis in enumerate("xyz")}
    scale = first.scale.stops
    hover = "x %{x:.2f}  y %{y:.2f}  z %{z:.2f} mm<extra></extra>"
    if drawn.faces is None:
        marker = {
            "size": 2.4,
            "color": _pack(first.values, "<f4"),
            "colorscale": scale,
            "cmin": first.low,
            "cmax": first.high,
        }
        return {"type": "scatter3d", "mode": "markers", **places, "marker": marker, "hovertemplate": hover}
    corners = {name: _pack(drawn.faces[:, k], "<i4") for k, name in enumerate("ijk")}
    return {
        "type": "mesh3d", **places, **corners, "intensity": _pack(first.values, "<f4"), "colorscale": scale,
        "cmin": first.low, "cmax": first.high, "showscale": False, "hovertemplate": hover, "flatshading": False,
        "lighting": {"ambient": 0.62, "diffuse": 0.55, "specular": 0.08, "roughness": 0.9, "fresnel": 0.05},
    }  # fmt: skip


def _layout(drawn: DrawnSurface, up: Vector) -> dict[str, Any]:
    eye = _DISTANCE * view_direction(drawn, up)
    axis = {
        "showbackground": False, "gridcolor": "#d5dde5", "zeroline": False, "tickfont": {"size": 11, "color": "#5b6b7b"},
        "ticksuffix": "", "nticks": 6,
    }  # fmt: skip
    return {
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "showlegend": False,
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#9aa8b5", "activecolor": "#0b3c5d"},
        "scene": {
            "aspectmode": "data",
            "dragmode": "orbit",
            "camera": {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "up": dict(zip("xyz", up, strict=True))},
            **{f"{name}axis": {**axis, "title": {"text": f"{name} in mm"}} for name in "xyz"},
        },
    }


def _as_json(colouring: Colouring) -> dict[str, Any]:
    return {
        "values": _pack(colouring.values, "<f4"),
        "scale": colouring.scale.stops,
        "low": colouring.low,
        "high": colouring.high,
    }


def _pack(values: NDArray[Any], kind: str) -> dict[str, str]:
    """Return an array in the form that the script unpacks: a third of the length of its digits."""
    data = np.ascontiguousarray(values, kind)
    return {"dtype": {"<f4": "f4", "<i4": "i4"}[kind], "bdata": base64.b64encode(data.tobytes()).decode()}


INK, MUTED, LINE = "#1c2733", "#5b6b7b", "#d5dde5"
VERDICT_COLOURS = {
    ReportVerdict.GOOD: "#1a7f52",
    ReportVerdict.DOUBTFUL: "#b26a00",
    ReportVerdict.UNCHECKED: "#b26a00",
    ReportVerdict.REFUSED: "#b3261e",
}
SUFFIX = ".html"
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'"
"""Content security policy: a browser must not load any other file, so that no data leave with the page."""
_WORDS = {
    ReportVerdict.GOOD: ("good", "✓"),
    ReportVerdict.DOUBTFUL: ("doubtful", "!"),
    ReportVerdict.UNCHECKED: ("unchecked", "?"),
    ReportVerdict.REFUSED: ("refused", "✕"),
}
_SMALL_MM = 1.0


def write_report(path: Path | str, report: Report) -> None:
    """Write the page, complete or not at all.

    Raises StorageError, MissingLibraryError where plotly is absent.
    """
    LocalFileSystem().replace_file(Path(path), page(report).encode())


def page(report: Report) -> str:
    """Return the page as self-contained HTML. Raises MissingLibraryError where plotly is absent."""
    full = surface_to_draw(report)
    html_page, scripts = Page(report.title, report.subtitle, report.about), ""
    html_page.tiles(_tiles(report))
    if report.warnings:
        lines = "".join(f"<li>{html.escape(line)}</li>" for line in report.warnings)
        html_page.add(f'<section class="warnings"><h2>Warnings</h2><ul>{lines}</ul></section>')
    if full is not None:
        view, scripts = _view(full, report.up)
        html_page.add(view)
        if report.nominal is not None:
            html_page.add(_nominal(report.nominal, full))
    if report.budget is not None:
        html_page.add(_budget(report.budget))
    _add_scans(html_page, report.scans)
    _add_pairs(html_page, report.scans, report.pairs)
    html_page.add(_READING)
    return html_page.as_html(_POLICY, scripts)


def _tiles(report: Report) -> list[tuple[str, str, str]]:
    tiles: list[tuple[str, str, str]] = []
    if report.scans:
        graded = [scan.grade for scan in report.scans if scan.grade is not None]
        used = [scan for scan in report.scans if scan.verdict is not ReportVerdict.REFUSED]
        doubtful = sum(scan.verdict is ReportVerdict.DOUBTFUL for scan in used)
        counts = [f"{graded.count(grade)} {grade.value}" for grade in Grade if grade in graded]
        of_them = ", ".join(counts) if graded else f"{doubtful} doubtful" if doubtful else ""
        tiles.append(("Scans used", f"{len(used)} of {len(report.scans)}", of_them))
    if report.surface is not None and len(report.surface.grey):
        median = float(np.median(report.surface.sigma_mm))
        tiles.append(("Points", _count(len(report.surface.grey)), f"sigma {_mm(median)} (median)"))
    elif report.mesh is not None:
        tiles.append(("Triangles", _count(len(report.mesh.faces)), f"between {_count(len(report.mesh.grey))} points"))
    if report.nominal is not None:
        summary = report.nominal.deviation.summary
        tiles.append(("Deviation, RMS", _mm(summary.rms_mm), f"from {report.nominal.name}"))
    if report.budget is not None:
        tiles.append(
            (
                f"Uncertainty over {report.budget.over_mm:.0f} mm",
                f"± {_mm(2 * report.budget.combined_mm)}",
                "two standard deviations",
            )
        )
    return tiles


def _view(full: DrawnSurface, up: Vector) -> tuple[str, str]:
    thinned = thin_out(full)
    element, scripts = interactive_view(thinned, up)
    # The still picture has all points, but only the browser's triangles, since these are filled one by one.
    drawn = thinned if thinned.faces is not None else full
    picture = still(drawn, drawn.colourings[0], up)
    bars = "".join(
        f'<div class="colouring" data-colouring="{k}"{"" if k == 0 else " hidden"}>{colour_bar(colouring)}</div>'
        for k, colouring in enumerate(full.colourings)
    )
    count_text = f"{_count(len(thinned.points_mm))} of {_count(len(full.points_mm))}" if thinned is not full else "all"
    content_text = "triangles between" if full.faces is not None else "surface of"
    return (
        f'<section class="view"><h2>Surface</h2>{element}<figure class="paper">{picture}</figure>{bars}'
        f'<p class="note screen">Drag to rotate, turn the wheel to zoom. Drawn: {content_text} {count_text} '
        "points.</p></section>"
    ), scripts


def _nominal(nominal: ReportNominal, full: DrawnSurface) -> str:
    summary = nominal.deviation.summary
    share = 100.0 * summary.beyond / max(1, summary.points)
    lines = [
        ("Mean", _mm(summary.mean_mm)),
        ("Standard deviation", _mm(summary.sd_mm)),
        ("RMS", _mm(summary.rms_mm)),
        ("Least, most", f"{_mm(summary.least_mm)}, {_mm(summary.most_mm)}"),
        *((f"{percent:g} % lie below", _mm(value)) for percent, value in summary.percentiles_mm),
        (
            "Within two of their sigmas",
            "–" if summary.within_2_sigma_percent is None else f"{summary.within_2_sigma_percent:.1f} %",
        ),
        (
            f"Beyond {summary.limit_mm:g} mm, not included above",
            f"{_count(summary.beyond)} ({share:.2f} %)",
        ),
    ]
    if nominal.tolerance_mm is not None:
        near = abs(nominal.deviation.deviation_mm)
        # Points beyond the limit are NaN, and also out of tolerance.
        outside = 100.0 * (1.0 - float((near <= nominal.tolerance_mm).mean())) if len(near) else 0.0
        lines.append((f"Out of ± {_mm(nominal.tolerance_mm)}", f"{outside:.2f} %"))
    map_ = full.colourings[0]
    marks = () if nominal.tolerance_mm is None else (-1000.0 * nominal.tolerance_mm, 1000.0 * nominal.tolerance_mm)
    mean_um = None if summary.mean_mm is None else 1000.0 * summary.mean_mm
    drawn = histogram(map_.values, map_.low, map_.high, "deviation in µm, positive outside", marks, mean_um)
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in lines)
    return (
        f"<section><h2>Deviation from {html.escape(nominal.name)}</h2><div class='beside'>"
        f"<figure>{drawn}</figure><table "
        f"class='figures'>{rows}</table></div></section>"
    )


def _budget(budget: ReportBudget) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(term.what)}</td><td>{_mm(term.value_mm)}</td><td>{html.escape(term.how)}</td></tr>"
        for term in budget.terms
    )
    statement = f"<p>{html.escape(budget.statement)}</p>" if budget.statement else ""
    return (
        f"<section><h2>Uncertainty over {budget.over_mm:.0f} "
        f"mm</h2>{statement}<table><thead><tr><th>Contribution</th><th>Standard "
        f"uncertainty</th><th>Source</th></tr></thead><tbody>{rows}</tbody><tfoot><tr><th>All "
        f"together</th><th>{_mm(budget.combined_mm)}"
        f"</th><th>expanded (k = 2), ± {_mm(2 * budget.combined_mm)}, covers some 95 "
        "%</th></tr></tfoot></table></section>"
    )


def _add_scans(html_page: Page, scans: Sequence[ReportScan]) -> None:
    if not scans:
        return
    rows = (
        (
            f"<b>{html.escape(scan.name)}</b>",
            _chip(scan.verdict, scan.word),
            _or_dash(scan.points, _count),
            _or_dash(scan.distance_mm, lambda mm: f"{mm:.0f} mm"),
            _mm(scan.sigma_mm),
            _mm(scan.ray_gap_mm),
            _vector(scan.position_mm, 2),
            _vector(scan.rotation_deg, 3),
            _or_dash(scan.pose_sigma_mm, lambda mm: f"± {_mm(mm)}"),
            _remarks(scan.reason, scan.warnings, scan.recorded),
        )
        for scan in scans
    )
    columns = (
        "Scan",
        "Verdict",
        "Points",
        "Distance",
        "Sigma",
        "Ray gap",
        "Position in mm",
        "Rotation in °",
        "Pose",
        "Remarks",
    )
    html_page.heading("Scans")
    html_page.table(columns, rows, "scans")
    pictures = [(scan, scan.picture_png) for scan in scans if scan.picture_png is not None]
    if not pictures:
        return
    html_page.heading("Pictures")
    html_page.note("Depth maps of the left camera; in each, yellow is near and dark is far.")
    html_page.add('<div class="pictures">')
    for scan, png in pictures:
        html_page.figure(f"scan {scan.name}: {_or_dash(scan.points, _count)} points", png)
    html_page.add("</div>")


def _add_pairs(html_page: Page, scans: Sequence[ReportScan], pairs: Sequence[ReportPair]) -> None:
    if not pairs:
        return
    rows = (
        (
            f"<b>{html.escape(pair.first)}</b> – <b>{html.escape(pair.second)}</b>",
            _chip(pair.verdict),
            _or_dash(pair.overlap_percent, lambda percent: f"{percent:.0f} %"),
            _or_dash(pair.matches, str),
            _mm(pair.residual_mm),
            _or_dash(pair.sigma_mm, lambda mm: f"± {_mm(mm)}"),
            _or_dash(pair.sigma_deg, lambda deg: f"± {deg:.4f}°"),
            _remarks(pair.reason, (), None),
        )
        for pair in pairs
    )
    html_page.heading("Scan pairs")
    drawn = net(scans, pairs)
    if drawn:
        html_page.add(
            f"<figure>{drawn}<figcaption>Scan poses; a thicker line means a larger overlap. Dashed: rejected, "
            "overlap unknown.</figcaption></figure>"
        )
    columns = ("Pair", "Verdict", "Overlap", "Features", "Residual", "Displacement", "Rotation", "Remarks")
    html_page.table(columns, rows, "pairs")


_READING = (
    '<section class="reading"><h2>How to read this</h2><p><b>Sigma</b> is the standard deviation of a point: of one scan along its ray, '
    "of the fused surface along its normal, in the object's frame: the noise of the scans, the uncertainty of their "
    "places, and by how much the object may be "
    "<b>bent</b> there by what all scans have in common, which no number of them makes smaller and no residual shows. "
    "Near by, most of the last two cancels. "
    "<b>Ray gap</b> is how far the rays of both "
    "cameras pass each other: the check of the calibration that every point brings with it. The <b>residual</b> of a "
    "pair tells how well both "
    "scans lie on each other, and nothing about sliding along a pipe or a plane; the uncertainties of displacement and "
    "rotation do. "
    "<b>Deviations</b> are along the nominal surface's normal, positive outside.</p></section>"
)


def _chip(verdict: ReportVerdict, shown: str | None = None) -> str:
    word, sign = _WORDS[verdict]
    return f'<span class="chip {word}">{sign} {shown or word}</span>'


def _remarks(reason: str, warnings: Sequence[str], recorded: str | None) -> str:
    lines = [html.escape(line) for line in (reason, *warnings) if line]
    if recorded:
        lines.append(f"<small>{html.escape(recorded)}</small>")
    return "<br>".join(lines)


def _or_dash(value: float | None, text: Callable[[float], str]) -> str:
    return "–" if value is None else text(value)


def _vector(value: Vector | None, digits: int) -> str:
    if value is None:
        return "–"
    parts = "".join(f"<span>{minus(f'{part:.{digits}f}')}</span> " for part in value)
    return f'<span class="vector">{parts}</span>'


def _count(number: float) -> str:
    return f"{number:,.0f}".replace(",", "\u202f")


def _mm(value: float | None) -> str:
    """Return a length as text: in µm below a millimetre, with a decimal below a tenth of a millimetre."""
    if value is None:
        return "–"
    if abs(value) < _SMALL_MM:
        return minus(f"{1000.0 * value:.0f} µm" if abs(value) >= 0.1 else f"{1000.0 * value:.1f} µm")
    return minus(f"{value:.3f} mm")


def colour_bar(colouring: Colouring) -> str:
    """Return the legend of a colouring with its ends and middle; empty for a plain picture."""
    if colouring.name == "Picture":
        return ""
    stops = "".join(f'<stop offset="{offset:.3f}" stop-color="{colour}"/>' for offset, colour in colouring.scale.stops)
    name = f"bar-{colouring.name.lower()}"
    ticks = "".join(
        f'<text x="{10 + 400 * part:.0f}" y="40" text-anchor="{anchor}">{html.escape(number_text(colouring.low + part * (colouring.high - colouring.low)))}</text>'
        for part, anchor in ((0.0, "start"), (0.5, "middle"), (1.0, "end"))
    )
    unit = f" in {colouring.unit}" if colouring.unit else ""
    return (
        f'<svg class="bar" viewBox="0 0 620 48" role="img" aria-label="{colouring.name}{unit}"><defs><linearGradient id="{name}">{stops}'
        f'</linearGradient></defs><rect x="10" y="6" width="400" height="16" rx="3" fill="url(#{name})"/>'
        f'<g font-size="15" fill="{MUTED}">{ticks}<text x="424" y="20" fill="{INK}">{colouring.name}{html.escape(unit)}</text></g></svg>'
    )


def net(scans: Sequence[ReportScan], pairs: Sequence[ReportPair]) -> str:
    """Return the graph of the scans and their pairs, seen from the side where it is widest.

    The text is empty if fewer than two scans have a pose.
    """
    placed = {scan.name: scan for scan in scans if scan.position_mm is not None}
    if len(placed) < 2:
        return ""
    places = np.array([scan.position_mm for scan in placed.values()], float)
    centred = places - places.mean(axis=0)
    # The plane in which the places differ most, by the first two right singular vectors.
    flat = centred @ np.linalg.svd(centred, full_matrices=False)[2][:2].T
    if flat.shape[1] < 2:
        flat = np.column_stack([flat, np.zeros(len(flat))])
    reach = np.maximum(np.abs(flat).max(axis=0), 1e-6)
    scale = min(270.0 / reach[0], 110.0 / reach[1])
    place_of = {name: (320 + scale * p[0], 140 + scale * p[1]) for name, p in zip(placed, flat, strict=True)}
    lines = []
    for pair in sorted(pairs, key=lambda scan_pair: scan_pair.verdict is not ReportVerdict.REFUSED):
        if pair.first in place_of and pair.second in place_of:
            (x1, y1), (x2, y2) = place_of[pair.first], place_of[pair.second]
            dash = ' stroke-dasharray="4 4"' if pair.verdict is ReportVerdict.REFUSED else ""
            thick = 1.0 + 3.0 * math.sqrt((pair.overlap_percent or 0.0) / 100.0)
            lines.append(
                f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{VERDICT_COLOURS[pair.verdict]}" '
                f'stroke-opacity=".7" stroke-width="{thick:.1f}"{dash}/>'
            )
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="13" fill="#fff" stroke="{VERDICT_COLOURS[placed[name].verdict]}" stroke-width="2.5"/>'
        f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{html.escape(_short(name))}</text>'
        for name, (x, y) in place_of.items()
    )
    return (
        '<svg class="chart net" viewBox="0 0 640 280" role="img" aria-label="Places of the scans and the pairs between them">'
        f'{"".join(lines)}<g font-size="11" fill="{INK}">{dots}</g></svg>'
    )


def _short(name: str) -> str:
    """Return a name that fits into a dot: a scan's number without leading zeros."""
    return (name.lstrip("0") or "0")[-4:]
