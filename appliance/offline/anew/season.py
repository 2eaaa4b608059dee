"""Owns the page about a season: lengths over time, health of the calibration, water, and which scans were refused and why.

Made from a table of ``kingfisher reprocess`` alone; it asks for nothing from outside, on a screen and on paper.
"""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from appliance.report.style import STYLE
from appliance.scan.grade import Grade
from appliance.storage.names import by_number

Cells = Mapping[str, str]
_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
_WIDE, _HIGH = 1060, 230
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 12, 14, 40
_COLOURS = ("#11698e", "#b25c00", "#4b7f2a", "#8a3d8f", "#a32638", "#5b6b7b")
_MOST_COLOURS = len(_COLOURS)
_MOST_LISTED = 60
_SHOWN_DIGITS = 12
_TICKS = 5
_MOST_NAMED = 10
"""Scans up to which each has its number below the chart; their dates are as wide as a tenth of it."""
_BINS = 400
"""Places along a chart; where several scans of a group share one, the lowest and the highest are drawn."""
_KIND_LETTERS = 90
_REFUSED = "#c2281d"


@dataclass(frozen=True, slots=True)
class _Point:
    at: int
    """Place of the scan among all, by number: the order in which they were taken, whatever a clock said."""
    value: float
    group: str
    words: str


def season_page(rows: Sequence[Cells], source: str) -> str:
    """Return the page about the ``rows`` of a table (``results.read_table``); ``source`` is named on it."""
    done = [row for row in rows if row["state"] == "done"]
    failed = [row for row in rows if row["state"] != "done"]
    spoilt = [row for row in done if row["spoilt"] == "True"]
    # Rows of a compensated scan come from a model, in which rays always meet; tables of before have their gaps.
    known = [row if "compensation=yes" not in row["verdicts"].split() else {**row, "gap_mm": ""} for row in rows]
    gaps = _points(known, "gap_mm", lambda row: row["calibration"][:_SHOWN_DIGITS], 1000.0)
    parts = [
        _head(rows, source),
        _tiles(rows, done, spoilt, failed),
        (
            "<h2>Lengths over time</h2><section><p>What the artefacts of the list were measured as, less what their certificates say. A step "
            "is a knock or a new calibration; a slope is a housing that moves. Red marks below each chart are refused scans.</p></section>"
        ),
        _chart(_points(rows, "length_error_mm", lambda row: row["artefact"], 1000.0), "length error, µm", rows),
        (
            "<h2>Health of the calibration</h2><section><p>Median distance at which the two rays of a point miss each other, one dot a scan, one "
            "colour a calibration. It rises when a camera moved or the water is not what was believed.</p></section>"
        ),
        _chart(gaps, "ray gap, µm", rows),
        "<h2>Noise</h2><section><p>Median expected standard deviation of a point.</p></section>",
        _chart(
            _points(
                rows,
                "noise_mm",
                lambda row: "spoilt" if row["spoilt"] == "True" else row["grade"] or "not graded",
                1000.0,
            ),
            "noise, µm",
            rows,
        ),
        "<h2>Water</h2><section><p>Temperature that the scans were worked through with.</p></section>",
        _chart(
            _points(
                rows,
                "temperature_c",
                lambda row: "" if (salinity := _number(row["salinity_psu"])) is None else f"{salinity:g} psu",
                1.0,
            ),
            "water, °C",
            rows,
        ),
        _refused(failed, spoilt),
    ]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>Season</title><style>{STYLE}</style></head>\n'
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _head(rows: Sequence[Cells], source: str) -> str:
    times = sorted(row["recorded"] for row in rows if row["recorded"])
    calibrations = sorted({row["calibration"] for row in rows if row["calibration"]})
    facts = {
        "From": times[0][:16].replace("T", " ") if times else "no clock",
        "To": times[-1][:16].replace("T", " ") if times else "no clock",
        "Calibrations": ", ".join(one[:_SHOWN_DIGITS] for one in calibrations[:3])
        + (f" and {len(calibrations) - 3} more" if len(calibrations) > 3 else ""),
        "Table": source,
    }
    # A path may break at its slashes, and not within "table.csv".
    listed = "".join(
        f"<div><dt>{name}</dt><dd>{html.escape(text).replace('/', '/<wbr>')}</dd></div>" for name, text in facts.items()
    )
    return f"<header><h1>Season at a glance</h1><p>{len(rows)} scans</p><dl>{listed}</dl></header>"


