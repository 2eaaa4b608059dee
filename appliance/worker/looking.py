"""Owns when a live picture is handed to the worker, and which answer counts: one picture at a time, the latest, and a third of a processor at
most."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.scan.guidance import Guidance
from appliance.worker.messages import LookAt, LookedAt

EVERY_S, SHARE = 0.4, 1.0 / 3.0
"""Least time from one picture to the next, and the most of a processor that looking at them may take."""
LIMIT_S = 5.0
"""Longest wait for an answer before another picture is handed over."""


@dataclass(frozen=True, slots=True)
class LiveLookedAt:
    """It is known what a scan from where a live picture was taken would have in common with the one that was kept."""

    guidance: Guidance | None
    """``None``: it cannot be told."""
    taken_ns: int
    """Time at which the picture was handed over."""
    cpu_s: float


class Looking:
    """The parent's account of live pictures. Called by one thread."""

    def __init__(self) -> None:
        self._number = 0
        """Number of the picture that was handed over last."""
        self._since_ns: int | None = None
        """Time since which its answer is awaited; ``None``: it is not."""
        self._from_ns = 0
        """Time from which the next one may be handed over."""

    def may(self, now_ns: int) -> bool:
        """Return whether a picture may be handed over now."""
        return now_ns >= self._from_ns

    def ask(self, shape: tuple[int, int], belongs_to: int, now_ns: int) -> LookAt:
        """Return the order to look at a picture (h, w) that lies in its place, for an object of that number."""
        self._number += 1
        self._since_ns, self._from_ns = now_ns, now_ns + round(LIMIT_S * 1e9)
        return LookAt(self._number, shape, belongs_to)

    def answered(self, answer: LookedAt) -> LiveLookedAt | None:
        """Return what an answer says; ``None``: nobody waits for it any more."""
        if answer.number != self._number or self._since_ns is None:
            return None
        taken_ns, self._since_ns = self._since_ns, None
        self._from_ns = taken_ns + round(1e9 * max(EVERY_S, answer.cpu_s / SHARE))
        return LiveLookedAt(answer.guidance, taken_ns, answer.cpu_s)

    def stop(self) -> None:
        """Await no answer any more: a scan begins, or the process is another one."""
        self._since_ns, self._from_ns = None, 0
