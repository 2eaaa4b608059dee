"""World time: one lock, the agenda of events, and waits that end in world time.

All state of the devices is used with ``condition`` held; a change that another thread may wait for is followed by
``condition.notify_all()``. World time moves from vertical blank to vertical blank. Between two blanks it follows real
time, never passes a due event, and halts just before the next blank.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

BLANK_NS = 16_666_667
"""Both heads of the card run at 60 Hz, unless the world's options say otherwise."""
START_NS = 3_000_000_000
"""World time at the start, a little after the host's boot."""
LONGEST_WAIT_S = 0.25
"""Longest wait without a notification."""
FOREIGN_SLICE_S = 0.005
"""Period at which a wait on a foreign condition checks world time."""
_FOREVER_NS = 2**62


@dataclass(order=True, slots=True)
class Happening:
    """An event at a moment of world time."""

    time_ns: int
    number: int
    action: Callable[[int], None] = field(compare=False)
    """Called with ``time_ns``, lock held."""
    ready: Callable[[], bool] | None = field(compare=False, default=None)
    """World time does not pass this event before it is ready."""


@dataclass(frozen=True, slots=True)
class _Mark:
    """A point of world time; replaced atomically, so that reading the clock needs no lock."""

    blank_ns: int
    blank_real_ns: int
    speed: float
    floor_ns: int
    limit_ns: int

    def now_ns(self, real_ns: int) -> int:
        # now = blank + speed · (real time since), between the last time that was read and the limit.
        followed_ns = self.blank_ns + int((real_ns - self.blank_real_ns) * self.speed)
        return max(self.floor_ns, min(followed_ns, self.limit_ns))


