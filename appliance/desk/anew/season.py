"""Page about a season: lengths over time, calibration health, water, and refused scans with reasons.

It is made from a table of ``kingfisher archive reprocess`` alone, and loads no other file, on a screen and on paper.
"""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median

from appliance.base import Page
from appliance.desk.anew.results import read_table
from appliance.measure import Grade

Cells = Mapping[str, str]
_WIDE, _HIGH = 1060, 230
_LEFT, _RIGHT, _TOP, _BOTTOM = 62, 40, 14, 40
_COLOURS = ("#11698e", "#b25c00", "#4b7f2a", "#8a3d8f", "#a32638", "#5b6b7b")
_SHOWN_DIGITS, _TICKS = 12, 5
_MAX_LABELS = 10
"""Number of scans with a label below the chart; a date is as wide as a tenth of it."""
_BINS = 400
"""Number of places along a chart; of several scans of a group in one place, the lowest and the highest are drawn."""
_MAX_NUMBER = 1e12
"""Largest number of a table that is drawn: axes of larger ones would not be finite."""


def page_of_table(table: Path) -> tuple[str, int]:
    """Return the page about the season of a table, and the number of its scans. Raises ResultsError."""
    rows = read_table(table)
    return season_page(rows, str(table)), len(rows)


def season_page(rows: Sequence[Cells], source: str) -> str:
    """Return the page about the ``rows`` of a table (``results.read_table``); it names ``source``."""
    # Rows of a compensated scan come from a model, in which rays always meet.
    measured = [row if "compensation=yes" not in row["verdicts"].split() else {**row, "gap_mm": ""} for row in rows]
    times = sorted(_recorded(row) for row in rows if row["recorded"]) or ["no clock"]
    calibrations = sorted({row["calibration"][:_SHOWN_DIGITS] for row in rows if row["calibration"]})
    facts = {"From": times[0], "To": times[-1], "Calibrations": _shorten_list(calibrations, 3, ", "), "Table": source}
    page = Page("Season at a glance", f"{len(rows)} scans", facts)
    page.tiles(_tiles(rows))
    charts: tuple[tuple[str, str, Sequence[Cells], str, str, Callable[[Cells], str]], ...] = (
        ("Lengths over time", "Measured minus calibrated length. A step: a knock or a new calibration. A slope: the housing moves.",
         rows, "length_error_mm", "length error, µm", lambda row: row["artefact"]),
        ("Health of the calibration", "Median ray gap of the points. It rises when a camera moves or the water differs.",
         measured, "gap_mm", "ray gap, µm", lambda row: row["calibration"][:_SHOWN_DIGITS]),
        ("Noise", "Median standard deviation of a point.",
         rows, "noise_mm", "noise, µm", lambda row: "spoilt" if row["spoilt"] == "True" else row["grade"] or "not graded"),
        ("Water", "Water temperature with which the scans are reprocessed.",
         rows, "temperature_c", "water, °C", lambda row: f"{row['salinity_psu'].removesuffix('.0')} psu" if row["salinity_psu"] else ""),
    )  # fmt: skip
    for heading, text, drawn, column, quantity, group in charts:
        page.heading(heading)
        page.note(text)
        chart = _chart(drawn, column, quantity, group)
        if chart:
            page.add(chart)
        else:
            page.note("No values in the table.")
    page.heading("Rejected scans, with reasons")
    _add_refusals(page, [row for row in rows if _is_refused(row)])
    return page.as_html()


def _tiles(rows: Sequence[Cells]) -> list[tuple[str, str, str]]:
    done = [row for row in rows if row["state"] == "done"]
    used = [row for row in rows if not _is_refused(row)]
    errors, noises, points = (
        [abs(value) for row in done if (value := _number(row[column])) is not None]
        for column in ("e_l_percent", "noise_mm", "points")
    )
    grades = Counter(row["grade"] for row in used)
    counts = [f"{grades[grade.value]} {grade.value}" for grade in Grade if grades[grade.value]]
    counts += [f"{len(done) - len(used)} spoilt", f"{len(rows) - len(done)} without points"]
    of_lists = f"{len(errors)} scans of artefacts" if errors else "no scan of an artefact"
    return [
        ("Scans with points", f"{len(used)} of {len(rows)}", ", ".join(counts)),
        ("Points", f"{sum(points) / 1e6:.1f} million", f"{median(points):,.0f} a scan (median)" if points else ""),
        ("Noise", f"{1000 * median(noises):.0f} µm" if noises else "–", "median over scans"),
        ("Largest length error", f"{max(errors):.3f} %" if errors else "–", of_lists),
    ]


