"""Owns what was learned of the laser pointers' beams, as it is remembered on the disk over a restart: one small checksummed file.

    <root>/calibration/beams.json

What was learned belongs to one calibration, whose frame it is in, and to one drawing: a file of others is not used.
"""

from __future__ import annotations

import json
import logging
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from appliance.checksummed_file import checked_content, with_checksum
from appliance.ranging.beams import PointerBeam, Pointers
from appliance.storage.atomic import make_folders, replace_file
from appliance.storage.filesystem import FileSystem, LocalFileSystem
from appliance.storage.names import CALIBRATIONS

log = logging.getLogger("kingfisher")

FILE = "beams.json"
SCHEMA = 1
MAX_BYTES = 20_000
MOST_SIGMAS = 6.0
"""A beam farther from the drawing than its tolerance explains is not one that was learned."""


class BeamsFile:
    """The memory of one instrument's pointers. One thread at a time."""

    def __init__(self, root: Path, pointers: Pointers, fs: FileSystem | None = None) -> None:
        """Remember beams below ``root``; ``pointers`` are as the rig file draws them."""
        self.path = root / CALIBRATIONS / FILE
        self._pointers = pointers
        self._fs: FileSystem = fs or LocalFileSystem()

    def read(self, calibration_hash: str) -> tuple[PointerBeam, PointerBeam]:
        """Read the beams learned with that calibration; the drawing's where there are none, or none that can be
        used."""
        try:
            with self.path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
            return self._decoded(data, calibration_hash)
        except FileNotFoundError:
            pass
        except (OSError, ValueError) as error:
            log.warning("%s: %s; the laser beams are learned anew from the drawing", self.path, error)
        return self._pointers.beams()

    def write(self, calibration_hash: str, beams: tuple[PointerBeam, PointerBeam]) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        # A beam that has seen no dot yet has infinity there, for which JSON has no word.
        spelled = [{**asdict(beam), "last_z_mm": _finite(beam.last_z_mm)} for beam in beams]
        content = {"calibration": calibration_hash, "drawn": self._drawn(), "beams": spelled}
        make_folders(self._fs, self.path.parent)
        replace_file(self._fs, self.path, with_checksum({"schema": SCHEMA, **content}))

    def _drawn(self) -> dict[str, Any]:
        drawn: dict[str, Any] = json.loads(json.dumps(asdict(self._pointers)))
        return drawn

    def _decoded(self, data: bytes, calibration_hash: str) -> tuple[PointerBeam, PointerBeam]:
        """Raises ValueError."""
        content = checked_content(data, MAX_BYTES)
        if content.get("schema") != SCHEMA:
            raise ValueError(f"schema {content.get('schema')!r}; {SCHEMA} is known here")
        # A beam is a correction of the drawing in the frame of one calibration: with another of either it means
        # nothing.
        if content.get("drawn") != self._drawn():
            raise ValueError("learned with other pointers than the rig file's")
        if content.get("calibration") != calibration_hash:
            raise ValueError("learned with another calibration than the one in use")
        beams = content.get("beams")
        if not isinstance(beams, list) or len(beams) != 2:
            raise ValueError("two beams were expected")
        left, right = (_beam(said, drawn) for said, drawn in zip(beams, self._pointers.beams(), strict=True))
        return left, right


def _beam(said: object, drawn: PointerBeam) -> PointerBeam:
    """Raises ValueError for what no dot could have taught ``drawn``."""
    try:
        line = np.asarray(said["line"], np.float64)  # type: ignore[index]
        P = np.asarray(said["covariance"], np.float64)  # type: ignore[index]
        learned, last_z_mm = said["learned"], said["last_z_mm"]  # type: ignore[index]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"a beam is not readable ({error})") from error
    if line.shape != (4,) or P.shape != (4, 4) or not (np.isfinite(line).all() and np.isfinite(P).all()):
        raise ValueError("a beam has four finite values and their covariance")
    if isinstance(learned, bool) or not isinstance(learned, int) or not 0 <= learned <= 2**53:
        raise ValueError(f"{learned!r} dots taught a beam")
    if last_z_mm is not None and (type(last_z_mm) not in (int, float) or not abs(last_z_mm) < 1e6):
        raise ValueError(f"last_z_mm {last_z_mm!r}")
    # Every dot makes a beam more certain than drawn; 1.001 and 1e-9 leave room for rounding.
    variances = np.diag(np.asarray(drawn.covariance))
    if (np.diag(P) > 1.001 * variances).any() or np.linalg.eigvalsh(0.5 * (P + P.T)).min() < -1e-9 * variances.max():
        raise ValueError("a beam is less certain than drawn")
    if (np.abs(line - np.asarray(drawn.line)) > MOST_SIGMAS * np.sqrt(variances)).any():
        raise ValueError("a beam is farther from the drawing than its tolerance allows")
    x0, y0, sx, sy = (float(v) for v in line)
    rows = tuple(tuple(float(v) for v in row) for row in P)
    last = math.inf if last_z_mm is None else float(last_z_mm)
    return PointerBeam(drawn.z0_mm, (x0, y0, sx, sy), rows, learned, last)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
