"""Figures of the naming of causes: how often the first cause of a bad scan is a true one.

``scans`` sets the number of bases: each gives 40 to 50 scenes, degraded by up to three of four factors. True causes
come from the simulator alone (``causes_truth``).
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from appliance.measure.verdict import Grade
from bench.result import Measurement
from bench.verdict.binomial import count_text, rate, tally
from bench.verdict.causes_scenes import Base, FactorLevels, draw_base, grid_of
from bench.verdict.causes_truth import FACTOR_OF, Outcome, Truth
from bench.verdict.parts import Say
from bench.verdict.worlds import ORDINARY

SCANS_PER_BASE = 40
RIGHT_PERCENT = 98.0

Row = dict[str, Any]


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure as many bases as give at least ``scans`` scenes; judge each scene, and examine each bad one.

    With ``keep``, frames and the results of this version of the product are stored there and reused, and so are the
    rows so far.
    """
    bases = max(1, -(-scans // SCANS_PER_BASE))
    rows: list[Row] = []
    for number in range(bases):
        base, grid = draw_base(seed, number), grid_of(seed, number)
        truth = Truth(base, keep, world)
        for k, levels in enumerate(grid):
            say("causes", (number + k / len(grid)) / bases)
            rows.append(_row(number, base, levels, truth))
            if keep is not None:
                (keep / f"causes-rows-{world}-{seed}.json").write_text(json.dumps(rows) + "\n", encoding="utf-8")
    return figures(rows), {"rows": rows, "by_reason": by_reason(rows)}


def _row(number: int, base: Base, levels: FactorLevels, truth: Truth) -> Row:
    outcome = truth.outcome(levels)
    row: Row = {
        "base": number, "object": base.scene.object, "texture": base.scene.texture, "scene": levels.name,
        "hands": levels.hands, "water": levels.water, "light": levels.light, "distance": levels.distance,
        "grade": outcome.grade.value, "reasons": [code.value for code in outcome.reasons],
        "coverage_percent": outcome.coverage_percent, "good": outcome.good, "error_mm": outcome.error_mm,
        "texts": outcome.texts, "numbers": outcome.numbers,
    }  # fmt: skip
    if outcome.grade is Grade.BAD:
        blamed = _blamed(outcome)
        row["true"] = sorted(truth.causes(levels, blamed))
        row["mends"] = sorted(truth.mending(levels, blamed))
        row["blamed"] = blamed
        row["right"] = blamed is not None and blamed in row["true"]
    return row


def _blamed(outcome: Outcome) -> str | None:
    """Return the factor that the first cause names; ``None`` without a cause, or for one of no factor."""
    return FACTOR_OF.get(outcome.reasons[0]) if outcome.reasons else None


def figures(rows: Sequence[Row]) -> list[Measurement]:
    """Return the rates with their intervals."""
    bad = [row for row in rows if row["grade"] == Grade.BAD.value]
    right = sum(row["right"] for row in bad)
    mending = sum(row["blamed"] in row["mends"] for row in bad)
    silent = sum(not row["reasons"] for row in bad)
    unknown = sum(row["reasons"][:1] == ["SCAN_POOR"] for row in bad)
    good = [row for row in rows if row["grade"] == Grade.GOOD.value]
    warned = sum(bool(row["reasons"]) for row in good)
    return [
        Measurement("scenes", float(len(rows)), "scenes"),
        tally("of these bad", len(bad), len(rows)),
        rate("first reason is a true one", right, len(bad), at_least=RIGHT_PERCENT, key="causes_right_percent"),
        rate("first reason is one that mends the scan by itself, if any does", mending, len(bad)),
        tally("bad without a reason", silent, len(bad), at_most=0.0, key="causes_silent"),
        tally("bad, and said that the cause is not known", unknown, len(bad)),
        tally("good, and yet warned of something", warned, len(good)),
    ]


def by_reason(rows: Sequence[Row]) -> dict[str, str]:
    """Return the frequency at which each first reason was a true one, with limits."""
    bad = [row for row in rows if row["grade"] == Grade.BAD.value]
    all_of = Counter((row["reasons"] or ["none"])[0] for row in bad)
    right = Counter((row["reasons"] or ["none"])[0] for row in bad if row["right"])
    return {name: count_text(right[name], number) for name, number in sorted(all_of.items())}
