"""The image sensors of the world ``outside``.

They differ in full well, noise and black level, non-linearity, row noise and hot pixels.
"""

# Symbols:
#   e         electrons of a pixel: mean × gain (PRNU) + dark current × time, plus noise of variance e + read², plus row and DSNU
#   s         filling of the well, 0..1; the signal is e + 4 a well s (1 − s), a the nonlinearity
#   deviate   a standard normal number

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.camera_traits import CameraTraits

TABLE_BITS = 20
HOT_E_PER_S = (3.0, 6.0)
"""Range of the dark currents of hot pixels as powers of ten, uniform in the logarithm."""
OVERFLOW = 1.04
"""Capacity of a pixel in full wells."""


class SensorOfTraits:
    """One camera's sensor; its fixed pattern belongs to the seed."""

    def __init__(self, width_px: int, height_px: int, seed: int, noise: bool, traits: CameraTraits) -> None:
        """Draw the fixed pattern. Without ``noise`` there are only response and black level."""
        rng = np.random.default_rng([seed, 78])
        shape = (height_px, width_px)
        self._noise, self._traits = noise, traits
        scale = 1.0 if noise else 0.0
        self._gain = (1.0 + scale * traits.prnu * rng.standard_normal(shape, np.float32)).astype(np.float32)
        self._dark_e = (scale * traits.dsnu_e * rng.standard_normal(shape, np.float32)).astype(np.float32)
        self._table = rng.standard_normal(1 << TABLE_BITS, np.float32)
        self._hot_e_per_s = np.zeros(shape, np.float32)
        count = rng.binomial(width_px * height_px, traits.hot_per_million * 1e-6) if noise else 0
        hot_pixels = rng.choice(width_px * height_px, count, replace=False)
        self._hot_e_per_s.ravel()[hot_pixels] = 10.0 ** rng.uniform(*HOT_E_PER_S, count)

    def read_out(
        self, electrons: NDArray[np.float32], gain_db: float, seed: int, exposure_s: float = 0.0
    ) -> NDArray[np.uint8]:
        """Return grey values (h, w) uint8 of mean electrons (h, w) float32; ``seed``: of this frame's noise."""
        traits = self._traits
        rng = np.random.default_rng([seed, 78])
        offsets = np.asarray(rng.integers(0, 1 << TABLE_BITS, electrons.shape[0]))
        row_noise_e = traits.row_noise_e if self._noise else 0.0
        rows_e = np.asarray(row_noise_e * rng.standard_normal(electrons.shape[0]), np.float64)
        out = np.empty(electrons.shape, np.uint8)
        _read_out(
            electrons, self._gain, self._dark_e, self._hot_e_per_s, exposure_s, rows_e, self._table, offsets, self._noise,
            traits.read_noise_e, traits.full_well_e, traits.nonlinearity,
            10.0 ** (gain_db / 20.0) * 255.0 / traits.full_well_e, traits.black_dn, out,
        )  # fmt: skip
        return out


@numba.njit(nogil=True, cache=True)
def _read_out(
    electrons: NDArray[np.float32], gain: NDArray[np.float32], dark_e: NDArray[np.float32],
    hot_e_per_s: NDArray[np.float32], exposure_s: float, rows_e: NDArray[np.float64], table: NDArray[np.float32],
    offsets: NDArray[np.int64], noise: bool, read_e: float, well_e: float, nonlinearity: float, dn_per_e: float,
    black_dn: float, out: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Fill ``out`` (h, w) with the grey values of mean ``electrons`` (h, w)."""
    mask = table.size - 1
    for y in range(electrons.shape[0]):
        # Each row begins at a random place in a table of a million deviates, which is cheaper than drawing them.
        offset = offsets[y]
        for x in range(electrons.shape[1]):
            e = max(electrons[y, x] * gain[y, x], 0.0) + hot_e_per_s[y, x] * exposure_s
            if noise:
                # Photon noise as a Gaussian of variance e, since a Poisson number hardly differs at these levels.
                e += table[(offset + x) & mask] * np.sqrt(e + read_e * read_e) + rows_e[y]
            e = min(e + dark_e[y, x], OVERFLOW * well_e)
            # The response is a parabola through zero and the full well, with the largest deviation at half of it.
            s = min(max(e / well_e, 0.0), 1.0)
            e += 4.0 * nonlinearity * well_e * s * (1.0 - s)
            out[y, x] = np.uint8(min(max(e * dn_per_e + black_dn + 0.5, 0.0), 255.0))
