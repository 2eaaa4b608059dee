"""Owns what a scan was taken with: written beside its frames, found again at the desk, and refused where it does not fit.

A new scan carries its calibration and its rig file. An old one has only the calibration's hash in its manifest: the file of
that hash is looked for under the storage root that the scan lies in. The drawing is used where the scan itself was taken
with it, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.calibration import owner as belonging
from appliance.calibration.file import IN_AIR, Calibration, CalibrationError, decode, load
from appliance.calibration.owner import Owner
from appliance.config import ConfigError, Rig, default_rig_path, load_rig, parse_rig
from appliance.offline.wish import Wish, root_of
from appliance.scan.sides import SIDES, of_side
from appliance.storage import scan as stored
from appliance.storage.calibrations import CURRENT, FOLDER
from appliance.storage.manifest import Manifest
from appliance.storage.scan import CALIBRATION, RIG, ScanError, StoredScan

FOREIGN_OPTION = "--foreign-calibration"
SHOWN_DIGITS = 12
"""Digits of a hash that people are shown."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceScan:
    """A stored scan and the instrument that took it, as far as it is known."""

    scan: StoredScan
    rig: Rig
    known: bool
    """``rig`` is this scan's: its own, or the one that was given. Otherwise it is the packaged one, for want of another,
    and only its cameras' data sheets and its folders are of use."""
    root: Path | None
    """The storage root that was given, or that the scan's folder lies in."""

    @property
    def storage_root(self) -> Path:
        """The folder of the instrument's own files."""
        return self.root or self.rig.storage.root


@dataclass(frozen=True, slots=True)
class Chosen:
    """The calibration a scan is reconstructed with."""

    calibration: Calibration
    whose: str
    """Source of the calibration, in words."""


def open_source(folder: Path, wish: Wish, scan: StoredScan | None = None) -> SourceScan:
    """Open a scan and the rig it was taken with: ``--rig``, else its own, else the packaged one.

    ``scan``: what was opened of it already. Raises ScanError, also for a rig file whose cameras are of another size.
    """
    scan = scan or stored.load(folder, only_raw=True)
    root = wish.root or root_of(folder)
    if wish.rig is not None:
        for side, camera in (("left", wish.rig.camera.left), ("right", wish.rig.camera.right)):
            _same_size(scan, side, (camera.width_px, camera.height_px), f"the rig file ({wish.rig.rig.name})", "--rig")
        return SourceScan(scan, wish.rig, True, root)
    # A damaged one counts as none: the frames are what cannot be made again (ADR 0033).
    own = _own(scan, RIG)
    if own is None:
        return SourceScan(scan, load_rig(default_rig_path()), False, root)
    try:
        return SourceScan(scan, parse_rig(own.decode(), str(folder / RIG)), True, root)
    except (ConfigError, UnicodeDecodeError) as error:
        raise ScanError(f"{folder / RIG}: {error}; give the rig file of the instrument with --rig PATH") from error


def instrument_of(scans: Sequence[SourceScan], wish: Wish) -> Rig:
    """Return the instrument that all ``scans`` are of, with its storage root: ``--rig``, else that of the first that
    knows its own.

    Raises ScanError for scans of several instruments.
    """
    known = [one for one in scans if one.known]
    rig = wish.rig or (known[0].rig if known else load_rig(default_rig_path()))
    for one in known:
        # Not `rig_hash`: exposure and folders may differ from scan to scan, cameras and raster may not.
        if one.rig.optical_hash != rig.optical_hash:
            raise ScanError(
                f"{one.scan.folder}: is of {_cameras(one.rig)}, not of {_cameras(rig)} as the others; "
                "take scans of one instrument"
            )
    root = wish.root or next((one.root for one in scans if one.root is not None), None)
    return rig if root is None else replace(rig, storage=replace(rig.storage, root=root))


def calibration_for(scan: SourceScan, wish: Wish) -> Chosen:
    """Return the calibration for a scan: the one asked for, else its own, else the file of the hash that its manifest
    names.

    Raises CalibrationError for one that is missing or does not fit; the text says what to do.
    """
    if wish.calibration is not None:
        chosen = Chosen(load(wish.calibration), f"--calibration {wish.calibration}")
    elif wish.current:
        path = scan.storage_root / FOLDER / CURRENT
        chosen = Chosen(load(path), str(path))
    else:
        chosen = _of_the_scan(scan)
    refuse_misfit(chosen.calibration, chosen.whose, scan, foreign=wish.foreign)
    return chosen


