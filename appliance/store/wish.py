"""The options that were given beside a scan, and the storage root that it lies in.

The module is light, so that a wrong option is reported before any module that computes is loaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.store.library import LibraryFolder
from appliance.store.names import CALIBRATION_FILE

if TYPE_CHECKING:  # brings pydantic, which a verb without a rig file can do without
    from appliance.store.config import Rig


@dataclass(frozen=True, slots=True)
class ScanOptions:
    """The options that were given beside the scan itself; ``None``: not given."""

    rig: Rig | None = None
    """Rig file of ``--rig``."""
    root: Path | None = None
    """Storage root of ``--root``."""
    calibration: Path | None = None
    """Calibration file of ``--calibration``, used instead of the scan's own."""
    current: bool = False
    """True if the calibration in use below the storage root takes its place."""
    foreign: bool = False
    """True if a calibration of another instrument is allowed."""


def root_of(folder: Path) -> Path | None:
    """Return the storage root that a scan's folder lies in: ROOT of ROOT/scans/000001.

    It is ``None`` outside of one.
    """
    path = folder.absolute()
    root = path.parent.parent
    # A folder called `scans` may be anywhere; one with `calibration` beside it is a storage root.
    inside = path.parent.name in {kind.value for kind in LibraryFolder} and (root / CALIBRATION_FILE).parent.is_dir()
    return root if inside else None
