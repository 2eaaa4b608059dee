"""Owns whether a process gets on, by one rule: while it owes an answer, it shows progress within a limit.

It also owns what a process takes of the machine, as Linux tells it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from drivers.api import Clock


def own_memory_mb(pid: int) -> float | None:
    """Return the resident memory of a process without what it shares with others, MB; ``None`` when it is not there any
    more."""
    status = _read(pid, "status")
    kb = {line.split(":")[0]: line.split()[1] for line in status.splitlines() if line.startswith("Rss")}
    # proc(5): VmRSS = RssAnon + RssFile + RssShmem; the last one is the frame store and the points.
    return (int(kb.get("RssAnon", "0")) + int(kb.get("RssFile", "0"))) / 1000.0 if kb else None


def cpu_s(pid: int) -> float | None:
    """Return the processor time of a process so far, all its threads; ``None`` when it is not there any more."""
    fields = _read(pid, "stat").rpartition(")")[2].split()  # the name before may hold spaces
    if len(fields) < 13:
        return None
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))  # proc(5): utime, stime


def _read(pid: int, name: str) -> str:
    try:
        return Path(f"/proc/{pid}/{name}").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""


LOOK_S = 2.0
"""Least time between two looks at the processor time."""
SHARE = 0.05
"""Share of the time between two looks that a process uses a processor if it gets on; one that hangs uses none."""


class Liveness:
    """Judge of one process.

    Progress is a message, or processor time; the latter alone counts for so long only, since a computation may go on
    for ever. Called by one thread.
    """

    def __init__(self, clock: Clock, used_s: Callable[[], float]) -> None:
        """``used_s`` returns the processor time of the process so far."""
        self._clock, self._used_s = clock, used_s
        self._limits_s: tuple[float, float] | None = None
        """Longest time without progress, and without a message; ``None``: nothing is owed."""
        self._since_ns = self._progress_ns = self._looked_ns = clock.now_ns()
        self._cpu_s = 0.0
        self._computed = False

    def owe(self, limit_s: float, silence_s: float) -> None:
        """Expect progress every ``limit_s`` from now on, and a message within ``silence_s``."""
        self._limits_s = limit_s, silence_s
        self._since_ns = self._progress_ns = self._looked_ns = self._clock.now_ns()
        self._cpu_s, self._computed = self._used_s(), False

    def rest(self) -> None:
        """Expect nothing from now on."""
        self._limits_s, self._since_ns = None, self._clock.now_ns()

    @property
    def rested_s(self) -> float:
        """Time since which nothing is owed; 0 while something is."""
        return (self._clock.now_ns() - self._since_ns) / 1e9 if self._limits_s is None else 0.0

    def late(self, grace_s: float = 0.0) -> str | None:
        """Return in words why the process does not get on, for longer than it may by ``grace_s``; ``None``: it does, or
        owes nothing."""
        if self._limits_s is None:
            return None
        self._look()
        now_ns, (limit_s, silence_s) = self._clock.now_ns(), self._limits_s
        if (now_ns - self._progress_ns) / 1e9 > limit_s + grace_s:
            return f"it gave no sign of life for {limit_s:g} s"
        if (now_ns - self._since_ns) / 1e9 > silence_s + grace_s:
            return f"it computed for {silence_s:g} s and said nothing"
        return None

    def computed(self) -> bool:
        """Return whether the process was seen to use a processor since this was asked last."""
        self._look()
        computed, self._computed = self._computed, False
        return computed

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        passed_s = (now_ns - self._looked_ns) / 1e9
        if passed_s < LOOK_S:
            return
        before_s, self._cpu_s = self._cpu_s, self._used_s()
        self._looked_ns = now_ns
        if self._cpu_s - before_s >= SHARE * passed_s:
            self._progress_ns, self._computed = now_ns, True
