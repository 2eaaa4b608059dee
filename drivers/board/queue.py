"""The queue of unread reports, and which of them are dropped when there are too many."""

from __future__ import annotations

import threading
from collections import deque

from drivers.api import BoardEvent, Clock, Telemetry

CAPACITY = 256
"""Four armed sequences of 64 pulses, or two minutes of heartbeats."""


class EventQueue:
    """Bounded, ordered, for one or more readers.

    When it is full the oldest *heartbeat* is dropped (a newer one replaces it); if there is none, the oldest event.
    ``dropped`` counts both: no loss is silent.
    """

    def __init__(self, clock: Clock, capacity: int = CAPACITY) -> None:
        if capacity < 1:
            raise ValueError(f"capacity {capacity}; at least 1 is needed")
        self._clock = clock
        self._capacity = capacity
        self._events: deque[BoardEvent] = deque()
        self._condition = threading.Condition()
        self.dropped = 0

    def put(self, event: BoardEvent) -> None:
        """Append; never blocks."""
        with self._condition:
            if len(self._events) >= self._capacity:
                self._give_up_one()
            self._events.append(event)
            self._condition.notify_all()

    def get(self, timeout_s: float) -> BoardEvent | None:
        """Return the oldest event, or ``None`` after ``timeout_s``."""
        with self._condition:
            if not self._clock.wait_for(self._condition, lambda: bool(self._events), timeout_s):
                return None
            return self._events.popleft()

    def _give_up_one(self) -> None:
        self.dropped += 1
        for index, event in enumerate(self._events):
            if isinstance(event, Telemetry):
                del self._events[index]
                return
        self._events.popleft()
