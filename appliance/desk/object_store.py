"""Owns what is kept of an object made of many scans: which scans belong to it, and where each of them lies.

    <root>/objects/<name>/object.json     checksummed; replaced as a whole
    <root>/objects/<name>/clouds/*.npz    each scan's cloud on its pixel grid; may be deleted, and is made again when it is needed
    <root>/objects/<name>/run/lock        held for as long as one of these files is written, never while something is computed

Scans stay where they are; nothing here is needed to read them. An object is changed by ``update`` alone: who has read
it, and worked for minutes, changes what is stored by then.
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
ADDED_SINCE = "added after the others were placed: kingfisher object solve"
"""Reason why a scan has no place yet."""
_LOCK_S = 30.0
"""The longest that another process is waited for: writing a file takes it a second or so."""


class ObjectError(Exception):
    """An object cannot be used; the text says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class MemberScan:
    """A scan that belongs to the object."""

    name: str
    """Its number, or its folder's name."""
    folder: str
    """Relative to the storage root where it lies below it, else absolute."""
    frames_sha256: tuple[str, ...]
    """Checksums of its files of frames: the same scan is not taken twice, and another one under its name is noticed."""


@dataclass(frozen=True, slots=True)
class ScanPlace:
    """Place of a scan: a point p of its left camera's frame is at rotation · p + translation in the object's."""

    rotation: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    translation_mm: tuple[float, float, float]
    middle_mm: tuple[float, float, float]
    """Middle of its points in the object's frame."""
    sigma_mm: float
    """Standard deviation of its middle's place relative to the first scan, the shared depth error included."""
    covariance: tuple[tuple[float, ...], ...]
    """(6, 6): of the turn (rad) and the shift (mm) about its own middle, in the object's frame."""
    bending_mm: float
    """Share of ``sigma_mm`` that the shared depth error has: what may bend the object without any residual."""
    bending_unaided_mm: float
    """The same with what was known of that error before the scans' overlaps told of it."""
    bending_aided_mm: float
    """The same with what an estimate from the overlaps leaves of it, if that is believed."""


@dataclass(frozen=True, slots=True)
class ComparedScans:
    """Two scans that were compared."""

    first: str
    second: str
    accepted: bool
    used: bool
    """Accepted, and in agreement with the loops."""
    text: str
    """Finding in words: how closely they are placed, or why not, which is the reason for each ``None`` below."""
    overlap_percent: float | None
    """``None``, as sigmas and matches: nothing holds their pose, or it is wrong."""
    sigma_mm: float | None
    discrepancy_mm: float | None
    """Distance between the pair's own pose and the places, RMS over the overlap; ``None``: it is not used, or in no
    loop that would check it."""
    sigma_deg: float | None = None
    """Standard deviation of the turn between both, in its weakest direction; of an accepted pair."""
    matches: int | None = None
    """Features that both show and that the pair's pose lays on each other; of an accepted pair."""


@dataclass(frozen=True, slots=True)
class CloudFacts:
    """Figures of a scan's cloud, as it was made for the object."""

    points: int
    distance_mm: float
    """Median of its points' distances from the left camera, along its axis."""
    sigma_mm: float
    """Median of its points' sigma."""
    ray_gap_mm: float | None
    """Median of the sizes of its points' ray gaps; ``None``: it has none."""
    recorded: str | None
    """Wall time of the recording as the instrument had it."""


@dataclass(frozen=True, slots=True)
class PackedMatrix:
    """A matrix in little room: little-endian float32, row by row, in base64."""

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
    """The errors of all places as they hang together (``appliance.desk.registration.joint`` says what each is)."""

    scans: tuple[str, ...]
    """Names in the order of the rows."""
    own_root: PackedMatrix
    follow: PackedMatrix
    shared_root: PackedMatrix
    working_mm: float
    """Working distance of the housing, which the shapes of the shared error scale with."""


