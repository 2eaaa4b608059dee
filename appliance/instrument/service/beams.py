"""Owns what was learned of the laser pointers' beams, as it is remembered on the disk over a restart: one small
checksummed file.

    <root>/calibration/beams.json

What was learned belongs to one calibration, whose frame it is in, and to one drawing: a file of others is not used.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from appliance.base import FINITE, ContentError, SealedFile, Within, plain
from appliance.instrument.ranging.beams import PointerBeam, Pointers
from appliance.store import CALIBRATIONS, FileSystem, LocalFileSystem

log = logging.getLogger("kingfisher")

FILE = "beams.json"
MOST_SIGMAS = 6.0
"""A beam farther from the drawing than its tolerance explains is not one that was learned."""
_Real = Annotated[float, FINITE]


@dataclass(frozen=True, slots=True)
class _StoredBeam:
    """A beam as it is written, which says nothing that no dot could have taught."""

    z0_mm: float
    line: tuple[_Real, _Real, _Real, _Real]
    covariance: tuple[tuple[_Real, ...], ...]
    learned: Annotated[int, Within(0, 2**53, whole=True)]
    last_z_mm: Annotated[float, Within(-999_999.0, 999_999.0)] | None
    """``None``: it has seen no dot yet; JSON has no word for infinity."""

    def of(self, drawn: PointerBeam) -> PointerBeam:
        """Return the beam that ``drawn`` became. Raises ValueError for what no dot could have taught it."""
        P = np.asarray(self.covariance)
        if P.shape != (4, 4):
            raise ValueError("a beam has four values and their covariance")
        # Every dot makes a beam more certain than drawn; 1.001 and 1e-9 leave room for rounding.
        variances = np.diag(np.asarray(drawn.covariance))
        if (np.diag(P) > 1.001 * variances).any() or np.linalg.eigvalsh(
            0.5 * (P + P.T)
        ).min() < -1e-9 * variances.max():
            raise ValueError("a beam is less certain than drawn")
        if (np.abs(np.subtract(self.line, drawn.line)) > MOST_SIGMAS * np.sqrt(variances)).any():
            raise ValueError("a beam is farther from the drawing than its tolerance allows")
        last_z_mm = math.inf if self.last_z_mm is None else self.last_z_mm
        return PointerBeam(drawn.z0_mm, self.line, self.covariance, self.learned, last_z_mm)


@dataclass(frozen=True, slots=True)
class _StoredBeams:
    """Content of the file: the left and the right beam."""

    beams: tuple[_StoredBeam, _StoredBeam]


BEAMS = SealedFile(_StoredBeams, schema=1, max_bytes=20_000)


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
        left, right = drawn = self._pointers.beams()
        try:
            found = BEAMS.load(self.path, self._learned_with(calibration_hash))
            return drawn if found is None else (found.beams[0].of(left), found.beams[1].of(right))
        except (ContentError, ValueError) as error:
            log.warning("%s: %s; the laser beams are learned anew from the drawing", self.path, error)
            return drawn

    def write(self, calibration_hash: str, beams: tuple[PointerBeam, PointerBeam]) -> None:
        """Write it all down; it is durable on return. Raises StorageError."""
        left, right = (_StoredBeam(one.z0_mm, one.line, one.covariance, one.learned, one.last_z_mm) for one in beams)
        self._fs.make_folders(self.path.parent)
        self._fs.replace_file(
            self.path, BEAMS.encode(_StoredBeams((left, right)), self._learned_with(calibration_hash))
        )

    def _learned_with(self, calibration_hash: str) -> dict[str, Any]:
        """Return what a file must say: a beam is a correction of the drawing in the frame of one calibration, and means
        nothing with another of either."""
        return {"calibration": calibration_hash, "drawn": plain(self._pointers)}
