"""The lock of a storage root: one process at a time may write there."""

from __future__ import annotations

import fcntl
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from appliance.store.atomic import StorageError

FILE_NAME = "lock"
_LOOK_S = 0.02
"""Time in seconds between two attempts to take the lock."""


@contextmanager
def hold_lock(root: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the lock of ``root``; the kernel releases it however the process ends.

    Raises StorageError if it is taken, and still is after ``wait_s``.
    """
    path = root / "run" / FILE_NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise StorageError.of("cannot open", path, error) from error
    try:
        try:
            _take(descriptor, time.monotonic() + wait_s)
        except OSError as error:
            owner = os.read(descriptor, 32).decode("ascii", "replace").strip() or "unknown"
            raise StorageError(
                "cannot use", root, f"another instance (process {owner}) is using it", "stop that process first"
            ) from error
        with StorageError.naming("cannot write", path):
            # The number is for messages only; the lock does not depend on it.
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(descriptor)


def _take(descriptor: int, until_s: float) -> None:
    never = threading.Event()  # it is never set: its wait is a pause that Ctrl-C ends
    while True:
        try:
            # flock belongs to the open file: it ends with the process, also with a killed one. A file with a process
            # number would outlive it.
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                raise
        never.wait(_LOOK_S)


def holder(root: Path) -> str | None:
    """Return the process that holds the lock of ``root``, or ``None``; never raises."""
    try:
        descriptor = os.open(root / "run" / FILE_NAME, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        # A shared lock, so that several processes can ask at once.
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return os.read(descriptor, 32).decode("ascii", "replace").strip() or "unknown"
    else:
        return None
    finally:
        os.close(descriptor)
