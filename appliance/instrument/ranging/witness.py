"""Owns the proof from images that no laser shone in a sequence: its dark frame has no dot that its bright one does not
explain.

What prints and pebbles reflect of ambient light looks like a dot too. But then the projector's light makes it brighter
still, in the ratio of both lights, which the surroundings tell; a laser's dot stays as bright as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.measure import Dot, Images, Ranger

SURELY_A_DOT_DN = 15.0
"""Contrast of a dot that counts as evidence."""
EXPLAINED = 3.0
"""A dot is print where projected light would make so much of its contrast at this ratio of the lights."""
AROUND_PX = 10
"""Half width of the surroundings, px of an image 400 px wide."""


def shines_in_the_dark(ranger: Ranger, bright: Images, dark: Images) -> tuple[str, ...]:
    """Return ``left`` and ``right`` pointer, as far as their dots are in both cameras' dark frames (h, w) uint8;
    ``bright`` are the same views in full light."""
    dots = ranger.find(dark)
    return tuple(
        side
        for side, dot in (("left", dots.left), ("right", dots.right))
        if dot is not None
        and dot.cameras == 2
        and dot.contrast_dn >= SURELY_A_DOT_DN
        and not _print_explains(ranger, dot, bright, dark)
    )


def _print_explains(ranger: Ranger, dot: Dot, bright: Images, dark: Images) -> bool:
    """Tell whether the dot is what ambient light makes of a print, in the camera where the projector's light is least
    saturated."""
    for number, (lit, unlit) in enumerate(zip(bright, dark, strict=True)):
        u, v = ranger.pixel_of(number, dot)
        step = max(1, lit.shape[1] // 400)
        row, column, half = round(v), round(u), AROUND_PX * step
        part = np.s_[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
        a, b = lit[part].astype(np.float64), unlit[part].astype(np.float64)
        if a.size == 0 or np.mean(a >= 255.0) > 0.1:
            continue
        height_lit, height_dark = _height(a, step), _height(b, step)
        ratio = max(float(np.median(b)), 1.0) / max(float(np.median(a - b)), 1.0)
        if height_dark <= EXPLAINED * max(height_lit - height_dark, 0.0) * ratio:
            return True
    return False


def _height(part: NDArray[np.float64], step: int) -> float:
    """Return how much brighter the middle is than the surroundings."""
    y, x = part.shape[0] // 2, part.shape[1] // 2
    return float(part[y - step : y + step + 1, x - step : x + step + 1].mean() - np.median(part))
