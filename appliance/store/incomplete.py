"""Owns incomplete recordings: the first frames of scans that broke off, kept apart from the scans and counted nowhere.

    <root>/incomplete/000001    frames_left.npy, frames_right.npy, calibration.json, rig.toml, incomplete.json
    <root>/incomplete/.000002   being written; what a loss of power left of it is taken away when the next one is kept

Numbers are of their own. The folder has no ``manifest.json``, so that nothing takes it for a scan; ``incomplete.json``
has the same content, with the frames that are missing and why. No finished recording is ever deleted; when there are
``MOST``, no more are kept.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.base import ContentError, SealedFile
from appliance.measure import SIDES
from appliance.store import manifest as form
from appliance.store.atomic import FileSystem, Stamp, StorageError, checked_stamp
from appliance.store.manifest import Decision, Manifest, ScanRecord, Stage
from appliance.store.names import scan_number
from appliance.store.scan import (
    CALIBRATION,
    RIG_FILE,
    ScanError,
    ScanOrigin,
    StoredScan,
    frame_checks,
    frames_file,
    map_frames,
    npy_parts,
    size_bytes,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

INCOMPLETE_FOLDER = "incomplete"
MOST = 50
"""Most recordings that are kept: 2.7 GB. Such a rig has another trouble than lost scans."""
INCOMPLETE_OF = {"kind": "incomplete recording"}
"""Kind of the file, which tells it from a scan's manifest."""
_NAME = re.compile(r"\.?([0-9]{6})")
_OTHER_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class BrokenManifest(Manifest):
    """Manifest of a scan that broke off, with the names of the patterns whose frames are missing."""

    missing: tuple[str, ...] = field(default=(), kw_only=True)


INCOMPLETE = SealedFile(BrokenManifest, form.MANIFEST.schema, form.MANIFEST.max_bytes, check=form.refuse_names)


@dataclass(frozen=True, slots=True, eq=False)
class IncompleteRecording:
    """An incomplete recording as it lies on disk."""

    scan: StoredScan
    """Its frames (n, h, w), n < those of its sequence, and its manifest, whose ``reason`` says what broke."""
    missing: tuple[str, ...]
    """Names of the patterns whose frames are missing."""

    @staticmethod
    def keep(
        fs: FileSystem,
        root: Path,
        frames: Mapping[str, NDArray[np.uint8]],
        record: ScanRecord,
        origin: ScanOrigin,
        reason: str,
        reserve_bytes: int,
    ) -> Path:
        """Make the first frames of a sequence durable, all or nothing, and return their folder.

        ``frames``: by side, (n, h, w) uint8, those of both sides of the same patterns. Raises ValueError for frames
        that are a whole sequence or of different number, and where ``MOST`` are kept already; StorageError, also where
        the disk would then have no room for a scan above ``reserve_bytes``. Nothing is left then.
        """
        patterns = record.sequence.patterns
        shapes = {frames[side].shape for side in SIDES}
        if len(shapes) != 1:
            raise ValueError(f"left and right frames differ: {sorted(shapes)}; give those of the same patterns")
        (count, height_px, width_px) = shapes.pop()
        if not 0 < count < len(patterns):
            raise ValueError(f"{count} of {len(patterns)} frames are no incomplete recording")
        shelf = root / INCOMPLETE_FOLDER
        taken = _sweep(fs, shelf)
        if len(taken) >= MOST:
            raise ValueError(f"{shelf} has {MOST} recordings already; look at them, and move them elsewhere")
        needed = 2 * count * height_px * width_px + _OTHER_BYTES
        # A scan that may come is worth more than one that broke.
        with StorageError.naming("cannot ask for the room on", root):
            left = fs.free_bytes(root) - needed - size_bytes(len(patterns), width_px, height_px) - reserve_bytes
        if left < 0:
            raise StorageError("cannot keep", shelf, "there would be no room for the next scan")
        number = f"{max(taken, default=0) + 1:06d}"
        draft = shelf / f".{number}"
        try:
            _write(fs, draft, number, frames, record, origin, reason)
            fs.move_folder(draft, shelf / number)
        except (StorageError, ValueError):
            with suppress(StorageError):
                _remove(fs, draft)
            raise
        return shelf / number

    @staticmethod
    def find(root: Path, recording: str) -> Path:
        """Return the folder of a recording by its number. Raises ScanError."""
        number = recording.zfill(6)
        folder = root / INCOMPLETE_FOLDER / number
        # The whole word: the last part of a path may be a number, too.
        if not recording or scan_number(number) is None or not folder.is_dir():
            raise ScanError(
                f"no incomplete recording {recording!r} under {root / INCOMPLETE_FOLDER}; give its number or its folder"
            )
        return folder

    @classmethod
    def load(cls, folder: Path) -> IncompleteRecording:
        """Open an incomplete recording; every byte is compared with its checksum. Raises ScanError."""
        path = folder / form.INCOMPLETE_MANIFEST_FILE
        try:
            manifest = INCOMPLETE.load(path, INCOMPLETE_OF, name=str(path))
        except ContentError as error:
            raise ScanError(str(error)) from error
        if manifest is None:
            raise ScanError(f"{folder}: not an incomplete recording (no {form.INCOMPLETE_MANIFEST_FILE} in it)")
        missing = manifest.missing
        count = len(manifest.record.sequence.patterns) - len(missing)
        if missing != manifest.record.sequence.patterns[count:]:
            raise ScanError(f"{path}: the missing frames are not the last of the sequence")
        for name in map(frames_file, SIDES):
            _compare(folder / name, manifest.files.get(name))
        frames = {side: map_frames(folder / frames_file(side), count) for side in SIDES}
        return cls(StoredScan(folder, manifest, frames), missing)

    @staticmethod
    def is_in(folder: Path) -> bool:
        """Return True if ``folder`` holds an incomplete recording, which is no scan."""
        return (folder / form.INCOMPLETE_MANIFEST_FILE).is_file()


