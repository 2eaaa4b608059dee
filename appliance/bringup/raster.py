"""Owns the judgement whether a projector shows its picture pixel by pixel: each single line must be as bright as its neighbours.

A picture that is scaled to another raster gives some lines more of the panel's pixels than others, with the period at which the two
rasters meet (beating). Lines are judged by all of their light, so that it does not matter whether a camera resolves them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LINES = 24
"""Lines next to each other, in either direction: they beat at least once where sizes differ by a twenty-fourth."""
MOST_BEATING = 0.03
"""Largest RMS difference of lines from a smooth course."""
OVER_NOISE = 3.0
"""And so many times what two passes differ by."""
MOST_NOISE = 0.05


@dataclass(frozen=True, slots=True)
class LineLight:
    """Lines of one direction, compared."""

    beating: float
    """RMS difference from a smooth course, share of a line's light."""
    noise: float
    """RMS difference of two passes from their mean."""

    @property
    def told(self) -> bool:
        """True where there was light enough to tell."""
        return self.noise <= MOST_NOISE

    @property
    def scaled(self) -> bool:
        """True where lines differ: the picture was scaled."""
        return self.told and self.beating > max(MOST_BEATING, OVER_NOISE * self.noise)


def compare_lines(first: NDArray[np.float64], second: NDArray[np.float64]) -> LineLight:
    """Compare the light of neighbouring lines in two passes, each (n,)."""
    mean = (first + second) / 2.0
    x = np.linspace(-1.0, 1.0, len(mean))
    # The lens and the scene make a slow course, which a parabola follows; what beats does not.
    smooth = np.polyval(np.polyfit(x, mean, 2), x)
    # Relative to the mean line: how bright lines are is the exposure's business.
    scale = max(float(np.abs(smooth).mean()), 1e-9)
    # Two passes differ by twice the noise of their mean, in squares by four times.
    noise = float(np.sqrt(np.mean(((first - second) / 2.0) ** 2))) / scale
    beating = float(np.sqrt(np.mean((mean - smooth) ** 2))) / scale
    return LineLight(float(np.sqrt(max(0.0, beating**2 - noise**2))), noise)


def line_pictures(size_px: tuple[int, int], rows: bool) -> list[NDArray[np.uint8]]:
    """Return ``LINES`` pictures (h, w), each with one bright column, or row, of the middle."""
    width, height = size_px
    pictures = []
    for k in range(LINES):
        picture = np.zeros((height, width), np.uint8)
        if rows:
            picture[(height - LINES) // 2 + k] = 255
        else:
            picture[:, (width - LINES) // 2 + k] = 255
        pictures.append(picture)
    return pictures


def checker(size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a checker of single pixels (h, w), for a person's eyes: it must look grey, without bars or grids in it."""
    width, height = size_px
    return ((np.add.outer(np.arange(height), np.arange(width)) % 2) * 255).astype(np.uint8)
