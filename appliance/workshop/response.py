"""Owns the judgement whether an exposure sees grey as it was drawn: straight, rising, and the same each time.

Of the sine that a code makes only what the exposure lets through is light. Where it cuts bit planes, some codes come
out darker than lower ones; where a gamma bends it, all of it is smooth and still no sine.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

STRAIGHT = 0.01
"""Largest RMS distance from a straight line, as a share of white."""
MOST_OFF = 0.01
"""Largest distance of a single code from it, beyond what passes differ by."""
REPEATS = 0.01
"""Largest RMS difference of two passes."""
FALLS_SIGMAS, FALLS = 4.0, 0.002
"""A code may come out darker than a lower one by so many standard deviations of what passes differ by, and never less
than this share."""
SMOOTH, SMOOTH_DEGREE = 0.006, 4
"""RMS distance from a polynomial of this degree, or from a power, below which a response is one smooth curve."""
LEAST_POWER, MOST_POWER = 0.7, 1.5
"""Exponents between which a smooth response may be called that of the lamp and its optics; others are a gamma that
somebody set."""
LEAST_LIGHT_DN = 8.0
RAMP_CODES = 62
"""Number of codes in a take: with white and black of its own, as many frames as it may have."""


class Shape(Enum):
    """Kinds of response."""

    STRAIGHT = "straight"
    CURVED = "curved"
    """Smooth and rising, no gamma: each scan straightens what it bends."""
    GAMMA = "gamma"
    BIT_PLANES = "bit planes"
    """Steps that no curve explains: some bits are seen longer than others."""
    RESTLESS = "restless"
    """Another one each time."""
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
        """True where fringes can be sines, or are straightened by each scan."""
        return self.shape in (Shape.STRAIGHT, Shape.CURVED)


def judge_response(
    codes: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> ResponseShape:
    """Judge the grey values (n,) of two passes over the same ``codes`` (n,), which contain 0 and 255."""
    order = np.argsort(codes)
    x = codes[order] / 255.0
    passes = [one[order] for one in (first, second)]
    light_dn = float(np.mean([one[-1] - one[0] for one in passes]))
    if light_dn < LEAST_LIGHT_DN:
        return ResponseShape(Shape.DARK, 1.0, 1.0, 0.0, 0.0, 1.0, light_dn)
    # Each pass by its own straight line's ends: a lamp that grew warmer between them is as bright a sine.
    shares = [(one - one[0]) / (one[-1] - one[0]) for one in passes]
    mean = (shares[0] + shares[1]) / 2.0
    repeat_rms = float(np.sqrt(np.mean((shares[0] - shares[1]) ** 2)))
    off = mean - np.polyval(np.polyfit(x, mean, 1), x)
    line_rms, line_most = float(np.sqrt(np.mean(off**2))), float(np.abs(off).max())
    # Against the highest code so far, not the last one: many small falls are one.
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
    """Return ``count`` different codes, 0 and 255 among them, half of them pairs on both sides of a step of the upper
    bits."""
    pairs = [(k, k - 1) for k in range(16, 256, 16)]
    wanted = {0, 255} | {code for pair in pairs for code in pair}
    spare = [int(c) for c in np.linspace(4, 251, 4 * count)]
    for code in spare[:: max(1, len(spare) // count)]:
        if len(wanted) < count:
            wanted.add(code)
    return np.array(sorted(wanted)[:count] if len(wanted) <= count else sorted(wanted), np.int64)


def shuffled(count: int, seed: int) -> NDArray[np.int64]:
    """Return the numbers 0 … count − 1 in a fixed disorder: neighbours in time must not be neighbours in grey, or an
    exposure that sees two pictures at once would pass for a straight one."""
    return np.random.default_rng(seed).permutation(count)


def _power(x: NDArray[np.float64], share: NDArray[np.float64]) -> float:
    """Return the exponent g that brings x**g closest to the response, to a hundredth."""
    powers = np.linspace(0.3, 4.0, 371)
    off = (x[None, :] ** powers[:, None] - share[None, :]) ** 2
    return float(powers[int(off.mean(axis=1).argmin())])
