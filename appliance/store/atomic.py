"""Writing files and folders so that they survive the loss of power.

A file: write, fsync, rename, fsync the folder. A folder: all its files so, fsync it, rename, fsync its parents. A
failed fsync means that the kernel may have dropped the data: the same file is not tried again, but written anew.

All changes of the disk go through the few calls that a ``FileSystem`` begins with, so that a test can make the n-th of
them fail, for every n. Reading needs no such calls: a read that fails is a damaged file and is treated as one.
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
_OWNER = "this user has no permission: check owner and mode of the folder, or use another folder"
_REMEDIES = {
    errno.ENOSPC: "the disk is full: free space on it, or use another folder",
    errno.EDQUOT: "this user's disk quota is used up: free space, or have the quota enlarged",
    errno.EROFS: "the file system is mounted read-only: mount it for writing, or use another folder",
    errno.EACCES: _OWNER,
    errno.EPERM: _OWNER,
    errno.ENOENT: "a part of the path does not exist: correct the path",
    errno.ENOTDIR: "a part of the path is a file: correct the path, or move the file away",
    errno.EISDIR: "the path is a folder: give the name of a file",
    errno.ENAMETOOLONG: "the name is too long: give a shorter one",
    errno.EIO: "the disk fails: copy its files, and replace it",
    errno.EMFILE: "too many files are open in this process: restart it",
    errno.ENOTEMPTY: "the folder is not empty: move its other files out",
}


class StorageError(Exception):
    """Error of a failed call to the disk; the text has the ``path``, the reason and the remedy."""

    def __init__(self, what: str, path: Path, reason: str, remedy: str = "free space or replace the disk") -> None:
        super().__init__(f"{what} {path}: {reason}; {remedy}")
        self.what = what
        self.path = path
        self.reason = reason
        self.remedy = remedy

    @classmethod
    def of(cls, what: str, path: Path, error: OSError) -> Self:
        """Return the error of a failed call on ``path``, with the remedy for its number (errno.h)."""
        remedy = _REMEDIES.get(error.errno or 0, "free space or replace the disk")
        return cls(what, path, error.strerror or str(error), remedy)

    @classmethod
    @contextmanager
    def naming(cls, what: str, path: Path) -> Iterator[None]:
        """Turn an OSError of the block into a StorageError that names the call and its ``path``."""
        try:
            yield
        except OSError as error:
            raise cls.of(what, path, error) from error

    @property
    def is_full(self) -> bool:
        """True if the disk or a quota is full."""
        return isinstance(self.__cause__, OSError) and self.__cause__.errno in (errno.ENOSPC, errno.EDQUOT)

    @property
    def is_read_only(self) -> bool:
        """True if the file system accepts no changes, as after a mount for reading only."""
        return isinstance(self.__cause__, OSError) and self.__cause__.errno == errno.EROFS


@dataclass(frozen=True, slots=True)
class Stamp:
    """Required length of a file in bytes and its sha256 (hex)."""

    length: int
    sha256: str


class WritableFile(Protocol):
    """A file being written for the first time."""

    def write(self, data: Bytes) -> None:
        """Append all of ``data``. Raises OSError."""

    def sync(self) -> None:
        """Return when all written bytes would survive the loss of power. Raises OSError."""

    def close(self) -> None:
        """Close the descriptor, also where this fails. Raises OSError."""


class FileSystem(ABC):
    """The calls that change a disk, and the durable operations that are made of them.

    The abstract calls raise OSError; the operations raise StorageError.
    """

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
        """Return when the folder's names are durable."""

    @abstractmethod
    def remove(self, path: Path) -> None:
        """Remove a file or an empty folder."""

    @abstractmethod
    def free_bytes(self, path: Path) -> int:
        """Return the space left for an unprivileged process."""

    def write_new(self, path: Path, parts: Iterable[Bytes]) -> Stamp:
        """Write a file that does not exist yet.

        Its content is durable on return, its name only with its folder. Raises StorageError; the file may then exist in
        part and must not be used.
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
                # Data before names: if the name were durable first, a loss of power could leave an empty or half file.
                file.sync()
            except BaseException:
                _close_after_failure(file)
                raise
            file.close()
        return Stamp(length, digest.hexdigest())

    def replace_file(self, path: Path, *parts: Bytes) -> Stamp:
        """Replace (or make) a file with ``parts``: at any instant ``path`` is all of the old or the new file.

        Raises StorageError.
        """
        return self.replace_parts(path, parts)

    def replace_parts(self, path: Path, parts: Iterable[Bytes]) -> Stamp:
        """Replace (or make) a file as ``replace_file`` does, but compute each part only when it is written.

        Raises StorageError.
        """
        draft = draft_of(path)
        # An interrupted attempt may have left its draft, with which the exclusive creation below would fail.
        self.discard(draft)
        try:
            stamp = self.write_new(draft, parts)
        except StorageError:
            with suppress(StorageError):  # free the full disk of half a file; if it stays, the next attempt removes it
                self.discard(draft)
            raise
        with StorageError.naming("cannot replace", path):
            # rename() replaces in one step, and fsync of the folder makes that step durable: until then a loss of power
            # gives the old file back, which is whole, too.
            self.rename(draft, path)
            self.sync_folder(path.parent)
        return stamp

    def replace_by(self, path: Path, write: Callable[[Path], None]) -> None:
        """Replace (or make) a file as ``replace_file`` does, with ``write`` to create its draft.

        This serves libraries that open their files themselves. Raises StorageError, and all that ``write`` raises but
        OSError; no draft is left then.
        """
        draft = draft_of(path)
        self.discard(draft)
        try:
            with StorageError.naming("cannot write", path):
                write(draft)
                with draft.open("rb") as file:
                    # fsync through any descriptor of a file makes its data durable, also those written through others.
                    os.fsync(file.fileno())
            with StorageError.naming("cannot replace", path):
                self.rename(draft, path)
                self.sync_folder(path.parent)
        except BaseException:
            with suppress(StorageError):
                self.discard(draft)
            raise

    def discard(self, path: Path) -> None:
        """Remove the file of an earlier, failed attempt. Raises StorageError."""
        if path.exists():
            with StorageError.naming("cannot remove the unfinished", path):
                self.remove(path)

    def move_folder(self, source: Path, target: Path) -> None:
        """Rename a folder, whose files are durable, so that the new name is durable.

        Raises StorageError; where only the last fsync failed, the folder already has its new name.
        """
        with StorageError.naming("cannot publish", target):
            # First the names in the folder, then its new name, then the removal of its old name. In any other order a
            # loss of power could leave a published folder that lacks files.
            self.sync_folder(source)
            self.rename(source, target)
            self.sync_folder(target.parent)
            if source.parent != target.parent:
                self.sync_folder(source.parent)

    def make_folders(self, folder: Path) -> None:
        """Make a folder and those above it that are missing; all their names are durable on return.

        Raises StorageError.
        """
        # Each new folder is an entry in the one above it, which must be durable first: from above to below.
        for missing in reversed([missing for missing in (folder, *folder.parents) if not missing.is_dir()]):
            with StorageError.naming("cannot make", missing):
                with suppress(FileExistsError):  # another process was first
                    self.make_folder(missing)
                self.sync_folder(missing.parent)

    def add_beside(self, path: Path, data: bytes) -> tuple[Path | None, bool]:
        """Write a file that comes from elsewhere, and replace none.

        Where ``path`` has other content, the new file's name gets a checksum. Return the file that has the content now,
        and whether it was written; ``None`` where that name has other content, too. Raises StorageError.
        """
        renamed = path.with_name(f"{path.stem}.{hashlib.sha256(data).hexdigest()[:CHECKSUM_DIGITS]}{path.suffix}")
        for copy in (path, renamed):
            with StorageError.naming("cannot read", copy):
                content = copy.read_bytes() if copy.exists() else None
            if content is None:
                self.make_folders(copy.parent)
                self.replace_file(copy, data)
                return copy, True
            if content == data:
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
    # close() may report the same failure once more; the caller needs the first one.
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
        unwritten = memoryview(data).cast("B")
        # write(2) may write fewer bytes than given, for example when a signal comes.
        while unwritten:
            unwritten = unwritten[os.write(self._descriptor, unwritten) :]

    def sync(self) -> None:
        os.fsync(self._descriptor)

    def close(self) -> None:
        os.close(self._descriptor)


class _LocalFileAnew(_LocalFile):
    """A file that is written over its old content."""

    def sync(self) -> None:
        # The reserved file may be longer than the new content; it is cut before the content counts as durable.
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
        """Make a file of that length with all its blocks allocated; it must not exist.

        Its content is undefined. Raises OSError.
        """
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        try:
            # Blocks, not only a length: writing into them later cannot fail for want of space.
            os.posix_fallocate(descriptor, 0, length_bytes)
        finally:
            os.close(descriptor)

    def reopen(self, path: Path) -> WritableFile:
        """Open an existing file to write it anew into its blocks; ``sync`` cuts it to the written length.

        Raises OSError.
        """
        return _LocalFileAnew(os.open(path, os.O_WRONLY | os.O_CLOEXEC))

    def append(self, path: Path) -> WritableFile:
        """Open an existing file to write behind its end. Raises OSError."""
        return _LocalFile(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CLOEXEC))

    def free_bytes(self, path: Path) -> int:
        answer = os.statvfs(path)
        # f_bavail, not f_bfree: blocks that are kept for root are not for scans.
        return answer.f_bavail * answer.f_frsize
