"""Reserved space on the disk: it is allocated before a scan, which can then be written to a full disk.

    <root>/room/frames-left      as long as one camera's frames; becomes frames_left.npy, block by block the same file
    <root>/room/...              one for each file that publishing a scan makes, and its folder
    <root>/room/slack            for a folder that grows by a block: given up at the first refusal for want of space

Writing into allocated blocks cannot fail for want of space. So ``create`` returns such a file under the new name
instead of an empty one; its sync cuts it to the written length. Files in the room are never read.
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
"""Error numbers of a file system that cannot allocate space beforehand."""

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
"""Reserved files that may become a file, by the name of that file."""

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
"""Sizes in bytes of the reserved files that do not depend on the sequence."""

Answer = TypeVar("Answer")


class Room(FileSystem):
    """A file system whose new files are made of reserved space as far as possible. One thread at a time."""

    def __init__(self, root: Path, fs: LocalFileSystem) -> None:
        """Set the folder of the reserved space; it is allocated by ``hold``."""
        self._folder = root / FOLDER
        self._fs = fs
        self.allocates = True
        """True until this file system refuses to allocate; from then on free space is only counted."""

    def hold(self, lengths: Mapping[str, int]) -> None:
        """Allocate the missing files of ``lengths`` (by name, in bytes); existing ones are kept.

        Raises StorageError, with the cause; files that were allocated until then are kept.
        """
        with StorageError.naming("cannot allocate space in", self._folder):
            if not self._folder.is_dir():
                self._fs.make_folder(self._folder)
            if not (self._folder / _SPARE).is_dir():
                self._fs.make_folder(self._folder / _SPARE)
            for name, length in lengths.items():
                # A shorter one is made anew: allocated for a shorter sequence, it would fail in the middle of a scan.
                if self.allocates and _allocated(self._folder / name) < length:
                    self._allocate(self._folder / name, length)

    def _allocate(self, path: Path, length: int) -> None:
        if path.exists():  # of a shorter sequence, or from before a loss of power
            self._fs.remove(path)
        try:
            self._fs.allocate(path, length)
        except OSError as error:
            if path.exists():
                self._fs.remove(path)
            # A full disk is an error. A file system that cannot allocate is not: there, free space is counted.
            if error.errno not in _CANNOT:
                raise
            self.allocates = False
            log.warning("space for a scan is counted, not allocated: %s: %s", path.parent, error.strerror)

    @property
    def held_bytes(self) -> int:
        """Space in bytes that the room takes on the disk."""
        try:
            # st_blocks counts units of 512 bytes on every file system (stat(2)).
            return sum(path.stat().st_blocks * 512 for path in self._folder.iterdir() if path.name != _SPARE)
        except OSError:
            return 0

    # ------------------------------------------------------------------------------------ file system

    def make_folder(self, path: Path) -> None:
        """Make a folder of the spare one, or a new one."""
        if not self._rename_reserved(_SPARE, path):
            self._with_slack(lambda: self._fs.make_folder(path))

    def create(self, path: Path) -> WritableFile:
        """Create a file of reserved space where there is some for this name, otherwise an empty one."""
        for name in PLACES.get(path.name, ()):
            if self._rename_reserved(name, path):
                return self._fs.reopen(path)
        return self._with_slack(lambda: self._fs.create(path))

    def rename(self, source: Path, target: Path) -> None:
        """Rename like the file system."""
        self._with_slack(lambda: self._fs.rename(source, target))

    def sync_folder(self, path: Path) -> None:
        """Sync a folder like the file system."""
        self._fs.sync_folder(path)

    def remove(self, path: Path) -> None:
        """Remove like the file system."""
        self._fs.remove(path)

    def free_bytes(self, path: Path) -> int:
        """Return the free and the reserved space: both are for scans."""
        return self._fs.free_bytes(path) + self.held_bytes

    def _rename_reserved(self, name: str, path: Path) -> bool:
        """Rename the reserved file ``name`` to ``path``, and return True if it existed."""
        piece = self._folder / name
        # The rename would replace an existing file and lose its content.
        if path.exists() or not _unused(piece):
            return False
        self._with_slack(lambda: self._fs.rename(piece, path))
        return True

    def _with_slack(self, call: Callable[[], Answer]) -> Answer:
        """Make the ``call``; repeat it without the slack if a folder could not grow on the full disk."""
        try:
            return call()
        except OSError as error:
            slack = self._folder / _SLACK
            if error.errno != errno.ENOSPC or not slack.exists():
                raise
            # A folder that gets one name too many grows by a block, and a full disk has none: the slack gives it.
            self._fs.remove(slack)
            return call()

    @staticmethod
    def plan(frames: int, width_px: int, height_px: int) -> dict[str, int]:
        """Return the lengths in bytes of a scan's files; the cloud's is a point for every left pixel."""
        each, cloud = frames_bytes(frames, width_px, height_px), cloud_bytes(width_px, height_px)
        return {**{f"frames-{side}": each for side in SIDES}, "cloud": cloud, **SMALL}


def _unused(piece: Path) -> bool:
    """Return True if a reserved file exists and has no second name.

    A loss of power between the two halves of a rename may leave it under both names: writing to it would then overwrite
    a stored scan.
    """
    try:
        # Two links to one file are the two halves of an interrupted rename.
        return not any(piece.iterdir()) if piece.is_dir() else piece.stat().st_nlink == 1
    except OSError:
        return False


def _allocated(path: Path) -> int:
    """Return the allocated bytes of a file; -1 if it does not exist or has a second name."""
    try:
        stat = path.stat()
    except OSError:
        return -1
    # A sparse file has its length but no blocks: both count.
    return min(stat.st_size, stat.st_blocks * 512) if stat.st_nlink == 1 else -1
