"""Owns what the desk asks for before it works: a scan that is whole and of the calibration's size, a file to write."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from appliance.calibration import file as calibration_file
from appliance.cli.output import UsageError
from appliance.config import Rig
from appliance.storage import scan as stored
from appliance.storage.atomic import StorageError, remedy_for
from appliance.storage.library import Library
from appliance.storage.scan import RAW_FILES, ScanError

CLOUD_SUFFIX = ".ply"


def usable_scan(rig: Rig, scan: str, calibration: Path | None) -> Path:
    """The folder of ``scan``, its number or its folder, whose raw frames are whole and have the calibration's size.

    Raises UnknownScan, ScanError (every byte of the frames is compared with its checksum), CalibrationError, UsageError.
    """
    folder = _folder(rig, scan)
    loaded = stored.load(folder)
    wrong = stored.wrong_files(folder, loaded.manifest, checksums=True)
    damaged = [f"{name}: {problem}" for name, problem in wrong.items() if name in RAW_FILES]
    if damaged:
        raise ScanError(f"{folder}: {'; '.join(damaged)}; bring the scan's folder back from a copy")
    _check_size(rig, folder, loaded, calibration)
    return folder


def place_of(listed: Path, scan: str) -> str:
    """What a list means by ``scan``: a folder is relative to the list, a number is one of the storage root."""
    return str(listed.parent / scan) if "/" in scan else scan


def measuring(calibration: Path | None) -> None:
    """Raises UsageError for a ``--calibration`` in air: what the windows do is not in it. Raises CalibrationError."""
    from appliance.calibration.start import METHOD as IN_AIR  # brings OpenCV, which `scans list` can do without

    if calibration is not None and calibration_file.load(calibration).method == IN_AIR:
        raise UsageError(
            f"--calibration {calibration}: is one in air, which only calibrating in water begins with; "
            "give one made in water (`kingfisher calibrate water`)"
        )


def writable(out: Path | None) -> None:
    """Raises UsageError for an ``--out`` that cannot become a file, before the work is done."""
    if out is None:
        return
    if out.is_dir():
        raise UsageError(f"--out {out}: is a folder; give the name of a file in it, for example {out / 'cloud.ply'}")
    if out.exists() and not out.is_file():
        raise UsageError(f"--out {out}: is no ordinary file and would be replaced by one; give the name of a file")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"--out {out}: there is no folder {out.parent}; make it first, or give another one")


def writable_cloud(out: Path | None) -> None:
    """As ``writable``, of a cloud. Raises UsageError for a name that promises another format than the one written."""
    if out is not None and out.suffix.lower() != CLOUD_SUFFIX:
        raise UsageError(
            f"--out {out}: a cloud is written as PLY, and {out.suffix or 'no suffix'} promises something else; allowed: "
            f"{CLOUD_SUFFIX}; give {out.with_suffix(CLOUD_SUFFIX)}, which other programs convert"
        )
    writable(out)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns what the disk refuses into a StorageError that names ``path`` and the option that leads elsewhere."""
    try:
        yield
    except (StorageError, OSError) as error:
        if isinstance(error, StorageError):
            reason, remedy = error.reason, error.remedy
        else:
            reason, remedy = error.strerror or str(error), remedy_for(error)
        raise StorageError("cannot write", path, reason, f"{remedy}; --out FILE writes elsewhere") from error


def _folder(rig: Rig, scan: str) -> Path:
    if "/" in scan or Path(scan).is_dir():
        folder = Path(scan)
        if not folder.is_dir():
            raise UsageError(f"SCAN {scan}: no such folder; give a scan's number or its folder")
        return folder
    return Library(rig.storage.root).entry(scan).folder


def _check_size(rig: Rig, folder: Path, scan: stored.StoredScan, calibration: Path | None) -> None:
    """Pixels of another size would give another instrument's points, or none."""
    for side, of_rig in (("left", rig.camera.left), ("right", rig.camera.right)):
        size = (of_rig.width_px, of_rig.height_px)  # the instrument's own calibration is only used if it has this size
        whose = f"the rig file ({rig.rig.name})"
        if calibration is not None:
            eye = getattr(calibration_file.load(calibration).rig, side)
            size, whose = (eye.width_px, eye.height_px), f"--calibration {calibration}"
        height, width = scan.frames[side].shape[1:]
        if (width, height) != size:
            raise UsageError(
                f"SCAN {folder}: its {side} images are {width}x{height} px; {whose} is for {size[0]}x{size[1]} px; "
                "give the rig file (--rig) or the calibration (--calibration) of the instrument that recorded it"
            )
