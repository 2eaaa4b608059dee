"""Effect of motion compensation over the speed of motion: along the fringes, across them, towards the object."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.result import Measurement
from bench.verdict.compensation import judge_cases, made_worse
from bench.verdict.compensation_cases import WAYS, speed_cases
from bench.verdict.parts import Say

AS_AT_REST = 1.2


def measure(scans: int, seed: int, say: Say, keep: Path | None = None) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the figures of steady motions of growing speed before one object; ``scans`` is not used."""
    cases = speed_cases(seed)
    rows = judge_cases(cases, say, keep)
    speeds = {case.name: max(map(abs, case.scene.motion.velocity_mm_s)) for case in cases}
    for row in rows:
        row["speed_mm_s"] = speeds[row["name"]]
    measured = []
    for direction in WAYS:
        mine = [row for row in rows if row["name"].split()[0] == direction]
        good = [row["speed_mm_s"] for row in mine if row["used"] and row["after"] <= AS_AT_REST]
        plain = [row["speed_mm_s"] for row in mine if row["before"] <= AS_AT_REST]
        measured += [
            Measurement(
                f"{direction}: fastest hand that is undone to {AS_AT_REST} of at rest", max(good, default=0.0), "mm/s"
            ),
            Measurement(f"{direction}: fastest that needs nothing", max(plain, default=0.0), "mm/s"),
        ]
    return [*measured, made_worse(rows)], {"seed": seed, "rows": rows}
