"""Owns the options that were given beside a scan, and the storage root that it lies in: light, so that a wrong one is
told before anything that computes is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from appliance.store.library import LibraryFolder
from appliance.store.names import CALIBRATION_FILE

if TYPE_CHECKING:  # brings pydantic, which a verb without a rig file can do without
    from appliance.store.config import Rig


@dataclass(frozen=True, slots=True)
class Wish:
    """The options that were given beside the scan itself; ``None``: nothing was said."""

    rig: Rig | None = None
    """Rig file of ``--rig``."""
    root: Path | None = None
    """Storage root of ``--root``."""
    calibration: Path | None = None
    """A calibration file that takes the place of the scan's own."""
    current: bool = False
    """The calibration in use under the storage root takes its place."""
    foreign: bool = False
    """One of another instrument is used all the same."""


def root_of(folder: Path) -> Path | None:
    """Return the storage root that a scan's folder lies in: ROOT of ROOT/scans/000001; ``None`` where it was copied
    elsewhere."""
    whole = folder.absolute()
    root = whole.parent.parent
    # A folder called `scans` may be anywhere; one with `calibration` beside it is a storage root.
    inside = whole.parent.name in {shelf.value for shelf in LibraryFolder} and (root / CALIBRATION_FILE).parent.is_dir()
    return root if inside else None
