"""Owns the stripes' numbers: bits of a pixel from the images of a code, and the number that they write.

A bit is set where the image is brighter than its inverse; without inverses, brighter than the middle between bright and dark; without
these, brighter than the mean of the sines; without any of them, brighter than the middle between the pixel's darkest and brightest
image of the code.

Stripes finer than the camera's pixels tell nothing, and their images are left out: a Gray code without its finest image numbers stripes
of twice the width. What was left out is said.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.description import AxisConvention
from appliance.foreign.images import ImageSet
from appliance.foreign.order import Shows

Floats = NDArray[np.float32]

SAMPLED = 3
"""Every so many pixels are asked whether the camera resolves an image."""
LIT = 0.2
"""Largest difference of a pixel that is asked, over that of the brightest ones."""
TOLD, LEAST_TOLD = 0.25, 0.7
"""Stripes as wide as a pixel leave a quarter of all pixels below a quarter of the full difference, and finer ones ever more: an image
is resolved where at least so many pixels reach it."""
LEAST_BITS = 3
NEARLY_FULL = 0.8
"""Share of the full difference that the two pixels beside a border's own have at least where no other border is near."""


class Threshold(Enum):
    """References that tell a bright stripe from a dark one."""

    INVERSE = "the inverse image"
    REFERENCES = "the middle between bright and dark"
    SINES = "the mean of the sines"
    RANGE = "the middle between the darkest and the brightest image of the code"


@dataclass(frozen=True, slots=True, eq=False)
class CodeBits:
    """The bits of one direction that the camera can tell."""

    bits: NDArray[np.bool_]
    """(n, h, w) in the order of the images: the stripe is bright. Images at either end that the camera cannot resolve are left out."""
    contrast: Floats
    """(h, w): the swing that all but a quarter of the bits reach, in grey values; that of the references or the range without inverses."""
    threshold: Threshold
    left_out: tuple[int, int]
    """Number of images that were left out at the beginning and at the end, because their stripes are finer than the camera's pixels."""
    borders: Floats | None = None
    """Place between two neighbours along the direction, 0 … 1, at which a bit turns: (h, w − 1), of y (w, h − 1); NaN where none does.
    ``None`` where fringes make the coordinate."""


