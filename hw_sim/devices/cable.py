"""The projector's end of a video cable from a real computer, whose images light the scene.

The projector has a variable refresh rate, as Adaptive-Sync defines it: each image begins a vsync when it comes; without
one, the image before is shown again after ``HELD_PERIODS``. So a machine without a blank of its own (a virtual one)
makes the vsyncs that the trigger board counts. All calls with the world's lock held.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hw_sim.devices.card import PROJECTOR_SIZE

HELD_PERIODS = 1.5
"""Periods before an image is repeated: more than a punctual machine needs, and less than two."""
MOST_WAITING = 4
"""Largest number of images that wait; beyond it the oldest is dropped."""


class Cable:
    """A cable from a machine that shows an image every ``period_ns``."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.pictures = 0
        """Number of pictures that came."""
        self._waiting: deque[NDArray[np.uint8]] = deque(maxlen=MOST_WAITING)
        self._shown: NDArray[np.uint8] | None = None
        self._sync_ns: int | None = None

    def show(self, green: NDArray[np.uint8]) -> None:
        """Take the next image of the machine: (768, 1024) uint8. Raises ValueError for another size."""
        width, height = PROJECTOR_SIZE
        if green.shape != (height, width) or green.dtype != np.uint8:
            raise ValueError(f"a picture of {green.shape} {green.dtype}; the projector takes ({height}, {width}) uint8")
        self.pictures += 1
        self._waiting.append(green)

    def dark(self) -> None:
        """Note that the machine no longer drives the cable."""
        self._waiting.clear()
        self._shown = None

    @property
    def driven(self) -> bool:
        """True if the cable has a signal."""
        return self._shown is not None

    def syncs(self, time_ns: int) -> bool:
        """Return True if a vsync begins at ``time_ns``."""
        if self._waiting or self._sync_ns is None:
            return True
        return time_ns - self._sync_ns >= HELD_PERIODS * self.period_ns

    def vblank(self, time_ns: int) -> None:
        """Begin a vsync: the oldest waiting image is shown."""
        self._sync_ns = time_ns
        if self._waiting:
            self._shown = self._waiting.popleft()

    def projected(self) -> NDArray[np.uint8]:
        """Return the codes (768, 1024) uint8 that light the scene; black without a signal."""
        width, height = PROJECTOR_SIZE
        return np.zeros((height, width), np.uint8) if self._shown is None else self._shown
