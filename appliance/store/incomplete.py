"""Incomplete scans: the first frames of scans that broke off, kept apart from the scans.

    <root>/incomplete/000001    frames_left.npy, frames_right.npy, calibration.json, rig.toml, incomplete.json
    <root>/incomplete/.000002   being written; its remains after a loss of power go when the next one is kept

They have their own numbers. The folder has no ``manifest.json``, so that it is never taken for a scan;
``incomplete.json`` has the same content, and the missing frames and the reason. No finished one is ever deleted; beyond
``MOST`` no more are kept.
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
"""Largest number of recordings that are kept, some 2.7 GB: a rig with more has a fault to repair first."""
INCOMPLETE_OF = {"kind": "incomplete recording"}
"""Kind of the file, which distinguishes it from a scan's manifest."""
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
    """Its frames (n, h, w), n < those of its sequence, and its manifest, whose ``reason`` tells why it broke off."""
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
        """Make the first frames of a sequence durable, all or none, and return their folder.

        ``frames``: by side, (n, h, w) uint8, those of both sides of the same patterns. Raises ValueError for frames
        that are a whole sequence or of different number, and where ``MOST`` are kept already; StorageError, also where
        the disk would then have no room for a scan above ``reserve_bytes``. No file is left then.
        """
        patterns = record.sequence.patterns
        shapes = {frames[side].shape for side in SIDES}
        if len(shapes) != 1:
            raise ValueError(
                f"left and right frames differ in shape: {sorted(shapes)}; give frames of the same patterns"
            )
        (count, height_px, width_px) = shapes.pop()
        if not 0 < count < len(patterns):
            raise ValueError(f"{count} of {len(patterns)} frames are no incomplete recording")
        folder = root / INCOMPLETE_FOLDER
        numbers = _sweep(fs, folder)
        if len(numbers) >= MOST:
            raise ValueError(f"{folder} has {MOST} recordings already; move some of them elsewhere")
        needed = 2 * count * height_px * width_px + _OTHER_BYTES
        # Space for the next scan has priority over an incomplete one.
        with StorageError.naming("cannot read the free space of", root):
            left = fs.free_bytes(root) - needed - size_bytes(len(patterns), width_px, height_px) - reserve_bytes
        if left < 0:
            raise StorageError("cannot keep", folder, "the space for the next scan would not be left")
        number = f"{max(numbers, default=0) + 1:06d}"
        draft = folder / f".{number}"
        try:
            _write(fs, draft, number, frames, record, origin, reason)
            fs.move_folder(draft, folder / number)
        except (StorageError, ValueError):
            with suppress(StorageError):
                _remove(fs, draft)
            raise
        return folder / number

    @staticmethod
    def find(root: Path, recording: str) -> Path:
        """Return the folder of a recording by its number. Raises ScanError."""
        number = recording.zfill(6)
        folder = root / INCOMPLETE_FOLDER / number
        # Only a number, no path: the last part of a path may be a number, too.
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
    # The manifest last, and then the folder's name: a folder without a dot is complete.
    fs.replace_file(
        draft / form.INCOMPLETE_MANIFEST_FILE, INCOMPLETE.encode(form.with_known_times(manifest), INCOMPLETE_OF)
    )


def _sweep(fs: FileSystem, folder: Path) -> list[int]:
    """Make the folder if it is missing, remove unfinished recordings, and return the numbers in use."""
    fs.make_folders(folder)
    with StorageError.naming("cannot list", folder):
        named = [(path, match) for path in folder.iterdir() if (match := _NAME.fullmatch(path.name)) and path.is_dir()]
    for path, _ in named:
        if path.name.startswith("."):
            _remove(fs, path)
    return [int(match[1]) for path, match in named if not path.name.startswith(".")]


def _remove(fs: FileSystem, draft: Path) -> None:
    """Remove a half-written folder."""
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
