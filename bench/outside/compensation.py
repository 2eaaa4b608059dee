"""The part ``compensation``: effect of motion compensation on hand motion, and rejection of spoilt results.

The named hands before the named objects, and drawn ones (``bench.verdict.compensation_cases``), each with all families and with the
calibration that states the truth, against the same scan at rest; 400 × 300 px.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from bench.outside.kept import Row, kept_row
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.binomial import tally
from bench.verdict.compensation import Judge, median, of, worse
from bench.verdict.compensation_cases import SMALL_PX, Case, drawn_case, named_cases
from bench.verdict.parts import Say
from bench.verdict.worlds import OUTSIDE

MOST_OVER_REST = 1.2
"""Largest error of a compensated scan that is shown, over that at rest."""
NAMED = 9
"""Of the named scans. A look at fewer drawn ones than these has none of them."""
PIPE = "pipe"


def measure(count: int, seed: int, say: Say, keep: Path | None = None) -> tuple[list[Measurement], dict[str, Any]]:
    """Return how far ``count`` drawn scans and the nine named ones err that are shown compensated, and how many are refused instead."""
    named = [replace(case, width_px=SMALL_PX) for case in named_cases(seed)] if count >= NAMED else []
    cases = [*named, *(drawn_case(seed, number) for number in range(count))]
    rows: list[Row] = []
    for done, row in enumerate(spread(partial(_row, keep=keep), cases), 1):
        say(f"compensation: {done} of {len(cases)}", done / len(cases))
        rows.append(row)
    first = len(named)
    return figures(rows[:first], rows[first:]), {"named": rows[:first], "drawn": rows[first:]}


def figures(named: Sequence[Row], drawn: Sequence[Row]) -> list[Measurement]:
    """Return the figures of the rows of named and random scans; every rate has its interval."""
    measured = []
    for name, rows in (("named", named), ("drawn", drawn)):
        moved = [row for row in rows if row["moved"]]
        shown = [row for row in moved if row["used"]]
        if not rows:
            continue
        measured += [
            tally(f"{name}, moving: shown compensated", len(shown), len(moved)),
            tally(f"{name}, moving: refused", len(moved) - len(shown), len(moved)),
            tally(f"{name}, shown: err over {MOST_OVER_REST:g} times as at rest", _beyond(shown), len(shown), at_most=0.0),
            of(f"{name}, shown: error over that at rest, median", shown, "after", median),
            of(f"{name}, shown: error over that at rest, largest", shown, "after", max),
            of(f"{name}, shown: the same, nothing done, median", shown, "before", median),
            tally(f"{name}: made worse by what is shown", sum(map(worse, rows)), len(rows), at_most=0.0),
            of(f"{name}, shown: error over sigma, median", _with_sigma(shown), "in_sigmas", median),
        ]  # fmt: skip
        still = [row for row in rows if not row["moved"]]
        if still:
            measured.append(
                tally(f"{name}, at rest: touched", sum(row["used"] for row in still), len(still), at_most=0.0)
            )
    pipes = [row for row in named if row["object"] == PIPE]
    if pipes:
        shown = [row for row in pipes if row["used"]]
        over = max((float(row["after"]) for row in shown), default=math.nan)
        measured += [
            tally("the checkered pipe: shown compensated, the others refused", len(shown), len(pipes)),
            Measurement("the checkered pipe, shown: error over that at rest, largest", over, "", at_most=MOST_OVER_REST)
            if shown
            else Measurement(
                "the checkered pipe, shown: error over that at rest, largest", over, "", why="all are refused"
            ),
        ]
    return measured


def _beyond(shown: Sequence[Row]) -> int:
    return sum(float(row["after"]) > MOST_OVER_REST for row in shown)


def _with_sigma(shown: Sequence[Row]) -> list[Row]:
    return [row for row in shown if row["in_sigmas"] is not None]


def _row(case: Case, keep: Path | None) -> Row:
    def compute() -> Row:
        (row,) = Judge(keep, OUTSIDE).rows(case)
        return row

    return kept_row(keep, ("compensation", case), compute)
