"""Owns the space that is allocated on the disk before it is needed: what was recorded can be written whatever else
fills it.

    <root>/room/frames-left      as long as one camera's frames; becomes frames_left.npy, block by block the same file
    <root>/room/...              one for each file that a scan's way to the shelf makes, and its folder
    <root>/room/slack            for a folder that grows by a block: given up at the first refusal for want of space

A file that is written into allocated blocks cannot be refused for want of space. So ``create`` hands out such a file
under the new name instead of an empty one; it is cut to what was written when it is synced. Nothing in the room is ever
read.
"""

from __future__ import annotations

import errno
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

from appliance.measure import SIDES
from appliance.store.atomic import FileSystem, LocalFileSystem, StorageError, WritableFile, draft_of
from appliance.store.manifest import MANIFEST_FILE as MANIFEST
from appliance.store.names import NUMBER_FILE as NUMBER
from appliance.store.scan import (
    CALIBRATION,
    CLOUD_FILE,
    PREVIEW_FILE,
    RIG_FILE,
    cloud_bytes,
    frames_bytes,
    frames_file,
    second_frames_file,
)

log = logging.getLogger("kingfisher")

FOLDER = "room"
_SPARE = "folder"
_SLACK = "slack"
_CANNOT = (errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)
"""Error numbers with which a file system says that it allocates nothing beforehand."""

PLACES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **{frames_file(side): (f"frames-{side}",) for side in SIDES},
        **{second_frames_file(side): (f"frames-{side}",) for side in SIDES},
        CLOUD_FILE: ("cloud",),
        PREVIEW_FILE: ("preview",),
        CALIBRATION: ("calibration",),
        RIG_FILE: ("rig",),
        draft_of(Path(MANIFEST)).name: ("manifest-1", "manifest-2"),  # with the raw frames, and at the end
        draft_of(Path(NUMBER)).name: ("number",),
    }
)
"""Pieces of the room that may become a file, by the name of that file."""

SMALL = MappingProxyType(
    {
        "preview": 1_500_000,
        "calibration": 250_000,  # 30 kB with a spline of 8 x 6 intervals in either camera and a covariance
        "rig": 50_000,
        "manifest-1": 400_000,
        "manifest-2": 400_000,
        "number": 4096,
        _SLACK: 500_000,
    }
)
"""Sizes in bytes of the pieces that do not depend on the sequence."""

Answer = TypeVar("Answer")


class Room(FileSystem):
    """A file system whose new files are made of what is allocated, as far as that goes. One thread at a time."""

    def __init__(self, root: Path, fs: LocalFileSystem) -> None:
        """Remember where the room is; nothing is allocated before ``hold``."""
        self._folder = root / FOLDER
        self._fs = fs
        self.allocates = True
        """True until this file system refuses to allocate; where it does, space is only counted."""

    def hold(self, lengths: Mapping[str, int]) -> None:
        """Allocate what is missing of ``lengths`` (by name, in bytes). What is there, also from an earlier start,
        stays.

        Raises StorageError, with the cause; what was allocated until then is kept.
        """
        with StorageError.naming("cannot allocate space in", self._folder):
            if not self._folder.is_dir():
                self._fs.make_folder(self._folder)
            if not (self._folder / _SPARE).is_dir():
                self._fs.make_folder(self._folder / _SPARE)
            for name, length in lengths.items():
                # Pieces are whole or made anew; one that was allocated for a shorter sequence would fail in the middle
                # of a scan.
                if self.allocates and _allocated(self._folder / name) < length:
                    self._allocate(self._folder / name, length)

    def _allocate(self, path: Path, length: int) -> None:
        if path.exists():  # of a shorter sequence, or what a loss of power left of it
            self._fs.remove(path)
        try:
            self._fs.allocate(path, length)
        except OSError as error:
            if path.exists():
                self._fs.remove(path)
            # A full disk is an error, a file system that cannot allocate is not: counting what is free has to do there.
            if error.errno not in _CANNOT:
                raise
            self.allocates = False
            log.warning("space for a scan is counted, not allocated: %s: %s", path.parent, error.strerror)

    @property
    def held_bytes(self) -> int:
        """Space in bytes that the room takes on the disk."""
        try:
            # st_blocks counts units of 512 bytes whatever the file system's block size (stat(2)).
            return sum(path.stat().st_blocks * 512 for path in self._folder.iterdir() if path.name != _SPARE)
        except OSError:
            return 0

    # ------------------------------------------------------------------------------------ file system

    def make_folder(self, path: Path) -> None:
        """Make a folder of the spare one, or a new one."""
        if not self._became(_SPARE, path):
            self._unhindered(lambda: self._fs.make_folder(path))

    def create(self, path: Path) -> WritableFile:
        """Create a file of the room where that has something for this name, otherwise an empty one."""
        for name in PLACES.get(path.name, ()):
            if self._became(name, path):
                return self._fs.reopen(path)
        return self._unhindered(lambda: self._fs.create(path))

    def rename(self, source: Path, target: Path) -> None:
        """Rename like the file system."""
        self._unhindered(lambda: self._fs.rename(source, target))

    def sync_folder(self, path: Path) -> None:
        """Sync a folder like the file system."""
        self._fs.sync_folder(path)

    def remove(self, path: Path) -> None:
        """Remove like the file system."""
        self._fs.remove(path)

    def free_bytes(self, path: Path) -> int:
        """Return the free space and what the room holds: both are for scans."""
        return self._fs.free_bytes(path) + self.held_bytes

    def _became(self, name: str, path: Path) -> bool:
        """Tell whether the room had ``name`` and it is ``path`` now."""
        piece = self._folder / name
        # An existing name would be replaced by the rename, and with it what is stored there.
        if path.exists() or not _unused(piece):
            return False
        self._unhindered(lambda: self._fs.rename(piece, path))
        return True

    def _unhindered(self, call: Callable[[], Answer]) -> Answer:
        """Make the ``call``; once more without the slack, if a folder had to grow and could not."""
        try:
            return call()
        except OSError as error:
            slack = self._folder / _SLACK
            if error.errno != errno.ENOSPC or not slack.exists():
                raise
            # A folder that gets one name too many grows by a block, and a full disk has none: the slack is there for
            # this block.
            self._fs.remove(slack)
            return call()

    @staticmethod
    def plan(frames: int, width_px: int, height_px: int) -> dict[str, int]:
        """Return lengths in bytes of what one scan needs: its frames for each camera, and at most a point for every
        left pixel."""
        each, cloud = frames_bytes(frames, width_px, height_px), cloud_bytes(width_px, height_px)
        return {**{f"frames-{side}": each for side in SIDES}, "cloud": cloud, **SMALL}


def _unused(piece: Path) -> bool:
    """Tell whether a piece is there and belongs to the room alone. A loss of power between the two halves of a rename
    may leave it under both names: what is written to it then would be written into a stored scan."""
    try:
        # Two links to one file are the two halves of an interrupted rename.
        return not any(piece.iterdir()) if piece.is_dir() else piece.stat().st_nlink == 1
    except OSError:
        return False


def _allocated(path: Path) -> int:
    """Return the bytes of a file that have their place on the disk; -1 where there is none."""
    try:
        found = path.stat()
    except OSError:
        return -1
    # A sparse file has its length and no room: both must be there.
    return min(found.st_size, found.st_blocks * 512) if found.st_nlink == 1 else -1