def _tiles(rows: Sequence[Cells], done: Sequence[Cells], spoilt: Sequence[Cells], failed: Sequence[Cells]) -> str:
    errors = [abs(value) for row in done if (value := _number(row["e_l_percent"])) is not None]
    noises = [value for row in done if (value := _number(row["noise_mm"])) is not None]
    points = [value for row in done if (value := _number(row["points"])) is not None]
    tiles = [
        (
            "Scans with points",
            f"{len(done) - len(spoilt)} of {len(rows)}",
            ", ".join([*_graded(done), f"{len(spoilt)} spoilt, {len(failed)} without points"]),
        ),
        ("Points", f"{sum(points) / 1e6:.1f} million", f"{median(points):,.0f} a scan (median)" if points else ""),
        ("Noise", f"{1000 * median(noises):.0f} µm" if noises else "–", "median over scans"),
        (
            "Largest length error",
            f"{max(errors):.3f} %" if errors else "–",
            f"{len(errors)} scans of artefacts" if errors else "no scan is in a --list",
        ),
    ]
    return f'<div class="tiles">{"".join(f"<div class=tile><span>{name}</span><b>{value}</b><small>{small}</small></div>" for name, value, small in tiles)}</div>'


def _graded(done: Sequence[Cells]) -> list[str]:
    """Return how many scans have which grade; a spoilt one counts as that."""
    counts = Counter(row["grade"] for row in done if row["spoilt"] != "True")
    return [f"{counts[grade.value]} {grade.value}" for grade in Grade if counts[grade.value]]


def _points(rows: Sequence[Cells], column: str, group: Callable[[Cells], str], scale: float) -> list[_Point]:
    found = []
    for at, row in enumerate(rows):
        value = _number(row[column])
        if value is not None:
            words = f"{row['scan']}  {row['recorded'][:16].replace('T', ' ')}  {scale * value:.4g}"
            found.append(_Point(at, scale * value, group(row), words))
    return found


