"""Effect of motion compensation in hard conditions: flickering light, milky water, no texture, depth steps with sharp
labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.result import Measurement
from bench.verdict.compensation import judge_cases, made_worse, of
from bench.verdict.compensation_cases import HARD, hard_cases
from bench.verdict.parts import Say
from bench.verdict.worlds import ORDINARY


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the figures of every named motion in every such condition; ``scans`` is not used."""
    rows = judge_cases(hard_cases(seed), say, keep, world)
    measured = []
    for name in HARD:
        mine = [row for row in rows if row["name"].split("-", 1)[1] == name]
        used = [row for row in mine if row["used"]]
        measured += [
            Measurement(f"{name}: compensated", float(len(used)), f"of {len(mine)}"),
            of(f"{name}, compensated: rms over at rest, worst", used, "after", max, at_most=1.2),
            of(f"{name}, compensated: the same, nothing done", used, "before", max),
        ]
    return [*measured, made_worse(rows)], {"seed": seed, "rows": rows}
