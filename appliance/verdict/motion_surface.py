"""Owns how the surface stands to the rays, cell by cell of the pattern, and what noise its points have across it.

An error along a ray that meets the surface at an angle θ (from its normal) misses the surface by cos θ of it. Limbs, where
points are least certain along their rays, count that much less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.table import Cloud
from appliance.verdict.motion_map import CELL_PX

MIN_POINTS = 4
"""Of a cell, with neighbours on all sides; fewer say nothing of how it stands."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SurfaceMap:
    """Arrays (rows, columns) float64 of the pattern's cells."""

    points: Array
    """Of the cloud, that have neighbours on all sides."""
    across: Array
    """RMS of cos θ; NaN: fewer than ``MIN_POINTS``."""
    noise_mm: Array
    """RMS of the points' expected error across the surface, from the cameras' noise; NaN as above."""


def surface_map(
    cloud: Cloud, p_px: NDArray[np.float32], q_px: NDArray[np.float32], shape: tuple[int, int]
) -> SurfaceMap:
    """Of a cloud whose points lie on a grid of the left image, whose coordinates are ``p_px`` and ``q_px`` (h, w)."""
    cosine, inside = facing(cloud, p_px.shape[1])
    pixel = cloud.pixel[inside]
    p, q = p_px.ravel()[pixel], q_px.ravel()[pixel]
    rows, columns = shape
    known = (p >= 0.0) & (q >= 0.0) & (p < columns * CELL_PX) & (q < rows * CELL_PX) & np.isfinite(cosine)
    cell = (q[known] / CELL_PX).astype(np.int64) * columns + (p[known] / CELL_PX).astype(np.int64)
    square = cosine[known].astype(np.float64) ** 2
    noise = square * cloud.sigma_mm[inside][known].astype(np.float64) ** 2

    def summed(values: Array | None = None) -> Array:
        return np.bincount(cell, values, rows * columns).reshape(shape).astype(np.float64)

    points = summed()
    enough = points >= MIN_POINTS
    with np.errstate(invalid="ignore", divide="ignore"):
        across, noise_mm = (np.where(enough, np.sqrt(summed(x) / points), np.nan) for x in (square, noise))
    return SurfaceMap(points, across, noise_mm)


def facing(cloud: Cloud, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """|cos θ| of the points that have neighbours on all four sides, and which points (n,) those are.

    Of flat pixel numbers of an image ``width_px`` wide, that lie on a grid of rows and columns at equal distances.
    """
    v, u = np.divmod(cloud.pixel.astype(np.int64), width_px)
    columns, rows = np.unique(u), np.unique(v)
    # 0 where there is but one.
    step, down = (int(np.gcd.reduce(np.diff(places))) for places in (columns, rows))
    if step == 0 or down == 0:
        return np.empty(0, np.float32), np.empty(0, np.intp)
    # A border of nothing spares the question what lies beside.
    x, y = (u - columns[0]) // step + 1, (v - rows[0]) // down + 1
    wide = int(x.max()) + 1
    place = y * wide + x
    at = np.full(wide * (int(y.max()) + 2), -1, np.int64)
    at[place] = np.arange(len(place))
    left, right, above, below = (at[place + offset] for offset in (-1, 1, -wide, wide))
    inside = np.flatnonzero((left >= 0) & (right >= 0) & (above >= 0) & (below >= 0))
    points = cloud.points_mm
    normal = np.cross(points[right[inside]] - points[left[inside]], points[below[inside]] - points[above[inside]])
    ray = points[inside]
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(np.einsum("ij,ij->i", normal, ray))
        cosine /= np.sqrt(np.einsum("ij,ij->i", normal, normal) * np.einsum("ij,ij->i", ray, ray))
    return cosine, inside
