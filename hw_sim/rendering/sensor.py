"""The image sensor: electrons with photon, read and fixed-pattern noise, gain, saturation, eight bits."""

# Symbols:
#   e         electrons of a pixel: mean × gain (PRNU), plus noise of variance e + READ_NOISE_E², plus dark signal (DSNU)
#   deviate   a standard normal number
# The model is that of EMVA 1288: DN = offset + K · electrons, K = 10^(gain/20 dB) / E_PER_DN.

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

FULL_WELL_E = 13_000.0
"""Electrons at 255 DN and 0 dB: photon noise of 1.58 DN at mid-scale."""
E_PER_DN = FULL_WELL_E / 255.0
READ_NOISE_E = 20.0
OFFSET_DN = 2.0
PRNU = 0.004
DSNU_E = 8.0
TABLE_BITS = 20


class Sensor:
    """One camera's sensor; its fixed pattern belongs to the seed."""

    def __init__(self, width_px: int, height_px: int, seed: int, noise: bool) -> None:
        rng = np.random.default_rng([seed, 77])
        shape = (height_px, width_px)
        self.noise = noise
        scale = 1.0 if noise else 0.0
        self._gain = (1.0 + scale * PRNU * rng.standard_normal(shape, np.float32)).astype(np.float32)
        self._dark_e = (scale * DSNU_E * rng.standard_normal(shape, np.float32)).astype(np.float32)
        self._table = rng.standard_normal(1 << TABLE_BITS, np.float32)

    def read_out(self, electrons: NDArray[np.float32], gain_db: float, seed: int) -> NDArray[np.uint8]:
        """Return grey values (h, w) uint8 of mean electrons (h, w) float32; ``seed``: of this frame's noise."""
        offsets = np.asarray(np.random.default_rng(seed).integers(0, 1 << TABLE_BITS, electrons.shape[0]))
        out = np.empty(electrons.shape, np.uint8)
        dn_per_e = 10.0 ** (gain_db / 20.0) / E_PER_DN
        _read_out(electrons, self._gain, self._dark_e, self._table, offsets, dn_per_e, self.noise, out)
        return out


@numba.njit(nogil=True, cache=True)
def _read_out(
    electrons: NDArray[np.float32],
    gain: NDArray[np.float32],
    dark_e: NDArray[np.float32],
    table: NDArray[np.float32],
    offsets: NDArray[np.int64],
    dn_per_e: float,
    noise: bool,
    out: NDArray[np.uint8],
) -> None:
    """Fill ``out`` (h, w) with the grey values of mean ``electrons`` (h, w)."""
    mask = np.uint32(table.size - 1)
    for y in range(electrons.shape[0]):
        # Each row begins at a random place in a table of a million deviates, which is cheaper than drawing them.
        offset = np.uint32(offsets[y])
        for x in range(electrons.shape[1]):
            e = max(electrons[y, x] * gain[y, x], np.float32(0.0))
            if noise:
                # Photon noise as a Gaussian of variance e, since a Poisson number hardly differs at these levels.
                deviate = table[(offset + np.uint32(x)) & mask]
                e += deviate * np.sqrt(e + np.float32(READ_NOISE_E * READ_NOISE_E))
            # The well is full a little above 255 DN at 0 dB.
            e = min(e + dark_e[y, x], np.float32(FULL_WELL_E * 1.05))
            value = e * np.float32(dn_per_e) + np.float32(OFFSET_DN)
            out[y, x] = np.uint8(min(max(value + np.float32(0.5), np.float32(0.0)), np.float32(255.0)))