def read_bits(images: ImageSet, axis: AxisConvention, sine_mean: Floats | None) -> CodeBits:
    """Return the bits of a direction; ``sine_mean`` (h, w) is the mean of its sines, ``None`` where it has none."""
    gray = [images.image(Shows.GRAY, axis.name, k) for k in range(axis.bits)]
    bright, dark = images.image(Shows.BRIGHT), images.image(Shows.DARK)
    stack = np.stack([one for one in gray if one is not None]).astype(np.float32)
    contrast: Floats | None = None
    if axis.inverses:
        inverse = [images.image(Shows.INVERSE, axis.name, k) for k in range(axis.bits)]
        stack -= np.stack([one for one in inverse if one is not None])
        kind = Threshold.INVERSE
    elif bright is not None and dark is not None:
        kind, contrast = Threshold.REFERENCES, bright.astype(np.float32) - dark
        stack -= np.float32(0.5) * (bright.astype(np.float32) + dark)
    elif sine_mean is not None:
        stack -= sine_mean
        kind = Threshold.SINES
    else:
        low, high = stack.min(axis=0), stack.max(axis=0)
        kind, contrast = Threshold.RANGE, high - low
        stack -= np.float32(0.5) * (low + high)
    left_out = _unresolved(stack)
    stack = stack[left_out[0] : len(stack) - left_out[1]]
    if contrast is None:
        # One bit, and of narrow stripes two, may be in the middle of turning: the others tell how much light there is.
        swing = np.partition(np.abs(stack), len(stack) // 4, axis=0)[len(stack) // 4]
        contrast = swing if kind is Threshold.INVERSE else np.float32(2.0) * swing
    borders = _borders(stack, axis.name == "y") if sine_mean is None else None
    return CodeBits(stack > 0.0, np.asarray(contrast, np.float32), kind, left_out, borders)


def _unresolved(signed: Floats) -> tuple[int, int]:
    """Return how many images at the beginning and at the end have stripes that the camera cannot tell: signed differences (n, h, w)
    from the threshold that are small against the pixel's largest one at too many pixels."""
    few = np.abs(signed[:, ::SAMPLED, ::SAMPLED]).reshape(len(signed), -1)
    largest = few.max(axis=0)
    lit = largest > LIT * float(np.quantile(largest, 0.95))
    if not lit.any():
        return 0, 0
    told = np.mean(few[:, lit] > TOLD * largest[lit], axis=1) >= LEAST_TOLD
    if np.count_nonzero(told) < LEAST_BITS:
        return 0, 0  # This is no matter of fineness.
    first = int(np.argmax(told))
    last = int(np.argmax(told[::-1]))
    return first, last


def _borders(signed: Floats, turned: bool) -> Floats:
    """Return where bits turn between neighbours, from signed differences (n, h, w); several that do are averaged.

    A pixel is the mean over its area: with t the difference over the full one, 1 before the border and −1 behind it, the sum of t over
    pixels on both sides is twice the distance of the border from their middle. Two pixels are asked, and four where two on either
    side are nearly full: what a lens blurs beyond two of them counts then, and another border does not.
    """
    full = np.maximum(np.abs(signed).max(axis=0), np.float32(1e-3))
    lines = np.swapaxes(signed / full, 1, 2) if turned else signed / full
    total = np.zeros((lines.shape[1], lines.shape[2] - 1), np.float32)
    count = np.zeros(total.shape, np.float32)
    for one in lines:
        row, column = np.nonzero((one[:, :-1] > 0.0) != (one[:, 1:] > 0.0))
        here, next_ = one[row, column], one[row, column + 1]
        side = np.where(here > 0.0, np.float32(0.5), np.float32(-0.5))
        place = np.float32(0.5) + side * (here + next_)
        # Two pixels before the border's own and two behind, each with the sign that it has on its side.
        around = [side * one[row, np.clip(column + off, 0, one.shape[1] - 1)] for off in (-2, -1, 2, 3)]
        least = np.minimum(np.minimum(around[0], around[1]), -np.maximum(around[2], around[3]))
        wide = least > np.float32(0.5 * NEARLY_FULL)
        place += np.where(wide, around[1] + around[2], np.float32(0.0))
        total[row, column] += np.clip(place, 0.0, 1.0)
        count[row, column] += 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, np.float32)


def stripe_numbers(bits: NDArray[np.bool_], axis: AxisConvention) -> NDArray[np.int32]:
    """Return the number (h, w) int32 of each pixel's stripe that ``bits`` (n, h, w) write by the convention of ``axis``."""
    ordered = bits[::-1] if axis.fine_first else bits
    number = np.zeros(bits.shape[1:], np.int32)
    last = np.zeros(bits.shape[1:], np.bool_)
    for bit in ordered:
        lit = ~bit if axis.inverted else bit
        # Gray code: a digit of the number is the image's bit, inverted where the digit before is set.
        last = lit if axis.plain_binary else lit ^ last
        number = 2 * number + last
    return number


def numbered_stripes(
    bits: NDArray[np.bool_], left_out: tuple[int, int], axis: AxisConvention
) -> tuple[NDArray[np.int32], float]:
    """Return the stripes' numbers and their width in px of the pattern.

    Without its last digit a number counts stripes of twice the width: so it is where the finest images were left out, and where stripes
    are finer than half a fringe, which tells the fringe already.
    """
    number = stripe_numbers(bits, axis)
    stripe_px = axis.stripe_px * 2.0 ** left_out[0 if axis.fine_first else 1]
    while axis.periods_px and stripe_px <= 0.2501 * axis.period_px and number.any():
        number >>= 1
        stripe_px *= 2.0
    return number, stripe_px
