"""Owns what is remembered on the disk about how a calibration holds: one small checksummed file per calibration.

    <root>/calibration/health/<first 16 digits of the calibration's hash>.json

Replaced as a whole after each scan, so that a loss of power costs the latest scan's entry at most. A file that cannot be
read is put aside under another name: the trend begins anew, and a person can look at what there was.
"""

from __future__ import annotations

import logging
import math
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from appliance.calibration.gaps import DOUBTS
from appliance.calibration.health import HealthTrend
from appliance.calibration.patches import COUNT
from appliance.checksummed_file import checked_content, with_checksum
from appliance.storage.atomic import StorageError, make_folders, refused, remedy_for, replace_file
from appliance.storage.filesystem import FileSystem, LocalFileSystem

log = logging.getLogger("kingfisher")

FOLDER = Path("calibration", "health")
SCHEMA = 1
MAX_BYTES = 1_000_000
_TREND = TypeAdapter(HealthTrend)


class HealthFile:
    """The memory of one calibration. One process writes, any number may read."""

    def __init__(self, root: Path, calibration_hash: str, fs: FileSystem | None = None) -> None:
        self._fs: FileSystem = fs or LocalFileSystem()
        self._hash = calibration_hash
        self.path = root / FOLDER / f"{calibration_hash[:16]}.json"

    def read(self) -> HealthTrend:
        """Read the remembered trend; an empty one where there is none, or none that can be read."""
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            return HealthTrend()
        except OSError as error:
            log.warning("%s: %s; the trend of the ray gaps begins anew", self.path, error.strerror or error)
            return HealthTrend()
        try:
            return self._decoded(data)
        except ValueError as error:
            log.warning("%s: %s; the trend of the ray gaps begins anew", self.path, error)
            return HealthTrend()

    def write(self, trend: HealthTrend) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        make_folders(self._fs, self.path.parent)
        self._set_aside()
        content = {"schema": SCHEMA, "calibration": self._hash, "trend": _TREND.dump_python(trend, mode="json")}
        replace_file(self._fs, self.path, with_checksum(content, indent=None))

    def _set_aside(self) -> None:
        """Move a file that cannot be read aside, so that it is not overwritten."""
        if not self.path.exists():
            return
        try:
            self._decoded(self.path.read_bytes())
        except OSError as error:
            raise StorageError("cannot read", self.path, error.strerror or str(error), remedy_for(error)) from error
        except ValueError:
            with refused("cannot rename", self.path):
                self._fs.rename(self.path, self.path.with_suffix(".damaged"))

    def _decoded(self, data: bytes) -> HealthTrend:
        """Raises ValueError."""
        content = checked_content(data, MAX_BYTES)
        if content.get("schema") != SCHEMA or content.get("calibration") != self._hash:
            raise ValueError("it is of another version or another calibration")
        try:
            trend = _TREND.validate_python(content.get("trend"))
        except ValidationError as error:
            raise ValueError(str(error.errors(include_url=False)[0]["msg"])) from error
        if trend.judged < 0 or not _is_finite(_TREND.dump_python(trend)):
            raise ValueError("it has a number that cannot be")
        reference = trend.reference
        if any(len(of) != COUNT for of in (reference.gap_um, reference.variance_um2, reference.scans)):
            raise ValueError(f"its reference has not {COUNT} patches")
        if len(reference.doubts_um) != COUNT * (DOUBTS + 1):
            raise ValueError(f"its reference has not {DOUBTS + 1} doubts of {COUNT} patches")
        return trend


def _is_finite(value: object) -> bool:
    """Tell whether every number in a tree of values is finite."""
    match value:
        case dict():
            return all(map(_is_finite, value.values()))
        case list() | tuple():
            return all(map(_is_finite, value))
        case float():
            return math.isfinite(value)
        case _:
            return True
