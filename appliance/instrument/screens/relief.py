"""Owns the shape of a cloud as a height over x and y, coarse and smooth: enough for light and shade."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

POINTS_PER_CELL = 4.0
MAX_CELLS = 512


class Relief:
    """Mean z of the points (n, 3) float32 mm in square cells between ``low`` and ``high`` (3,), smoothed 3 × 3.

    For looking at only: nothing that is measured goes through it.
    """

    def __init__(self, points: NDArray[np.float32], low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        across_mm, down_mm = np.maximum(high[:2] - low[:2], 1e-3)
        # As fine as the cloud allows: about four points in each cell if they covered the whole box.
        cell_mm = float(np.sqrt(across_mm * down_mm * POINTS_PER_CELL / len(points)))
        self._cell_mm = max(cell_mm, across_mm / MAX_CELLS, down_mm / MAX_CELLS)
        self._low = low[:2]
        self._columns, self._rows = int(across_mm / self._cell_mm) + 1, int(down_mm / self._cell_mm) + 1
        at = self._cells(points)
        shape = self._rows, self._columns
        size = self._rows * self._columns
        number = np.bincount(at, minlength=size).reshape(shape)
        total = np.bincount(at, weights=points[:, 2], minlength=size).reshape(shape)
        self.area_mm2 = max(1, int(np.count_nonzero(number))) * self._cell_mm**2
        """Area that the points cover as seen along z; holes do not count."""
        # Sums and counts are smoothed apart and divided then, so that a cell without points takes no part in the
        # mean.
        weight = np.asarray(cv2.blur(number.astype(np.float64), (3, 3)), np.float64)
        height = np.asarray(cv2.blur(total, (3, 3)), np.float64)
        self._height = np.divide(height, weight, out=np.full(shape, np.nan), where=weight > 0.0)

    def slopes(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return (n, 2) float32: dz/dx and dz/dy of the surface around each point; 0 where it has no neighbours."""
        down, across = np.gradient(self._height, self._cell_mm) if min(self._height.shape) > 1 else (0.0, 0.0)
        at = self._cells(points)
        found = np.empty((len(points), 2), np.float32)
        found[:, 0] = np.broadcast_to(across, self._height.shape).ravel()[at]
        found[:, 1] = np.broadcast_to(down, self._height.shape).ravel()[at]
        return np.nan_to_num(found, nan=0.0)

    def _cells(self, points: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the flat index of each point's cell; points beyond the edge count to the cell at the edge."""
        column = np.clip((points[:, 0] - self._low[0]) / self._cell_mm, 0, self._columns - 1).astype(np.int64)
        row = np.clip((points[:, 1] - self._low[1]) / self._cell_mm, 0, self._rows - 1).astype(np.int64)
        flat: NDArray[np.int64] = row * self._columns + column
        return flat
