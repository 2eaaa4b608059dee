"""Owns the file of the cameras' measured noise: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from appliance.base import SealedFile, Within

LIMITS = {"full_well_e": Within(500.0, 9e5), "read_noise_e": Within(0.0, 900.0), "black_level_dn": Within(0.0, 63.0)}
"""Range of each figure, within that of the rig file's key of the same name."""


@dataclass(frozen=True, slots=True)
class CameraFigures:
    """One camera's figures as the rig file has them, measured instead of read in a data sheet."""

    serial: str
    """The camera's serial number: another one has another noise."""
    full_well_e: Annotated[float, LIMITS["full_well_e"]]
    """Electrons at 255 grey values and 0 dB."""
    read_noise_e: Annotated[float, LIMITS["read_noise_e"]]
    """All noise that does not depend on light, but rounding to grey values."""
    black_level_dn: Annotated[float, LIMITS["black_level_dn"]]
    """Grey value of no light."""


@dataclass(frozen=True, slots=True)
class BothFigures:
    """The figures of both cameras."""

    left: CameraFigures
    right: CameraFigures


@dataclass(frozen=True, slots=True)
class StoredNoise:
    """The noise of both cameras and where it comes from."""

    rig_serial: str
    made_from: tuple[str, ...]
    """Ids of the scans."""
    cameras: BothFigures


NOISE = SealedFile(
    StoredNoise,
    schema=1,
    max_bytes=64 * 1024,
    what="noise",
    remedy="measure the noise again, or remove the file: the rig file's data sheets are then believed",
)
