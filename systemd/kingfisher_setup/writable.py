"""Owns the exception to a read-only system: it can be written while versions change, and is read-only again afterwards."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from kingfisher_setup.errors import SetupError


@contextmanager
def writable(paths: Iterable[Path]) -> Iterator[None]:
    """Inside, the file systems that ``paths`` lie on can be written. Raises SetupError where one cannot be made so.

    A loss of power inside leaves nothing behind: how it is mounted is decided at the next start.
    """
    opened: list[Path] = []
    try:
        for mounted in dict.fromkeys(_mounted(path) for path in paths):
            if os.statvfs(mounted).f_flag & os.ST_RDONLY:
                _remount(mounted, "rw")
                opened.append(mounted)
        yield
    finally:
        os.sync()
        for mounted in reversed(opened):
            _remount(mounted, "ro")


def _mounted(path: Path) -> Path:
    """The mount point above ``path``, which need not exist."""
    while not (path.exists() and path.is_mount()):
        path = path.parent
    return path


def _remount(mounted: Path, how: str) -> None:
    command = ["mount", "-o", f"remount,{how}", str(mounted)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if done.returncode != 0:
        raise SetupError(f"{mounted} cannot be mounted {how}: {done.stderr.strip()}; do it by hand")
