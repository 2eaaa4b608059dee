"""Failures of the computer in the housing: of its worker, its disk and its power.

Like a diver it uses the status file, which names the process and lies in ``run`` of the storage root.
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
"""Free space of a filled disk, for the status file."""
MOST_FILLED_BYTES = 500_000_000
"""Largest disk that may be filled, so that no real one is."""
VERBS = {
    ("power", "cut"),
    ("worker", "kill"),
    ("worker", "hang"),
    ("disk", "off"),
    ("disk", "on"),
    ("disk", "fill"),
    ("disk", "spare"),
}


def check(failure: tuple[str, ...]) -> None:
    """Check that the failure exists. Raises ValueError otherwise."""
    if failure not in VERBS:
        raise ValueError(f"'{' '.join(failure)}'; allowed are {', '.join(' '.join(pair) for pair in sorted(VERBS))}")


def happen(failure: tuple[str, ...], status: Path) -> None:
    """Cause the failure now. Raises ValueError if there is no process or disk for it."""
    root = status.parent.parent
    match failure:
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
        case ("disk", "off"):  # every call in the folder fails, for every user
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
        # The other file fills the disk; its removal frees the space.
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
