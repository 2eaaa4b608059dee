"""Owns albedo: how light or dark an object is at each of its points, fixed to the object."""

from __future__ import annotations

import math

import numba

NONE, SLIGHT, STRONG = range(3)
NAMES = {"none": NONE, "slight": SLIGHT, "strong": STRONG}
MEAN_ALBEDO = 0.6


@numba.njit(nogil=True, cache=True)
def albedo(texture: int, x: float, y: float, z: float) -> float:
    """Diffuse albedo 0..1 at a point of the object's frame."""
    if texture == 0:
        return 0.6
    wave = (
        math.sin(0.31 * x + 0.12 * y + 0.2 * z)
        + math.sin(-0.17 * x + 0.29 * y + 0.11 * z + 1.3)
        + math.sin(0.09 * x - 0.07 * y + 0.33 * z + 2.1)
        + 0.7 * math.sin(0.83 * x + 0.41 * y + 0.2)
        + 0.7 * math.sin(-0.52 * x + 0.77 * y + 0.37 * z + 4.0)
        + 0.5 * math.sin(1.9 * x - 1.3 * y + 0.9 * z)
    ) / 4.9
    if texture == 1:
        return 0.6 * (1.0 + 0.18 * wave)
    # Strong: blotches with sharp edges on top of the waves, as growth and paint have.
    blotch = math.sin(0.21 * x + 1.1 * math.sin(0.17 * y)) * math.sin(0.19 * y + 1.3 * math.sin(0.13 * x + 0.1 * z))
    base = 0.32 if blotch > 0.15 else 0.68
    return base * (1.0 + 0.25 * wave)
