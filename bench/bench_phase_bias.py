"""Systematic phase errors (response, defocus, borders of albedo), and the effect of corrected patterns."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from appliance.measure.light.response import Response
from bench.phase_bias.page import write_page
from bench.phase_bias.tables import (
    Row,
    after_compensation,
    artefacts,
    causes,
    distances,
    measured_response,
    paint,
    periods,
)
from bench.picture import Bar, Panel, draw
from bench.result import Measurement

OUT = Path("bench/out")
TABLES: dict[str, Callable[[Response], Iterator[Row]]] = {
    "causes": causes,
    "periods": periods,
    "distances": distances,
    "paint": paint,
    "artefacts": artefacts,
}
ROWS, PICTURE = "phase_bias-rows.json", "phase_bias.png"


def measure() -> Iterator[Measurement]:
    """Yield all tables, with limits."""
    yield from measured(tuple(TABLES))


def measured(tables: Sequence[str]) -> Iterator[Measurement]:
    """Yield some of ``TABLES``; the rows of the others stay as they were in ``ROWS``."""
    OUT.mkdir(parents=True, exist_ok=True)
    rows = [row for row in earlier() if row.table not in (*tables, "response")]
    response, recorded = measured_response()
    drawn = after_compensation(response)
    rows += [recorded, drawn]
    ratio = abs(recorded.values["phase error, °"] / drawn.values["phase error, °"])
    yield Measurement("phase error of fringes, before over after", ratio, "×", at_least=3.0)
    for table in tables:
        for row in TABLES[table](response):
            rows.append(row)
            (OUT / ROWS).write_text(
                json.dumps({"rows": [asdict(table_row) for table_row in rows]}, indent=1) + "\n", encoding="utf-8"
            )
            for name, value in row.values.items():
                at_most, at_least = bounds(row, name)
                yield Measurement(f"{row.table}: {row.name}: {name}", value, name.rpartition(" ")[2], at_most, at_least)
    draw(OUT / PICTURE, panels(rows))


def earlier() -> list[Row]:
    """Return the rows of the last run; none without one."""
    try:
        return [Row(**row) for row in json.loads((OUT / ROWS).read_text(encoding="utf-8"))["rows"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def bounds(row: Row, name: str) -> tuple[float | None, float | None]:
    """Return the bounds (at most, at least) of a figure; ``None`` for most."""
    if row.name.startswith("16 px: light") and name == "ripple of a coordinate, px":
        return 0.067 / 3.0, None  # a third of what it is without
    if row.table in ("periods", "distances") and name == "rms in sigmas":
        return 1.1, 0.9
    if row.table == "periods" and row.name.startswith("16 px") and name == "rms, µm":
        return 30.0, None
    return None, None


def panels(rows: Sequence[Row]) -> list[Panel]:
    """Return the panels: ripple of depth by cause, then all errors by cause and noise."""
    smallest = 0.01
    causes_um = [row for row in rows if row.table == "causes"]
    return [
        Panel(
            "Ripple of depth by cause, um, no noise", [_bar(row, "ripple of depth, µm", smallest) for row in causes_um]
        ),
        Panel(
            "Errors of points, rms, um, as the instrument is",
            [_bar(row, "rms, µm", smallest) for row in rows if row.table in ("periods", "distances")],
        ),
        Panel(
            "Points on borders of paint, rms, um",
            [_bar(r, "rms on borders, µm", smallest) for r in rows if r.table == "paint"],
        ),
    ]


SHORTER = {
    "500 mm, turned by 35°": "turned 35 deg",
    "500 mm, facing": "500 mm",
    "patterns drawn for it": "compensated",
    " of the projector": "",
    "°": " deg",
}
"""Replacements in the labels of the picture: short words, and no degree sign, which its font lacks."""


def _bar(row: Row, name: str, smallest: float) -> Bar:
    label = row.name
    for long, short in SHORTER.items():
        label = label.replace(long, short)
    return Bar(label, max(row.values[name], smallest))


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench phase_bias --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench phase_bias", description=__doc__)
    parser.add_argument("--tables", default=",".join(TABLES), help="names with commas between; default: %(default)s")
    parser.add_argument(
        "--write-docs", action="store_true", help="measure nothing; write docs/phase-bias.md from bench/out"
    )
    options = parser.parse_args(arguments)
    if options.write_docs:
        write_page(OUT / ROWS, Path("docs/phase-bias.md"))
        return 0
    tables = options.tables.split(",")
    for table in tables:
        if table not in TABLES:
            parser.error(f"--tables: {table!r} is unknown; allowed are {', '.join(TABLES)}")
    all_kept = True
    for number in measured(tables):
        sys.stdout.write(number.line() + "\n")
        all_kept = all_kept and number.is_kept
    return 0 if all_kept else 1
