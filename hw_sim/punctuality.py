"""Punctuality in real time: how soon the host answers a vertical blank, and how late the world is.

It has a meaning only if the world's pace is ``realtime``.
"""

from __future__ import annotations

import time
from collections import deque

from hw_sim.devices.head import Flip

MOST = 20_000
"""Largest number of values of each kind; the oldest are dropped."""


class Punctuality:
    """Counts and times of vertical blanks. Called for each one with the world's lock held."""

    def __init__(self) -> None:
        self.answers_us: deque[float] = deque(maxlen=MOST)
        """Time, for each flip of a sequence, from the blank before it, as it happened, until the host asked for it. Later than
        one period is too late."""
        self.blanks_late_us: deque[float] = deque(maxlen=MOST)
        """Delay of each blank of a sequence after it was due. That is the world's own fault."""
        self.missed = 0
        """Blanks of a sequence that found no flip waiting."""
        self.other_blanks = 0
        """Blanks while no sequence was recorded."""
        self.screen_updates = 0
        """Other blanks that brought a new picture on the display."""
        self._flipped_ns: int | None = None

    def blank(self, late_ns: int, recording: bool, projector: Flip | None, display: Flip | None) -> None:
        """Note a vertical blank that happens now, ``late_ns`` after its time, with these flips waiting."""
        if recording:
            self.blanks_late_us.append(late_ns / 1e3)
            if projector is None:
                self.missed += 1
            elif self._flipped_ns is not None:
                self.answers_us.append((projector.asked_ns - self._flipped_ns) / 1e3)
        else:
            self.other_blanks += 1
            self.screen_updates += display is not None
        if projector is not None:
            # The host's answer counts from the real time of the blank, not from its due time.
            self._flipped_ns = time.monotonic_ns()
