"""Storage of objects: which scans belong to an object, and the pose of each.

    <root>/objects/<name>/object.json     checksummed; replaced as a whole
    <root>/objects/<name>/clouds/*.npz    each scan's cloud on its pixel grid; may be deleted, and is made again when it is needed
    <root>/objects/<name>/run/lock        held for as long as one of these files is written, never during a computation

Scans stay in their folders, and are read without these files. An object is changed by ``update_object`` alone: a
process that worked for minutes on an object changes the version that is stored by then.
"""

from __future__ import annotations

import base64
import io
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from appliance.base import ContentError, SealedFile
from appliance.store import OBJECTS, LocalFileSystem, StorageError, component, hold_lock, is_object

if TYPE_CHECKING:  # a list of objects needs no NumPy
    import numpy as np
    from numpy.typing import NDArray

FOLDER = OBJECTS
FILE = "object.json"
CLOUDS = "clouds"
ADDED_SINCE = "added after the object was solved: kingfisher object solve"
"""Reason of a scan that was added after the object was solved."""
_LOCK_S = 30.0
"""Longest wait for another process, which needs a second or so to write a file."""


class ObjectError(Exception):
    """An object cannot be used; the text names it, the reason and the remedy."""


@dataclass(frozen=True, slots=True)
class MemberScan:
    """A scan of an object."""

    name: str
    """Number of the scan, or name of its folder."""
    folder: str
    """Relative to the storage root where it lies below it, else absolute."""
    frames_sha256: tuple[str, ...]
    """Hashes of its files of frames, so that a scan is not added twice, and another scan under its name is noticed."""


@dataclass(frozen=True, slots=True)
class ScanPlace:
    """Pose of a scan: a point p of its left camera frame is at rotation · p + translation in the object's."""

    rotation: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    translation_mm: tuple[float, float, float]
    middle_mm: tuple[float, float, float]
    """Middle of its points in the object's frame."""
    sigma_mm: float
    """Standard deviation of its middle relative to the first scan, the shared depth error included."""
    covariance: tuple[tuple[float, ...], ...]
    """(6, 6): of rotation (rad) and shift (mm) about its own middle, in the object's frame."""
    bending_mm: float
    """Share of ``sigma_mm`` by the shared depth error, which may bend the object without any residual."""
    bending_unaided_mm: float
    """The same with the prior of that error."""
    bending_aided_mm: float
    """The same with the error that an estimate from the overlaps leaves, if that is applied."""


@dataclass(frozen=True, slots=True)
class ComparedScans:
    """A compared scan pair."""

    first: str
    second: str
    accepted: bool
    used: bool
    """Accepted, and in agreement with the loops."""
    text: str
    """The result in words: how certain the pose is, or why there is none, which is the reason for each ``None`` below."""
    overlap_percent: float | None
    """``None``, like sigmas and matches: the pose is not determined, or wrong."""
    sigma_mm: float | None
    discrepancy_mm: float | None
    """Distance between the pair's own pose and the scan poses, RMS over the overlap; ``None``: it is not used, or in no
    loop that would check it."""
    sigma_deg: float | None = None
    """Standard deviation of the rotation between both, in its weakest direction; of an accepted pair."""
    matches: int | None = None
    """Number of keypoints in both scans that the pair's pose maps onto each other; of an accepted pair."""


@dataclass(frozen=True, slots=True)
class CloudFacts:
    """Figures of a scan's cloud, as it was made for the object."""

    points: int
    distance_mm: float
    """Median of its points' distances from the left camera, along its axis."""
    sigma_mm: float
    """Median of its points' sigma."""
    ray_gap_mm: float | None
    """Median of the absolute ray gaps of its points; ``None``: it has none."""
    recorded: str | None
    """Wall time of the capture by the instrument's clock."""


@dataclass(frozen=True, slots=True)
class PackedMatrix:
    """A compact matrix: little-endian float32, row by row, in base64."""

    rows: int
    columns: int
    base64: str

    @classmethod
    def of(cls, matrix: NDArray[np.floating]) -> PackedMatrix:
        """Pack a matrix (rows, columns)."""
        raw = matrix.astype("<f4").tobytes()
        return cls(matrix.shape[0], matrix.shape[1], base64.b64encode(raw).decode("ascii"))

    def array(self) -> NDArray[np.float64]:
        """Return it as (rows, columns) float64. Raises ObjectError for text of another length."""
        import numpy as np

        try:
            raw = base64.b64decode(self.base64, validate=True)
            return np.frombuffer(raw, "<f4").reshape(self.rows, self.columns).astype(np.float64)
        except ValueError as error:
            raise ObjectError(
                f"a matrix of {self.rows} x {self.columns} numbers is damaged ({error}); solve the object again"
            ) from error


