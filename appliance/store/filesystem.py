"""Owns the few system calls that change the disk; everything durable goes through this port.

It exists so that a test can make the n-th of these calls fail, for every n. Reading needs no port: a read that fails
is a damaged file and is treated as one.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Protocol

Bytes = bytes | bytearray | memoryview


class WritableFile(Protocol):
    """A file being written for the first time."""

    def write(self, data: Bytes) -> None:
        """Append all of ``data``. Raises OSError."""

    def sync(self) -> None:
        """Return when everything written would survive the loss of power. Raises OSError."""

    def close(self) -> None:
        """Raises OSError; the descriptor is gone in any case."""


class FileSystem(Protocol):
    """The operations that storage needs of a file system. Every call raises OSError on failure."""

    def make_folder(self, path: Path) -> None:
        """Make one folder; it must not exist."""

    def create(self, path: Path) -> WritableFile:
        """Make one file; it must not exist."""

    def rename(self, source: Path, target: Path) -> None:
        """Rename atomically; an existing target file is replaced, an existing target folder is an error."""

    def sync_folder(self, path: Path) -> None:
        """Return when the folder's names would survive the loss of power."""

    def remove(self, path: Path) -> None:
        """Remove a file or an empty folder."""

    def free_bytes(self, path: Path) -> int:
        """Return the space left for an unprivileged process."""


class AllocatingFileSystem(FileSystem, Protocol):
    """A file system that can give space before there is anything to write. Every call raises OSError on failure."""

    def allocate(self, path: Path, length_bytes: int) -> None:
        """Make one file of that length, all of whose blocks are taken; it must not exist.

        What is in it means nothing.
        """

    def reopen(self, path: Path) -> WritableFile:
        """Write an existing file anew from its start, into the blocks it has; ``sync`` cuts it to what was written."""


class AppendingFileSystem(FileSystem, Protocol):
    """A file system on which a file that was begun can be gone on with. Every call raises OSError on failure."""

    def append(self, path: Path) -> WritableFile:
        """Go on behind the end of an existing file."""


class _LocalFile:
    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def write(self, data: Bytes) -> None:
        rest = memoryview(data).cast("B")
        # write(2) may write less than asked, for example when a signal comes.
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


class _LocalFileAnew(_LocalFile):
    """Written over what is there."""

    def sync(self) -> None:
        # The piece of the room may be longer than what was written into it; its rest is cut off before the content
        # counts as durable.
        os.ftruncate(self._descriptor, os.lseek(self._descriptor, 0, os.SEEK_CUR))
        super().sync()


class LocalFileSystem:
    """The disk of this machine (POSIX)."""

    def make_folder(self, path: Path) -> None:
        path.mkdir(mode=0o755)

    def create(self, path: Path) -> WritableFile:
        return _LocalFile(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644))

    def rename(self, source: Path, target: Path) -> None:
        if source.is_dir() and target.exists():  # POSIX would replace an empty folder in silence
            raise FileExistsError(f"{target} exists")
        source.rename(target)

    def sync_folder(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def remove(self, path: Path) -> None:
        if path.is_dir():
            path.rmdir()
        else:
            path.unlink()

    def allocate(self, path: Path, length_bytes: int) -> None:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            # Blocks, not only a length: writing into them later cannot fail for want of space.
            os.posix_fallocate(descriptor, 0, length_bytes)
        finally:
            os.close(descriptor)

    def reopen(self, path: Path) -> WritableFile:
        return _LocalFileAnew(os.open(path, os.O_WRONLY | os.O_CLOEXEC))

    def append(self, path: Path) -> WritableFile:
        return _LocalFile(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC))

    def free_bytes(self, path: Path) -> int:
        answer = os.statvfs(path)
        # f_bavail, not f_bfree: blocks that are kept for root are not for scans.
        return answer.f_bavail * answer.f_frsize