@dataclass(frozen=True, slots=True)
class Places:
    """Places of an object's scans, and all that was found on the way."""

    calibrations: tuple[str, ...]
    """Hashes of the calibrations that the clouds were made with."""
    water_index: tuple[float, ...]
    places: Mapping[str, ScanPlace]
    pairs: tuple[ComparedScans, ...]
    left_out: Mapping[str, str]
    """Reason, for each scan that has no place."""
    warnings: tuple[str, ...]
    shared_error_mm: tuple[float, ...]
    """Coefficients of the depth error that all scans share (appliance.desk.registration.bow)."""
    shared_error_spread_mm: float
    """Standard deviation of that error in the points as they are, RMS over the view: after the estimate where it is
    taken out, else what the calibration leaves."""
    shared_error_aided_mm: float
    """The same after the estimate."""
    shared_error_removed: bool
    """The points are to be corrected by it."""
    variance_factor: float
    shared_error_score: float | None
    """Distance of the estimate from what was known before, in standard deviations; ``None``: the overlaps tell nothing
    of it."""
    joint: JointPlaces
    clouds: Mapping[str, CloudFacts]
    """Figures of every scan's cloud, also of those without a place."""


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object: its scans, and where they lie if that was found out."""

    name: str
    scans: tuple[MemberScan, ...] = ()
    places: Places | None = None
    """``None``: never solved. Scans that were added since are left out of them (``ADDED_SINCE``)."""
    schema: int = 1

    @property
    def added_since(self) -> tuple[str, ...]:
        """The scans that were added after the others were placed."""
        return () if self.places is None else tuple(n for n, why in self.places.left_out.items() if why == ADDED_SINCE)


def _refuse_names(stored: StoredObject) -> None:
    """Raises ValueError for a name in it that no part of a path may be called: clouds are kept under those of
    scans."""
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
    remedy="the scans are untouched: move the folder away and make the object again",
)


def check_name(name: str) -> str:
    """Return ``name``. Raises ObjectError for one that cannot name a folder everywhere."""
    if not is_object(name):
        raise ObjectError(
            f"object '{name}': allowed are 1 to 64 letters, digits, blanks and . _ -, beginning with a letter or digit "
            "and not ending "
            "with a blank or a dot"
        )
    return name


def folder_of(root: Path, name: str) -> Path:
    """Return the folder of an object. Raises ObjectError for an impossible name."""
    return root / FOLDER / check_name(name)


def object_names(root: Path) -> list[str]:
    """Return the names of all objects under a storage root, in order."""
    return sorted(path.parent.name for path in (root / FOLDER).glob(f"*/{FILE}") if is_object(path.parent.name))


def read_object(root: Path, name: str) -> StoredObject:
    """Read an object. Raises ObjectError for one that is not there or is damaged."""
    path = folder_of(root, name) / FILE
    try:
        found = OBJECT.load(path, name=str(path))
    except ContentError as error:
        raise ObjectError(str(error)) from error
    if found is None:
        known = ", ".join(object_names(root)) or "none yet"
        raise ObjectError(f"object '{name}': there is none under {root} ({known}); make it: kingfisher object add")
    # The folder's name is the object's, also where somebody renamed it: what is written next must not go to another's
    # folder.
    return replace(found, name=name)


def solved_object(root: Path, name: str) -> StoredObject:
    """Read an object that has places. Raises ObjectError for any other, before anything that computes is loaded where
    there is none."""
    found = read_object(root, name)
    from appliance.desk.object_errors import errors_of

    errors_of(found)  # says where it is not solved
    return found


def object_exists(root: Path, name: str) -> bool:
    """Return whether there is an object of that name, also a damaged one. Raises ObjectError for an impossible name."""
    return (folder_of(root, name) / FILE).exists()


def update_object(root: Path, name: str, change: Callable[[StoredObject | None], StoredObject]) -> StoredObject:
    """Replace an object by ``change`` of what is stored now (``None``: there is none), under its lock; return it,
    durable.

    Raises what ``change`` raises, StorageError, ObjectError.
    """
    fs, folder = LocalFileSystem(), folder_of(root, name)
    fs.make_folders(folder)
    with hold_lock(folder, _LOCK_S):
        changed = change(read_object(root, name) if object_exists(root, name) else None)
        fs.replace_file(folder / FILE, OBJECT.encode(changed))
    return changed


def write(root: Path, stored: StoredObject) -> None:
    """Write an object in the place of whatever is stored under its name; it is durable on return.

    Raises StorageError, ObjectError.
    """
    update_object(root, stored.name, lambda _: stored)


def with_scans(stored: StoredObject, added: tuple[MemberScan, ...]) -> StoredObject:
    """Return the object with scans added; they have no place yet. Raises ObjectError for a scan that it has already."""
    have = {one.frames_sha256: one.name for one in stored.scans}
    taken = {one.name for one in stored.scans}
    for scan in added:
        if scan.frames_sha256 in have:
            raise ObjectError(
                f"object '{stored.name}': scan {scan.name} is in it already, as {have[scan.frames_sha256]}; leave it "
                "out"
            )
        if scan.name in taken:
            raise ObjectError(
                f"object '{stored.name}': has another scan called {scan.name}; name its folder otherwise, then add it"
            )
        have[scan.frames_sha256] = scan.name
        taken.add(scan.name)
    return _with_places(replace(stored, scans=(*stored.scans, *added)), stored.places)


def merge_places(now: StoredObject | None, solved: StoredObject) -> StoredObject:
    """Return the object as it is stored now with the places that were found for what it was before; scans that were
    added meanwhile have none yet.

    Raises ObjectError where it was made again meanwhile, or solved with more scans: what is stored is worth more then.
    """
    if now is None or not set(solved.scans) <= set(now.scans):
        raise ObjectError(
            f"object '{solved.name}': was made again while it was solved; its places are not kept: solve it once more"
        )
    more = sorted(_scans_with_result(now.places) - _scans_with_result(solved.places))
    if more:
        raise ObjectError(
            f"object '{solved.name}': was solved with {', '.join(more)}, too, meanwhile; those places are kept, and "
            "these are not"
        )
    return _with_places(now, solved.places)


def _scans_with_result(places: Places | None) -> set[str]:
    """Return the scans that have a place, or a reason of their own for having none."""
    if places is None:
        return set()
    return {*places.places, *(name for name, why in places.left_out.items() if why != ADDED_SINCE)}


def _with_places(stored: StoredObject, places: Places | None) -> StoredObject:
    """Return the object with ``places``, of which the scans that they say nothing of are left out."""
    if places is None:
        return replace(stored, places=None)
    answered = _scans_with_result(places)
    since = {one.name: ADDED_SINCE for one in stored.scans if one.name not in answered}
    return replace(stored, places=replace(places, left_out={**places.left_out, **since}))


# ------------------------------------------------------------------------------------------------ kept clouds


def load_cloud(root: Path, name: str, scan: str, key: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays kept of a scan under ``key``; ``None`` where there are none, or of another key, or damaged
    ones."""
    import numpy as np

    path = folder_of(root, name) / CLOUDS / f"{scan}.npz"
    try:
        with np.load(path, allow_pickle=False) as kept:
            if str(kept["key"]) != key:
                return None
            return {one: kept[one] for one in kept.files if one != "key"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        # It can be made again from the frames.
        return None


def save_cloud(root: Path, name: str, scan: str, key: str, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Keep a scan's arrays under ``key``.

    What cannot be kept is made again next time. Raises ObjectError for an impossible name.
    """
    import numpy as np

    fs, folder = LocalFileSystem(), folder_of(root, name) / CLOUDS
    path = folder / f"{scan}.npz"
    buffer = io.BytesIO()
    values: dict[str, Any] = {"key": np.array(key), **arrays}
    np.savez(buffer, **values)
    # Two that make the same cloud at once write the same draft.
    with suppress(OSError, StorageError), hold_lock(folder.parent, _LOCK_S):
        if not folder.is_dir():
            fs.make_folder(folder)
        fs.replace_file(path, buffer.getbuffer())
