"""Owns the order of system calls after which data survives the loss of power, and never less than all of it.

A file: write, fsync, rename, fsync the folder. A folder: all its files so, fsync it, rename, fsync its parents. A
failed fsync means that the kernel may have dropped the data: nothing is retried on the same file, it is written anew.

What changes the disk goes through the few calls that a ``FileSystem`` begins with, so that a test can make the n-th of
them fail, for every n. Reading needs no port: a read that fails is a damaged file and is treated as one.
"""

from __future__ import annotations

import errno
import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, Self

Bytes = bytes | bytearray | memoryview
_BLOCK = 4 * 1024 * 1024
CHECKSUM_DIGITS = 12
"""Digits of the checksum in the name of a file whose own name was taken by other content."""
_OWNER = "this user may not: check the owner and the mode of the folder, or use another folder"
_REMEDIES = {
    errno.ENOSPC: "the disk is full: free space on it, or use another folder",
    errno.EDQUOT: "this user's share of the disk is used up: free space, or have the share enlarged",
    errno.EROFS: "the file system is mounted for reading only: mount it for writing, or use another folder",
    errno.EACCES: _OWNER,
    errno.EPERM: _OWNER,
    errno.ENOENT: "a part of the path does not exist: correct it",
    errno.ENOTDIR: "a part of the path is a file: correct it, or move the file away",
    errno.EISDIR: "it is a folder: give the name of a file",
    errno.ENAMETOOLONG: "the name is too long: give a shorter one",
    errno.EIO: "the disk fails: copy what is on it, and replace it",
    errno.EMFILE: "too many files are open in this process: start it again",
    errno.ENOTEMPTY: "something else was put into the folder: move it out",
}


class StorageError(Exception):
    """The disk refused. ``path`` and the reason are in the text, and what to do."""

    def __init__(self, what: str, path: Path, reason: str, remedy: str = "free space or replace the disk") -> None:
        super().__init__(f"{what} {path}: {reason}; {remedy}")
        self.what = what
        self.path = path
        self.reason = reason
        self.remedy = remedy

    @classmethod
    def of(cls, what: str, path: Path, error: OSError) -> Self:
        """Return the error that says ``what`` was tried on ``path``, with the remedy of its number (errno.h)."""
        remedy = _REMEDIES.get(error.errno or 0, "free space or replace the disk")
        return cls(what, path, error.strerror or str(error), remedy)

    @classmethod
    @contextmanager
    def naming(cls, what: str, path: Path) -> Iterator[None]:
        """Turns OSError into StorageError that names ``what`` was tried on ``path``."""
        try:
            yield
        except OSError as error:
            raise cls.of(what, path, error) from error

    @property
    def is_full(self) -> bool:
        """True if the disk refused for want of space, or of a quota."""
        return isinstance(self.__cause__, OSError) and self.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)

    @property
    def is_read_only(self) -> bool:
        """True if the disk takes no changes at all, as after a mount for reading only."""
        return isinstance(self.__cause__, OSError) and self.__cause__.errno == errno.EROFS


@dataclass(frozen=True, slots=True)
class Stamp:
    """Length of a file in bytes and its sha256 (hex), as they must be."""

    length: int
    sha256: str


class WritableFile(Protocol):
    """A file being written for the first time."""

    def write(self, data: Bytes) -> None:
        """Append all of ``data``. Raises OSError."""

    def sync(self) -> None:
        """Return when everything written would survive the loss of power. Raises OSError."""

    def close(self) -> None:
        """Raises OSError; the descriptor is gone in any case."""


