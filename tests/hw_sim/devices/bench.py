"""Owns a laboratory bench for one device: world time that a test turns by hand, faults, and vertical blanks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import BLANK_NS, WorldTime


class Bench:
    """World time stands still unless ``run_s`` turns it. Used with the lock held (``with bench.time.condition``)."""

    def __init__(self) -> None:
        self.time = WorldTime(speed=0.0)
        self.changed: list[Callable[[int], None]] = []
        self.on_blank: Callable[[int], None] = lambda _: None
        self.faults = FaultBook(self.time.now_ns, self.time.at, self._changed)

    def _changed(self, time_ns: int) -> None:
        for refresh in self.changed:
            refresh(time_ns)

    def run_s(self, duration_s: float) -> None:
        end_ns = self.time.now_ns() + round(duration_s * 1e9)
        self.time.at(end_ns, lambda _: None)
        while self.time.now_ns() < end_ns:
            blank_ns = self.time.blank_ns + BLANK_NS
            if self.time.due(min(end_ns, blank_ns)) is not None:
                self.time.happen()
            else:
                self.time.blank(0.0, time.monotonic_ns(), self.on_blank)

    def blanks(self, count: int) -> None:
        """Run to a moment just behind that many more vertical blanks."""
        last_ns = self.time.blank_ns + count * BLANK_NS
        self.run_s((last_ns + 1000 - self.time.now_ns()) / 1e9)


@contextmanager
def bench() -> Iterator[Bench]:
    made = Bench()
    with made.time.condition:
        yield made
