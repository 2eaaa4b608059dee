"""Owns what a process takes of the machine, as Linux tells it."""

from __future__ import annotations

import os
from pathlib import Path


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
