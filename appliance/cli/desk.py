"""Owns what the desk asks for before it works: a scan whose frames are whole, a file to write.

Whatever a wrong word could need is imported where it is needed: a mistake is told before anything that computes is loaded.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from appliance.cli.output import UsageError
from appliance.cli.places import root_of_rig, scan_folder
from appliance.store import Library, StorageError, Wish, remedy_for

CLOUD_SUFFIX, PAGE_SUFFIX = ".ply", ".html"


def whole_scan(wish: Wish, scan: str) -> Path:
    """Return the folder of ``scan``, its number or its folder, whose frames are whole: every byte is compared with
    its checksum.

    What can be made again from the frames (cloud, preview), and what may be found elsewhere (calibration, rig file), need
    not be whole. Raises UnknownScan, ScanError, UsageError.
    """
    folder = scan_in(wish, scan)
    from appliance.store import refuse_damaged_frames

    refuse_damaged_frames(folder)
    return folder


def scan_in(wish: Wish, scan: str) -> Path:
    """Return the folder of ``scan``, its number or its folder, whatever is in it. Raises UnknownScan, UsageError."""
    return scan_folder(scan) or Library(library_root(wish)).entry(scan).folder


def library_root(wish: Wish) -> Path:
    """Return the storage root in which numbers of scans are looked up. Raises ConfigError, UsageError."""
    return wish.root or root_of_rig(wish.rig)


def place_of(listed: Path, scan: str) -> str:
    """Return what a list means by ``scan``: a folder is relative to the list, a number is one of the storage root."""
    return str(listed.parent / scan) if "/" in scan else scan


def measuring(calibration: Path | None) -> None:
    """Raises UsageError for a ``--calibration`` in air: what the windows do is not in it. Raises CalibrationError."""
    if calibration is None:
        return
    from appliance.measure import IN_AIR
    from appliance.store import load_calibration

    if load_calibration(calibration).method == IN_AIR:
        raise UsageError(
            f"--calibration {calibration}: is one in air, which only calibrating in water begins with; "
            "give one made in water (`kingfisher calibrate water`)"
        )


def existing(what: str, folder: Path, holds: str) -> None:
    """Raises UsageError where ``folder``, the operand ``what``, is none; ``holds``: what it is to hold, for the remedy."""
    if not folder.is_dir():
        raise UsageError(f"{what} {folder}: no such folder; give the one that holds {holds}")


def writable(out: Path | None, name: str = "--out") -> None:
    """Raises UsageError for a file of the option ``name`` that cannot become a file, before the work is done."""
    if out is None:
        return
    if out.is_dir():
        raise UsageError(f"{name} {out}: is a folder; give the name of a file in it, for example {out / 'cloud.ply'}")
    if out.exists() and not out.is_file():
        raise UsageError(f"{name} {out}: is no ordinary file and would be replaced by one; give the name of a file")
    if not out.absolute().parent.is_dir():
        raise UsageError(f"{name} {out}: there is no folder {out.parent}; make it first, or give another one")


def writable_page(out: Path) -> None:
    """Raises UsageError for a name that ``writable`` refuses or that promises another format than a page."""
    writable(out)
    if out.suffix.lower() != PAGE_SUFFIX:
        raise UsageError(f"--out {out}: a page is written as {PAGE_SUFFIX}; give {out.with_suffix(PAGE_SUFFIX).name}")


def writable_cloud(out: Path | None) -> None:
    """Raises UsageError for a name that ``writable`` refuses or that promises another format than the one written."""
    writable(out)
    if out is not None and out.suffix.lower() != CLOUD_SUFFIX:
        raise UsageError(
            f"--out {out}: a cloud is written as PLY, and {out.suffix or 'no suffix'} promises something else; allowed: "
            f"{CLOUD_SUFFIX}; give {out.with_suffix(CLOUD_SUFFIX)}, which other programs convert"
        )


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turns what the disk refuses into a StorageError that names ``path`` and the option that leads elsewhere."""
    try:
        yield
    except (StorageError, OSError) as error:
        # StorageError has its own remedy; a bare OSError (a vanished folder, say) gets one by its number.
        if isinstance(error, StorageError):
            reason, remedy = error.reason, error.remedy
        else:
            reason, remedy = error.strerror or str(error), remedy_for(error)
        raise StorageError("cannot write", path, reason, f"{remedy}; --out FILE writes elsewhere") from error
