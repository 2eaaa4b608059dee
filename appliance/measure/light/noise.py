"""The noise of grey values: read noise and photon noise, from the camera's data sheet and its gain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar, overload

import numpy as np
from numpy.typing import NDArray

FULL_DN = 255
"""Largest grey value of a camera's eight bits: a pixel with it is saturated."""
QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole grey values."""
# 1 / Φ⁻¹(3/4), with Φ the normal distribution.
MAD_TO_SIGMA = 1.4826
"""The standard deviation of normally distributed values over the median of their distances from the mean (MAD)."""
Float = TypeVar("Float", np.float32, np.float64)


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """One camera's temporal noise: variance = ``read_dn``² + ``dn_per_e`` · (grey value − ``black_dn``).

    Fixed patterns (offset, sensitivity) cancel in the phase and are not included.
    """

    read_dn: float
    """Noise that does not depend on light, including rounding."""
    dn_per_e: float
    """Grey values per electron: the variance of photon noise per grey value."""
    black_dn: float
    """Grey value without light."""

    @property
    def dark_variance_dn2(self) -> float:
        """The variance at grey value 0 on the straight line, to which a kernel adds ``dn_per_e`` · grey value.

        It may be below 0 if black is far above 0; grey values below black occur only by noise.
        """
        return self.read_dn**2 - self.dn_per_e * self.black_dn

    @overload
    def variance_dn2(self, grey_dn: float) -> float: ...
    @overload
    def variance_dn2(self, grey_dn: NDArray[Float]) -> NDArray[Float]: ...
    def variance_dn2(self, grey_dn: float | NDArray[Float]) -> float | NDArray[Float]:
        """Return the variance of grey values with mean ``grey_dn``, of any shape; below black, that of black."""
        # Light cannot be negative: below black the photon noise is zero.
        if isinstance(grey_dn, np.ndarray):
            return np.asarray(self.read_dn**2 + self.dn_per_e * np.maximum(grey_dn - self.black_dn, 0.0), grey_dn.dtype)
        return self.read_dn**2 + self.dn_per_e * max(grey_dn - self.black_dn, 0.0)


@dataclass(frozen=True, slots=True)
class StereoNoise:
    """The temporal noise of both cameras."""

    left: CameraNoise
    right: CameraNoise


def camera_noise(full_well_e: float, read_noise_e: float, black_dn: float, gain_db: float) -> CameraNoise:
    """Return the noise model from the figures of a data sheet after EMVA 1288, both at 0 dB.

    ``full_well_e``: electrons at 255 grey values (saturation capacity); ``read_noise_e``: temporal dark noise.
    """
    # Gain in dB of amplitude: 20 dB are a factor of ten. Quantisation to whole grey values adds 1/12.
    dn_per_e = FULL_DN / full_well_e * 10.0 ** (gain_db / 20.0)
    return CameraNoise(math.sqrt((read_noise_e * dn_per_e) ** 2 + QUANTISATION_DN2), dn_per_e, black_dn)


TYPICAL = camera_noise(13_000.0, 20.0, 2.0, 0.0)
"""Noise of a camera without data sheet figures."""
TYPICAL_PAIR = StereoNoise(TYPICAL, TYPICAL)
