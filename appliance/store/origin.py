"""Calibration and rig file with which a stored scan is reconstructed: its own, or others that fit it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.measure import IN_AIR, SIDES, Calibration, CalibrationError, Owner, of_side, owner_misfit
from appliance.store.config import ConfigError, Rig, parse_rig
from appliance.store.instrument import load_calibration
from appliance.store.names import CALIBRATION_FILE
from appliance.store.scan import CALIBRATION, RIG_FILE, ScanError, StoredScan
from appliance.store.wish import ScanOptions, root_of

if TYPE_CHECKING:
    from appliance.store.config import Rig


FOREIGN_OPTION = "--foreign-calibration"
SHOWN_DIGITS = 12
"""Digits of a hash that people are shown."""


@dataclass(frozen=True, slots=True, eq=False)
class SourceScan:
    """A stored scan and the instrument that took it."""

    scan: StoredScan
    rig: Rig
    root: Path | None
    """The storage root that was given, or that the scan's folder lies in."""

    @property
    def storage_root(self) -> Path:
        """The folder of the instrument's own files."""
        return self.root or self.rig.storage.root

    @classmethod
    def open(
        cls, folder: Path, options: ScanOptions, scan: StoredScan | None = None, *, whole: bool = False
    ) -> SourceScan:
        """Open a scan and the rig it was taken with: ``--rig``, else its own.

        ``scan``: the scan if it is open already. ``whole``: every byte of its frames is compared with its checksum
        first. Raises ScanError, also for a rig file that is damaged or whose cameras are of another size.
        """
        if whole:
            StoredScan.refuse_damage(folder)
        scan = scan or StoredScan.load(folder, only_raw=True)
        root = options.root or root_of(folder)
        if options.rig is not None:
            for side, camera in (("left", options.rig.camera.left), ("right", options.rig.camera.right)):
                _same_size(
                    scan, side, (camera.width_px, camera.height_px), f"the rig file ({options.rig.rig.name})", "--rig"
                )
            return cls(scan, options.rig, root)
        remedy = "give the rig file of the instrument with --rig PATH"
        problem = scan.problem_of(RIG_FILE)
        if problem is not None:
            raise ScanError(f"{folder / RIG_FILE}: {problem}; {remedy}")
        try:
            return cls(scan, parse_rig((folder / RIG_FILE).read_text(encoding="utf-8"), str(folder / RIG_FILE)), root)
        except (ConfigError, OSError, UnicodeDecodeError) as error:
            raise ScanError(f"{folder / RIG_FILE}: {error}; {remedy}") from error

    @staticmethod
    def instrument_of(scans: Sequence[SourceScan], options: ScanOptions) -> Rig:
        """Return the instrument that all ``scans`` (one or more) are of, with its storage root.

        Raises ScanError for scans of several instruments.
        """
        rig = options.rig or scans[0].rig
        for source in scans:
            # Not `rig_hash`: exposures and folders may differ between scans, cameras and raster may not.
            if source.rig.optical_hash != rig.optical_hash:
                raise ScanError(
                    f"{source.scan.folder}: is of {_cameras(source.rig)}, the others are of "
                    f"{_cameras(rig)}; give scans of one instrument"
                )
        root = options.root or next((source.root for source in scans if source.root is not None), None)
        return rig if root is None else replace(rig, storage=replace(rig.storage, root=root))

    def calibration_for(self, options: ScanOptions) -> ChosenCalibration:
        """Return the calibration for this scan: the one in the options, else its own.

        Raises CalibrationError for one that is missing or does not fit; the text has the remedy.
        """
        if options.calibration is not None:
            chosen = ChosenCalibration(load_calibration(options.calibration), f"--calibration {options.calibration}")
        elif options.current:
            path = self.storage_root / CALIBRATION_FILE
            chosen = ChosenCalibration(load_calibration(path), str(path))
        else:
            chosen = _of_the_scan(self.scan)
        self.refuse_misfit(chosen.calibration, chosen.whose, foreign=options.foreign)
        return chosen

    @staticmethod
    def one_calibration(scans: Sequence[SourceScan], options: ScanOptions) -> ChosenCalibration:
        """Return one calibration for several scans. Raises CalibrationError also where their own ones differ."""
        chosen = [scan.calibration_for(options) for scan in scans]
        k_other = next((k for k, choice in enumerate(chosen) if choice.calibration != chosen[0].calibration), None)
        if k_other is None:
            return chosen[0]
        first, second = (chosen[k].calibration for k in (0, k_other))
        raise CalibrationError(
            f"{scans[0].scan.folder} is of calibration {first.hash[:SHOWN_DIGITS]} of {first.made_at}, "
            f"{scans[k_other].scan.folder} with {second.hash[:SHOWN_DIGITS]} of {second.made_at}; choose "
            "one for all scans with --calibration FILE, or the instrument's with --current"
        )

    def refuse_misfit(self, calibration: Calibration, whose: str, *, foreign: bool, start: bool = False) -> None:
        """Raise CalibrationError where ``misfit`` returns a reason.

        ``whose``: the source of the calibration, in words.
        """
        problem = misfit(calibration, self, foreign=foreign, start=start)
        if problem is not None:
            raise CalibrationError(f"{whose}: {problem} ({self.scan.folder})")


