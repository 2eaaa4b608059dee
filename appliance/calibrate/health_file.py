"""Owns what is remembered on the disk about how a calibration holds: one small checksummed file per calibration.

    <root>/calibration/health/<first 16 digits of the calibration's hash>.json

Replaced as a whole after each scan, so that a loss of power costs the latest scan's entry at most. A file that cannot be
read is put aside under another name: the trend begins anew, and a person can look at what there was.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from appliance.base import ContentError, SealedFile
from appliance.calibrate.health import HealthTrend
from appliance.measure import DOUBTS, PATCH_COUNT
from appliance.store import FileSystem, LocalFileSystem, StorageError, make_folders, refused, remedy_for, replace_file

log = logging.getLogger("kingfisher")

FOLDER = Path("calibration", "health")


@dataclass(frozen=True, slots=True)
class _StoredHealth:
    """Content of the file."""

    trend: HealthTrend


def _refuse_impossible(stored: _StoredHealth) -> None:
    """Raises ValueError."""
    reference = stored.trend.reference
    if stored.trend.judged < 0:
        raise ValueError(f"trend.judged is {stored.trend.judged}; allowed: whole numbers from 0")
    if any(len(of) != PATCH_COUNT for of in (reference.gap_um, reference.variance_um2, reference.scans)):
        raise ValueError(f"its reference has not {PATCH_COUNT} patches")
    if len(reference.doubts_um) != PATCH_COUNT * (DOUBTS + 1):
        raise ValueError(f"its reference has not {DOUBTS + 1} doubts of {PATCH_COUNT} patches")


HEALTH = SealedFile(_StoredHealth, schema=1, max_bytes=1_000_000, indent=None, check=_refuse_impossible)


class HealthFile:
    """The memory of one calibration. One process writes, any number may read."""

    def __init__(self, root: Path, calibration_hash: str, fs: FileSystem | None = None) -> None:
        self._fs: FileSystem = fs or LocalFileSystem()
        self._of: Mapping[str, str] = {"calibration": calibration_hash}
        self.path = root / FOLDER / f"{calibration_hash[:16]}.json"

    def read(self) -> HealthTrend:
        """Read the remembered trend; an empty one where there is none, or none that can be read."""
        try:
            found = HEALTH.load(self.path, self._of, name=str(self.path))
        except ContentError as error:
            log.warning("%s; the trend of the ray gaps begins anew", error)
            return HealthTrend()
        return HealthTrend() if found is None else found.trend

    def write(self, trend: HealthTrend) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        make_folders(self._fs, self.path.parent)
        self._set_aside()
        replace_file(self._fs, self.path, HEALTH.encode(_StoredHealth(trend), self._of))

    def _set_aside(self) -> None:
        """Move a file that cannot be read aside, so that it is not overwritten."""
        if not self.path.exists():
            return
        try:
            HEALTH.decode(self.path.read_bytes(), str(self.path), self._of)
        except OSError as error:
            raise StorageError("cannot read", self.path, error.strerror or str(error), remedy_for(error)) from error
        except ContentError:
            with refused("cannot rename", self.path):
                self._fs.rename(self.path, self.path.with_suffix(".damaged"))
