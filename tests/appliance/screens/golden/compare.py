"""Owns when two pictures are the same to an eye: the edge of a letter may lie otherwise by a pixel, things may not."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FINE_PX, COARSE_PX = 3.0, 12.0
"""Blurs under which pictures are compared: about the width of a letter's stroke, and of a line of text."""
SHRINK = 4
"""Before the coarse blur, which it saves time to make on a smaller picture."""
FINE, COARSE = 62.0, 22.0
"""Largest differences, of 255, that another rasteriser of fonts or another GL may make under each."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Of two blurred pictures, in levels of 255."""

    fine: float
    coarse: float
    at: tuple[int, int]
    """Column and row of the largest fine one."""

    @property
    def same(self) -> bool:
        return self.fine <= FINE and self.coarse <= COARSE


def compare(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> Difference:
    """Of two RGB pictures (h, w, 3). Raises ValueError where their sizes differ."""
    if one.shape != other.shape:
        raise ValueError(f"pictures of {one.shape} and {other.shape} cannot be compared")
    away = one.astype(np.float32) - other.astype(np.float32)
    small = cv2.resize(away, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)
    fine = np.abs(cv2.GaussianBlur(away, (0, 0), FINE_PX)).max(axis=2)
    coarse = np.abs(cv2.GaussianBlur(small, (0, 0), COARSE_PX / SHRINK))
    row, column = np.unravel_index(int(fine.argmax()), fine.shape)
    return Difference(float(fine.max()), float(coarse.max()), (int(column), int(row)))