def one_calibration(scans: Sequence[SourceScan], wish: Wish) -> Chosen:
    """Return the calibration for several scans at once. Raises CalibrationError also where they were taken with
    different ones."""
    chosen = [calibration_for(scan, wish) for scan in scans]
    other = next((k for k, one in enumerate(chosen) if one.calibration != chosen[0].calibration), None)
    if other is None:
        return chosen[0]
    first, second = (chosen[k].calibration for k in (0, other))
    raise CalibrationError(
        f"{scans[0].scan.folder} was taken with calibration {first.hash[:SHOWN_DIGITS]} of {first.made_at}, "
        f"{scans[other].scan.folder} with {second.hash[:SHOWN_DIGITS]} of {second.made_at}; choose one for all with "
        "--calibration FILE, or the instrument's with --current"
    )


def refuse_misfit(
    calibration: Calibration, whose: str, scan: SourceScan, *, foreign: bool, start: bool = False
) -> None:
    """Raises CalibrationError where ``misfit`` has a reason. ``whose``: where the calibration is from, in words."""
    problem = misfit(calibration, scan, foreign=foreign, start=start)
    if problem is not None:
        raise CalibrationError(f"{whose}: {problem} ({scan.scan.folder})")


def misfit(calibration: Calibration, scan: SourceScan, *, foreign: bool = False, start: bool = False) -> str | None:
    """Return why a scan cannot be measured with a calibration, and what to do; ``None`` where it can.

    The images must have its size. Instrument and cameras must be its own too, unless ``foreign``: that is compared as far
    as the scan, the rig file given for it or the calibration that its manifest names say whose it is. ``start``: it is
    what a calibration begins with.
    """
    option = "--start" if start else "--calibration"
    remedy = f"give the one of the instrument that recorded it with {option} FILE"
    for side in SIDES:
        eye = of_side(calibration.rig, side)
        height_px, width_px = scan.scan.frames[side].shape[1:]
        if (width_px, height_px) != (eye.width_px, eye.height_px):
            return f"is for {side} images of {eye.width_px}x{eye.height_px} px; the scan's are {width_px}x{height_px} px; {remedy}"
    if calibration.method == IN_AIR and not start:
        return (
            "is one in air, which only calibrating in water begins with; give one made in water with --calibration FILE"
        )
    # The very calibration that the scan was taken with fits it by definition, whatever serial numbers say.
    if foreign or calibration.hash == scan.scan.manifest.record.calibration_hash:
        return None
    # Asked last: it may read every calibration that is kept, to find the one that names the owner.
    owner = _owner(scan)
    other = None if owner is None else belonging.misfit(calibration, owner)
    if other is None:
        return None
    return f"{other.reason}; {remedy}" + ("" if start else f", or use it all the same with {FOREIGN_OPTION}")


def _owner(scan: SourceScan) -> Owner | None:
    """Return the instrument that took a scan; ``None`` where nothing says which."""
    left, right = (scan.scan.frames[side].shape for side in SIDES)
    sizes_px = ((left[2], left[1]), (right[2], right[1]))
    if scan.known:
        camera = scan.rig.camera
        return Owner(scan.rig.rig.serial, sizes_px, (camera.left.serial, camera.right.serial))
    named = next(_of_the_hash(scan), None)
    return None if named is None else Owner(named.calibration.rig_serial, sizes_px, named.calibration.camera_serials)


# ------------------------------------------------------------------------------------- the scan's own


