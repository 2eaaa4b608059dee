"""The files of a scan's folder: their names, the order in which they are written, and their reading.

Two steps. ``write_raw``: frames, their ``ScanOrigin`` and a first manifest, durable before the diver decides.
``finish``: cloud and preview, then the manifest that lists them. In between, ``add_second`` may add the frames of a
second exposure. Each manifest replaces the one before atomically, so that at any instant the folder holds a manifest
and every file it lists, or no manifest at all.

At a desk a file of frames may be packed instead (``appliance.store.packed``); the manifest is the same, and such a scan
is read like any other.
"""

from __future__ import annotations

import hashlib
import io
import re
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.base import ContentError
from appliance.measure import SIDES
from appliance.store import manifest as form
from appliance.store.atomic import Bytes, FileSystem, LocalFileSystem, Stamp, StorageError, checked_stamp, draft_of
from appliance.store.manifest import Decision, Manifest, ScanRecord, Stage
from appliance.store.packed import PackedError, PackedFile, packed_path, read_index

if TYPE_CHECKING:  # NumPy is loaded where pixels and points are: a list of scans touches none
    import numpy as np
    from numpy.typing import NDArray

    from appliance.measure import Calibration, PatternSequence, Water
    from appliance.store.ply import PointCloud, StoredCloud
    from appliance.store.reprocess import EmptyCloud

_HEADER_BYTES = 256
_HEADER = re.compile(
    rb"\x93NUMPY\x01\x00(..)\{'descr': '\|u1', 'fortran_order': False, 'shape': \((\d{1,9}), (\d{1,9}), (\d{1,9})\), \} *\n",
    re.DOTALL,
)
"""Header of NumPy's format 1.0."""
CLOUD_FILE = "cloud.ply"
PREVIEW_FILE = "preview.png"
CALIBRATION = "calibration.json"
RIG_FILE = "rig.toml"
ORIGIN_FILES = (CALIBRATION, RIG_FILE)
"""Files that describe the instrument with which a scan was taken."""
DERIVED_FILES = (CLOUD_FILE, PREVIEW_FILE)
"""Files that can be made again from the others."""


def frames_file(side: str) -> str:
    """Return the name of the file with one camera's frames."""
    return f"frames_{side}.npy"


def second_frames_file(side: str) -> str:
    """Return the name of the file with one camera's frames of the second exposure."""
    return f"frames_{side}_second.npy"


RAW_FILES = tuple(frames_file(side) for side in SIDES)
SECOND_FILES = tuple(second_frames_file(side) for side in SIDES)
FRAME_FILES = (*RAW_FILES, *SECOND_FILES)
"""Names of all files of frames that a scan may have."""


class ScanError(Exception):
    """Error of a stored scan that cannot be used; the text says which and why."""


