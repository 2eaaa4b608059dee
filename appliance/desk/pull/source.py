"""Owns what is asked of the place that scans are taken from, and how a mounted folder or a USB disk answers it.

Paths are relative to the storage root there, with ``/`` between names. Nothing is ever changed there: the protocol has
no way to.
"""

from __future__ import annotations

import errno
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

BLOCK_BYTES = 1024 * 1024
_GONE = (errno.ENOENT, errno.ENOTDIR)
_LINK = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ETIMEDOUT)
"""Errors of a network folder or a stick whose cable moved; a disk that fails gives the first of them, too."""


class PullError(Exception):
    """Scans cannot be taken from there at all; the text says why and what to do."""


class LinkLost(Exception):
    """The link broke or fell silent; what was taken is kept, and the next attempt goes on behind it."""


class NotThere(Exception):
    """A file or a folder is not there, or not any more."""


class Unreadable(Exception):
    """A file or a folder is there and is not given; the text names it."""


@dataclass(frozen=True, slots=True)
class RemoteEntry:
    """One name in a folder there."""

    name: str
    size_bytes: int
    folder: bool


class Source(Protocol):
    """A storage root that is read. Each call may raise LinkLost, and Unreadable for what is not given."""

    def listing(self, folder: str) -> list[RemoteEntry]:
        """Return the ordinary files and folders in a folder, by name. Raises NotThere."""

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        """Give a file's bytes from ``start`` to ``end``, in order; fewer where it ends before. Raises NotThere."""


class FolderSource:
    """A storage root on this computer: a mounted share, the instrument's disk, a USB disk."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def listing(self, folder: str) -> list[RemoteEntry]:
        with self._told(folder) as path:
            found = [(one.name, one.lstat()) for one in sorted(path.iterdir())]
        return [entry for name, about in found if (entry := entry_of(name, about.st_mode, about.st_size)) is not None]

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        with self._told(path) as here, here.open("rb") as file:
            file.seek(start)
            while start < end and (block := file.read(min(BLOCK_BYTES, end - start))):
                start += len(block)
                yield block

    @contextmanager
    def _told(self, path: str) -> Iterator[Path]:
        """Give where ``path`` lies, and turn OSError into what the protocol promises."""
        here = self._root / path
        if is_linked(self._root, path):
            raise Unreadable(f"{here}: leads over a link, which could lead anywhere on this computer; not followed")
        try:
            yield here
        except OSError as error:
            kind = NotThere if error.errno in _GONE else LinkLost if error.errno in _LINK else Unreadable
            raise kind(f"{here}: {error.strerror or error}") from error


def entry_of(name: str, mode: int, size_bytes: int) -> RemoteEntry | None:
    """Return an entry of a listing; ``None`` for what is neither file nor folder: a link could lead anywhere."""
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        return None
    return RemoteEntry(name, size_bytes, stat.S_ISDIR(mode))


def is_linked(root: Path, path: str) -> bool:
    """Return True if a component of ``path`` below ``root`` is a link: on a strange disk it may lead to the desk's own
    files."""
    parts = Path(path).parts
    return any(root.joinpath(*parts[: k + 1]).is_symlink() for k in range(len(parts)))


def text_of(source: Source, path: str, most_bytes: int) -> bytes:
    """Return a whole small file. Raises NotThere, LinkLost, Unreadable where it is larger than ``most_bytes``."""
    data = b"".join(source.read(path, 0, most_bytes + 1))
    if len(data) > most_bytes:
        raise Unreadable(f"{path}: more than {most_bytes} bytes")
    return data
