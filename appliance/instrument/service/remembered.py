"""Files that keep choices and laser beams over a restart, each with its checksum.

    ChoicesFile    <root>/choices.json              the diver's choices
    BeamsFile      <root>/calibration/beams.json    corrections of the laser pointers' beams

Only choices that differ from the rig file are written, so that a corrected rig file still holds for the others.
Corrected beams belong to one calibration, whose frame they are in, and to one design: a file of others is not used.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from appliance.base import FINITE, Among, ContentError, SealedFile, Within, plain, shaped
from appliance.instrument.machine.choices import COLDEST_C, LANGUAGES, WARMEST_C, Choices
from appliance.instrument.ranging.beams import PointerBeam, Pointers
from appliance.measure import PERIODS_PX, Exposure, Fault, FaultCode
from appliance.store import CALIBRATION_FILE, FileSystem, LocalFileSystem

log = logging.getLogger("kingfisher")

MOST_OBJECTS = 999_999
"""Largest object number that is accepted."""


@dataclass(frozen=True, slots=True)
class _StoredChoices:
    """All stored choices."""

    exposure_us: Annotated[int, Within(50, 16_600)]
    gain_db: Annotated[float, Within(0.0, 48.0)]
    period_px: Annotated[int, Among(PERIODS_PX)]
    salinity_psu: Annotated[float, Within(0.0, 45.0)]
    water_c: Annotated[float, Within(COLDEST_C, WARMEST_C)]
    language: Annotated[str, Among(LANGUAGES)]
    object: Annotated[int, Within(1, MOST_OBJECTS, integers_only=True)] | None
    objects: Annotated[int, Within(0, MOST_OBJECTS, integers_only=True)]


@dataclass(frozen=True, slots=True)
class _ChangedChoices:
    """Content of the file: choices that differ from the rig file."""

    chosen: Mapping[str, Any]


CHOICES = SealedFile(_ChangedChoices, schema=1, max_bytes=10_000)


class ChoicesFile:
    """File with the diver's choices on one instrument. One thread at a time."""

    def __init__(self, root: Path, standard: Choices, fs: FileSystem | None = None) -> None:
        """Set the place of the file; ``standard``: the choices by the rig file."""
        self.path = root / "choices.json"
        self._standard = standard
        self._fs: FileSystem = fs or LocalFileSystem()

    def read(self) -> tuple[Choices, Fault | None]:
        """Read the diver's choices; if that fails, return the rig file's values and a condition."""
        try:
            stored = CHOICES.load(self.path, name="")
            if stored is None:
                return self._standard, None
            chosen = shaped(_StoredChoices, {**asdict(_spelled(self._standard)), **stored.chosen})
            if chosen.object is not None and chosen.object > chosen.objects:
                raise ContentError("", f"object is {chosen.object}", f"1..{chosen.objects}, the largest number")
        except ContentError as error:
            log.warning("%s: %s; the rig file's values hold until a new choice", self.path, error)
            return self._standard, Fault(FaultCode.SETTINGS_LOST, f"{self.path.name}: {error}")
        values = {name: value for name, value in asdict(chosen).items() if name not in ("exposure_us", "gain_db")}
        return replace(self._standard, exposure=Exposure(chosen.exposure_us, chosen.gain_db), **values), None

    def write(self, choices: Choices) -> None:
        """Write the choices; durable on return. Raises StorageError."""
        standard, chosen = asdict(_spelled(self._standard)), asdict(_spelled(choices))
        content = {name: value for name, value in chosen.items() if value != standard[name]}
        self._fs.replace_file(self.path, CHOICES.encode(_ChangedChoices(content)))


def _spelled(choices: Choices) -> _StoredChoices:
    return _StoredChoices(
        choices.exposure.time_us,
        choices.exposure.gain_db,
        choices.period_px,
        choices.salinity_psu,
        choices.water_c,
        choices.language,
        choices.object,
        choices.objects,
    )


MOST_SIGMAS = 6.0
"""Largest distance of a corrected beam from the nominal one, in sigmas of its tolerance."""
_Real = Annotated[float, FINITE]


@dataclass(frozen=True, slots=True)
class _StoredBeam:
    """A beam as it is written, with checks of its values."""

    z0_mm: float
    line: tuple[_Real, _Real, _Real, _Real]
    covariance: tuple[tuple[_Real, ...], ...]
    learned: Annotated[int, Within(0, 2**53, integers_only=True)]
    last_z_mm: Annotated[float, Within(-999_999.0, 999_999.0)] | None
    """``None`` before the first dot, since JSON has no infinity."""

    def of(self, drawn: PointerBeam) -> PointerBeam:
        """Return the beam as a correction of the nominal one, ``drawn``.

        Raises ValueError for values that no dots can have produced.
        """
        P = np.asarray(self.covariance)
        if P.shape != (4, 4):
            raise ValueError("a beam has four values and their covariance")
        # Every dot makes a beam more certain than the nominal one; 1.001 and 1e-9 allow for rounding.
        variances = np.diag(np.asarray(drawn.covariance))
        if (np.diag(P) > 1.001 * variances).any() or np.linalg.eigvalsh(
            0.5 * (P + P.T)
        ).min() < -1e-9 * variances.max():
            raise ValueError("the uncertainty of a beam exceeds that of the design")
        if (np.abs(np.subtract(self.line, drawn.line)) > MOST_SIGMAS * np.sqrt(variances)).any():
            raise ValueError("a beam deviates from the design beyond its tolerance")
        last_z_mm = math.inf if self.last_z_mm is None else self.last_z_mm
        return PointerBeam(drawn.z0_mm, self.line, self.covariance, self.learned, last_z_mm)


@dataclass(frozen=True, slots=True)
class _StoredBeams:
    """Content of the file: the left and the right beam."""

    beams: tuple[_StoredBeam, _StoredBeam]


BEAMS = SealedFile(_StoredBeams, schema=1, max_bytes=20_000)


class BeamsFile:
    """File with the corrected beams of one instrument. One thread at a time."""

    def __init__(self, root: Path, pointers: Pointers, fs: FileSystem | None = None) -> None:
        """Set the place of the file below ``root``; ``pointers``: as the rig file states them."""
        self.path = (root / CALIBRATION_FILE).with_name("beams.json")
        self._pointers = pointers
        self._fs: FileSystem = fs or LocalFileSystem()

    def read(self, calibration_hash: str) -> tuple[PointerBeam, PointerBeam]:
        """Read the beams corrected with that calibration; the nominal ones if there are none that can be used."""
        left, right = drawn = self._pointers.beams()
        try:
            stored = BEAMS.load(self.path, self._learned_with(calibration_hash))
            return drawn if stored is None else (stored.beams[0].of(left), stored.beams[1].of(right))
        except (ContentError, ValueError) as error:
            log.warning("%s: %s; the laser beams are measured again, from the design", self.path, error)
            return drawn

    def write(self, calibration_hash: str, beams: tuple[PointerBeam, PointerBeam]) -> None:
        """Write the beams; durable on return. Raises StorageError."""
        left, right = (
            _StoredBeam(beam.z0_mm, beam.line, beam.covariance, beam.learned, beam.last_z_mm) for beam in beams
        )
        self._fs.make_folders(self.path.parent)
        self._fs.replace_file(
            self.path, BEAMS.encode(_StoredBeams((left, right)), self._learned_with(calibration_hash))
        )

    def _learned_with(self, calibration_hash: str) -> dict[str, Any]:
        """Return the keys that a usable file must have.

        A corrected beam is valid only with the same design and in the frame of the same calibration.
        """
        return {"calibration": calibration_hash, "drawn": plain(self._pointers)}
