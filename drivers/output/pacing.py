"""The pace of flips that the hardware does not throttle, and an extended counter of vertical blanks."""

from __future__ import annotations

from drivers.api import Clock

UNTHROTTLED_FRACTION = 0.75
"""Two flips closer than this part of a period were not held back by a vertical blank."""


class Pacer:
    """Limits flips to one per period by the clock, once they came faster than that.

    A virtual machine's display and a window without swap interval complete a flip at once; real hardware never meets
    this wait.
    """

    def __init__(self, clock: Clock, refresh_hz: float) -> None:
        self._clock = clock
        self._period_ns = round(1e9 / refresh_hz)
        self._due_ns: int | None = None
        self._last_ns: int | None = None
        self._unthrottled = False

    @property
    def unthrottled(self) -> bool:
        return self._unthrottled

    def wait(self) -> None:
        """Return when the next picture may be handed over; at once on hardware that throttles."""
        if self._unthrottled and self._due_ns is not None:
            left_ns = self._due_ns - self._clock.now_ns()
            # More than a period left means that a clock or the grid jumped: do not wait.
            if 0 < left_ns <= self._period_ns:
                self._clock.sleep_s(left_ns * 1e-9)

    def shown(self, time_ns: int) -> None:
        """Take the time at which a picture became visible."""
        if self._last_ns is not None and 0 <= time_ns - self._last_ns < UNTHROTTLED_FRACTION * self._period_ns:
            self._unthrottled = True
        # The grid of due times advances by whole periods so that waiting late once does not shift all later ones.
        on_grid = self._due_ns is not None and abs(time_ns - self._due_ns) < self._period_ns // 2
        self._due_ns = (self._due_ns if on_grid and self._due_ns is not None else time_ns) + self._period_ns
        self._last_ns = time_ns


class BlankCounter:
    """Turns the kernel's 32-bit vertical-blank counter into one that never wraps.

    Hardware without a counter reports 0 for ever: its sequence is ``None``, not zero.
    """

    def __init__(self) -> None:
        self._last: int | None = None

    def extend(self, raw_sequence: int) -> int | None:
        if self._last is None:
            if raw_sequence == 0:
                return None
            self._last = raw_sequence
            return raw_sequence
        # Signed difference modulo 2**32: a report that is older than the latest stays older.
        step = (raw_sequence - self._last + (1 << 31)) % (1 << 32) - (1 << 31)
        self._last += step
        return self._last