class WorldTime:
    """The world's clock, agenda and lock. ``speed`` is world time per real time between blanks; 0 stands still.

    ``period_ns`` is from one vertical blank to the next.
    """

    def __init__(self, speed: float = 1.0, period_ns: int = BLANK_NS) -> None:
        self.period_ns = period_ns
        # World time stops before the blank until the thread does it, so that no later time is read before.
        self._halt_ns = period_ns * 97 // 100
        self.condition = threading.Condition()
        self.closed = False
        """The world has ended; time follows real time from then on, so that no wait of a host hangs or spins."""
        self._agenda: list[Happening] = []
        self._numbers = 0
        self._standing_ns: int | None = None
        self._mark = _Mark(START_NS, time.monotonic_ns(), speed, START_NS, START_NS + self._halt_ns)

    @property
    def blank_ns(self) -> int:
        """World time of the latest vertical blank."""
        return self._mark.blank_ns

    @property
    def blank_late_ns(self) -> int:
        """Real time that has passed since the latest vertical blank was due."""
        return time.monotonic_ns() - self._mark.blank_real_ns

    def now_ns(self) -> int:
        """Return world time, which never goes back."""
        return self._mark.now_ns(time.monotonic_ns())

    def at(self, time_ns: int, action: Callable[[int], None], ready: Callable[[], bool] | None = None) -> None:
        """Run ``action`` at ``time_ns``, or at once if that is past. The caller holds the lock.

        It never runs after the end of the world.
        """
        if self.closed:
            return
        self._numbers += 1
        heapq.heappush(self._agenda, Happening(max(time_ns, self.now_ns()), self._numbers, action, ready))
        self._set_mark(self._mark.floor_ns)
        self.condition.notify_all()

    def due(self, until_ns: int) -> Happening | None:
        """Return the next event not later than ``until_ns``. The caller holds the lock."""
        return self._agenda[0] if self._agenda and self._agenda[0].time_ns <= until_ns else None

    def happen(self) -> None:
        """Run the next event now. Only the world's thread calls this, with the lock held."""
        happening = heapq.heappop(self._agenda)
        self._stand(happening.time_ns, happening.action)

    def blank(self, speed: float, real_ns: int, action: Callable[[int], None]) -> None:
        """Do the next vertical blank, at ``real_ns`` of real time, with ``action``. The caller holds the lock."""
        blank_ns = self._mark.blank_ns + self.period_ns
        self._mark = _Mark(blank_ns, real_ns, speed, blank_ns, blank_ns)
        self._stand(blank_ns, action)

    def _stand(self, time_ns: int, action: Callable[[int], None]) -> None:
        """Stop time while ``action`` runs, so that all of it happens at that moment."""
        self._standing_ns = time_ns
        self._set_mark(time_ns)
        try:
            action(time_ns)
        finally:
            self._standing_ns = None
            self._set_mark(time_ns)
            self.condition.notify_all()

    def _set_mark(self, floor_ns: int) -> None:
        if self.closed:
            return
        mark = self._mark
        limit_ns = mark.blank_ns + self._halt_ns
        if self._standing_ns is not None:
            limit_ns = self._standing_ns
        elif self._agenda:
            limit_ns = min(self._agenda[0].time_ns, limit_ns)
        # A lower limit must not turn the clock back.
        floor_ns = max(floor_ns, mark.now_ns(time.monotonic_ns()))
        self._mark = _Mark(mark.blank_ns, mark.blank_real_ns, mark.speed, floor_ns, limit_ns)

    def close(self) -> None:
        """End the world. The caller holds the lock."""
        now_ns, real_ns = self.now_ns(), time.monotonic_ns()
        # From now on it follows real time without a limit, so that no wait hangs.
        self._agenda.clear()
        self._mark = _Mark(now_ns, real_ns, 1.0, now_ns, _FOREVER_NS)
        self.closed = True
        self.condition.notify_all()

    def real_until_s(self, time_ns: int) -> float:
        """Return the real seconds until ``time_ns``, without delays; infinite while it stands still."""
        mark = self._mark
        if mark.speed <= 0:
            return float("inf")
        passed_ns = time.monotonic_ns() - mark.blank_real_ns
        return ((time_ns - mark.blank_ns) / mark.speed - passed_ns) / 1e9

    def real_ns(self, time_ns: int) -> int:
        """Return a moment of world time by CLOCK_MONOTONIC, at the present pace."""
        mark = self._mark
        return mark.blank_real_ns + round((time_ns - mark.blank_ns) / (mark.speed or 1.0))

    def wait_for(self, predicate: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait with the lock held until ``predicate()``, or ``timeout_s`` of world time (``None``: no limit).

        Returns the predicate's value. A caller that waits for a device must also check ``closed``.
        """
        deadline_ns = None if timeout_s is None else self.now_ns() + int(timeout_s * 1e9)
        while not predicate():
            if deadline_ns is not None and self.now_ns() >= deadline_ns:
                return predicate()
            # Beyond the limit only the world's thread moves time, and it notifies.
            within = deadline_ns is not None and deadline_ns <= self._mark.limit_ns
            real_s = self.real_until_s(deadline_ns) if within and deadline_ns is not None else LONGEST_WAIT_S
            self.condition.wait(min(max(real_s, 0.0002), LONGEST_WAIT_S))
        return True

    def sleep_s(self, duration_s: float) -> None:
        """Return after ``duration_s`` of world time."""
        with self.condition:
            self.wait_for(lambda: False, duration_s)


class WorldClock:
    """World time with the interface of the product's clock, for conditions of the product."""

    def __init__(self, world_time: WorldTime) -> None:
        self._time = world_time

    def now_ns(self) -> int:
        """Return world time, the clock of the flips' time stamps."""
        return self._time.now_ns()

    def sleep_s(self, duration_s: float) -> None:
        """Return after ``duration_s`` of world time."""
        self._time.sleep_s(duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        """Wait with ``condition`` held until ``predicate()`` or the timeout; return the predicate's value."""
        deadline_ns = self._time.now_ns() + int(timeout_s * 1e9)
        while not predicate():
            if self._time.now_ns() >= deadline_ns:
                return predicate()
            condition.wait(FOREIGN_SLICE_S)
        return True