@dataclass(frozen=True, slots=True)
class ScanOrigin:
    """Calibration and rig file of a scan, as bytes: with them its folder can be read anywhere."""

    calibration: bytes
    """A calibration file: the one in use, or else the nominal one."""
    rig: bytes
    """A rig file, changed options and defaults included (``appliance.store.config.rig_text``)."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """A scan as it lies on disk.

    ``frames`` by side: (n, h, w) uint8, mapped; in memory where they were packed.
    """

    folder: Path
    manifest: Manifest
    frames: Mapping[str, NDArray[np.uint8]]
    second: Mapping[str, NDArray[np.uint8]] | None = None
    """Frames of the second exposure, like ``frames``; ``None``: there is none."""

    def cloud(self) -> StoredCloud | None:
        """Return the stored cloud; ``None`` where the scan has none. Raises ScanError."""
        if CLOUD_FILE not in self.manifest.files:
            return None
        from appliance.store.ply import PlyError, read_ply

        try:
            return read_ply(self.folder / CLOUD_FILE)
        except PlyError as error:
            raise ScanError(str(error)) from error

    def problem_of(self, name: str) -> str | None:
        """Return the problem of one of its files, whose every byte is checked; ``None`` if it is undamaged."""
        if name not in self.manifest.files:
            return "not in the manifest"
        single = replace(self.manifest, files={name: self.manifest.files[name]})
        return wrong_files(self.folder, single, checksums=True).get(name)

    def compare_cloud(self, *parts: Bytes) -> str:
        """Return in words how the stored cloud compares with the new one in ``parts``."""
        stamp = self.manifest.files.get(CLOUD_FILE)
        if stamp is None:
            return "none was stored"
        digest = hashlib.sha256()
        for part in parts:
            digest.update(part)
        # By its checksum in the manifest, which works also where the stored cloud is damaged or gone.
        same = digest.hexdigest() == stamp.sha256
        problem = self.problem_of(CLOUD_FILE)
        if problem is None:
            return "the same, byte for byte" if same else "other points"
        return (
            f"{CLOUD_FILE}: {problem}; "
            f"{'computed again, equal byte for byte' if same else 'computed again, but the points differ'}"
        )

    @classmethod
    def load(cls, folder: Path, *, only_raw: bool = False) -> StoredScan:
        """Open a scan; its files' lengths are checked, checksums are not (``Library.verify``).

        Raises ScanError. ``only_raw``: all but the files of frames may be missing or damaged.
        """
        manifest = cls.manifest_of(folder)
        wrong = wrong_files(folder, manifest, checksums=False)
        if only_raw:
            wrong = {name: problem for name, problem in wrong.items() if name in FRAME_FILES}
        if wrong:
            raise ScanError(f"{folder}: {'; '.join(f'{name}: {problem}' for name, problem in wrong.items())}")
        count = len(manifest.record.sequence.patterns)
        frames = {side: map_frames(folder / frames_file(side), count) for side in SIDES}
        second = None
        if manifest.record.second is not None:
            second = {side: map_frames(folder / second_frames_file(side), count) for side in SIDES}
        return cls(folder, manifest, frames, second)

    @staticmethod
    def manifest_of(folder: Path) -> Manifest:
        """Return the manifest of a scan's folder. Raises ScanError."""
        try:
            return form.read(folder)
        except ContentError as error:
            raise ScanError(str(error)) from error

    @staticmethod
    def read_frame(folder: Path, side: str, k: int, *, second: bool = False) -> NDArray[np.uint8]:
        """Return frame ``k`` of one camera, (h, w) uint8, compared with its checksum.

        No other frame is read, packed or not. ``second``: of the second exposure. Raises ScanError,
        MissingLibraryError.
        """
        import numpy as np

        manifest = StoredScan.manifest_of(folder)
        name = second_frames_file(side) if second else frames_file(side)
        names = manifest.record.sequence.patterns
        if not 0 <= k < len(names):
            raise ScanError(f"{folder}: frame {k} does not exist; allowed are 0 to {len(names) - 1}")
        if is_packed(folder, name):
            frame = _frame_of_packed(packed_path(folder / name), k, len(names))
        else:
            frame = np.array(map_frames(folder / name, len(names))[k])
        if frame_checks(frame[None]) != manifest.frame_crc32.get(name, ())[k : k + 1]:
            raise ScanError(f"{folder / name}: frame {names[k]} is damaged (its checksum does not fit)")
        return frame

    @property
    def sequence(self) -> PatternSequence:
        """The patterns it was recorded with, in their order. Raises ScanError where there is no such sequence."""
        try:
            return self.manifest.record.sequence.as_sequence()
        except ValueError as error:
            raise ScanError(f"{self.folder}: {error}") from error

    def water(self, calibration: Calibration) -> Water:
        """Return the water in which it was recorded by its manifest, else that of the ``calibration``."""
        from appliance.measure import Water

        water = self.manifest.record.water
        t, s, w = water.get("temperature_c"), water.get("salinity_psu"), water.get("wavelength_nm")
        if t is None or s is None or w is None:
            return calibration.water
        return Water(t, s, w)

    def refuse_empty(self, empty: EmptyCloud | None) -> None:
        """Raise ScanError if there is a reason why the scan has (nearly) no points."""
        if empty is not None:
            raise ScanError(f"{self.folder}: {empty.reason}")

    @staticmethod
    def keep(folder: Path, frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord, origin: ScanOrigin) -> None:
        """Make the scan ``folder`` outside of a library, complete or not at all.

        It is written beside it, under a name that is no scan's, and then renamed. Raises StorageError, ValueError.
        """
        fs, draft = LocalFileSystem(), draft_of(folder)
        if draft.exists():
            discard_raw(fs, draft)  # of an attempt that was interrupted
        try:
            manifest = write_raw(fs, draft, folder.name, frames, record, origin)
            finish_scan(fs, draft, manifest, Decision.KEPT, record)
            fs.move_folder(draft, folder)
        except BaseException:
            with suppress(StorageError):
                discard_raw(fs, draft)
            raise

    @staticmethod
    def refuse_damage(folder: Path) -> None:
        """Compare every byte of the frames in a scan's folder with its checksum.

        Raises ScanError that names every damaged file, and the frame where that is known.
        """
        from appliance.store.damage import damaged_frames

        manifest = StoredScan.manifest_of(folder)
        damaged = damaged_frames(folder, manifest)
        if damaged:
            damages = "; ".join(str(frames) for frames in damaged)
            raise ScanError(
                f"{folder}: {damages}; restore the scan's folder from a copy, or make a cloud without the "
                "damaged frames by `kingfisher cloud` (.ply)"
            )


