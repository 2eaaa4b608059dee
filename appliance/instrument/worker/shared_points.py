"""Owns where points lie in the memory that the worker shares with its parent: the full cloud's, and the coarse cloud's in a place of their own.

The full cloud is found in its place, so the worker waits until the parent has copied it. The coarse one is small and copied to the
other place, which nothing is written to before the next sequence has been begun: the worker goes on at once.
"""

from __future__ import annotations

from appliance.instrument.worker.live_picture import behind_picture
from appliance.measure import POINT_BYTES, PointTable, coarse_stride_px

ALIGNED_BYTES = 64


class SharedPoints:
    """Both places, for a left camera of ``width_px`` × ``height_px``."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self.capacity = width_px * height_px
        """Number of points that there is room for: one in every left pixel, so that no cloud can be too large."""
        stride_px = coarse_stride_px(width_px, height_px)
        self._coarse_capacity = -(-width_px // stride_px) * -(-height_px // stride_px)
        # Columns of four bytes follow: they must begin where such numbers may lie.
        self._coarse_first = -(-behind_picture(self.capacity) // ALIGNED_BYTES) * ALIGNED_BYTES

    @property
    def size_bytes(self) -> int:
        """Size of the memory for both, and for the live picture between them."""
        return self._coarse_first + self._coarse_capacity * POINT_BYTES

    def full(self, memory: memoryview | None) -> PointTable:
        """Return the full cloud's table. While it lives, ``memory`` cannot be closed. Raises ValueError where it is (``None``)."""
        return PointTable(self.capacity, _open(memory))

    def coarse(self, memory: memoryview | None) -> PointTable:
        """Return the coarse cloud's table. While it lives, ``memory`` cannot be closed. Raises ValueError where it is (``None``)."""
        return PointTable(self._coarse_capacity, _open(memory)[self._coarse_first :])


def _open(memory: memoryview | None) -> memoryview:
    if memory is None:
        raise ValueError("the shared memory is closed; take points from it while the worker runs")
    return memory
