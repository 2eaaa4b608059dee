"""Forward scattering of the world ``outside`` in the projected light and in a camera's image.

It is one convolution: an unscattered spike, a core, and a halo whose width grows with the path
(``particles.Transfer``). The path is that to the middle of the volume for the whole image; the attenuation on it is
each point's own.
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
"""Borders, as shares of the size, around the light (dark there) and around an image (continued there), so that the halo
does not wrap around."""


class ForwardSpread:
    """Convolutions by the point spread of one path through the water; sums grow by forward scattering."""

    def __init__(self, particles: Particles, attenuation_per_m: float) -> None:
        self._transfer = Transfer(particles, attenuation_per_m)

    @property
    def gain(self) -> float:
        """Factor of uniform light: all light that arrives after one path over the unscattered light."""
        return float(self._transfer(MIDDLE_MM, np.array(0.0)))

    def light(self, light: Picture) -> Picture:
        """Return projected light (h, w) in the middle of the volume; it is dark around it."""
        return self._spread(light, PROJECTOR_PX_MM, DARK_BORDER, cv2.BORDER_CONSTANT)

    def picture(self, picture: Picture) -> Picture:
        """Return a camera's image (h, w) of the middle of the volume; its edges continue outside."""
        return self._spread(picture, PX_MM * 1600.0 / picture.shape[1], SEEN_BORDER, cv2.BORDER_REPLICATE)

    def _spread(self, image: Picture, px_mm: float, border: float, beyond: int) -> Picture:
        h, w = image.shape
        # Half of the border on each side; they are neighbours for the spectrum.
        top, left = math.ceil(0.5 * border * h), math.ceil(0.5 * border * w)
        rows, columns = fast_length(h, border), fast_length(w, border)
        around = cv2.copyMakeBorder(image, top, rows - h - top, left, columns - w - left, beyond, value=0.0)
        fy, fx = np.abs(scipy.fft.fftfreq(rows, px_mm))[:, None], scipy.fft.rfftfreq(columns, px_mm)[None]
        factor = self._transfer(MIDDLE_MM, 2.0 * math.pi * np.hypot(fy, fx)).astype(np.float32)
        spread = scipy.fft.irfft2(scipy.fft.rfft2(np.asarray(around, np.float32)) * factor, (rows, columns))
        return np.asarray(spread[top : top + h, left : left + w], np.float32)


def fast_length(size: int, border: float) -> int:
    """Return a length with a fast transform that holds ``size`` and a total ``border`` (share of it)."""
    return int(scipy.fft.next_fast_len(size + 2 * math.ceil(0.5 * border * size), real=True))
