"""Owns when a report was made: the pad's 16-bit milliseconds, laid onto host time."""

from __future__ import annotations

_WRAP_MS = 1 << 16
_MS = 1_000_000


class PadTime:
    """Dates reports so that a host that was late to read them does not change how long a key was held.

    A report that was waited for is dated to its arrival. One that was lying there already is dated by the pad's own
    clock from the report before it, never after its arrival and never before its predecessor.
    """

    def __init__(self) -> None:
        self._last_ms: int | None = None
        self._last_ns = 0

    def date(self, pad_time_ms: int, arrival_ns: int, waited_for: bool) -> int:
        """Host time in ns at which the report was made."""
        time_ns = arrival_ns
        if not waited_for and self._last_ms is not None:
            elapsed_ns = (pad_time_ms - self._last_ms) % _WRAP_MS * _MS
            time_ns = min(arrival_ns, self._last_ns + elapsed_ns)
        self._last_ms = pad_time_ms
        self._last_ns = max(time_ns, self._last_ns)
        return self._last_ns
