"""Albedo and texture of the objects, fixed to the object."""

# Symbols:
#   i, j, k   cell of the lattice, modulo 64; s, t, r place within it, 0..1, eased
#   u, v, w   the object's point in rotated axes, mm

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

NONE, SLIGHT, STRONG, CHECKER, LABELS = range(5)
NAMES = {"none": NONE, "slight": SLIGHT, "strong": STRONG, "checker": CHECKER, "labels": LABELS}
MEAN_ALBEDO = 0.6
CHECKER_MM, CHECKER_BORDER_MM = 10.0, 0.15
"""Side of a printed square, and the width of its border: one pixel of 1600, the limit of the sampling."""
CHECKER_ALBEDOS = (0.15, 0.70)
LABELS_ALBEDOS = (0.03, 0.85)
"""White labels on black rubber, of the checker's size: a range beyond one exposure."""
LATTICE = 64
"""Period of the noise in cells."""


def noise_lattice() -> NDArray[np.float32]:
    """Return constant random values −1..1 at the lattice points of ``albedo``: (LATTICE,)*3 float32."""
    return np.random.default_rng(64).uniform(-1.0, 1.0, (LATTICE, LATTICE, LATTICE)).astype(np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _noise(lattice: NDArray[np.float32], x: float, y: float, z: float) -> float:
    """Return smooth noise −1..1 with cells of size 1: trilinear between lattice points, eased."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    s, t, r = x - fx, y - fy, z - fz
    # Ease with 3s² − 2s³, whose slope is 0 at both ends: no creases between cells (Perlin 1985).
    s, t, r = s * s * (3.0 - 2.0 * s), t * t * (3.0 - 2.0 * t), r * r * (3.0 - 2.0 * r)
    i, j, k = int(fx) & 63, int(fy) & 63, int(fz) & 63
    i1, j1, k1 = (i + 1) & 63, (j + 1) & 63, (k + 1) & 63
    # Trilinear: along x at the four edges, then along y, then along z.
    a = lattice[k, j, i] + s * (lattice[k, j, i1] - lattice[k, j, i])
    b = lattice[k, j1, i] + s * (lattice[k, j1, i1] - lattice[k, j1, i])
    c = lattice[k1, j, i] + s * (lattice[k1, j, i1] - lattice[k1, j, i])
    d = lattice[k1, j1, i] + s * (lattice[k1, j1, i1] - lattice[k1, j1, i])
    a, c = a + t * (b - a), c + t * (d - c)
    return float(a + r * (c - a))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _stripe(x: float) -> float:
    """Return 1 and −1 alternately, CHECKER_MM each, with a straight border between them."""
    to_border = (
        0.5 * CHECKER_MM - abs((x / (2.0 * CHECKER_MM) - math.floor(x / (2.0 * CHECKER_MM))) * 2.0 - 1.0) * CHECKER_MM
    )
    return min(max(to_border / (0.5 * CHECKER_BORDER_MM), -1.0), 1.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def albedo(texture: int, lattice: NDArray[np.float32], x: float, y: float, z: float) -> float:
    """Return the diffuse albedo 0..1 at a point of the object's frame, mm."""
    if texture == NONE:
        return MEAN_ALBEDO
    if texture in (CHECKER, LABELS):
        dark, bright = CHECKER_ALBEDOS if texture == CHECKER else LABELS_ALBEDOS
        return dark + (bright - dark) * (0.5 + 0.5 * _stripe(x) * _stripe(y))
    # Clouds of 23 mm, stains of 7 mm, grain of 2 mm; the axes are rotated so that no face shows the lattice.
    u, v, w = 0.80 * x + 0.36 * y + 0.48 * z, -0.60 * x + 0.48 * y + 0.64 * z, -0.80 * y + 0.60 * z
    clouds = _noise(lattice, u / 23.0, v / 23.0, w / 23.0)
    stains = _noise(lattice, v / 7.0 + 11.0, w / 7.0, u / 7.0)
    grain = _noise(lattice, w / 2.1, u / 2.1, v / 2.1 + 5.0)
    if texture == SLIGHT:
        return MEAN_ALBEDO * (1.0 + 0.14 * clouds + 0.10 * stains + 0.06 * grain)
    # Growth and paint: dark patches with borders of a third of a millimetre on a stained ground.
    patch = min(max(0.5 + 40.0 * (clouds + 0.5 * stains - 0.15) / 2.0, 0.0), 1.0)
    return (0.70 - 0.42 * patch) * (1.0 + 0.20 * stains + 0.16 * grain)
