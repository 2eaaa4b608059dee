"""Owns who else has a serial port open: what keeps the answers of the board away although it works.

A port is locked by those who ask for the lock, and read by anybody who does not (``picocom``, ``cat``): each byte then comes to one of the
readers, whichever asks first. Linux tells in ``/proc`` which processes have it open, of those that this user may look into.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_PROCESSES = Path("/proc")


def other_users(port: str) -> tuple[str, ...]:
    """Return the programs besides this one that have ``port`` (a path) open, as ``name (process number)``; empty where none is known."""
    try:
        wanted = Path(port).resolve(strict=True)
        processes = [one for one in _PROCESSES.iterdir() if one.name.isdigit() and int(one.name) != os.getpid()]
    except OSError:  # a URL that is no path, or no /proc
        return ()
    found = []
    for process in sorted(processes, key=lambda one: int(one.name)):
        # A process may end meanwhile, and those of other users are closed to us.
        with suppress(OSError):
            if any(_leads_to(file) == wanted for file in (process / "fd").iterdir()):
                name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                found.append(f"{name} (process {process.name})")
    return tuple(found)


def _leads_to(file: Path) -> Path | None:
    try:
        return file.readlink()
    except OSError:
        return None
