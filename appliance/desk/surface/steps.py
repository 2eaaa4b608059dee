"""Steps in depth between neighbouring pixels of an organised cloud: which neighbours see one surface.

Of two neighbours p and q, in a row or a column of the image, r is the distance from the camera, d = r(q) − r(p) and l
their distance across the ray. They see one surface where both hold:

    incidence     |d| ≤ tan 80° · l + 4 √(σp² + σq²)          a surface seen at less than 80°, and noise
    local slope   |d − d'| ≤ l / 2 + 4 √(3 (σp² + σq²))       d' is that of the pair before or of the pair after, whichever is
                                                              nearer: a slope goes on at one side at least, a step at none

3 (σp² + σq²) is the variance of a second difference, σ² (1 + 4 + 1), where neighbours are equally noisy. With σ of 22
µm and pixels of 0.17 mm, steps are found from about 0.5 mm on; lower ones count as a slope of the surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import OrganisedCloud

SURE = np.float32(4.0)
"""Number of standard deviations of noise above which a difference is real."""
STEEPEST = np.float32(math.tan(math.radians(80.0)))
"""Depth over distance across the ray of the most inclined meshed surface; such points are noisy, and hide others."""
BEND = np.float32(0.5)
"""Largest change of the depth from one pair to the next on a curved surface, over their distance across the ray."""


LINES_AT_ONCE = 32


@dataclass(frozen=True, slots=True, eq=False)
class Connections:
    """Pairs of neighbouring pixels that see one surface; ``False`` also where one of the two has no point."""

    right: NDArray[np.bool_]
    """(h, w - 1) bool: the pixel and the one to its right."""
    down: NDArray[np.bool_]
    """(h - 1, w) bool: the pixel and the one below."""


def connect_neighbours(cloud: OrganisedCloud) -> Connections:
    """Return which neighbours see one surface, by the limits above."""
    h, w = cloud.shape
    right, down = np.empty((h, w - 1), np.bool_), np.empty((h - 1, w), np.bool_)
    # Columns are rows of the transposed image; process some lines at a time, which stay in the cache.
    for points, sigma, same in (
        (cloud.points_mm, cloud.sigma_mm, right),
        (cloud.points_mm.transpose(1, 0, 2), cloud.sigma_mm.T, down.T),
    ):
        for begin in range(0, len(same), LINES_AT_ONCE):
            some = slice(begin, begin + LINES_AT_ONCE)
            same[some] = _along_rows(points[some], sigma[some])
    return Connections(right, down)


def _along_rows(points_mm: NDArray[np.float32], sigma_mm: NDArray[np.float32]) -> NDArray[np.bool_]:
    range_mm = np.sqrt(np.einsum("yxk,yxk->yx", points_mm, points_mm))
    step = np.diff(range_mm, axis=1)
    offset = np.diff(points_mm, axis=1)
    # Rounding of equal points could make it negative.
    across = np.sqrt(np.maximum(np.einsum("yxk,yxk->yx", offset, offset) - step**2, np.float32(0.0)))
    variance = sigma_mm[:, 1:] ** 2 + sigma_mm[:, :-1] ** 2
    # Comparisons with NaN are false: a missing point is connected to no other.
    same: NDArray[np.bool_] = np.abs(step) <= STEEPEST * across + SURE * np.sqrt(variance)
    bend = np.abs(np.diff(step, axis=1))
    least_bend = np.full_like(step, np.nan)
    least_bend[:, 1:] = bend
    least_bend[:, :-1] = np.fmin(least_bend[:, :-1], bend)
    # A pair without neighbours has no slope; only the first limit applies.
    same &= ~(least_bend > BEND * across + SURE * np.sqrt(np.float32(3.0) * variance))
    return same
