"""Owns how well the worker tells what a scan has in common with the one before, and what that costs: pairs by hand along the water main."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from appliance.measure.guidance import Overlap
from appliance.measure.overlap.overlap import compare
from bench.merge.guide import KEPT_AT_MM, PAINTS, SURFACE_MM, Place, held, kept_scan
from bench.progress import Progress
from bench.result import Measured
from bench.spread import spread

WITH_MM = tuple(float(one) for one in np.linspace(45.0, 165.0, 19))
WITHOUT_MM = tuple(float(one) for one in np.linspace(235.0, 400.0, 16))
"""Ways along the main from a scan to the next: of pairs with a third of the view and more in common, and of pairs with next to nothing."""
LEAST, NOTHING = 0.25, 0.1
"""True shares above which a number is wanted, and below which NO OVERLAP is right."""
OFF = 0.05


@dataclass(frozen=True, slots=True)
class Row:
    """One pair."""

    texture: str
    along_mm: float
    true_share: float
    said: Overlap
    prepared_s: float
    compared_s: float


def measure(
    seed: int, size_px: tuple[int, int], pairs: int | None = None
) -> tuple[list[Measured], list[dict[str, Any]]]:
    """Return figures and rows of both paints; ``pairs``: so many of each, evenly; ``None``: all 35."""
    alongs = [*WITH_MM, *WITHOUT_MM]
    alongs = alongs if pairs is None else [alongs[k] for k in np.linspace(0, len(alongs) - 1, pairs).astype(int)]
    wanted = [(texture, along, number) for texture in PAINTS for number, along in enumerate(alongs)]
    progress = Progress(len(wanted))
    rows: list[Row] = []
    for row in spread(partial(_row, seed=seed, size_px=size_px), wanted):
        progress.step(f"pair {len(rows) + 1} of {len(wanted)}")
        rows.append(row)
    figures: list[Measured] = []
    for texture in PAINTS:
        mine = [row for row in rows if row.texture == texture]
        told = [row for row in mine if row.said.share]
        none = [row for row in mine if row.said.share == 0.0]
        off = [abs((row.said.share or 0.0) - row.true_share) for row in told]
        said = f"overlap, {texture}: "
        figures += [
            Measured(f"{said}pairs with a quarter and more in common", sum(row.true_share > LEAST for row in mine), ""),
            Measured(f"{said}of these told a percentage", sum(row.true_share > LEAST for row in told), ""),
            Measured(f"{said}pairs with a tenth and less", sum(row.true_share < NOTHING for row in mine), ""),
            Measured(f"{said}of these NO OVERLAP", sum(row.true_share < NOTHING for row in none), ""),
            Measured(f"{said}NO OVERLAP of a quarter and more", sum(row.true_share > LEAST for row in none), "", at_most=0.0),
            Measured(f"{said}percentages off by more than 5", sum(one > OFF for one in off), "", at_most=0.0),
            Measured(f"{said}CPU of both pictures of a new scan, median", float(np.median([row.prepared_s for row in mine])), "s"),
            Measured(f"{said}CPU of the comparison, median", float(np.median([row.compared_s for row in mine])), "s"),
            Measured(f"{said}CPU of both, largest", max(row.prepared_s + row.compared_s for row in mine), "s"),
        ]  # fmt: skip
        if off:
            figures.append(Measured(f"{said}error of the percentage, largest", 100.0 * max(off), "%"))
    return figures, [
        {
            "texture": row.texture,
            "along_mm": row.along_mm,
            "true": row.true_share,
            "said": row.said.share,
            "cpu_s": row.prepared_s + row.compared_s,
        }
        for row in rows
    ]


def _row(item: tuple[str, float, int], seed: int, size_px: tuple[int, int]) -> Row:
    texture, along, number = item
    rng = np.random.default_rng([41, seed, number])
    x = KEPT_AT_MM[number % len(KEPT_AT_MM)]
    sign = -1.0 if x > 0.0 else 1.0
    poses = held(rng, x), held(rng, x + sign * along)
    (first, points, _), (second, new, _) = (
        kept_scan(Place(texture, pose, (), 2 * number + k, size_px)) for k, pose in enumerate(poses)
    )
    distance, _ = cKDTree(points).query(new[::7], distance_upper_bound=SURFACE_MM)
    for _ in first.search():  # what was done when the scan before was taken
        pass
    begun = time.process_time()
    for _ in second.search():
        pass
    prepared = time.process_time()
    *_, said = compare(first, second)
    done = time.process_time()
    assert said is not None
    return Row(texture, along, float(np.isfinite(distance).mean()), said, prepared - begun, done - prepared)
