"""Owns the parent's end of the memory that it shares with its worker: clouds are copied out of it, live pictures are put into it."""

from __future__ import annotations

from multiprocessing.shared_memory import SharedMemory

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.worker.cloud_memory import CloudMemory
from appliance.instrument.worker.live_picture import LivePicture
from appliance.instrument.worker.shared_points import SharedPoints
from appliance.measure import Cloud, Found


class ParentMemory:
    """Shared memory for a left camera of ``width_px`` × ``height_px``, made here. No view of it outlives a call: it could not be closed."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._places = SharedPoints(width_px, height_px)
        self._memory = SharedMemory(create=True, size=self._places.size_bytes)
        self._copies = CloudMemory(self._places.capacity)

    @property
    def name(self) -> str:
        """Name by which another process opens it."""
        return self._memory.name

    def coarse(self, found: Found) -> Cloud:
        """Return a copy of the coarse cloud. Raises ValueError where the memory is closed, as all here."""
        return self._places.coarse(self._memory.buf).cloud(found)

    def full(self, found: Found) -> Cloud:
        """Return a copy of the full cloud, in memory that is used again once nobody has the copy any more."""
        return self._copies.copied(self._places.full(self._memory.buf), found)

    def put(self, picture: NDArray[np.uint8]) -> tuple[int, int]:
        """Put a live ``picture`` (h, w) into its place, reduced as far as it must be; returns its shape there."""
        return LivePicture(self._memory.buf, self._places.capacity).put(picture)

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        self._memory.unlink()
