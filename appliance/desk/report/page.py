"""Owns the page of a report: what stands where, how it looks on a screen and on paper, and that it asks for nothing from outside."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from appliance.desk.report.charts import colour_bar, histogram, minus, net
from appliance.desk.report.content import (
    Report,
    ReportBudget,
    ReportNominal,
    ReportPair,
    ReportScan,
    ReportVerdict,
    Vector,
)
from appliance.desk.report.frame import document, head, table, tiles
from appliance.desk.report.shown import ShownSurface, shown, thinned
from appliance.desk.report.still import still
from appliance.desk.report.turned import turned
from appliance.measure import Grade
from appliance.store import LocalFileSystem, replace_file

SUFFIX = ".html"
_POLICY = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src 'unsafe-inline' 'unsafe-eval'"
"""Content security policy: whatever a browser would fetch from elsewhere is forbidden, so that nothing leaves with the page."""
_WORDS = {
    ReportVerdict.GOOD: ("good", "✓"),
    ReportVerdict.DOUBTFUL: ("doubtful", "!"),
    ReportVerdict.UNCHECKED: ("unchecked", "?"),
    ReportVerdict.REFUSED: ("refused", "✕"),
}
_SMALL_MM = 1.0


def write_report(path: Path | str, report: Report) -> None:
    """Write the page, whole or not at all. Raises StorageError, MissingLibraryError where plotly is absent."""
    replace_file(LocalFileSystem(), Path(path), page(report).encode())


def page(report: Report) -> str:
    """Return the page as HTML; everything it needs is in it. Raises MissingLibraryError where plotly is absent."""
    full = shown(report)
    view, scripts = _view(full, report.up) if full is not None else ("", "")
    parts = [
        head(report.title, report.subtitle, report.about),
        tiles(_tiles(report)),
        _list("Warnings", report.warnings, "warnings"),
        view,
        "" if report.nominal is None or full is None else _nominal(report.nominal, full),
        "" if report.budget is None else _budget(report.budget),
        _scans(report.scans),
        _pictures(report.scans),
        _pairs(report.scans, report.pairs),
        _READING,
    ]
    return document(report.title, _POLICY, parts, scripts)


def _tiles(report: Report) -> list[tuple[str, str, str]]:
    found: list[tuple[str, str, str]] = []
    if report.scans:
        graded = [scan.grade for scan in report.scans if scan.grade is not None]
        used = [scan for scan in report.scans if scan.verdict is not ReportVerdict.REFUSED]
        doubtful = sum(scan.verdict is ReportVerdict.DOUBTFUL for scan in used)
        counts = [f"{graded.count(grade)} {grade.value}" for grade in Grade if grade in graded]
        of_them = ", ".join(counts) if graded else f"{doubtful} doubtful" if doubtful else ""
        found.append(("Scans used", f"{len(used)} of {len(report.scans)}", of_them))
    if report.surface is not None and len(report.surface.grey):
        median = float(np.median(report.surface.sigma_mm))
        found.append(("Points", _count(len(report.surface.grey)), f"sigma {_mm(median)} (median)"))
    elif report.mesh is not None:
        found.append(("Triangles", _count(len(report.mesh.faces)), f"between {_count(len(report.mesh.grey))} points"))
    if report.nominal is not None:
        summary = report.nominal.deviation.summary
        found.append(("Deviation, RMS", _mm(summary.rms_mm), f"from {report.nominal.name}"))
    if report.budget is not None:
        found.append(
            (
                f"Uncertainty over {report.budget.over_mm:.0f} mm",
                f"± {_mm(2 * report.budget.combined_mm)}",
                "two standard deviations",
            )
        )
    return found


def _list(title: str, lines: Sequence[str], kind: str) -> str:
    if not lines:
        return ""
    return f'<section class="{kind}"><h2>{title}</h2><ul>{"".join(f"<li>{html.escape(line)}</li>" for line in lines)}</ul></section>'


def _view(full: ShownSurface, up: Vector) -> tuple[str, str]:
    few = thinned(full)
    element, scripts = turned(few, up)
    # Points are drawn from all there are; triangles from those of the browser, since they are filled one by one.
    drawn = few if few.faces is not None else full
    picture = still(drawn, drawn.colourings[0], up)
    bars = "".join(
        f'<div class="colouring" data-colouring="{k}"{"" if k == 0 else " hidden"}>{colour_bar(one)}</div>'
        for k, one in enumerate(full.colourings)
    )
    told = f"{_count(len(few.points_mm))} of {_count(len(full.points_mm))}" if few is not full else "all"
    what = "triangles between" if full.faces is not None else "surface of"
    return (
        f'<section class="view"><h2>Surface</h2>{element}<figure class="paper">{picture}</figure>{bars}'
        f'<p class="note screen">Drag to turn, wheel to go nearer. Drawn: {what} {told} points.</p></section>'
    ), scripts


def _nominal(nominal: ReportNominal, full: ShownSurface) -> str:
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
            f"Farther than {summary.limit_mm:g} mm, not counted above",
            f"{_count(summary.beyond)} ({share:.2f} %)",
        ),
    ]
    if nominal.tolerance_mm is not None:
        near = abs(nominal.deviation.deviation_mm)
        # Points beyond the limit are NaN, and out of tolerance all the same.
        outside = 100.0 * (1.0 - float((near <= nominal.tolerance_mm).mean())) if len(near) else 0.0
        lines.append((f"Out of ± {_mm(nominal.tolerance_mm)}", f"{outside:.2f} %"))
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in lines)
    return (
        f"<section><h2>Deviation from {html.escape(nominal.name)}</h2><div class='beside'>"
        f"<figure>{histogram(nominal, full.colourings[0])}</figure><table class='figures'>{rows}</table></div></section>"
    )


def _budget(budget: ReportBudget) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(term.what)}</td><td>{_mm(term.value_mm)}</td><td>{html.escape(term.how)}</td></tr>"
        for term in budget.terms
    )
    statement = f"<p>{html.escape(budget.statement)}</p>" if budget.statement else ""
    return (
        f"<section><h2>Uncertainty over {budget.over_mm:.0f} mm</h2>{statement}<table><thead><tr><th>Contribution</th><th>Standard "
        f"uncertainty</th><th>Source</th></tr></thead><tbody>{rows}</tbody><tfoot><tr><th>All together</th><th>{_mm(budget.combined_mm)}"
        f"</th><th>twice that, ± {_mm(2 * budget.combined_mm)}, covers some 95 %</th></tr></tfoot></table></section>"
    )


def _scans(scans: Sequence[ReportScan]) -> str:
    if not scans:
        return ""
    rows = (
        (
            f"<b>{html.escape(scan.name)}</b>",
            _chip(scan.verdict, scan.word),
            _given(scan.points, _count),
            _given(scan.distance_mm, lambda mm: f"{mm:.0f} mm"),
            _mm(scan.sigma_mm),
            _mm(scan.ray_gap_mm),
            _vector(scan.position_mm, 2),
            _vector(scan.rotation_deg, 3),
            _given(scan.pose_sigma_mm, lambda mm: f"± {_mm(mm)}"),
            _said(scan.reason, scan.warnings, scan.recorded),
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
        "Place in mm",
        "Rotation in °",
        "Pose",
        "Remarks",
    )
    return f"<section><h2>Scans</h2>{table(columns, rows, 'scans')}</section>"


def _pictures(scans: Sequence[ReportScan]) -> str:
    shown_ = [(scan, scan.picture_png) for scan in scans if scan.picture_png is not None]
    if not shown_:
        return ""
    figures = "".join(
        f'<figure><img alt="scan {html.escape(scan.name)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'
        f"<figcaption><b>{html.escape(scan.name)}</b> {_given(scan.points, _count)} points</figcaption></figure>"
        for scan, png in shown_
    )
    return f'<section><h2>Pictures</h2><p class="note">As the left camera sees them; yellow is near, dark is far, within each picture.</p><div class="pictures">{figures}</div></section>'


def _pairs(scans: Sequence[ReportScan], pairs: Sequence[ReportPair]) -> str:
    if not pairs:
        return ""
    rows = (
        (
            f"<b>{html.escape(pair.first)}</b> – <b>{html.escape(pair.second)}</b>",
            _chip(pair.verdict),
            _given(pair.overlap_percent, lambda percent: f"{percent:.0f} %"),
            _given(pair.matches, str),
            _mm(pair.residual_mm),
            _given(pair.sigma_mm, lambda mm: f"± {_mm(mm)}"),
            _given(pair.sigma_deg, lambda deg: f"± {deg:.4f}°"),
            _said(pair.reason, (), None),
        )
        for pair in pairs
    )
    drawing = net(scans, pairs)
    figure = (
        f"<figure>{drawing}<figcaption>Places of the scans; the thicker a line, the larger the overlap. Dashed: refused, overlap unknown.</figcaption></figure>"
        if drawing
        else ""
    )
    columns = ("Pair", "Verdict", "Overlap", "Features", "Residual", "Displacement", "Rotation", "Remarks")
    return f"<section><h2>Pairs of scans</h2>{figure}{table(columns, rows, 'pairs')}</section>"


_READING = (
    '<section class="reading"><h2>How to read this</h2><p><b>Sigma</b> is the standard deviation of a point: of one scan along its ray, '
    "of the fused surface along its normal, in the object's frame: the noise of the scans, the uncertainty of their places, and by how much the object may be "
    "<b>bent</b> there by what all scans have in common, which no number of them makes smaller and no residual shows. Near by, most of the last two cancels. "
    "<b>Ray gap</b> is how far the rays of both "
    "cameras pass each other: the check of the calibration that every point brings with it. The <b>residual</b> of a pair tells how well both "
    "scans lie on each other, and nothing about sliding along a pipe or a plane; the uncertainties of displacement and rotation do. "
    "<b>Deviations</b> are along the nominal surface's normal, positive outside.</p></section>"
)


def _chip(verdict: ReportVerdict, shown: str | None = None) -> str:
    word, sign = _WORDS[verdict]
    return f'<span class="chip {word}">{sign} {shown or word}</span>'


def _said(reason: str, warnings: Sequence[str], recorded: str | None) -> str:
    lines = [html.escape(line) for line in (reason, *warnings) if line]
    if recorded:
        lines.append(f"<small>{html.escape(recorded)}</small>")
    return "<br>".join(lines)


def _given(value: float | None, text: Callable[[float], str]) -> str:
    return "–" if value is None else text(value)


def _vector(value: Vector | None, digits: int) -> str:
    if value is None:
        return "–"
    parts = "".join(f"<span>{minus(f'{part:.{digits}f}')}</span> " for part in value)
    return f'<span class="vector">{parts}</span>'


def _count(number: float) -> str:
    return f"{number:,.0f}".replace(",", "\u202f")


def _mm(value: float | None) -> str:
    """Return a length as people say it: µm below a millimetre, to a tenth of one, and from a tenth of a millimetre on whole."""
    if value is None:
        return "–"
    if abs(value) < _SMALL_MM:
        return minus(f"{1000.0 * value:.0f} µm" if abs(value) >= 0.1 else f"{1000.0 * value:.1f} µm")
    return minus(f"{value:.3f} mm")
