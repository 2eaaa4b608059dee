"""The response of an exposure: it must be straight, rising, and the same each time.

Only the light within the exposure counts for the sine that a code makes. Where the exposure cuts bit planes, some codes
are darker than lower ones; a gamma bends the response, which is then smooth and still no sine.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

STRAIGHT = 0.01
"""Largest RMS distance from a straight line, as a share of white."""
MOST_OFF = 0.01
"""Largest distance of a single code from the line, beyond the difference of passes."""
REPEATS = 0.01
"""Largest RMS difference of two passes."""
FALLS_SIGMAS, FALLS = 4.0, 0.002
"""A code may be darker than a lower one by so many standard deviations of the difference of passes, or by this share if
that is more."""
SMOOTH, SMOOTH_DEGREE = 0.006, 4
"""RMS distance from a polynomial of this degree, or from a power, below which a response is one smooth curve."""
LEAST_POWER, MOST_POWER = 0.7, 1.5
"""Exponents between which a smooth response counts as that of the lamp and its optics; others count as
a gamma setting.
"""
LEAST_LIGHT_DN = 8.0
RAMP_CODES = 62
"""Number of codes in a take: with an extra white and black frame it is full."""


class Shape(Enum):
    """Kinds of response."""

    STRAIGHT = "straight"
    CURVED = "curved"
    """Smooth and rising, no gamma: each scan corrects it."""
    GAMMA = "gamma"
    BIT_PLANES = "bit planes"
    """Steps that no smooth curve explains: some bits are exposed longer than others."""
    RESTLESS = "restless"
    """It differs from pass to pass."""
    DARK = "dark"


@dataclass(frozen=True, slots=True)
class ResponseShape:
    """A response as it was measured twice."""

    shape: Shape
    line_rms: float
    """RMS distance from the straight line through it, share of white."""
    line_most: float
    repeat_rms: float
    """RMS difference of the two passes."""
    falls: float
    """Largest fall from a code to any higher one, share of white; 0 where it never falls."""
    power: float
    """Exponent of the power of the code that fits best."""
    light_dn: float
    """White over black, grey values."""

    @property
    def usable(self) -> bool:
        """True where fringes are sines, or each scan corrects their response."""
        return self.shape in (Shape.STRAIGHT, Shape.CURVED)


def judge_response(
    codes: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> ResponseShape:
    """Judge the grey values (n,) of two passes over the same ``codes`` (n,), which contain 0 and 255."""
    order = np.argsort(codes)
    x = codes[order] / 255.0
    passes = [grey[order] for grey in (first, second)]
    light_dn = float(np.mean([grey[-1] - grey[0] for grey in passes]))
    if light_dn < LEAST_LIGHT_DN:
        return ResponseShape(Shape.DARK, 1.0, 1.0, 0.0, 0.0, 1.0, light_dn)
    # Each pass relative to its own ends, so that a lamp that grew warmer between them does not count.
    shares = [(grey - grey[0]) / (grey[-1] - grey[0]) for grey in passes]
    mean = (shares[0] + shares[1]) / 2.0
    repeat_rms = float(np.sqrt(np.mean((shares[0] - shares[1]) ** 2)))
    off = mean - np.polyval(np.polyfit(x, mean, 1), x)
    line_rms, line_most = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
    # Against the highest value so far, not the previous one: many small falls add up.
    falls = float((np.maximum.accumulate(mean) - mean).max())
    power = _power(x, mean)
    smooth_rms = float(np.sqrt(np.mean((mean - np.polyval(np.polyfit(x, mean, SMOOTH_DEGREE), x)) ** 2)))
    power_rms = float(np.sqrt(np.mean((mean - x**power) ** 2)))
    rising = falls <= max(FALLS, FALLS_SIGMAS * repeat_rms / 2.0)
    if repeat_rms > REPEATS:
        shape = Shape.RESTLESS
    elif rising and line_rms < STRAIGHT and line_most < MOST_OFF + 1.5 * repeat_rms:
        shape = Shape.STRAIGHT
    elif not rising or min(smooth_rms, power_rms) > SMOOTH:
        shape = Shape.BIT_PLANES
    else:
        shape = Shape.CURVED if LEAST_POWER <= power <= MOST_POWER else Shape.GAMMA
    return ResponseShape(shape, line_rms, line_most, repeat_rms, falls, power, light_dn)


def ramp_codes(count: int) -> NDArray[np.int64]:
    """Return ``count`` different codes with 0 and 255.

    Half of them are pairs on both sides of a step of the upper bits.
    """
    pairs = [(k, k - 1) for k in range(16, 256, 16)]
    codes = {0, 255} | {code for pair in pairs for code in pair}
    spare = [int(c) for c in np.linspace(4, 251, 4 * count)]
    for code in spare[:: max(1, len(spare) // count)]:
        if len(codes) < count:
            codes.add(code)
    return np.array(sorted(codes)[:count] if len(codes) <= count else sorted(codes), np.int64)


def shuffled_indices(count: int, seed: int) -> NDArray[np.int64]:
    """Return the numbers 0 … count − 1 in a fixed random order.

    Neighbours in time must not be neighbours in grey: an exposure that sees two pictures at once would pass for a
    straight one.
    """
    return np.random.default_rng(seed).permutation(count)


def _power(x: NDArray[np.float64], share: NDArray[np.float64]) -> float:
    """Return the exponent g that brings x**g closest to the response, to a hundredth."""
    powers = np.linspace(0.3, 4.0, 371)
    off = (x[None, :] ** powers[:, None] - share[None, :]) ** 2
    return float(powers[int(off.mean(axis=1).argmin())])
