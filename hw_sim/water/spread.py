"""Owns what forward scattering of the world ``outside`` does to the projected light and to a camera's picture: a spike that is
not scattered, a core, and a halo as wide as the way is long (``particles.Transfer``), as one convolution.

The way is that to the middle of the volume for everything in the picture; how much is dimmed on it is each point's own.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hw_sim.optics.geometry import MIDDLE_MM
from hw_sim.water.medium import PX_MM
from hw_sim.water.particles import Particles, Transfer

Picture = NDArray[np.float32]

PROJECTOR_PX_MM = 0.255
"""Size of a projector px in the middle of the volume."""
DARK_BORDER, SEEN_BORDER = 0.25, 0.15
"""Borders around the light, which is dark there, and around a picture, which goes on there, as shares of their sizes: what the
halo throws out at one side must not come in at the other."""


class ForwardSpread:
    """Convolutions by the point spread of one way through the water; their sums grow by the light that was turned forwards."""

    def __init__(self, particles: Particles, attenuation_per_m: float) -> None:
        self._transfer = Transfer(particles, attenuation_per_m)

    @property
    def gain(self) -> float:
        """Factor of evenly spread light: all that arrives after one way, against what was not scattered."""
        return float(self._transfer(MIDDLE_MM, np.array(0.0)))

    def light(self, light: Picture) -> Picture:
        """Return projected light (h, w) as it arrives in the middle of the volume; around it is darkness."""
        return self._spread(light, PROJECTOR_PX_MM, DARK_BORDER, cv2.BORDER_CONSTANT)

    def picture(self, picture: Picture) -> Picture:
        """Return a camera's picture (h, w) of what is in the middle of the volume; around it the scene goes on as at its edge."""
        return self._spread(picture, PX_MM * 1600.0 / picture.shape[1], SEEN_BORDER, cv2.BORDER_REPLICATE)

    def _spread(self, image: Picture, px_mm: float, border: float, beyond: int) -> Picture:
        h, w = image.shape
        # Half of the border on each side; the spectrum takes both for neighbours.
        top, left = math.ceil(0.5 * border * h), math.ceil(0.5 * border * w)
        rows, columns = fast_length(h, border), fast_length(w, border)
        around = cv2.copyMakeBorder(image, top, rows - h - top, left, columns - w - left, beyond, value=0.0)
        fy, fx = np.abs(scipy.fft.fftfreq(rows, px_mm))[:, None], scipy.fft.rfftfreq(columns, px_mm)[None]
        factor = self._transfer(MIDDLE_MM, 2.0 * math.pi * np.hypot(fy, fx)).astype(np.float32)
        spread = scipy.fft.irfft2(scipy.fft.rfft2(np.asarray(around, np.float32)) * factor, (rows, columns))
        return np.asarray(spread[top : top + h, left : left + w], np.float32)


def fast_length(size: int, border: float) -> int:
    """Return a length that is quickly transformed, of at least ``size`` and a ``border`` (share of it) on both sides together."""
    return int(scipy.fft.next_fast_len(size + 2 * math.ceil(0.5 * border * size), real=True))