def _of_the_scan(scan: SourceScan) -> Chosen:
    folder, record = scan.scan.folder, scan.scan.manifest.record
    own = _own(scan.scan, CALIBRATION)
    if own is not None:
        return Chosen(decode(own, str(folder / CALIBRATION)), "the scan's own")
    if record.calibration_hash is None:
        if scan.root is not None:
            path = scan.root / FOLDER / CURRENT
            return Chosen(load(path), str(path))
        raise CalibrationError(
            f"{folder}: does not say with which calibration it was taken; give one with --calibration FILE, "
            "or the storage root of its instrument with --root PATH and --current"
        )
    found = next(_of_the_hash(scan), None)
    if found is not None:
        return found
    where = ", ".join(str(root / FOLDER) for root in _roots(scan)) or "no storage root"
    raise CalibrationError(
        f"{folder}: was taken with calibration {record.calibration_hash[:SHOWN_DIGITS]}, which is neither in its folder nor "
        f"under {where}; give its file with --calibration FILE, or take the instrument's newest with --current --root PATH"
    )


def unrecorded(folder: Path, wish: Wish) -> tuple[str, ...]:
    """Return what decides about a scan's points and is neither in its manifest nor in ``wish``, in words; mostly nothing.

    Files that it carries and that are damaged are passed over, and a scan that names no calibration takes the one in use under its
    storage root, which changes.
    """
    try:
        manifest = stored.manifest_of(folder)
    except ScanError:
        return ()
    problems = {name: lost(folder, manifest, name) for name in (CALIBRATION, RIG) if name in manifest.files}
    found = [f"{name}: {problem}" for name, problem in problems.items() if problem is not None]
    carried = CALIBRATION in manifest.files and problems[CALIBRATION] is None
    root = wish.root or root_of(folder)
    if wish.calibration is None and not carried and manifest.record.calibration_hash is None and root is not None:
        try:
            found.append(f"in use: {load(root / FOLDER / CURRENT).hash}")
        except CalibrationError as error:
            found.append(f"in use: {error}")
    return tuple(found)


def _of_the_hash(scan: SourceScan) -> Iterator[Chosen]:
    """Yield calibrations of the hash that the scan's manifest names, from wherever they may be kept."""
    wanted = scan.scan.manifest.record.calibration_hash
    if wanted is None:
        return
    for root in _roots(scan):
        folder = root / FOLDER
        for path in (
            folder / CURRENT,
            # The latest first: most scans were taken with what was in use last.
            *sorted(folder.glob("kept/*.json"), reverse=True),
            *sorted(folder.glob("*.json")),
        ):
            try:
                found = load(path)
            except CalibrationError:
                continue
            if found.hash == wanted:
                yield Chosen(found, str(path))
    from appliance.instrument import design_of  # late: it brings OpenCV, and most scans need no drawing

    drawn = design_of(scan.rig)
    if drawn.hash == wanted:
        yield Chosen(drawn, "the drawing in the rig file")


def _roots(scan: SourceScan) -> list[Path]:
    """Return the storage roots that may hold the scan's calibration: the one it lies in first."""
    wanted = (root_of(scan.scan.folder), scan.root, scan.rig.storage.root)
    return [root for k, root in enumerate(wanted) if root is not None and root not in wanted[:k]]


def _own(scan: StoredScan, name: str) -> bytes | None:
    """Return the bytes of a file that the scan carries; ``None`` where it carries none, or a damaged one."""
    if lost(scan.folder, scan.manifest, name) is not None:
        return None
    try:
        return (scan.folder / name).read_bytes()
    except OSError:
        return None


def lost(folder: Path, manifest: Manifest, name: str) -> str | None:
    """Return what is wrong with one of a scan's files, its bytes compared with their checksum; ``None`` where it is whole."""
    if name not in manifest.files:
        return "not in the manifest"
    alone = replace(manifest, files={name: manifest.files[name]})
    return stored.wrong_files(folder, alone, checksums=True).get(name)


def _same_size(scan: StoredScan, side: str, size: tuple[int, int], whose: str, option: str) -> None:
    height_px, width_px = scan.frames[side].shape[1:]
    if (width_px, height_px) != size:
        raise ScanError(
            f"{scan.folder}: its {side} images are {width_px}x{height_px} px; {whose} is for {size[0]}x{size[1]} px; give the "
            f"one of the instrument that recorded it ({option}), or none where the scan carries its own"
        )


def _cameras(rig: Rig) -> str:
    left, right = rig.camera.left, rig.camera.right
    return f"instrument {rig.rig.serial} with cameras {left.serial} and {right.serial} of {left.width_px}x{left.height_px} px"
