"""Owns taking every n-th pixel of single frames, as these arrive."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray


class PixelGrid:
    """An even grid of one camera's pixels, taken of the frames that are ``wanted``.

    ``steps`` returns the distance of rows and that of columns, for an image of so many rows and columns.
    """

    def __init__(self, wanted: Sequence[int], steps: Callable[[int, int], tuple[int, int]]) -> None:
        self._wanted, self._steps = list(wanted), steps
        self.down_px = self.across_px = 1
        """Distance of the rows, and of the columns."""
        self.grey = np.empty((len(self._wanted), 0, 0), np.uint8)
        """(wanted, rows, columns): grey values, in the order of ``wanted``."""

    @property
    def at(self) -> tuple[slice, slice]:
        """Pixels of the grid, as an index of an image or a map."""
        return slice(self.down_px // 2, None, self.down_px), slice(self.across_px // 2, None, self.across_px)

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the pixels of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        if index == 0:
            self.down_px, self.across_px = self._steps(*frames.shape[1:])
            self.grey = np.empty((len(self._wanted), *frames[0][self.at].shape), np.uint8)
        if index in self._wanted:
            self.grey[self._wanted.index(index)] = frames[index][self.at]

    def taken(self, frames: NDArray[np.uint8]) -> PixelGrid:
        """Take the pixels of whole ``frames`` (n, h, w) uint8; returns itself."""
        for index in range(len(frames)):
            self.push(frames, index)
        return self
