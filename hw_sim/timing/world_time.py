"""Owns world time: one lock for everything that happens, what happens next, and waiting that ends in world time.

All state of the devices is touched with ``condition`` held; whoever changes something that another may wait for
calls ``condition.notify_all()``. World time moves from vertical blank to vertical blank. Between two blanks it
follows real time, never passes anything that is still to happen, and halts just before the next blank.
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
"""The world begins a little after its host booted."""
LONGEST_WAIT_S = 0.25
"""Bound of a wait that is expected to end by a notification."""
FOREIGN_SLICE_S = 0.005
"""A wait on somebody else's condition looks at world time so often."""
_FOREVER_NS = 2**62


@dataclass(order=True, slots=True)
class Happening:
    """Something that will happen at a moment of world time."""

    time_ns: int
    number: int
    action: Callable[[int], None] = field(compare=False)
    """Called with ``time_ns``, lock held."""
    ready: Callable[[], bool] | None = field(compare=False, default=None)
    """World time does not pass this happening before it is ready."""


@dataclass(frozen=True, slots=True)
class _Mark:
    """Replaced as a whole, so that reading the clock needs no lock."""

    blank_ns: int
    blank_real_ns: int
    speed: float
    floor_ns: int
    limit_ns: int

    def now_ns(self, real_ns: int) -> int:
        # now = blank + speed · (real time since), between what was seen already and what may not be passed yet.
        followed_ns = self.blank_ns + int((real_ns - self.blank_real_ns) * self.speed)
        return max(self.floor_ns, min(followed_ns, self.limit_ns))


class WorldTime:
    """The world's clock, agenda and lock. ``speed`` is world time per real time between blanks; 0 stands still.

    ``period_ns`` is from one vertical blank to the next.
    """

    def __init__(self, speed: float = 1.0, period_ns: int = BLANK_NS) -> None:
        self.period_ns = period_ns
        # World time stops short of the blank until the thread makes it happen: nobody sees a time after it before it came.
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
        """Let ``action`` happen at ``time_ns``, or at once where that is past. The caller holds the lock.

        Nothing happens any more once the world has ended.
        """
        if self.closed:
            return
        self._numbers += 1
        heapq.heappush(self._agenda, Happening(max(time_ns, self.now_ns()), self._numbers, action, ready))
        self._set_mark(self._mark.floor_ns)
        self.condition.notify_all()

    def due(self, until_ns: int) -> Happening | None:
        """Return what happens next, if not later than ``until_ns``. The caller holds the lock."""
        return self._agenda[0] if self._agenda and self._agenda[0].time_ns <= until_ns else None

    def happen(self) -> None:
        """Make the next happening happen now. Only the world's thread calls this, with the lock held."""
        happening = heapq.heappop(self._agenda)
        self._stand(happening.time_ns, happening.action)

    def blank(self, speed: float, real_ns: int, action: Callable[[int], None]) -> None:
        """Make the next vertical blank happen, at ``real_ns`` of real time, and ``action`` with it. The caller holds the lock."""
        blank_ns = self._mark.blank_ns + self.period_ns
        self._mark = _Mark(blank_ns, real_ns, speed, blank_ns, blank_ns)
        self._stand(blank_ns, action)

    def _stand(self, time_ns: int, action: Callable[[int], None]) -> None:
        """Let time stand still while ``action`` runs, so that all of it happens at that moment."""
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
        # What was already seen stays seen: a lower limit must not turn the clock back.
        floor_ns = max(floor_ns, mark.now_ns(time.monotonic_ns()))
        self._mark = _Mark(mark.blank_ns, mark.blank_real_ns, mark.speed, floor_ns, limit_ns)

    def close(self) -> None:
        """End the world. The caller holds the lock."""
        now_ns, real_ns = self.now_ns(), time.monotonic_ns()
        # From now on it follows real time without a limit, so that nobody who still waits hangs.
        self._agenda.clear()
        self._mark = _Mark(now_ns, real_ns, 1.0, now_ns, _FOREVER_NS)
        self.closed = True
        self.condition.notify_all()

    def real_until_s(self, time_ns: int) -> float:
        """Return the real seconds until ``time_ns``, if nothing holds world time up; infinite where it stands still."""
        mark = self._mark
        if mark.speed <= 0:
            return float("inf")
        passed_ns = time.monotonic_ns() - mark.blank_real_ns
        return ((time_ns - mark.blank_ns) / mark.speed - passed_ns) / 1e9

    def real_ns(self, time_ns: int) -> int:
        """A moment of world time by CLOCK_MONOTONIC, as if world time had kept its present pace then."""
        mark = self._mark
        return mark.blank_real_ns + round((time_ns - mark.blank_ns) / (mark.speed or 1.0))

    def wait_for(self, predicate: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait with the lock held until ``predicate()``, or ``timeout_s`` of world time (``None``: no limit).

        Returns the predicate's value. Who waits for a device also asks whether the world is ``closed``.
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
    """World time in the shape of a product's clock, for conditions of the product's own."""

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