@dataclass(frozen=True, slots=True)
class ChosenCalibration:
    """The calibration a scan is reconstructed with."""

    calibration: Calibration
    whose: str
    """Source of the calibration, in words."""


def misfit(calibration: Calibration, scan: SourceScan, *, foreign: bool = False, start: bool = False) -> str | None:
    """Return the reason why a scan cannot be measured with a calibration, and the remedy, or ``None``.

    The images must have its size. Instrument and cameras must be those of the rig file too, unless ``foreign``.
    ``start``: the calibration is only the start of another one.
    """
    remedy = "give the one of the instrument that recorded it with --calibration FILE"
    for side in SIDES:
        eye = of_side(calibration.rig, side)
        height_px, width_px = scan.scan.frames[side].shape[1:]
        if (width_px, height_px) != (eye.width_px, eye.height_px):
            return f"is for {side} images of {eye.width_px}x{eye.height_px} px; the scan's are {width_px}x{height_px} px; {remedy}"
    if calibration.method == IN_AIR and not start:
        return (
            "is an air calibration, from which only a water calibration starts; give a water calibration "
            "with --calibration FILE"
        )
    # The calibration that the scan was taken with fits it by definition, with any serial numbers.
    if foreign or calibration.hash == scan.scan.manifest.record.calibration_hash:
        return None
    mismatch = owner_misfit(calibration, _owner(scan))
    if mismatch is None:
        return None
    return f"{mismatch.reason}; {remedy}" + ("" if start else f", or accept it with {FOREIGN_OPTION}")


def _owner(scan: SourceScan) -> Owner:
    """Return the instrument that took a scan."""
    left, right = (scan.scan.frames[side].shape for side in SIDES)
    sizes_px = ((left[2], left[1]), (right[2], right[1]))
    camera = scan.rig.camera
    return Owner(scan.rig.rig.serial, sizes_px, (camera.left.serial, camera.right.serial))


def _of_the_scan(scan: StoredScan) -> ChosenCalibration:
    path = scan.folder / CALIBRATION
    problem = scan.problem_of(CALIBRATION)
    if problem is not None:
        named = (scan.manifest.record.calibration_hash or "not named")[:SHOWN_DIGITS]
        raise CalibrationError(
            f"{path}: {problem}; the scan's calibration is {named}: give its file with --calibration FILE, "
            "or use the instrument's newest with --current --root PATH"
        )
    return ChosenCalibration(load_calibration(path), "the scan's own")


def _same_size(scan: StoredScan, side: str, size: tuple[int, int], whose: str, option: str) -> None:
    height_px, width_px = scan.frames[side].shape[1:]
    if (width_px, height_px) != size:
        raise ScanError(
            f"{scan.folder}: its {side} images are {width_px}x{height_px} px; {whose} is for {size[0]}x{size[1]} px; "
            "give the "
            f"one of the instrument that recorded it ({option}), or no option if the scan has its own"
        )


def _cameras(rig: Rig) -> str:
    left, right = rig.camera.left, rig.camera.right
    return f"instrument {rig.rig.serial} with cameras {left.serial} and {right.serial} of {left.width_px}x{left.height_px} px"