def write_raw(
    fs: FileSystem,
    folder: Path,
    scan_id: str,
    frames: Mapping[str, NDArray[np.uint8]],
    record: ScanRecord,
    origin: ScanOrigin,
) -> Manifest:
    """Make ``folder`` with the frames, their ``origin`` and the first manifest.

    All but its own name is durable on return. ``frames``: by side, (n, h, w) uint8. Raises StorageError, ValueError.
    """
    _check(frames, record)
    with StorageError.naming("cannot make", folder):
        fs.make_folder(folder)
    files = {frames_file(side): fs.write_new(folder / frames_file(side), npy_parts(frames[side])) for side in SIDES}
    for name, content in ((CALIBRATION, origin.calibration), (RIG_FILE, origin.rig)):
        files[name] = fs.write_new(folder / name, (content,))
    with StorageError.naming("cannot make durable", folder):
        fs.sync_folder(folder)
    # The manifest comes last, after everything that it lists is durable: a folder with a manifest is a scan, one
    # without is not.
    checks = {frames_file(side): frame_checks(frames[side]) for side in SIDES}
    manifest = Manifest(scan_id, Stage.RAW, Decision.UNDECIDED, record, files, frame_crc32=checks)
    fs.replace_file(folder / form.MANIFEST_FILE, form.encode(manifest))
    return manifest


def add_second(
    fs: FileSystem,
    folder: Path,
    manifest: Manifest,
    frames: Mapping[str, NDArray[np.uint8]],
    record: ScanRecord,
) -> Manifest:
    """Add the second exposure's ``frames``, as in ``write_raw``, and the manifest with its ``record``.

    Durable on return. On failure the folder is the scan it was, but for files that its manifest does not list; may be
    called again. Raises StorageError, ValueError.
    """
    _check(frames, record)
    if record.second is None:
        raise ValueError("the record has no second sequence; add it before its frames")
    # Files of an earlier attempt are not in the manifest and may be damaged: they are written anew.
    files = {name: stamp for name, stamp in manifest.files.items() if name not in SECOND_FILES}
    checks = dict(manifest.frame_crc32)
    for side in SIDES:
        name = second_frames_file(side)
        fs.discard(folder / name)
        files[name] = fs.write_new(folder / name, npy_parts(frames[side]))
        checks[name] = frame_checks(frames[side])
    with StorageError.naming("cannot make durable", folder):
        fs.sync_folder(folder)
    added = replace(manifest, record=record, files=files, frame_crc32=checks)
    # From here on the scan has two exposures; before, the folder is the scan with one.
    fs.replace_file(folder / form.MANIFEST_FILE, form.encode(added))
    return added


