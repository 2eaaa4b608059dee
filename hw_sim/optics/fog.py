"""A place on a port that is fogged or scratched, and its effect on the camera's image.

Droplets and scratches scatter light: the light through the place is partly a glow of its surroundings; fine detail is
lost first and mean light last. The port is 18 mm before a pupil of 1.44 mm (11.5 mm at f/8), so that the place has no
sharp border: it is blurred over 1.44 / 18 of the focal length, 130 px of 1600.
"""

# Symbols in over:
#   u, v      column and row of a pixel; away_px its distance outside of the place's border
#   thrown    share of light that the place scatters in its middle; share the same at a pixel

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float32]

GLOW_PX = 220.0
"""Gaussian sigma, px of 1600, of the scattered light: some 5 degrees, as by droplets of a hundredth of a mm."""
BORDER_PX = 33.0
"""The same of the border: a disc of 130 px, a quarter of it as sigma."""
KEPT = 0.9
"""Share of the scattered light that still reaches the image."""
SHRINK = 8
"""Factor by which the image is reduced to compute the smooth glow."""


@dataclass(frozen=True, slots=True)
class Fog:
    """One place on a port, or on both. Off by default. Raises ValueError for impossible values."""

    left: float = 0.0
    """Share of the light that the place on the left camera's port scatters, 0..1."""
    right: float = 0.0
    x: float = 0.3
    """Middle of the place, in widths of the image from its left border."""
    y: float = 0.4
    """The same from the top, in heights."""
    radius: float = 0.12
    """Radius of the place, in widths of the image; 2 covers all of it."""

    def __post_init__(self) -> None:
        for name, highest in (("left", 1.0), ("right", 1.0), ("x", 1.0), ("y", 1.0), ("radius", 2.0)):
            value = getattr(self, name)
            if not 0.0 <= value <= highest:
                raise ValueError(f"fog: {name} = {value}; allowed are 0..{highest:g}")

    def over(self, camera: str, picture: Picture) -> Picture:
        """Return the image (h, w) float32, electrons, of ``left`` or ``right`` through its port."""
        thrown = self.left if camera == "left" else self.right
        if thrown == 0.0:
            return picture
        h, w = picture.shape
        scale = w / 1600.0
        # The glow: scattered light comes from a wide surrounding, so it is blurred on a reduced image.
        small = cv2.resize(picture, (math.ceil(w / SHRINK), math.ceil(h / SHRINK)), interpolation=cv2.INTER_AREA)
        soft = cv2.GaussianBlur(small, (0, 0), GLOW_PX * scale / SHRINK, borderType=cv2.BORDER_REFLECT)
        glow = cv2.resize(soft, (w, h), interpolation=cv2.INTER_LINEAR)
        v, u = np.mgrid[:h, :w].astype(np.float32)
        # A disc convolved with a smooth border, approximated by a tanh of the same width.
        away_px = np.hypot(u - self.x * w, v - self.y * h) - self.radius * w
        inside = 0.5 * (1.0 - np.tanh(away_px / (1.5 * BORDER_PX * scale)))
        # (1 − share) of the light goes straight; of the share, KEPT returns as glow.
        share = np.asarray(thrown * inside, np.float32)
        return np.asarray(picture + share * (np.float32(KEPT) * glow - picture), np.float32)