@dataclass(frozen=True, slots=True)
class JointPlaces:
    """Joint errors of all scan poses (``appliance.desk.registration.joint`` explains the fields)."""

    scans: tuple[str, ...]
    """Names in the order of the rows."""
    own_root: PackedMatrix
    follow: PackedMatrix
    shared_root: PackedMatrix
    working_mm: float
    """Working distance of the housing, with which the shapes of the shared error scale."""


@dataclass(frozen=True, slots=True)
class Places:
    """Scan poses of an object, with the results of solving it."""

    calibrations: tuple[str, ...]
    """Hashes of the calibrations of the clouds."""
    water_index: tuple[float, ...]
    places: Mapping[str, ScanPlace]
    pairs: tuple[ComparedScans, ...]
    left_out: Mapping[str, str]
    """Reason of each scan without a pose."""
    warnings: tuple[str, ...]
    shared_error_mm: tuple[float, ...]
    """Coefficients of the depth error that all scans share (appliance.desk.registration.bow)."""
    shared_error_spread_mm: float
    """Standard deviation of that error in the points, RMS over the view: after the estimate where it is removed, else
    that of the calibration."""
    shared_error_aided_mm: float
    """The same after the estimate."""
    shared_error_removed: bool
    """True if the points are to be corrected by it."""
    variance_factor: float
    shared_error_score: float | None
    """Distance of the estimate from the prior mean, in standard deviations; ``None``: the overlaps do not determine it.
    """
    joint: JointPlaces
    clouds: Mapping[str, CloudFacts]
    """Figures of every scan's cloud, also of those without a pose."""


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object: its scans, and their poses if it was solved."""

    name: str
    scans: tuple[MemberScan, ...] = ()
    places: Places | None = None
    """``None``: never solved. Scans that were added later are in ``left_out`` (``ADDED_SINCE``)."""
    schema: int = 1

    @property
    def added_since(self) -> tuple[str, ...]:
        """Names of the scans that were added after the object was solved."""
        return (
            ()
            if self.places is None
            else tuple(n for n, reason in self.places.left_out.items() if reason == ADDED_SINCE)
        )


def _refuse_names(stored: StoredObject) -> None:
    """Raise ValueError for a name that is no valid part of a path.

    Clouds are kept under the names of scans.
    """
    for scan in stored.scans:
        component(scan.name, "a scan's name")
        if ".." in PurePosixPath(scan.folder).parts or "\0" in scan.folder:
            raise ValueError(
                f"the folder of scan {scan.name} is {scan.folder!r:.60}; allowed is one below the root, or an absolute "
                "one"
            )
    if stored.places is not None:
        pairs = (name for pair in stored.places.pairs for name in (pair.first, pair.second))
        for name in (*stored.places.places, *stored.places.left_out, *stored.places.clouds, *pairs):
            component(name, "a scan's name")


OBJECT = SealedFile(
    StoredObject,
    schema=1,
    max_bytes=50_000_000,
    check=_refuse_names,
    remedy="the scans are unchanged; move the folder away, and make the object again",
)


def check_name(name: str) -> str:
    """Return ``name``. Raises ObjectError if it cannot be a folder name everywhere."""
    if not is_object(name):
        raise ObjectError(
            f"object '{name}': allowed are 1 to 64 letters, digits, blanks and . _ -, beginning with a letter or digit "
            "and not ending "
            "with a blank or a dot"
        )
    return name


def folder_of(root: Path, name: str) -> Path:
    """Return the folder of an object. Raises ObjectError for an invalid name."""
    return root / FOLDER / check_name(name)


def object_names(root: Path) -> list[str]:
    """Return the names of all objects under a storage root, in order."""
    return sorted(path.parent.name for path in (root / FOLDER).glob(f"*/{FILE}") if is_object(path.parent.name))


def read_object(root: Path, name: str) -> StoredObject:
    """Read an object. Raises ObjectError if it is missing or damaged."""
    path = folder_of(root, name) / FILE
    try:
        stored = OBJECT.load(path, name=str(path))
    except ContentError as error:
        raise ObjectError(str(error)) from error
    if stored is None:
        names = ", ".join(object_names(root)) or "none yet"
        raise ObjectError(f"object '{name}': there is none under {root} ({names}); make it: kingfisher object add")
    # The folder's name counts, also after a person renamed it: the next write must not go to another object's folder.
    return replace(stored, name=name)


def read_solved_object(root: Path, name: str) -> StoredObject:
    """Read a solved object. Raises ObjectError for any other.

    The error comes before modules that compute are loaded.
    """
    stored = read_object(root, name)
    from appliance.desk.object_errors import errors_of

    errors_of(stored)  # raises ObjectError if it is not solved
    return stored


def object_exists(root: Path, name: str) -> bool:
    """Return whether there is an object of that name, also a damaged one.

    Raises ObjectError for an invalid name.
    """
    return (folder_of(root, name) / FILE).exists()


def update_object(root: Path, name: str, change: Callable[[StoredObject | None], StoredObject]) -> StoredObject:
    """Replace an object by ``change`` of the stored one (``None``: there is none), under its lock.

    The result is durable. Raises the errors of ``change``, StorageError, ObjectError.
    """
    fs, folder = LocalFileSystem(), folder_of(root, name)
    fs.make_folders(folder)
    with hold_lock(folder, _LOCK_S):
        changed = change(read_object(root, name) if object_exists(root, name) else None)
        fs.replace_file(folder / FILE, OBJECT.encode(changed))
    return changed


def write(root: Path, stored: StoredObject) -> None:
    """Write an object in place of any that is stored under its name; it is durable on return.

    Raises StorageError, ObjectError.
    """
    update_object(root, stored.name, lambda _: stored)


def with_scans(stored: StoredObject, added: tuple[MemberScan, ...]) -> StoredObject:
    """Return the object with scans added, without poses.

    Raises ObjectError for a scan that it has already.
    """
    name_by_frames = {member.frames_sha256: member.name for member in stored.scans}
    names = {member.name for member in stored.scans}
    for scan in added:
        if scan.frames_sha256 in name_by_frames:
            raise ObjectError(
                f"object '{stored.name}': scan {scan.name} is already in it as "
                f"{name_by_frames[scan.frames_sha256]}; leave it "
                "out"
            )
        if scan.name in names:
            raise ObjectError(
                f"object '{stored.name}': has another scan called {scan.name}; rename the folder of the new one, "
                "then add it"
            )
        name_by_frames[scan.frames_sha256] = scan.name
        names.add(scan.name)
    return _with_places(replace(stored, scans=(*stored.scans, *added)), stored.places)


def merge_places(now: StoredObject | None, solved: StoredObject) -> StoredObject:
    """Return the stored object ``now`` with the poses of ``solved``.

    Scans that were added meanwhile have none yet. Raises ObjectError if the object was made again meanwhile, or solved
    with more scans: then the stored poses stay.
    """
    if now is None or not set(solved.scans) <= set(now.scans):
        raise ObjectError(
            f"object '{solved.name}': was made again during solving; these scan poses are not kept; solve it again"
        )
    further = sorted(_scans_with_result(now.places) - _scans_with_result(solved.places))
    if further:
        raise ObjectError(
            f"object '{solved.name}': was meanwhile solved with {', '.join(further)}, too; these scan poses are not "
            "kept; use the kept ones"
        )
    return _with_places(now, solved.places)


def _scans_with_result(places: Places | None) -> set[str]:
    """Return the scans that have a pose, or a reason for having none."""
    if places is None:
        return set()
    return {*places.places, *(name for name, reason in places.left_out.items() if reason != ADDED_SINCE)}


def _with_places(stored: StoredObject, places: Places | None) -> StoredObject:
    """Return the object with ``places``, in which scans without a result are left out."""
    if places is None:
        return replace(stored, places=None)
    with_result = _scans_with_result(places)
    since = {scan.name: ADDED_SINCE for scan in stored.scans if scan.name not in with_result}
    return replace(stored, places=replace(places, left_out={**places.left_out, **since}))


# ------------------------------------------------------------------------------------------------ kept clouds


def load_cloud(root: Path, name: str, scan: str, key: str) -> dict[str, NDArray[Any]] | None:
    """Return the kept arrays of a scan.

    ``None`` if there are none, their key is not ``key``, or they are damaged.
    """
    import numpy as np

    path = folder_of(root, name) / CLOUDS / f"{scan}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            if str(file["key"]) != key:
                return None
            return {array_name: file[array_name] for array_name in file.files if array_name != "key"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        # It can be made again from the frames.
        return None


def save_cloud(root: Path, name: str, scan: str, key: str, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Keep a scan's arrays under ``key``; if that fails, they are made again next time.

    Raises ObjectError for an invalid name.
    """
    import numpy as np

    fs, folder = LocalFileSystem(), folder_of(root, name) / CLOUDS
    path = folder / f"{scan}.npz"
    buffer = io.BytesIO()
    values: dict[str, Any] = {"key": np.array(key), **arrays}
    np.savez(buffer, **values)
    # Two processes that make the same cloud at once write the same draft.
    with suppress(OSError, StorageError), hold_lock(folder.parent, _LOCK_S):
        if not folder.is_dir():
            fs.make_folder(folder)
        fs.replace_file(path, buffer.getbuffer())
