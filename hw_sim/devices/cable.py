"""Owns the projector's end of a video cable from a computer that is not simulated: its pictures light the scene.

The projector has a variable refresh rate, as Adaptive-Sync defines it: a picture begins a vertical sync when it comes;
where none comes, the one before is shown again after ``HELD_PERIODS``. So a machine whose scan-out has no blank of its own
(a virtual one) is what the trigger board counts. All calls with the world's lock held.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from hw_sim.devices.card import PROJECTOR_SIZE

HELD_PERIODS = 1.5
"""Longer than a machine that is in time ever waits, and shorter than two periods."""
MOST_WAITING = 4
"""Pictures that came within one look at the cable; more than that, and the oldest was never seen."""


class Cable:
    """A cable from a machine that shows a picture every ``period_ns``."""

    def __init__(self, period_ns: int) -> None:
        self.period_ns = period_ns
        self.pictures = 0
        """Number of pictures that came."""
        self._waiting: deque[NDArray[np.uint8]] = deque(maxlen=MOST_WAITING)
        self._shown: NDArray[np.uint8] | None = None
        self._sync_ns: int | None = None

    def show(self, green: NDArray[np.uint8]) -> None:
        """Take a picture that the machine scans out from now on: (768, 1024) uint8. Raises ValueError for another size."""
        width, height = PROJECTOR_SIZE
        if green.shape != (height, width) or green.dtype != np.uint8:
            raise ValueError(f"a picture of {green.shape} {green.dtype}; the projector takes ({height}, {width}) uint8")
        self.pictures += 1
        self._waiting.append(green)

    def dark(self) -> None:
        """Note that the machine drives the cable no more."""
        self._waiting.clear()
        self._shown = None

    @property
    def driven(self) -> bool:
        """Something is scanned out."""
        return self._shown is not None

    def syncs(self, time_ns: int) -> bool:
        """Return whether a vertical sync begins at ``time_ns``."""
        if self._waiting or self._sync_ns is None:
            return True
        return time_ns - self._sync_ns >= HELD_PERIODS * self.period_ns

    def vblank(self, time_ns: int) -> None:
        """Begin a vertical sync: the oldest picture that waits is shown."""
        self._sync_ns = time_ns
        if self._waiting:
            self._shown = self._waiting.popleft()

    def projected(self) -> NDArray[np.uint8]:
        """Return (768, 1024) uint8 that lights the scene; black while nothing is scanned out."""
        width, height = PROJECTOR_SIZE
        return np.zeros((height, width), np.uint8) if self._shown is None else self._shown
