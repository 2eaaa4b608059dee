"""The shapes of the smooth depth error that all scans of one calibration share and no residual shows.

The error is along the ray, in mm at 525 mm distance (of the standard housing; of another one in proportion), and grows
with the square of the distance, as any error of a disparity does. Where errors of lens and port combine, it grows a
little faster or slower, so that some shapes also vary with the distance. Symbols: u, v  direction (x/z, y/z) over its
value at the border of the view;  w  distance from 525 mm, over a tenth of it;  c  coefficients, mm;  φ  their shapes
uⁱ vʲ wᵏ (z/525 mm)².
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.volume import STANDARD, WorkingVolume

Array = NDArray[np.float64]
Rows = tuple[tuple[float, ...], ...]

POWERS: tuple[tuple[int, int, int], ...] = (
    *((total - j, j, 0) for total in range(2, 6) for j in range(total + 1)),
    *((total - j, j, 1) for total in range(1, 5) for j in range(total + 1)),
)
"""Exponents i, j, k of u, v and w. Constant and linear terms only move a scan as a whole, which registration absorbs.
"""
DEPTH_ERROR_TERMS = len(POWERS)
DISTANCE_MM = 525.0
"""Distance in the standard housing to which the coefficients refer."""
BORDER = 0.24
"""x/z at the border of the view."""


def shapes(points_mm: Array, volume: WorkingVolume = STANDARD) -> Array:
    """Return φ (…, COUNT) at points (…, 3) of a scan's frame: depth error in mm per mm of coefficient."""
    distance_mm = volume.scaled(DISTANCE_MM)
    z = points_mm[..., 2]
    u, v = points_mm[..., 0] / z / BORDER, points_mm[..., 1] / z / BORDER
    w = 10.0 * (z / distance_mm - 1.0)
    grows = (z / distance_mm) ** 2
    up_to = max(max(powers) for powers in POWERS)
    of_u, of_v, of_w = ([np.ones_like(z), *(coordinate**n for n in range(1, up_to + 1))] for coordinate in (u, v, w))
    return np.stack([of_u[i] * of_v[j] * of_w[k] * grows for i, j, k in POWERS], axis=-1)


def along_ray(points_mm: Array) -> Array:
    """Return the displacements (…, 3) of points per mm of depth error."""
    return np.asarray(points_mm / points_mm[..., 2:])
