"""The part ``sample``: some of a report's random scenes and all soft ones, for a quick check after a change of the
product."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from bench.outside.draws import SEEDS_PER_SEED
from bench.outside.figures import of_scenes
from bench.outside.kept import Row
from bench.outside.parts import PARTS
from bench.outside.scenes import TOGETHER, scene_row, watched
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.parts import Say
from hw_sim.objects.soft import is_soft


def measure(
    count: int, seed: int, say: Say, keep: Path | None = None, noise: str = "sheet"
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the figures of ``count`` rigid scenes, evenly spaced in a report's, and of all soft ones of it; of these not more than ``count``
    either."""
    numbers = numbers_of(count, seed)
    rows: list[Row] = []
    for done, row in enumerate(spread(partial(_row, seed=seed, keep=keep, noise=noise), numbers), 1):
        say(f"sample: {done} of {len(numbers)}", done / len(numbers))
        rows.append(row)
    return of_scenes(rows) + watched(rows, seed), {"rows": rows, "numbers": numbers}


def numbers_of(count: int, seed: int) -> list[int]:
    """Return which scenes of a report are taken again, in their order, chosen by their numbers alone."""
    of_report = range(PARTS["scenes"].count)
    soft = [number for number in of_report if is_soft(SEEDS_PER_SEED * seed + number + SEEDS_PER_SEED // 2)]
    rigid = [number for number in of_report if number not in soft]
    step = max(1.0, len(rigid) / count)
    return sorted([*(rigid[int(k * step)] for k in range(min(count, len(rigid)))), *soft[:count]])


def _row(number: int, seed: int, keep: Path | None, noise: str) -> Row:
    return scene_row(TOGETHER, number, seed, keep, noise)