def frame_checks(frames: NDArray[np.uint8]) -> tuple[str, ...]:
    """Return the CRC-32 of each of ``frames`` (n, h, w) uint8 as 8 hexadecimal digits."""
    import numpy as np

    return tuple(f"{zlib.crc32(np.ascontiguousarray(frame).reshape(-1).data):08x}" for frame in frames)


def _check(frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord) -> None:
    expected = len(record.sequence.patterns)
    for side in SIDES:
        shape, dtype = frames[side].shape, frames[side].dtype
        if len(shape) != 3 or shape[0] != expected or dtype != "uint8":
            raise ValueError(f"{side} frames are {dtype} {shape}; uint8 ({expected}, height, width) is needed")


def finish_scan(
    fs: FileSystem,
    folder: Path,
    manifest: Manifest,
    decision: Decision,
    record: ScanRecord,
    cloud: PointCloud | None = None,
    preview_png: bytes | None = None,
    reason: str = "",
) -> Manifest:
    """Add cloud and preview and write the final manifest.

    May be repeated after a failure. Raises StorageError.
    """
    files = {name: stamp for name, stamp in manifest.files.items() if name not in DERIVED_FILES}
    # Cloud and preview can be computed again; they are written before the manifest that lists them.
    added: dict[str, tuple[Bytes, ...]] = {}
    if cloud is not None:
        from appliance.store.ply import encode_ply

        added[CLOUD_FILE] = encode_ply(cloud)
    if preview_png is not None:
        added[PREVIEW_FILE] = (preview_png,)
    for name, parts in added.items():
        fs.discard(folder / name)
        files[name] = fs.write_new(folder / name, parts)
    with StorageError.naming("cannot make durable", folder):
        fs.sync_folder(folder)
    final = replace(manifest, stage=Stage.COMPLETE, decision=decision, record=record, files=files, reason=reason)
    fs.replace_file(folder / form.MANIFEST_FILE, form.encode(final))
    return final


def discard_raw(fs: FileSystem, folder: Path) -> None:
    """Remove the folder of a ``write_raw`` that failed, whose frames are still in memory.

    Raises StorageError.
    """
    for name in (form.MANIFEST_FILE, *RAW_FILES, *ORIGIN_FILES):  # manifest first: it must never list a removed file
        fs.discard(folder / name)
        fs.discard(draft_of(folder / name))
    fs.discard(folder)


def wrong_files(folder: Path, manifest: Manifest, *, checksums: bool) -> dict[str, str]:
    """Return the problems, by name, of the files a scan must have and of those its manifest lists.

    Lengths are compared, and with ``checksums`` every byte.
    """
    needed = RAW_FILES if manifest.record.second is None else FRAME_FILES
    wrong = {name: "not in the manifest" for name in needed if name not in manifest.files}
    for name, stamp in sorted(manifest.files.items()):
        if is_packed(folder, name):
            problem = _wrong_packed(packed_path(folder / name), stamp, checksums=checksums)
            if problem is not None:
                wrong[name] = problem
            continue
        try:
            length = (folder / name).stat().st_size
            if length != stamp.length:
                wrong[name] = f"{length} bytes instead of {stamp.length}"
            elif checksums and checked_stamp(folder / name) != stamp:
                wrong[name] = "damaged (its checksum does not fit)"
        except FileNotFoundError:
            wrong[name] = "missing"
        except OSError as error:
            wrong[name] = error.strerror or str(error)
    return wrong


def is_packed(folder: Path, name: str) -> bool:
    """Return True if the file of frames ``name`` lies in ``folder`` in its packed form only."""
    frames = name in FRAME_FILES
    return frames and not (folder / name).exists() and packed_path(folder / name).exists()