def _chart(rows: Sequence[Cells], column: str, quantity: str, group: Callable[[Cells], str]) -> str:
    """Return dots over the scans' order, coloured by their group, with round numbers beside them.

    The text is empty without points.
    """
    scale = 1000.0 if column.endswith("_mm") else 1.0
    # In the order of scan numbers, which is that of capture, since clocks may be wrong.
    points = [(scale * value, index) for index, row in enumerate(rows) if (value := _number(row[column])) is not None]
    if not points:
        return ""
    low, high = min(points)[0], max(points)[0]
    largest = max(abs(low), abs(high))
    # For values that differ only in their last digits, or are nearly zero, an axis would have no length.
    rough = max((high - low or largest or 1.0) / _TICKS, 1e-9 * largest, 1e-12)
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * next(factor for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= rough)
    low, high = step * math.floor(low / step), step * math.ceil(high / step)
    high = high if high > low else low + step

    def x(index: int) -> float:
        return _LEFT + (index + 0.5) / len(rows) * (_WIDE - _LEFT - _RIGHT)

    def y(value: float) -> float:
        return _HIGH - _BOTTOM - (value - low) / (high - low) * (_HIGH - _TOP - _BOTTOM)

    drawn = []
    for value in (low + k * step for k in range(round((high - low) / step) + 1)):
        zero = abs(value) < step / 2
        ink = "#8a97a4" if zero and low < 0.0 < high else "#d5dde5"
        label = f"{0.0 if zero else value:.6g}".replace("-", "−")
        drawn.append(
            f'<line x1="{_LEFT}" x2="{_WIDE - _RIGHT}" y1="{y(value):.1f}" y2="{y(value):.1f}" stroke="{ink}"/>'
            f'<text x="{_LEFT - 8}" y="{y(value) + 4:.1f}" text-anchor="end">{label}</text>'
        )
    for place in sorted({f"{x(index):.1f}" for index, row in enumerate(rows) if _is_refused(row)}, key=float):
        drawn.append(f'<path d="M{place} {_HIGH - _BOTTOM + 1}v6" stroke="#c2281d" stroke-width="2"/>')
    for index in sorted({round(k * (len(rows) - 1) / (_MAX_LABELS - 1)) for k in range(_MAX_LABELS)}):
        for text, up_px in ((rows[index]["scan"], 22), (rows[index]["recorded"][:10], 7)):
            drawn.append(
                f'<text x="{x(index):.1f}" y="{_HIGH - up_px}" text-anchor="middle">{html.escape(text)}</text>'
            )
    groups = [name for name, _ in Counter(group(rows[index]) for _, index in points).most_common()]
    colour = {name: _COLOURS[min(k, len(_COLOURS) - 1)] for k, name in enumerate(groups)}
    bins: dict[tuple[int, str], list[tuple[float, int]]] = {}
    for value, index in points:
        bins.setdefault((index * min(len(rows), _BINS) // len(rows), group(rows[index])), []).append((value, index))
    for (_, name), members in bins.items():
        for value, index in sorted({min(members), max(members)}):
            tooltip = html.escape(f"{rows[index]['scan']}  {_recorded(rows[index])}  {value:.4g}")
            drawn.append(
                f'<circle cx="{x(index):.1f}" cy="{y(value):.1f}" r="3" fill="{colour[name]}" fill-opacity=".75"><title>{tooltip}</title></circle>'
            )
    names = [f'<span style="color:{colour[name]}">●</span> {html.escape(name) or "not known"}' for name in groups]
    return (
        f'<figure><svg viewBox="0 0 {_WIDE} {_HIGH}" style="width:100%;height:auto" font-size="12" fill="#5b6b7b" role="img" '
        f'aria-label="{quantity}">{"".join(drawn)}</svg><figcaption>{quantity}; scans in the order of capture; '
        "rejected scans are marked red. "
        f"{_shorten_list(names, len(_COLOURS), ' ')}</figcaption></figure>"
    )


def _shorten_list(names: Sequence[str], max_count: int, separator: str) -> str:
    return separator.join(names[:max_count]) + (f" and {len(names) - max_count} more" if len(names) > max_count else "")


def _is_refused(row: Cells) -> bool:
    return row["state"] != "done" or row["spoilt"] == "True"


def _add_refusals(page: Page, refused: Sequence[Cells]) -> None:
    if not refused:
        page.note("None.")
        return
    page.rows([{"reason": kind, "scans": count} for kind, count in Counter(map(_kind, refused)).most_common()])
    page.heading("All scans")
    page.rows(
        [
            {"scan": row["scan"], "recorded": _recorded(row) or "–", "faults and verdicts": _reason_text(row)}
            for row in refused
        ]
    )


def _recorded(row: Cells) -> str:
    return row["recorded"][:16].replace("T", " ")


def _reason_text(row: Cells) -> str:
    """Return why a scan is refused, without its folder, which is in the table."""
    return (row["reason"] or row["faults"]).replace(row["folder"], "").lstrip("/: ") or "not known"


def _kind(row: Cells) -> str:
    """Return a reason's kind: the first fault's name, or the start of an error, without numbers of the scan."""
    return _reason_text(row).partition(";" if row["reason"] else ":")[0].partition(" (")[0]


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= _MAX_NUMBER else None
