"""Finding other programs that have the board's serial port open and so take its answers.

A port is locked only against programs that use the lock; any other (``picocom``, ``cat``) may read it: each byte then
goes to one of the readers. Linux lists in ``/proc`` the open files of those processes that this user may inspect.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

_PROCESSES = Path("/proc")


def other_users(port: str) -> tuple[str, ...]:
    """Return the other programs that have ``port`` (a path) open, as ``name (process number)``."""
    try:
        resolved_port = Path(port).resolve(strict=True)
        processes = [entry for entry in _PROCESSES.iterdir() if entry.name.isdigit() and int(entry.name) != os.getpid()]
    except OSError:  # a URL that is no path, or no /proc
        return ()
    users = []
    for process in sorted(processes, key=lambda entry: int(entry.name)):
        # A process may end meanwhile, and those of other users cannot be read.
        with suppress(OSError):
            if any(_leads_to(file) == resolved_port for file in (process / "fd").iterdir()):
                name = (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
                users.append(f"{name} (process {process.name})")
    return tuple(users)


def _leads_to(file: Path) -> Path | None:
    try:
        return file.readlink()
    except OSError:
        return None
