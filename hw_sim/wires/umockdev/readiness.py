"""The answer of ``poll`` for a device node: a named pipe in its place, kept full or empty."""

from __future__ import annotations

import fcntl
import os
import threading
from pathlib import Path

_PAGE = 4096


class Readiness:
    """``poll`` reports readable (``POLLIN``), or with ``for_writing`` writable (``POLLOUT``), while it is set.

    All openings of a node share it: a call in vain gets EAGAIN, as after any other spurious wake-up.
    """

    def __init__(self, node: Path, for_writing: bool = False) -> None:
        """The node must not exist yet."""
        node.parent.mkdir(parents=True, exist_ok=True)
        os.mkfifo(node, 0o660)
        self._for_writing = for_writing
        self._lock = threading.Lock()
        self._fd = os.open(node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        fcntl.fcntl(self._fd, fcntl.F_SETPIPE_SZ, _PAGE)
        self._ready = False
        if for_writing:
            self._fill()

    def set(self, ready: bool) -> None:
        """Let ``poll`` report ``ready`` from now on; no effect after ``close``."""
        with self._lock:
            if ready == self._ready or self._fd < 0:
                return
            self._ready = ready
            if ready == self._for_writing:
                os.read(self._fd, _PAGE)
            else:
                self._fill()

    def _fill(self) -> None:
        os.write(self._fd, bytes(_PAGE if self._for_writing else 1))

    def close(self) -> None:
        """Remove the node. Files that are still open on it become ready, so that their next call fails."""
        self.set(True)
        with self._lock:
            os.close(self._fd)
            self._fd = -1
