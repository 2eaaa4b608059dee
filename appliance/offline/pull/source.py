"""Owns what is asked of the place that scans are taken from, and how a mounted folder or a USB disk answers it.

Paths are relative to the storage root there, with ``/`` between names. Nothing is ever changed there: the protocol has no way to.
"""

from __future__ import annotations

import errno
import stat
from collections.abc import Iterator
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
    changed_s: int
    """Time of the last change by the clock there; only compared with itself."""


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
        found = []
        self._refuse_links(folder)
        with _Told(self._root / folder):
            for path in sorted((self._root / folder).iterdir()):
                about = path.lstat()  # a link is neither file nor folder: it could lead anywhere
                if stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode):
                    folder_there = stat.S_ISDIR(about.st_mode)
                    found.append(RemoteEntry(path.name, about.st_size, folder_there, int(about.st_mtime)))
        return found

    def read(self, path: str, start: int, end: int) -> Iterator[bytes]:
        self._refuse_links(path)
        with _Told(self._root / path), (self._root / path).open("rb") as file:
            file.seek(start)
            while start < end and (block := file.read(min(BLOCK_BYTES, end - start))):
                start += len(block)
                yield block

    def _refuse_links(self, path: str) -> None:
        if is_linked(self._root, path):
            raise Unreadable(
                f"{self._root / path}: leads over a link, which could lead anywhere on this computer; not followed"
            )


def is_linked(root: Path, path: str) -> bool:
    """Return True if a component of ``path`` below ``root`` is a link: on a strange disk it may lead to the desk's own files."""
    at = root
    for part in Path(path).parts:
        at = at / part
        if at.is_symlink():
            return True
    return False


class _Told:
    """Turns OSError into what the protocol promises."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if not isinstance(error, OSError):
            return
        text = f"{self._path}: {error.strerror or error}"
        if error.errno in _GONE:
            raise NotThere(text) from error
        if error.errno in _LINK:
            raise LinkLost(text) from error
        raise Unreadable(text) from error


def text_of(source: Source, path: str, most_bytes: int) -> bytes:
    """Return a whole small file. Raises NotThere, LinkLost, Unreadable where it is larger than ``most_bytes``."""
    data = b"".join(source.read(path, 0, most_bytes + 1))
    if len(data) > most_bytes:
        raise Unreadable(f"{path}: more than {most_bytes} bytes")
    return data
