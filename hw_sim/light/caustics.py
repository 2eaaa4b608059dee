"""Caustics: the net of bright lines by sunlight that a random water surface refracts.

Each ray of an even beam is displaced by the slope of the waves above it; where neighbours are displaced towards each
other, light gathers. No light is lost: the net's mean is 1. The waves are band-limited around one length, run in all
directions, and disperse as in deep water (frequency ∝ root of the wave number). The net is periodic in a tile.
"""

# Symbols:
#   k         wave number in cycles per tile, kx and ky its parts; height the waves' spectrum; slopes i k height
#   omega     angular frequency of each wave, rad/s
#   dx, dy    displacement of each ray, cells; a, b its target, i, j the integer and s, t the fractional part of it

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

CELLS = 256
MESHES = 6
"""Side of the tile in units of the net's mesh."""
GATHERING = 1.0
"""Rms of the relative change of the area between neighbouring rays: at −1 they cross."""
SUN_CELLS = 1.2
"""Blur of the net by the size of the sun (Gaussian sigma)."""


class Net:
    """The waves of one seed."""

    def __init__(self, scale_mm: float, speed_mm_s: float, seed: int) -> None:
        self.tile_mm = MESHES * scale_mm
        rng = np.random.default_rng([seed, 200])
        cycles = np.fft.fftfreq(CELLS, 1.0 / CELLS)
        kx, ky = cycles[None, :], cycles[:, None]
        k = np.hypot(kx, ky)
        # One band of wave numbers around the mesh; with heights ∝ 1/k² all of them focus equally.
        band = np.where(np.abs(k / MESHES - 1.25) < 1.0, np.exp(-(((k / MESHES - 1.25) / 0.5) ** 2)), 0.0)
        height = band / np.maximum(k, 1.0) ** 2 * np.exp(2j * math.pi * rng.uniform(size=k.shape))
        radians = 2.0 * math.pi / CELLS
        # Parseval: rms of the Laplacian, which is the change of area between neighbouring rays.
        gathering = math.sqrt(0.5 * float(np.sum(np.abs(height) ** 2 * (radians * k) ** 4)))
        height *= GATHERING / gathering * CELLS**2
        self._slopes = (1j * radians * kx * height, 1j * radians * ky * height)
        # Deep water: ω = √(g k); here scaled so that a wave of one mesh runs at the given speed.
        self._omega = 2.0 * math.pi * speed_mm_s / self.tile_mm * np.sqrt(k * MESHES)

    def light(self, clock_s: float) -> NDArray[np.float32]:
        """Return the net at a time: (CELLS, CELLS) float32 with mean 1; row and column repeat after ``tile_mm``."""
        turned = np.exp(-1j * self._omega * clock_s)
        dx, dy = (np.fft.ifft2(slope * turned).real.astype(np.float32) for slope in self._slopes)
        net = np.zeros((CELLS, CELLS), np.float32)
        _gather(dx, dy, net)
        edge = math.ceil(4.0 * SUN_CELLS)
        soft = cv2.GaussianBlur(np.pad(net, edge, mode="wrap"), (0, 0), SUN_CELLS)
        return np.ascontiguousarray(soft[edge:-edge, edge:-edge], np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _gather(dx: NDArray[np.float32], dy: NDArray[np.float32], net: NDArray[np.float32]) -> None:
    """Add the light of each cell at its displaced place, shared by the four cells around it."""
    rows, columns = net.shape
    for y in range(rows):
        for x in range(columns):
            a, b = x + dx[y, x], y + dy[y, x]
            i, j = math.floor(a), math.floor(b)
            s, t = a - i, b - j
            i0, j0 = i % columns, j % rows
            i1, j1 = (i0 + 1) % columns, (j0 + 1) % rows
            net[j0, i0] += (1.0 - s) * (1.0 - t)
            net[j0, i1] += s * (1.0 - t)
            net[j1, i0] += (1.0 - s) * t
            net[j1, i1] += s * t
