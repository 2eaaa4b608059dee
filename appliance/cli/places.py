"""Options that many verbs share: rig file, storage root, calibration and scan."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import Verb, path_option, switch
from appliance.cli.output import UsageError
from appliance.store import standing_root

if TYPE_CHECKING:  # imported where needed, so that other verbs do not load them
    from appliance.store import Rig, ScanOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class WithRig(Verb):
    """A verb of one instrument, which a rig file describes."""

    rig: Path | None = path_option("--rig", "rig file (default: the packaged one)", metavar="PATH")

    def read_rig(self) -> Rig:
        """Read the given rig file, else the packaged one. Raises ConfigError."""
        from appliance.store import load_rig

        return load_rig(self.rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class WithRoot(WithRig):
    """A verb that works below a storage root."""

    root: Path | None = path_option(
        "--root", "storage root (default: that of the current folder, KINGFISHER_ROOT, the rig file's)", metavar="PATH"
    )

    def named_root(self) -> Path | None:
        """Return the root of ``--root``, else, without ``--rig``, that around the working folder or in the environment.

        ``None`` leaves it to the rig file. Raises UsageError.
        """
        return check_root(self.root) if self.root is not None else None if self.rig is not None else _standing_root()[0]

    def existing_root(self) -> Path:
        """Return ``named_root``, else that of the rig file, which is read only then. Raises ConfigError, UsageError."""
        if self.root is not None:
            return check_root(self.root)
        return root_of_rig(None if self.rig is None else self.read_rig())

    def rooted_rig(self) -> Rig:
        """Return the rig with ``named_root`` as its root. Raises ConfigError, UsageError."""
        rig = self.read_rig()
        root = self.named_root()
        return rig if root is None else replace(rig, storage=replace(rig.storage, root=root))

    def new_root(self) -> Path | None:
        """Return the root of ``--root``, which is made later if it does not exist. Raises UsageError for a file."""
        if self.root is None:
            return None
        if self.root.exists() and not self.root.is_dir():
            raise UsageError(f"--root {self.root}: is a file; give a folder, which is made if it does not exist")
        return self.root.absolute()

    def scan_options(self) -> ScanOptions:
        """Return the options for reading scans; a rig file is read only if it was given.

        Raises ConfigError, UsageError.
        """
        from appliance.store import ScanOptions

        return ScanOptions(
            # Not the packaged rig file by default: a scan has its own, and the default would override it.
            rig=None if self.rig is None else self.read_rig(),
            root=None if self.root is None else check_root(self.root),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WithCalibration(WithRoot):
    """A verb that makes points, by default with each scan's own calibration."""

    calibration: Path | None = path_option(
        "--calibration", "calibration file (default: that of the scan)", either="calibration"
    )
    current: bool = switch("--current", "use the calibration in use under the storage root", either="calibration")
    foreign_calibration: bool = switch("--foreign-calibration", "accept the calibration of another instrument")

    def scan_options(self) -> ScanOptions:
        """Return the options of ``WithRoot`` with the choice of a calibration.

        Raises ConfigError, CalibrationError, UsageError.
        """
        reject_air_calibration(self.calibration)
        return replace(
            # By name: `dataclass(slots=True)` creates a new class, so that `super()` without arguments would refer to
            # the original one.
            WithRoot.scan_options(self),
            calibration=self.calibration,
            current=self.current,
            foreign=self.foreign_calibration,
        )


def reject_air_calibration(calibration: Path | None) -> None:
    """Raise UsageError for a ``--calibration`` in air, which lacks the effect of ports and water.

    Raises CalibrationError for a file that cannot be read.
    """
    if calibration is None:
        return
    from appliance.measure import IN_AIR
    from appliance.store import load_calibration

    if load_calibration(calibration).method == IN_AIR:
        raise UsageError(
            f"--calibration {calibration}: is an air calibration, from which only a water calibration starts; "
            "give a water calibration (`kingfisher calibration water`)"
        )


def check_root(root: Path) -> Path:
    """Return ``root``. Raises UsageError if it is no folder."""
    if root.is_file():
        raise UsageError(f"--root {root}: is a file; give the folder that holds scans/")
    if not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; give the storage root that holds scans/")
    return root


def root_of_rig(rig: Rig | None) -> Path:
    """Return the storage root without ``--root``: that of a given rig file, else of the surroundings.

    With ``None`` it is the one around the working folder, else that of ``KINGFISHER_ROOT``, else of the packaged rig
    file. Raises UsageError if the last does not exist, as on a computer that is no instrument.
    """
    if rig is not None:
        return rig.storage.root
    standing, attempts = _standing_root()
    if standing is not None:
        return standing
    from appliance.store import load_rig

    root = load_rig().storage.root
    if not root.is_dir():
        raise UsageError(f"no storage root: {attempts}, and {root} is not there; give --root PATH")
    return root


def _standing_root() -> tuple[Path | None, str]:
    try:
        return standing_root(os.environ)
    except NotADirectoryError as error:
        raise UsageError(str(error)) from error


def scan_folder(scan: str) -> Path | None:
    """Return the folder that ``scan`` names; ``None`` for a number. Raises UsageError for a missing folder."""
    # A word without a slash is a number unless a folder of that name exists here; with one it is a folder.
    if "/" not in scan and not Path(scan).is_dir():
        return None
    if not Path(scan).is_dir():
        raise UsageError(f"SCAN {scan}: no such folder; give a scan's number or its folder")
    return Path(scan)
