"""Owns which points are good enough to be shown and saved, and the numbers that describe a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """A point outside of any limit is masked, never moved or invented."""

    max_gap_mm: float = 0.25
    """Rays of a true correspondence pass at a few hundredths of a millimetre; calibration drift adds to it."""
    max_sigma_mm: float = 0.5
    min_depth_mm: float = 380.0
    max_depth_mm: float = 680.0
    max_step_mm: float = 1.5
    """Allowed distance in depth to the median of the 3 × 3 neighbours at full resolution; scales with the pixel."""
    min_neighbours: int = 5
    """Of eight; fewer is a fragment of an edge."""


@dataclass(frozen=True, slots=True)
class CloudSummary:
    """What the diver and the manifest are told about a cloud."""

    points: int
    coverage_percent: float | None
    """Points over left pixels with projector light; ``None`` when nothing was lit."""
    distance_mm: float | None
    """Median distance of the points from the rig's front along the viewing direction, as depth in the left frame."""
    noise_mm: float | None
    """Median expected sigma."""
    gap_mm: float | None
    """Median ray gap."""


@numba.njit(nogil=True, cache=True)
def select_points(
    points: NDArray[np.float32],
    gap: NDArray[np.float32],
    sigma: NDArray[np.float32],
    stride: int,
    max_gap_mm: float,
    max_sigma_mm: float,
    min_depth_mm: float,
    max_depth_mm: float,
    max_step_mm: float,
    min_neighbours: int,
    chosen: NDArray[np.uint32],
) -> int:
    """Write the flat left-pixel indices of good points into ``chosen``; return how many.

    Per point: gap, sigma and depth within limits, and (at stride 1) enough neighbours of which most lie on the same
    surface.
    """
    rows, columns = gap.shape
    count = 0
    for y in range(0, rows, stride):
        for x in range(0, columns, stride):
            z = points[y, x, 2]
            if not (gap[y, x] <= max_gap_mm and sigma[y, x] <= max_sigma_mm and min_depth_mm <= z <= max_depth_mm):
                continue
            near = 0
            far = 0
            for dy in range(-stride, stride + 1, stride):
                for dx in range(-stride, stride + 1, stride):
                    if dx == 0 and dy == 0:
                        continue
                    yy, xx = y + dy, x + dx
                    if yy < 0 or xx < 0 or yy >= rows or xx >= columns:
                        continue
                    other = points[yy, xx, 2]
                    if other == other:
                        if abs(other - z) <= max_step_mm * stride:
                            near += 1
                        else:
                            far += 1
            if stride == 1 and near < min_neighbours:
                continue
            if far > near:
                continue
            chosen[count] = y * columns + x
            count += 1
    return count


def summarise(
    lit_pixels: int, points: NDArray[np.float32], sigma: NDArray[np.float32], gap: NDArray[np.float32]
) -> CloudSummary:
    """Numbers of a cloud: points (n, 3), sigma (n,), gap (n,) float32 in mm; ``lit_pixels`` at the same stride."""
    n = len(points)
    coverage = 100.0 * n / lit_pixels if lit_pixels else None
    if n == 0:
        return CloudSummary(0, coverage, None, None, None)
    sample = slice(None, None, max(1, n // 50_000))
    return CloudSummary(
        points=n,
        coverage_percent=coverage,
        distance_mm=float(np.median(points[sample, 2])),
        noise_mm=float(np.median(sigma[sample])),
        gap_mm=float(np.median(gap[sample])),
    )
