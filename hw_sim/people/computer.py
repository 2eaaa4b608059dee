"""Owns what can happen to the computer in the housing: its process for points dies or hangs, its disk refuses, somebody else
fills it, or the power goes.

Like a diver it goes by the status file: that names the process, and lies in ``run`` of the storage root.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

from hw_sim.people import status_file

SCANS = "scans"
GONE = "scans.taken-away"
SOMEBODY_ELSES = "somebody-elses-file"
LEFT_BYTES = 200_000
"""A disk that somebody fills has so much left: the status file must find its place."""
MOST_FILLED_BYTES = 500_000_000
"""A larger disk is not one made for this."""
VERBS = {
    ("power", "cut"),
    ("worker", "kill"),
    ("worker", "hang"),
    ("disk", "off"),
    ("disk", "on"),
    ("disk", "fill"),
    ("disk", "spare"),
}


def check(words: tuple[str, ...]) -> None:
    """Check that it can happen. Raises ValueError otherwise."""
    if words not in VERBS:
        raise ValueError(f"'{' '.join(words)}'; allowed are {', '.join(' '.join(pair) for pair in sorted(VERBS))}")


def happen(words: tuple[str, ...], status: Path) -> None:
    """Make it happen now. Raises ValueError where there is nothing that it could happen to."""
    root = status.parent.parent
    match words:
        case ("power", _):
            pid = status_file.read(status).get("pid")
            if pid is None:
                raise ValueError("no service is running")
            os.kill(int(pid), signal.SIGKILL)
        case ("worker", how):
            pid = status_file.read(status).get("worker_pid")
            if pid is None:
                raise ValueError("no process for points is running")
            os.kill(int(pid), signal.SIGKILL if how == "kill" else signal.SIGSTOP)
        case ("disk", "off"):  # every call that wants into the folder fails, for whatever user
            (root / SCANS).rename(root / GONE)
            (root / SCANS).write_bytes(b"")
        case ("disk", "fill"):
            free = _free_bytes(root)
            if free > MOST_FILLED_BYTES:
                raise ValueError(
                    f"{free / 1e6:.0f} MB are free; a disk of at most {MOST_FILLED_BYTES / 1e6:.0f} MB is filled"
                )
            with (root / SOMEBODY_ELSES).open("ab", buffering=0) as file:
                os.posix_fallocate(file.fileno(), file.tell(), max(1, free - LEFT_BYTES))
        # The other file is what fills the disk; without it there is room again.
        case ("disk", "spare"):
            (root / SOMEBODY_ELSES).unlink(missing_ok=True)
        case ("disk", _):
            if not (root / GONE).is_dir():
                raise ValueError("the disk is not off")
            (root / SCANS).unlink()
            (root / GONE).rename(root / SCANS)


def _free_bytes(root: Path) -> int:
    answer = os.statvfs(root)
    return answer.f_bavail * answer.f_frsize