def _write(
    fs: FileSystem,
    draft: Path,
    number: str,
    frames: Mapping[str, NDArray[np.uint8]],
    record: ScanRecord,
    origin: ScanOrigin,
    reason: str,
) -> None:
    with StorageError.naming("cannot make", draft):
        fs.make_folder(draft)
    files = {frames_file(side): fs.write_new(draft / frames_file(side), npy_parts(frames[side])) for side in SIDES}
    for name, content in ((CALIBRATION, origin.calibration), (RIG_FILE, origin.rig)):
        files[name] = fs.write_new(draft / name, (content,))
    checks = {frames_file(side): frame_checks(frames[side]) for side in SIDES}
    missing = record.sequence.patterns[len(frames[SIDES[0]]) :]
    manifest = BrokenManifest(
        number, Stage.RAW, Decision.UNDECIDED, record, files, reason, frame_crc32=checks, missing=missing
    )
    # Last, and the folder's name after it: a folder without a dot is whole.
    fs.replace_file(
        draft / form.INCOMPLETE_MANIFEST_FILE, INCOMPLETE.encode(form.with_known_times(manifest), INCOMPLETE_OF)
    )


def _sweep(fs: FileSystem, shelf: Path) -> list[int]:
    """Make the shelf where it is missing, take away what was not finished, and return the numbers that are taken."""
    fs.make_folders(shelf)
    with StorageError.naming("cannot list", shelf):
        named = [(path, found) for path in shelf.iterdir() if (found := _NAME.fullmatch(path.name)) and path.is_dir()]
    for path, _ in named:
        if path.name.startswith("."):
            _remove(fs, path)
    return [int(found[1]) for path, found in named if not path.name.startswith(".")]


def _remove(fs: FileSystem, draft: Path) -> None:
    """Remove what is half written."""
    if draft.is_dir():
        for path in draft.iterdir():
            fs.discard(path)
        fs.discard(draft)


def _compare(path: Path, stamp: Stamp | None) -> None:
    try:
        same = stamp is not None and checked_stamp(path) == stamp
    except OSError as error:
        raise ScanError(f"{path}: {error.strerror or error}") from error
    if not same:
        raise ScanError(f"{path}: damaged (its checksum does not fit); bring the folder back from a copy")