def _wrong_packed(path: Path, stamp: Stamp, *, checksums: bool) -> str | None:
    """Return the problem of a packed file whose frames must have ``stamp``; no frame is decoded."""
    try:
        index = read_index(path)
        length = path.stat().st_size
        if length != index.length_bytes:
            return f"packed: {length} bytes instead of {index.length_bytes}"
        if index.stamp != stamp:
            return "packed: of different frames"
        if checksums and not index.is_undamaged():
            return "damaged (its checksum does not fit)"
    except PackedError as error:
        return f"packed: {error}"
    except OSError as error:
        return error.strerror or str(error)
    return None


def read_header(data: bytes) -> tuple[int, tuple[int, int, int]] | None:
    """Return the header's length and (n, h, w) of a file of frames that begins with ``data``, or ``None``.

    It is compared with the one that ``npy_parts`` writes; no part of it is executed.
    """
    match = _HEADER.match(data[:_HEADER_BYTES])
    if match is None:
        return None
    return 10 + int.from_bytes(match[1], "little"), (int(match[2]), int(match[3]), int(match[4]))


def _frame_of_packed(path: Path, k: int, count: int) -> NDArray[np.uint8]:
    with _as_scan_error(path):
        return _index_of(path, count).frame(k)


def _index_of(path: Path, count: int) -> PackedFile:
    index = read_index(path)
    if index.count != count:
        raise PackedError(f"has {index.count} frames instead of {count}")
    return index


@contextmanager
def _as_scan_error(path: Path) -> Iterator[None]:
    try:
        yield
    except PackedError as error:
        raise ScanError(f"{path}: {error}") from error
    except (OSError, ValueError) as error:
        raise ScanError(f"{path}: not readable as frames ({error})") from error


def map_frames(path: Path, count: int) -> NDArray[np.uint8]:
    """Return the ``count`` frames of a file, (n, h, w) uint8: mapped, or decoded where it is packed.

    Writing to them does not change the file. Raises ScanError, MissingLibraryError.
    """
    import numpy as np

    if is_packed(path.parent, path.name):
        with _as_scan_error(packed_path(path)):
            return _index_of(packed_path(path), count).frames()
    with _as_scan_error(path):
        # The header is compared by bytes, not parsed by NumPy: it is a Python literal, and a damaged one may be any.
        with path.open("rb") as file:
            header = read_header(file.read(_HEADER_BYTES))
        if header is None or header[1][0] != count:
            raise ScanError(f"{path}: not {count} frames of 8 bits")
        header_bytes, shape = header
        if not 0 < shape[0] * shape[1] * shape[2] == path.stat().st_size - header_bytes:
            raise ScanError(f"{path}: {path.stat().st_size} bytes are not {count} frames of {shape[2]} x {shape[1]} px")
        # Mode "c" copies on writing, so that the file cannot change. Read-only arrays would be another type, for which
        # numba would compile each kernel a second time.
        return np.memmap(path, np.uint8, "c", header_bytes, shape)


def npy_parts(frames: NDArray[np.uint8]) -> tuple[Bytes, Bytes]:
    """Return the header and body of an .npy file (NumPy format 1.0), without a copy of the pixels."""
    import numpy as np

    solid = np.ascontiguousarray(frames)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, np.lib.format.header_data_from_array_1_0(solid))
    return header.getvalue(), solid.reshape(-1).data


def size_bytes(frames: int, width_px: int, height_px: int) -> int:
    """Return the space that a scan with one exposure needs at most.

    It has both cameras' frames, a point for every left pixel, and a margin for the other files. A second exposure takes
    its frames once more.
    """
    return 2 * frames_bytes(frames, width_px, height_px) + cloud_bytes(width_px, height_px) + 3_500_000


def frames_bytes(frames: int, width_px: int, height_px: int) -> int:
    """Return the length of the file with one camera's frames."""
    import numpy as np

    header, _ = npy_parts(np.empty((frames, height_px, width_px), np.uint8))
    return len(header) + frames * width_px * height_px


def cloud_bytes(width_px: int, height_px: int) -> int:
    """Return the greatest length of the file with the points: one for every left pixel."""
    from appliance.store.ply import POINT

    return POINT.itemsize * width_px * height_px + 4096
