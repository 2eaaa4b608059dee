"""Accuracy and cost of the overlap of a scan with the one before: scan pairs by hand along the water main."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from appliance.measure.guidance import Overlap
from appliance.measure.overlap.overlap import compare
from bench.merge.guide import KEPT_AT_MM, PAINTS, SURFACE_MM, Place, held_pose, kept_scan
from bench.progress import Progress
from bench.result import Measurement
from bench.spread import spread

WITH_MM = tuple(float(mm) for mm in np.linspace(45.0, 165.0, 19))
WITHOUT_MM = tuple(float(mm) for mm in np.linspace(235.0, 400.0, 16))
"""Displacements along the main from a scan to the next: of pairs with an overlap of a third or more, and with almost
none."""
LEAST, NOTHING = 0.25, 0.1
"""True shares above which a number is wanted, and below which NO OVERLAP is right."""
OFF = 0.05


@dataclass(frozen=True, slots=True)
class Row:
    """Result of one scan pair."""

    texture: str
    along_mm: float
    true_share: float
    overlap: Overlap
    prepared_s: float
    compared_s: float


def measure(
    seed: int, size_px: tuple[int, int], pairs: int | None = None
) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return figures and rows of both textures; ``pairs`` of each, evenly spread, or all 35 for ``None``."""
    alongs = [*WITH_MM, *WITHOUT_MM]
    alongs = alongs if pairs is None else [alongs[k] for k in np.linspace(0, len(alongs) - 1, pairs).astype(int)]
    jobs = [(texture, along, number) for texture in PAINTS for number, along in enumerate(alongs)]
    progress = Progress(len(jobs))
    rows: list[Row] = []
    for row in spread(partial(_row, seed=seed, size_px=size_px), jobs):
        progress.step(f"pair {len(rows) + 1} of {len(jobs)}")
        rows.append(row)
    figures: list[Measurement] = []
    for texture in PAINTS:
        mine = [row for row in rows if row.texture == texture]
        with_share = [row for row in mine if row.overlap.share]
        apart = [row for row in mine if row.overlap.share == 0.0]
        off = [abs((row.overlap.share or 0.0) - row.true_share) for row in with_share]
        name = f"overlap, {texture}: "
        figures += [
            Measurement(
                f"{name}pairs with a quarter and more in common", sum(row.true_share > LEAST for row in mine), ""
            ),
            Measurement(f"{name}of these told a percentage", sum(row.true_share > LEAST for row in with_share), ""),
            Measurement(f"{name}pairs with a tenth and less", sum(row.true_share < NOTHING for row in mine), ""),
            Measurement(f"{name}of these NO OVERLAP", sum(row.true_share < NOTHING for row in apart), ""),
            Measurement(
                f"{name}NO OVERLAP of a quarter and more", sum(row.true_share > LEAST for row in apart), "", at_most=0.0
            ),
            Measurement(f"{name}percentages off by more than 5", sum(error > OFF for error in off), "", at_most=0.0),
            Measurement(
                f"{name}CPU of both pictures of a new scan, median",
                float(np.median([row.prepared_s for row in mine])), "s",
            ),
            Measurement(
                f"{name}CPU of the comparison, median", float(np.median([row.compared_s for row in mine])), "s"
            ),
            Measurement(f"{name}CPU of both, largest", max(row.prepared_s + row.compared_s for row in mine), "s"),
        ]  # fmt: skip
        if off:
            figures.append(Measurement(f"{name}error of the percentage, largest", 100.0 * max(off), "%"))
    return figures, [
        {
            "texture": row.texture,
            "along_mm": row.along_mm,
            "true": row.true_share,
            "said": row.overlap.share,
            "cpu_s": row.prepared_s + row.compared_s,
        }
        for row in rows
    ]


def _row(item: tuple[str, float, int], seed: int, size_px: tuple[int, int]) -> Row:
    texture, along, number = item
    rng = np.random.default_rng([41, seed, number])
    x = KEPT_AT_MM[number % len(KEPT_AT_MM)]
    sign = -1.0 if x > 0.0 else 1.0
    poses = held_pose(rng, x), held_pose(rng, x + sign * along)
    (first, points, _), (second, new, _) = (
        kept_scan(Place(texture, pose, (), 2 * number + k, size_px)) for k, pose in enumerate(poses)
    )
    distance, _ = cKDTree(points).query(new[::7], distance_upper_bound=SURFACE_MM)
    for _ in first.search():  # as done when the scan before was taken
        pass
    begun = time.process_time()
    for _ in second.search():
        pass
    prepared = time.process_time()
    *_, overlap = compare(first, second)
    done = time.process_time()
    assert overlap is not None
    return Row(texture, along, float(np.isfinite(distance).mean()), overlap, prepared - begun, done - prepared)
