"""Owns when a live picture is handed to the worker, and which answer counts: one picture at a time, the latest, and a
third of a processor at most."""

from __future__ import annotations

from appliance.instrument.worker.messages import LookAt
from appliance.measure import LiveGuidance

EVERY_S, SHARE = 0.4, 1.0 / 3.0
"""Least time from one picture to the next, and the most of a processor that looking at them may take."""
LIMIT_S = 5.0
"""Longest wait for an answer before another picture is handed over."""


class Looking:
    """The parent's account of live pictures. Called by one thread."""

    def __init__(self) -> None:
        self._taken_ns: int | None = None
        """Time of the picture whose answer is awaited; ``None``: none is."""
        self._from_ns = 0
        """Time from which the next one may be handed over."""

    def may(self, now_ns: int) -> bool:
        """Return whether a picture may be handed over now."""
        return now_ns >= self._from_ns

    def ask(self, shape: tuple[int, int], belongs_to: int, now_ns: int) -> LookAt:
        """Return the order to look at a picture (h, w) that lies in its place, for an object of that number."""
        self._taken_ns, self._from_ns = now_ns, now_ns + round(LIMIT_S * 1e9)
        return LookAt(now_ns, shape, belongs_to)

    def awaits(self, answer: LiveGuidance) -> bool:
        """Take note of an answer; returns False where nobody waits for it any more."""
        if answer.taken_ns != self._taken_ns:
            return False
        self._taken_ns = None
        self._from_ns = answer.taken_ns + round(1e9 * max(EVERY_S, answer.cpu_s / SHARE))
        return True

    def stop(self) -> None:
        """Await no answer any more: a scan begins, or the process is another one."""
        self._taken_ns, self._from_ns = None, 0
