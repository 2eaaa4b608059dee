"""The ray shift: displacements of rays in water beyond port and image correction.

An image correction rotates rays; it cannot express that a ray is right at one depth and wrong at another. A port that
is not quite flat or plane-parallel does that. The shift displaces the ray without rotating it: a bicubic B-spline over
the image, in mm across the camera's axis, some hundredths at most. Both together are a free field of rays about the
refractive model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.correction import node_count, surface

Array = NDArray[np.float64]

INTERVALS = (4, 3)
"""Intervals across and down the image."""


@dataclass(frozen=True, slots=True)
class RayShift:
    """Displacements of rays as a bicubic B-spline, in mm.

    ``coefficients_mm`` holds (x, y) per node, row by row: (down+3)·(across+3)·2. Raises ValueError for another number.
    """

    width_px: int
    height_px: int
    intervals: tuple[int, int]
    """Intervals across, down."""
    coefficients_mm: tuple[float, ...]

    def __post_init__(self) -> None:
        count = 2 * node_count(self.intervals)
        if len(self.coefficients_mm) != count:
            raise ValueError(
                f"ray shift with {len(self.coefficients_mm)} coefficients; {self.intervals[0]} × "
                f"{self.intervals[1]} intervals need {count}; calibrate again"
            )

    def at_mm(self, uv_px: Array) -> Array:
        """Return the shift (..., 2) in mm of the rays of pixels (..., 2), along the camera's x and y.

        Beyond the image's edge it is that of the edge.
        """
        return surface(uv_px, (self.width_px, self.height_px), self.intervals, self.coefficients_mm)
