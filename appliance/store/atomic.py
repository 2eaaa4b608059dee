"""Owns the order of system calls after which data survives the loss of power, and never less than all of it.

A file: write, fsync, rename, fsync the folder. A folder: all its files so, fsync it, rename, fsync its parents. A
failed fsync means that the kernel may have dropped the data: nothing is retried on the same file, it is written anew.
"""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from appliance.store.filesystem import Bytes, FileSystem, WritableFile

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


@dataclass(frozen=True, slots=True)
class Stamp:
    """Length of a file in bytes and its sha256 (hex), as they must be."""

    length: int
    sha256: str


@contextmanager
def refused(what: str, path: Path) -> Iterator[None]:
    """Turns OSError into StorageError that names ``what`` was tried on ``path``."""
    try:
        yield
    except OSError as error:
        raise StorageError(what, path, error.strerror or str(error), remedy_for(error)) from error


def remedy_for(error: OSError) -> str:
    """Return what to do about a disk's refusal, by its number (errno.h)."""
    return _REMEDIES.get(error.errno or 0, "free space or replace the disk")


def write_new(fs: FileSystem, path: Path, parts: Iterable[Bytes]) -> Stamp:
    """Write a file that does not exist yet; its content is durable on return, its name only with its folder.

    Raises StorageError; the file may then exist in part and must not be used.
    """
    digest = hashlib.sha256()
    length = 0
    with refused("cannot write", path):
        file = fs.create(path)
        try:
            for part in parts:
                view = memoryview(part).cast("B")
                length += len(view)
                for start in range(0, len(view), _BLOCK):
                    block = view[start : start + _BLOCK]
                    file.write(block)
                    digest.update(block)
            # Data before names: a name that is durable before its content would be an empty or half file after a loss
            # of power.
            file.sync()
        except BaseException:
            _close_after_failure(file)
            raise
        file.close()
    return Stamp(length, digest.hexdigest())


def _close_after_failure(file: WritableFile) -> None:
    # close() may report the same failure once more; the first one is what the caller is told.
    with suppress(OSError):
        file.close()


def replace_file(fs: FileSystem, path: Path, *parts: Bytes) -> Stamp:
    """Replace (or make) a file: afterwards, and at any instant before, ``path`` is the old or the new one, whole.

    ``parts`` follow each other in it.

    Raises StorageError.
    """
    return replace_parts(fs, path, parts)


def replace_parts(fs: FileSystem, path: Path, parts: Iterable[Bytes]) -> Stamp:
    """Replace (or make) a file as ``replace_file`` does, whose parts are made one after the other.

    Raises StorageError.
    """
    draft = draft_of(path)
    # An interrupted attempt left its draft; it is in the way of the exclusive creation below.
    discard(fs, draft)
    try:
        stamp = write_new(fs, draft, parts)
    except StorageError:
        with suppress(
            StorageError
        ):  # half a file on a full disk helps nobody; if it stays, the next attempt removes it
            discard(fs, draft)
        raise
    with refused("cannot replace", path):
        # rename() replaces in one step, and fsync of the folder makes that step durable: until then a loss of power
        # gives the old file back, which is whole, too.
        fs.rename(draft, path)
        fs.sync_folder(path.parent)
    return stamp


def replace_by(fs: FileSystem, path: Path, write: Callable[[Path], None]) -> None:
    """Replace (or make) a file by what ``write`` leaves at the name that it is given: as ``replace_file``, for
    libraries that open their files themselves.

    Raises StorageError, and whatever ``write`` raises but OSError; no draft is left then.
    """
    draft = draft_of(path)
    discard(fs, draft)
    try:
        with refused("cannot write", path):
            write(draft)
            with draft.open("rb") as file:
                # fsync through any descriptor of a file makes its data durable, whoever wrote it.
                os.fsync(file.fileno())
        with refused("cannot replace", path):
            fs.rename(draft, path)
            fs.sync_folder(path.parent)
    except BaseException:
        with suppress(StorageError):
            discard(fs, draft)
        raise


def draft_of(path: Path) -> Path:
    """Return the path at which the new content of ``path`` is written before it replaces the old."""
    return path.with_name(f".{path.name}.draft")


def discard(fs: FileSystem, path: Path) -> None:
    """Remove what an earlier, failed attempt left. Raises StorageError."""
    if path.exists():
        with refused("cannot remove the unfinished", path):
            fs.remove(path)


def move_folder(fs: FileSystem, source: Path, target: Path) -> None:
    """Rename a folder, whose files are durable, so that the new name is durable.

    Raises StorageError; where only the last fsync failed, the folder already has its new name.
    """
    with refused("cannot publish", target):
        # First the names inside of the folder, then its own new name, then that the old name is gone. In any other
        # order a loss of power could leave a published folder that lacks files.
        fs.sync_folder(source)
        fs.rename(source, target)
        fs.sync_folder(target.parent)
        if source.parent != target.parent:
            fs.sync_folder(source.parent)


def make_folders(fs: FileSystem, folder: Path) -> None:
    """Make a folder and those above it that are missing; all their names are durable on return. Raises StorageError."""
    # Each new folder is an entry in the one above it, which must be durable, too: from above to below.
    for one in reversed([one for one in (folder, *folder.parents) if not one.is_dir()]):
        with refused("cannot make", one):
            with suppress(FileExistsError):  # another process was first
                fs.make_folder(one)
            fs.sync_folder(one.parent)


def add_beside(fs: FileSystem, path: Path, data: bytes) -> tuple[Path | None, bool]:
    """Write a file that comes from elsewhere, and replace nothing: where ``path`` has other content, under a name with
    a checksum.

    Returns the file that has the content now, and whether it was written; ``None`` where that name has other content,
    too. Raises StorageError.
    """
    other = path.with_name(f"{path.stem}.{hashlib.sha256(data).hexdigest()[:CHECKSUM_DIGITS]}{path.suffix}")
    for copy in (path, other):
        with refused("cannot read", copy):
            there = copy.read_bytes() if copy.exists() else None
        if there is None:
            make_folders(fs, copy.parent)
            replace_file(fs, copy, data)
            return copy, True
        if there == data:
            return copy, False
    return None, False


def checked_stamp(path: Path) -> Stamp:
    """Return the length and sha256 of a file as it lies on the disk. Raises OSError."""
    digest = hashlib.sha256()
    length = 0
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
            length += len(block)
    return Stamp(length, digest.hexdigest())
