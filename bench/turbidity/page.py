"""Generator of tables and picture of ``docs/turbidity.md`` from measured values."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from bench.turbidity.plot import Line, Panel, draw

BEGIN, END = "<!-- figures: ./dev bench turbidity --write-docs -->", "<!-- end of figures -->"
X_MARKS = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
HALF, NEARLY = 50.0, 95.0
"""Percent of the object: where the scanner counts as having stopped, and where it still does all of its work."""
SERIES = ("attenuation alone", "all three", "all three, exposure and gain", "milky, exposure and gain")
"""Series of the first table; the picture has all."""
ATTENUATIONS_PER_M = (0.5, 1.0, 2.0, 3.0, 4.0)
"""Rows of the second table."""
Rows = Sequence[Mapping[str, Any]]


def write_page(data: Path, page: Path, pictures: Path) -> None:
    """Replace the text between the marks, and draw the picture. Raises OSError, and ValueError for a page without
    marks."""
    content = json.loads(data.read_text(encoding="utf-8"))
    planes, artefacts = content["plane"]["rows"], content["artefacts"]["rows"]
    text = page.read_text(encoding="utf-8")
    if BEGIN not in text or END not in text:
        raise ValueError(f"{page} has no marks {BEGIN} and {END}")
    parts = [limits_table(planes), noise_table(planes)]
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    page.write_text(before + BEGIN + "\n\n" + "\n\n".join(parts) + "\n\n" + END + after, encoding="utf-8")
    draw(pictures / "turbidity.png", panels(planes, artefacts))


def by_attenuation(rows: Rows, key: str) -> list[tuple[float, float | None]]:
    """Return (attenuation, median over rigs) in order; ``None`` where no rig has a value."""
    medians = []
    for attenuation in sorted({row["attenuation_per_m"] for row in rows}):
        values = [row[key] for row in rows if row["attenuation_per_m"] == attenuation and row[key] is not None]
        medians.append((attenuation, median(values) if values else None))
    return medians


def reaches(rows: Rows, percent: float) -> float | None:
    """Return the attenuation above which completeness stays below ``percent``; ``None`` without one.

    Values between the measured ones are interpolated.
    """
    line = [(x, y) for x, y in by_attenuation(rows, "completeness_percent") if y is not None]
    above = [k for k, (_, y) in enumerate(line) if y >= percent]
    if not above or above[-1] + 1 == len(line):
        return None
    (x0, y0), (x1, y1) = line[above[-1]], line[above[-1] + 1]
    return x0 + (x1 - x0) * (y0 - percent) / (y0 - y1)


def limits_table(rows: Rows) -> str:
    """Return a table with the limits of each series."""
    lines = [
        "| Water, cameras | complete to 95 % up to | half of it up to | noise at 1 /m, µm | at 2 /m | at 3 /m | wrong, ppm |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    series = _series(rows)
    for name in SERIES:
        mine = series[name]
        noise = dict(by_attenuation(mine, "rms_um"))
        wrong = [row["wrong_ppm"] for row in mine if row["wrong_ppm"] is not None]
        cells = [_say(reaches(mine, NEARLY), "{:.1f} /m"), _say(reaches(mine, HALF), "{:.1f} /m")]
        cells += [_say(noise.get(x), "{:.0f}") for x in (1.0, 2.0, 3.0)]
        cells.append(_say(max(wrong, default=None), "≤ {:.0f}"))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def noise_table(rows: Rows) -> str:
    """Return expected and actual noise, and the attenuation by the scan, in water with all effects."""
    mine = _series(rows)["all three, exposure and gain"]
    columns: tuple[tuple[str, str], ...] = (
        ("completeness_percent", "{:.1f}"),
        ("rms_um", "{:.0f}"),
        ("sigma_um", "{:.0f}"),
        ("said_per_m", "{:.2f}"),
        ("said_sigma_per_m", "{:.2f}"),
    )
    lines = [
        "| All three, exposure and gain: c, 1/m | complete, % | noise, µm | sigma (median), µm | stated c, 1/m | ± |",
        "|---:|" + "---:|" * len(columns),
    ]
    values = {key: dict(by_attenuation(mine, key)) for key, _ in columns}
    for attenuation in ATTENUATIONS_PER_M:
        cells = [_say(values[key][attenuation], form) for key, form in columns]
        lines.append(f"| {attenuation:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def panels(planes: Rows, artefacts: Rows) -> list[Panel]:
    """Return completeness, noise, lengths and flatness, and the attenuation by scans."""

    def lines(key: str) -> list[Line]:
        return [_line(name, by_attenuation(mine, key)) for name, mine in _series(planes).items()]

    rows = _series(planes)["milky, exposure and gain"]
    stated = by_attenuation(rows, "said_per_m")
    errors: list[Line] = []
    for name, mine in _series(artefacts).items():
        short = name.partition(",")[0]
        short = "fresh" if short == "all three" else short
        for key, what in (("e_l_percent", "E_L ball bar"), ("e_f_sys_percent", "E_F,sys")):
            errors.append(_line(f"{what}, {short}", _worst_by_attenuation(mine, key)))
    return [
        Panel("Completeness, %, over attenuation, 1/m", lines("completeness_percent"), X_MARKS, (0, 25, 50, 75, 100)),
        Panel(
            "Noise (rms error), um, over attenuation, 1/m", lines("rms_um"), X_MARKS,
            (20, 50, 100, 200, 500), log_y=True,
        ),
        Panel(
            "Worst error, %, over attenuation, 1/m", errors, X_MARKS[:5], (0.001, 0.003, 0.01, 0.03, 0.1), log_y=True
        ),
        Panel(
            "Attenuation as a scan states it, over the true one, 1/m",
            [
                Line(
                    "milky",
                    [x for x, _ in stated],
                    [y for _, y in stated],
                    [sigma for _, sigma in by_attenuation(rows, "said_sigma_per_m")],
                ),
                Line("truth", (0.0, 8.0), (0.0, 8.0)),
            ],
            X_MARKS,
            X_MARKS,
        ),
    ]  # fmt: skip


def _series(rows: Rows) -> dict[str, list[Mapping[str, Any]]]:
    series: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        series.setdefault(row["series"], []).append(row)
    return series


def _line(name: str, points: Sequence[tuple[float, float | None]]) -> Line:
    return Line(name, [x for x, _ in points], [y for _, y in points])


def _worst(rows: Rows, key: str) -> float | None:
    return max((abs(row[key]) for row in rows if row[key] is not None), default=None)


def _worst_by_attenuation(rows: Rows, key: str) -> list[tuple[float, float | None]]:
    attenuations = sorted({row["attenuation_per_m"] for row in rows})

    return [(x, _worst([row for row in rows if row["attenuation_per_m"] == x], key)) for x in attenuations]


def _say(value: float | None, form: str) -> str:
    return "—" if value is None else form.format(value)