class FileSystem(ABC):
    """The calls that change a disk, each of which raises OSError on failure, and what keeps its promises by their
    order, which raises StorageError."""

    @abstractmethod
    def make_folder(self, path: Path) -> None:
        """Make one folder; it must not exist."""

    @abstractmethod
    def create(self, path: Path) -> WritableFile:
        """Make one file; it must not exist."""

    @abstractmethod
    def rename(self, source: Path, target: Path) -> None:
        """Rename atomically; an existing target file is replaced, an existing target folder is an error."""

    @abstractmethod
    def sync_folder(self, path: Path) -> None:
        """Return when the folder's names would survive the loss of power."""

    @abstractmethod
    def remove(self, path: Path) -> None:
        """Remove a file or an empty folder."""

    @abstractmethod
    def free_bytes(self, path: Path) -> int:
        """Return the space left for an unprivileged process."""

    def write_new(self, path: Path, parts: Iterable[Bytes]) -> Stamp:
        """Write a file that does not exist yet; its content is durable on return, its name only with its folder.

        Raises StorageError; the file may then exist in part and must not be used.
        """
        digest = hashlib.sha256()
        length = 0
        with StorageError.naming("cannot write", path):
            file = self.create(path)
            try:
                for part in parts:
                    view = memoryview(part).cast("B")
                    length += len(view)
                    for start in range(0, len(view), _BLOCK):
                        block = view[start : start + _BLOCK]
                        file.write(block)
                        digest.update(block)
                # Data before names: a name that is durable before its content would be an empty or half file after a
                # loss of power.
                file.sync()
            except BaseException:
                _close_after_failure(file)
                raise
            file.close()
        return Stamp(length, digest.hexdigest())

    def replace_file(self, path: Path, *parts: Bytes) -> Stamp:
        """Replace (or make) a file: afterwards, and at any instant before, ``path`` is the old or the new one, whole.

        ``parts`` follow each other in it.

        Raises StorageError.
        """
        return self.replace_parts(path, parts)

    def replace_parts(self, path: Path, parts: Iterable[Bytes]) -> Stamp:
        """Replace (or make) a file as ``replace_file`` does, whose parts are made one after the other.

        Raises StorageError.
        """
        draft = draft_of(path)
        # An interrupted attempt left its draft; it is in the way of the exclusive creation below.
        self.discard(draft)
        try:
            stamp = self.write_new(draft, parts)
        except StorageError:
            with suppress(
                StorageError
            ):  # half a file on a full disk helps nobody; if it stays, the next attempt removes it
                self.discard(draft)
            raise
        with StorageError.naming("cannot replace", path):
            # rename() replaces in one step, and fsync of the folder makes that step durable: until then a loss of power
            # gives the old file back, which is whole, too.
            self.rename(draft, path)
            self.sync_folder(path.parent)
        return stamp

    def replace_by(self, path: Path, write: Callable[[Path], None]) -> None:
        """Replace (or make) a file by what ``write`` leaves at the name that it is given: as ``replace_file``, for
        libraries that open their files themselves.

        Raises StorageError, and whatever ``write`` raises but OSError; no draft is left then.
        """
        draft = draft_of(path)
        self.discard(draft)
        try:
            with StorageError.naming("cannot write", path):
                write(draft)
                with draft.open("rb") as file:
                    # fsync through any descriptor of a file makes its data durable, whoever wrote it.
                    os.fsync(file.fileno())
            with StorageError.naming("cannot replace", path):
                self.rename(draft, path)
                self.sync_folder(path.parent)
        except BaseException:
            with suppress(StorageError):
                self.discard(draft)
            raise

    def discard(self, path: Path) -> None:
        """Remove what an earlier, failed attempt left. Raises StorageError."""
        if path.exists():
            with StorageError.naming("cannot remove the unfinished", path):
                self.remove(path)

    def move_folder(self, source: Path, target: Path) -> None:
        """Rename a folder, whose files are durable, so that the new name is durable.

        Raises StorageError; where only the last fsync failed, the folder already has its new name.
        """
        with StorageError.naming("cannot publish", target):
            # First the names inside of the folder, then its own new name, then that the old name is gone. In any other
            # order a loss of power could leave a published folder that lacks files.
            self.sync_folder(source)
            self.rename(source, target)
            self.sync_folder(target.parent)
            if source.parent != target.parent:
                self.sync_folder(source.parent)

    def make_folders(self, folder: Path) -> None:
        """Make a folder and those above it that are missing; all their names are durable on return.

        Raises StorageError.
        """
        # Each new folder is an entry in the one above it, which must be durable, too: from above to below.
        for one in reversed([one for one in (folder, *folder.parents) if not one.is_dir()]):
            with StorageError.naming("cannot make", one):
                with suppress(FileExistsError):  # another process was first
                    self.make_folder(one)
                self.sync_folder(one.parent)

    def add_beside(self, path: Path, data: bytes) -> tuple[Path | None, bool]:
        """Write a file that comes from elsewhere, and replace nothing: where ``path`` has other content, under a name
        with a checksum.

        Returns the file that has the content now, and whether it was written; ``None`` where that name has other
        content, too. Raises StorageError.
        """
        other = path.with_name(f"{path.stem}.{hashlib.sha256(data).hexdigest()[:CHECKSUM_DIGITS]}{path.suffix}")
        for copy in (path, other):
            with StorageError.naming("cannot read", copy):
                there = copy.read_bytes() if copy.exists() else None
            if there is None:
                self.make_folders(copy.parent)
                self.replace_file(copy, data)
                return copy, True
            if there == data:
                return copy, False
        return None, False

    def remove_folder(self, folder: Path) -> None:
        """Remove a folder of files. Raises StorageError."""
        with StorageError.naming("cannot remove", folder):
            for path in sorted(folder.iterdir()):
                self.remove(path)
            self.remove(folder)
            self.sync_folder(folder.parent)


def _close_after_failure(file: WritableFile) -> None:
    # close() may report the same failure once more; the first one is what the caller is told.
    with suppress(OSError):
        file.close()


def draft_of(path: Path) -> Path:
    """Return the path at which the new content of ``path`` is written before it replaces the old."""
    return path.with_name(f".{path.name}.draft")


def checked_stamp(path: Path) -> Stamp:
    """Return the length and sha256 of a file as it lies on the disk. Raises OSError."""
    digest = hashlib.sha256()
    length = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            length += len(block)
    return Stamp(length, digest.hexdigest())


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


class LocalFileSystem(FileSystem):
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
        """Make one file of that length, all of whose blocks are taken; it must not exist. What is in it means nothing.

        Raises OSError.
        """
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            # Blocks, not only a length: writing into them later cannot fail for want of space.
            os.posix_fallocate(descriptor, 0, length_bytes)
        finally:
            os.close(descriptor)

    def reopen(self, path: Path) -> WritableFile:
        """Write an existing file anew from its start, into the blocks it has; ``sync`` cuts it to what was written.

        Raises OSError.
        """
        return _LocalFileAnew(os.open(path, os.O_WRONLY | os.O_CLOEXEC))

    def append(self, path: Path) -> WritableFile:
        """Go on behind the end of an existing file. Raises OSError."""
        return _LocalFile(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC))

    def free_bytes(self, path: Path) -> int:
        answer = os.statvfs(path)
        # f_bavail, not f_bfree: blocks that are kept for root are not for scans.
        return answer.f_bavail * answer.f_frsize
