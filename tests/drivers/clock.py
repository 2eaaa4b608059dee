"""A clock for driver tests that moves only when someone waits: hours pass in microseconds, and in order."""

from __future__ import annotations

import threading
from collections.abc import Callable


class SteppedClock:
    """``drivers.api.Clock`` of one thread; ``advance_s`` is what a scripted device calls when it lets time pass."""

    def __init__(self, start_ns: int = 1_000_000_000) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def advance_s(self, duration_s: float) -> None:
        self._now_ns += round(duration_s * 1e9)

    def sleep_s(self, duration_s: float) -> None:
        self.advance_s(max(0.0, duration_s))

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        if not predicate():
            self.advance_s(timeout_s)
        return predicate()
