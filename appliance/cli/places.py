"""The options that many verbs share: which rig file, storage root, calibration and scan."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.cli.arguments import Verb, path_option, switch
from appliance.cli.output import UsageError
from appliance.store import standing_root

if TYPE_CHECKING:  # imported where they are needed: a verb that needs neither loads neither
    from appliance.store import Rig, ScanOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class WithRig(Verb):
    """A verb of one instrument, which a rig file describes."""

    rig: Path | None = path_option("--rig", "rig file (default: the packaged one)", metavar="PATH")

    def read_rig(self) -> Rig:
        """Read the rig file that was given, else the packaged one. Raises ConfigError."""
        from appliance.store import load_rig

        return load_rig(self.rig)


@dataclass(frozen=True, slots=True, kw_only=True)
class WithRoot(WithRig):
    """A verb of what lies under a storage root."""

    root: Path | None = path_option(
        "--root", "storage root (default: the one you stand in, KINGFISHER_ROOT, the rig file's)", metavar="PATH"
    )

    def named_root(self) -> Path | None:
        """Return the root that was given with ``--root``, else, without ``--rig``, the one that the folder one stands
        in or the environment names; ``None``: the rig file says it. Raises UsageError."""
        return given_root(self.root) if self.root is not None else None if self.rig is not None else _standing()[0]

    def existing_root(self) -> Path:
        """Return ``named_root``, else the rig file's, which is read only then. Raises ConfigError, UsageError."""
        if self.root is not None:
            return given_root(self.root)
        return root_of_rig(None if self.rig is None else self.read_rig())

    def rooted_rig(self) -> Rig:
        """Return the rig with ``named_root``. Raises ConfigError, UsageError."""
        rig = self.read_rig()
        root = self.named_root()
        return rig if root is None else replace(rig, storage=replace(rig.storage, root=root))

    def new_root(self) -> Path | None:
        """Return the root that was given, which is made if it is not there. Raises UsageError for a file."""
        if self.root is None:
            return None
        if self.root.exists() and not self.root.is_dir():
            raise UsageError(f"--root {self.root}: is a file; give a folder, which is made if it is not there")
        return self.root.absolute()

    def wish(self) -> ScanOptions:
        """Return what was asked for beside a scan. Reads a rig file only where one was given. Raises ConfigError,
        UsageError."""
        from appliance.store import ScanOptions

        return ScanOptions(
            # Not the packaged rig file instead: a scan brings its own, and a default would pass for somebody's wish.
            rig=None if self.rig is None else self.read_rig(),
            root=None if self.root is None else given_root(self.root),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class WithCalibration(WithRoot):
    """A verb that makes points: by default with each scan's own calibration."""

    calibration: Path | None = path_option(
        "--calibration", "default: the one the scan was taken with", either="calibration"
    )
    current: bool = switch("--current", "the one in use under the storage root", either="calibration")
    foreign_calibration: bool = switch("--foreign-calibration", "also if it is another instrument's")

    def wish(self) -> ScanOptions:
        """Return the wish of ``WithRoot`` with the choice of a calibration. Raises ConfigError, CalibrationError,
        UsageError."""
        measuring(self.calibration)
        return replace(
            # By name: a dataclass with slots is made anew, so that `super()` without arguments would look in the class
            # of before.
            WithRoot.wish(self),
            calibration=self.calibration,
            current=self.current,
            foreign=self.foreign_calibration,
        )


def measuring(calibration: Path | None) -> None:
    """Raises UsageError for a ``--calibration`` in air: what the windows do is not in it. Raises CalibrationError."""
    if calibration is None:
        return
    from appliance.measure import IN_AIR
    from appliance.store import load_calibration

    if load_calibration(calibration).method == IN_AIR:
        raise UsageError(
            f"--calibration {calibration}: is one in air, which only calibrating in water begins with; "
            "give one made in water (`kingfisher calibration water`)"
        )


def given_root(root: Path) -> Path:
    """Return ``root`` itself. Raises UsageError where it is no folder."""
    if root.is_file():
        raise UsageError(f"--root {root}: is a file; give the folder that holds scans/")
    if not root.is_dir():
        raise UsageError(f"--root {root}: no such folder; give the storage root that holds scans/")
    return root


def root_of_rig(rig: Rig | None) -> Path:
    """Return the storage root where ``--root`` names none: that of the rig file that was given; where none was
    (``None``), the one around the folder one stands in, else that of ``KINGFISHER_ROOT``, else the packaged rig file's.

    Raises UsageError for a packaged one that is not there, as on every computer that is no instrument."""
    if rig is not None:
        return rig.storage.root
    found, vain = _standing()
    if found is not None:
        return found
    from appliance.store import load_rig

    root = load_rig().storage.root
    if not root.is_dir():
        raise UsageError(f"no storage root: {vain}, and {root} is not there; give --root PATH")
    return root


def _standing() -> tuple[Path | None, str]:
    try:
        return standing_root(os.environ)
    except NotADirectoryError as error:
        raise UsageError(str(error)) from error


def scan_folder(scan: str) -> Path | None:
    """Return the folder that ``scan`` names; ``None`` where it is a number. Raises UsageError for a folder that is
    not there."""
    # A bare word is a number unless a folder of that name lies here; with a slash it can only be a folder.
    if "/" not in scan and not Path(scan).is_dir():
        return None
    if not Path(scan).is_dir():
        raise UsageError(f"SCAN {scan}: no such folder; give a scan's number or its folder")
    return Path(scan)
