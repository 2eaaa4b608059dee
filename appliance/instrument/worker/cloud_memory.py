"""Owns the memory that the parent copies full clouds into: touched before the dive, and used again once nobody has the cloud any more.

New memory is slow: the kernel has to find and to clear each page of 40 MB, in the same tenth of a second in which the raw frames want 92 MB
of it. Measured, that made a copy of 13 ms of a processor one of 80 ms, and of 0.15 s by the clock.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from appliance.measure import CLOUD_BYTES, Cloud, Found, PointTable

MOST_BLOCKS = 2
"""A scan that is still being published has one while the next one's cloud comes; so have both exposures of one scan."""
_POOL_ALONE = 2
"""References to a block that nobody has: the list's, and that of who asks how many there are."""


class CloudMemory:
    """Blocks for up to ``capacity`` points each, the first of them touched at once. Used by one thread; clouds may be dropped by any."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._blocks: list[NDArray[np.uint8]] = []
        self._add()

    def copied(self, table: PointTable, found: Found) -> Cloud:
        """Return a copy of the points found. It stays as it is as long as anybody has one of its arrays, or a part of one."""
        return table.cloud(found, self._free())

    def _free(self) -> NDArray[np.uint8] | None:
        """Return a block of which nobody has a part; ``None``: there is none, and no more are kept."""
        for k in range(len(self._blocks)):
            # Each array that lies in a block refers to it, however it was cut out of another one. Where nobody has one, nobody can get one.
            if sys.getrefcount(self._blocks[k]) <= _POOL_ALONE:
                return self._blocks[k]
        return self._add() if len(self._blocks) < MOST_BLOCKS else None

    def _add(self) -> NDArray[np.uint8]:
        block = np.empty(self._capacity * CLOUD_BYTES, np.uint8)
        block.fill(0)  # touch every page now
        self._blocks.append(block)
        return block
