"""Owns world time: one lock for everything that happens, and waiting that ends in world time.

All device state is touched with ``condition`` held; whoever changes something that another may wait for calls
``condition.notify_all()``. World time moves from vertical blank to vertical blank; between two blanks it follows
real time and halts just before the next.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

BLANK_NS = 16_666_667
"""Both heads of the card run at 60 Hz."""
HALT = 0.97
"""Fraction of a period at which time halts until the next blank."""
SLICE_S = 0.004


class WorldTime:
    """The world's clock and lock."""

    def __init__(self, start_ns: int = 3_000_000_000) -> None:
        self.condition = threading.Condition()
        self.closed = False
        """The world has ended: waiting ends at once."""
        self._blank_ns = start_ns
        self._blank_real_ns = time.monotonic_ns()
        self._speed = 1.0

    @property
    def blank_ns(self) -> int:
        """World time of the latest vertical blank."""
        return self._blank_ns

    def now_ns(self) -> int:
        """World time."""
        elapsed = (time.monotonic_ns() - self._blank_real_ns) * self._speed
        return self._blank_ns + int(min(elapsed, HALT * BLANK_NS))

    def blank(self, speed: float = 1.0) -> int:
        """The next vertical blank happens now; returns its time. Only the world calls this, with the lock held."""
        self._blank_ns += BLANK_NS
        self._blank_real_ns = time.monotonic_ns()
        self._speed = speed
        self.condition.notify_all()
        return self._blank_ns

    def wait_for(self, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """With ``condition`` held: wait until ``predicate()`` or until the timeout in world time has passed."""
        deadline_ns = self.now_ns() + int(timeout_s * 1e9)
        while not predicate():
            if self.closed or self.now_ns() >= deadline_ns:
                return predicate()
            self.condition.wait(SLICE_S)
        return True

    def sleep_s(self, duration_s: float) -> None:
        """Return after ``duration_s`` of world time."""
        with self.condition:
            self.wait_for(lambda: False, duration_s)


class WorldClock:
    """World time in the shape of the product's clock (``drivers.api.Clock``), for conditions of the product's own."""

    def __init__(self, world_time: WorldTime) -> None:
        self._time = world_time

    def now_ns(self) -> int:
        return self._time.now_ns()

    def sleep_s(self, duration_s: float) -> None:
        self._time.sleep_s(duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        deadline_ns = self._time.now_ns() + int(timeout_s * 1e9)
        while not predicate():
            if self._time.closed or self._time.now_ns() >= deadline_ns:
                return predicate()
            condition.wait(SLICE_S)
        return True
