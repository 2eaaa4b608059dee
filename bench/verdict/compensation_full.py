"""Effect of motion compensation at the instrument's own resolution: the named motions and objects, 1600 × 1200."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from bench.result import Measurement
from bench.verdict.compensation import judge_cases, made_worse, median, of
from bench.verdict.compensation_cases import NAMED, named_cases
from bench.verdict.parts import Say

FULL_PX = 1600


def measure(scans: int, seed: int, say: Say, keep: Path | None = None) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the figures of all nine cases; ``scans`` is not used. Rendering takes most of the time."""
    rows = judge_cases([replace(case, width_px=FULL_PX) for case in named_cases(seed)], say, keep)
    calibrated = [row for row in rows if row["calibration"] == "calibrated"]
    hands = {hand: [row for row in calibrated if row["name"].startswith(f"{hand}-")] for hand in NAMED}
    measured = [
        of(f"hand {hand}: rms over at rest, worst of three", mine, "after", max, at_most=1.2)
        for hand, mine in hands.items()
    ]
    cpu = of("CPU time of an attempt at 1600 x 1200, median", calibrated, "cpu_s", median, "s")
    return [*measured, made_worse(rows), cpu], {"seed": seed, "rows": rows}
