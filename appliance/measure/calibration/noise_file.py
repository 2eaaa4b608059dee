"""The file of the cameras' measured noise: small, checksummed, readable JSON, beside the calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from appliance.base import SealedFile, Within
from appliance.measure.light.noise import FULL_DN, QUANTISATION_DN2

LIMITS = {"full_well_e": Within(500.0, 9e5), "read_noise_e": Within(0.0, 900.0), "black_level_dn": Within(0.0, 63.0)}
"""Allowed range of each figure, within that of the rig file's key of the same name."""


@dataclass(frozen=True, slots=True)
class CameraFigures:
    """One camera's measured noise figures, with the names of the rig file."""

    serial: str
    """The camera's serial number: another camera has another noise."""
    full_well_e: Annotated[float, LIMITS["full_well_e"]]
    """Electrons at 255 grey values and 0 dB."""
    read_noise_e: Annotated[float, LIMITS["read_noise_e"]]
    """All noise that does not depend on light, without the rounding to grey values."""
    black_level_dn: Annotated[float, LIMITS["black_level_dn"]]
    """Grey value without light."""

    @classmethod
    def of_line(
        cls, serial: str, gain_db: float, dn_per_e: float, variance_at_dn2: tuple[float, float], black_dn: float
    ) -> CameraFigures:
        """Return the figures at 0 dB of a camera whose variance was linear in light at ``gain_db``.

        The line grows by ``dn_per_e`` per grey value through the variance ``variance_at_dn2`` (light, variance), and is
        kept exactly: if ``black_dn`` contains ambient light, black level and read noise are both too large, but the
        variance of every grey value is right.
        """
        light_dn, variance_dn2 = variance_at_dn2
        read_dn2 = variance_dn2 - dn_per_e * (light_dn - black_dn) - QUANTISATION_DN2
        full_well_e = FULL_DN / dn_per_e * 10.0 ** (gain_db / 20.0)
        return cls(serial, full_well_e, math.sqrt(max(read_dn2, 0.0)) / dn_per_e, black_dn)


@dataclass(frozen=True, slots=True)
class BothFigures:
    """The figures of both cameras."""

    left: CameraFigures
    right: CameraFigures


@dataclass(frozen=True, slots=True)
class StoredNoise:
    """The noise of both cameras and its source."""

    rig_serial: str
    made_from: tuple[str, ...]
    """Ids of the scans."""
    cameras: BothFigures


NOISE = SealedFile(
    StoredNoise,
    schema=1,
    max_bytes=64 * 1024,
    what="noise",
    remedy="measure the noise again, or remove the file: the data sheets' noise of the rig file is then used",
)