def _chart(points: Sequence[_Point], what: str, rows: Sequence[Cells]) -> str:
    """Return dots over the scans' order, coloured by their group, with round numbers beside them."""
    if not points:
        return '<p class="note">Nothing in the table.</p>'
    low, high = min(one.value for one in points), max(one.value for one in points)
    largest = max(abs(low), abs(high))
    # Of numbers that differ in their last digits alone, or are hardly more than nothing, an axis would have no length.
    rough = max((high - low) / _TICKS, 1e-9 * largest) if high > low else largest / _TICKS or 1.0
    step = _round_step(max(rough, 1e-12))
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    high = high if high > low else low + step

    def x(at: float) -> float:
        return _LEFT + (at + 0.5) / len(rows) * (_WIDE - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _HIGH - _BOTTOM - (value - low) / (high - low) * (_HIGH - _TOP - _BOTTOM)

    groups = [name for name, _ in Counter(one.group for one in points).most_common()]
    colour = {name: _COLOURS[min(k, _MOST_COLOURS - 1)] for k, name in enumerate(groups)}
    lines = []
    for k in range(round((high - low) / step) + 1):
        value = low + k * step
        ink = "#8a97a4" if abs(value) < step / 2 and low < 0.0 < high else "#d5dde5"
        lines.append(
            f'<line x1="{_LEFT}" x2="{_WIDE - _RIGHT}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="{ink}"/>'
        )
        said = f"{0.0 if abs(value) < step / 2 else value:.6g}"
        lines.append(f'<text x="{_LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{said.replace("-", "−")}</text>')
    marks = sorted({f"{x(at):.1f}" for at, row in enumerate(rows) if _is_refused(row)}, key=float)
    lines += [f'<path d="M{at} {_HIGH - _BOTTOM + 1}v6" stroke="{_REFUSED}" stroke-width="2"/>' for at in marks]
    last = len(rows) - 1
    places = range(len(rows)) if len(rows) <= _MOST_NAMED else [round(k * last / _TICKS) for k in range(_TICKS + 1)]
    for at in places:
        anchor = "start" if at == 0 else "end" if at == last else "middle"
        day = rows[at]["recorded"][:10]
        lines.append(
            f'<text x="{x(at):.1f}" y="{_HIGH - 22}" text-anchor="{anchor}">{html.escape(rows[at]["scan"])}</text>'
        )
        lines.append(
            f'<text x="{x(at):.1f}" y="{_HIGH - 7}" text-anchor="{anchor}" fill="#8a97a4">{html.escape(day)}</text>'
        )
    dots = [
        f'<circle cx="{x(one.at):.1f}" cy="{y(one.value):.1f}" r="3" fill="{colour[one.group]}" fill-opacity=".75"><title>{html.escape(one.words)}</title></circle>'
        for one in _thinned(points, len(rows))
    ]
    named = groups if groups != [""] else []
    shown = " ".join(
        f'<span style="color:{colour[name]}">●</span> {html.escape(name) or "not known"}'
        for name in named[:_MOST_COLOURS]
    )
    more = f" and {len(named) - _MOST_COLOURS} more" if len(named) > _MOST_COLOURS else ""
    return (
        f'<figure><svg viewBox="0 0 {_WIDE} {_HIGH}" style="width:100%;height:auto" font-size="12" fill="#5b6b7b" role="img" '
        f'aria-label="{html.escape(what)}">{"".join(lines + dots)}</svg><figcaption>{html.escape(what)}; scans in the order they were taken. '
        f"{shown}{more}</figcaption></figure>"
    )


def _thinned(points: Sequence[_Point], scans: int) -> list[_Point]:
    """Return the points that are drawn: of a whole archive the extremes of each place and group, for nothing that stands out may be lost."""
    bins: dict[tuple[int, str], list[_Point]] = {}
    for one in points:
        bins.setdefault((one.at * _BINS // scans if scans > _BINS else one.at, one.group), []).append(one)
    found = []
    for some in bins.values():
        low, high = min(some, key=lambda one: one.value), max(some, key=lambda one: one.value)
        found += [low] if low is high else [low, high]
    return found


def _is_refused(row: Cells) -> bool:
    return row["state"] != "done" or row["spoilt"] == "True"


def _refused(failed: Sequence[Cells], spoilt: Sequence[Cells]) -> str:
    if not failed and not spoilt:
        return "<h2>Refused scans</h2><p>None.</p>"
    reasons = Counter(_kind(row) for row in (*failed, *spoilt))
    counted = "".join(
        f"<tr><td>{html.escape(reason)}</td><td>{count}</td></tr>" for reason, count in reasons.most_common()
    )
    listed = [(row, _told(row)) for row in sorted((*failed, *spoilt), key=lambda row: by_number(row["scan"]))]
    each = "".join(
        f"<tr><td>{html.escape(row['scan'])}</td><td style='white-space:nowrap'>{html.escape(row['recorded'][:16].replace('T', ' ')) or '–'}</td><td>{html.escape(why)}</td></tr>"
        for row, why in listed[:_MOST_LISTED]
    )
    more = (
        f'<p class="note">and {len(listed) - _MOST_LISTED} more, in the table</p>' if len(listed) > _MOST_LISTED else ""
    )
    return (
        f"<h2>Refused scans, and why</h2><table><thead><tr><th>reason</th><th>scans</th></tr></thead><tbody>{counted}</tbody></table><h2>Each of them</h2>"
        f"<table><thead><tr><th>scan</th><th>recorded</th><th>what was found</th></tr></thead><tbody>{each}</tbody></table>{more}"
    )


def _told(row: Cells) -> str:
    """Return why a scan is refused, without its folder, which is in the table."""
    if row["faults"] and not row["reason"]:
        return row["faults"]
    return row["reason"].replace(f"{row['folder']}/", "").removeprefix(row["folder"]).lstrip(": ") or "not known"


def _kind(row: Cells) -> str:
    """Return a reason's kind: the faults' names, or how an error begins, without the numbers of that one scan."""
    if row["faults"] and not row["reason"]:
        return ", ".join(sorted({part.partition(":")[0].strip() for part in row["faults"].split(";") if ":" in part}))
    text = _told(row).partition(";")[0].partition(" (")[0]
    return text if len(text) <= _KIND_LETTERS else f"{text[:_KIND_LETTERS].rpartition(' ')[0]} …"


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _round_step(rough: float) -> float:
    power = 10.0 ** math.floor(math.log10(rough))
    return power * next(one for one in (1.0, 2.0, 5.0, 10.0) if one * power >= rough)
