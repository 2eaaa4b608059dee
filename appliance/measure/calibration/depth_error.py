"""Owns the shapes of a smooth depth error that all scans of one calibration share: numbers that no residual shows.

The error is along the ray, in mm at 525 mm distance (of the standard housing; of another one in proportion), and grows
with the square of the distance, as any error of a disparity does; where lens and window err together it grows a little
faster or slower, so that some shapes go with the distance besides. Symbols: u, v  direction (x/z, y/z) over its value
at the border of the view;  w  distance from 525 mm, over a tenth of it; c  coefficients, mm;  φ  their shapes uⁱ vʲ wᵏ
(z/525 mm)².
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
"""Exponents i, j, k of u, v and w. What is constant or tilts only moves or turns a scan, and overlaps absorb it."""
DEPTH_ERROR_TERMS = len(POWERS)
DISTANCE_MM = 525.0
"""Distance in the standard housing at which coefficients are mm."""
BORDER = 0.24
"""x/z at the border of the view."""


def shapes(points_mm: Array, volume: WorkingVolume = STANDARD) -> Array:
    """Return φ (…, COUNT) at points (…, 3) of a scan's own frame: depth error in mm per mm of each coefficient."""
    distance_mm = volume.scaled(DISTANCE_MM)
    z = points_mm[..., 2]
    u, v = points_mm[..., 0] / z / BORDER, points_mm[..., 1] / z / BORDER
    w = 10.0 * (z / distance_mm - 1.0)
    grows = (z / distance_mm) ** 2
    up_to = max(max(powers) for powers in POWERS)
    of_u, of_v, of_w = ([np.ones_like(z), *(one**n for n in range(1, up_to + 1))] for one in (u, v, w))
    return np.stack([of_u[i] * of_v[j] * of_w[k] * grows for i, j, k in POWERS], axis=-1)


def along_ray(points_mm: Array) -> Array:
    """Return the vectors (…, 3) by which points move per mm of depth."""
    return np.asarray(points_mm / points_mm[..., 2:])
