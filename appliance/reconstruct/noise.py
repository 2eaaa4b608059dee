"""Owns how much a camera's grey values scatter: read noise and photons, from the camera's data sheet and its gain."""

from __future__ import annotations

import math
from dataclasses import dataclass

LEVELS = 255.0
QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole grey values."""


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """One camera's temporal noise: variance = ``read_dn``² + ``dn_per_e`` · (grey value − ``black_dn``).

    What is fixed to the pixel (offset, sensitivity) cancels in the phase and is not in it.
    """

    read_dn: float
    """All that does not depend on light, rounding included."""
    dn_per_e: float
    """Grey values per electron: the photons' variance per grey value."""
    black_dn: float
    """Grey value of no light."""

    def variance_dn2(self, grey_dn: float) -> float:
        """Of a grey value whose mean is ``grey_dn``."""
        return self.read_dn**2 + self.dn_per_e * max(grey_dn - self.black_dn, 0.0)


@dataclass(frozen=True, slots=True)
class StereoNoise:
    """Of both cameras."""

    left: CameraNoise
    right: CameraNoise


def camera_noise(full_well_e: float, read_noise_e: float, black_dn: float, gain_db: float) -> CameraNoise:
    """From the figures of a data sheet after EMVA 1288 (saturation capacity, temporal dark noise), both at 0 dB.

    ``full_well_e``: electrons at 255 grey values.
    """
    dn_per_e = LEVELS / full_well_e * 10.0 ** (gain_db / 20.0)
    return CameraNoise(math.sqrt((read_noise_e * dn_per_e) ** 2 + QUANTISATION_DN2), dn_per_e, black_dn)


TYPICAL = camera_noise(13_000.0, 20.0, 2.0, 0.0)
"""Of a camera whose data sheet nobody has entered."""
TYPICAL_PAIR = StereoNoise(TYPICAL, TYPICAL)
