"""Owns what can happen to the computer in the housing: its process for points dies or hangs, its disk refuses.

Like the diver's sight it goes by the status file: that names the process, and lies in ``run`` of the storage root.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

from hw_sim import sight

SCANS = "scans"
GONE = "scans.taken-away"
VERBS = {("worker", "kill"), ("worker", "hang"), ("disk", "off"), ("disk", "on")}


def check(words: tuple[str, ...]) -> None:
    """Raises ValueError for what cannot happen."""
    if words not in VERBS:
        raise ValueError(f"'{' '.join(words)}'; allowed are {', '.join(' '.join(pair) for pair in sorted(VERBS))}")


def happen(words: tuple[str, ...], status: Path) -> None:
    """Let it happen now. Raises ValueError where there is nothing that it could happen to."""
    root = status.parent.parent
    match words:
        case ("worker", how):
            pid = sight.read(status).get("worker_pid")
            if pid is None:
                raise ValueError("no process for points is running")
            os.kill(int(pid), signal.SIGKILL if how == "kill" else signal.SIGSTOP)
        case ("disk", "off"):  # every call that wants into the folder fails, for whatever user
            (root / SCANS).rename(root / GONE)
            (root / SCANS).write_bytes(b"")
        case ("disk", _):
            if not (root / GONE).is_dir():
                raise ValueError("the disk is not off")
            (root / SCANS).unlink()
            (root / GONE).rename(root / SCANS)
