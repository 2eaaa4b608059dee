"""Owns the stripes' numbers: bits of a pixel from the images of a code, and the number that they write.

A bit is set where the image is brighter than its inverse; without inverses, brighter than the middle between bright and dark; without
these, brighter than the mean of the sines; without any of them, brighter than the middle between the pixel's darkest and brightest
image of the code.
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


class Threshold(Enum):
    """References that tell a bright stripe from a dark one."""

    INVERSE = "the inverse image"
    REFERENCES = "the middle between bright and dark"
    SINES = "the mean of the sines"
    RANGE = "the middle between the darkest and the brightest image of the code"


@dataclass(frozen=True, slots=True, eq=False)
class CodeBits:
    """The bits of one direction."""

    bits: NDArray[np.bool_]
    """(n, h, w) in the order of the images: the stripe is bright."""
    contrast: Floats
    """(h, w): the least swing of any of them, in grey values; that of the references or the range where there are no inverses."""
    threshold: Threshold


def read_bits(images: ImageSet, axis: AxisConvention, sine_mean: Floats | None) -> CodeBits:
    """Return the bits of a direction; ``sine_mean`` (h, w) is the mean of its sines, ``None`` where it has none."""
    gray = [images.image(Shows.GRAY, axis.name, k) for k in range(axis.bits)]
    bright, dark = images.image(Shows.BRIGHT), images.image(Shows.DARK)
    stack = np.stack([one for one in gray if one is not None])
    if axis.inverses:
        inverse = [images.image(Shows.INVERSE, axis.name, k) for k in range(axis.bits)]
        others = np.stack([one for one in inverse if one is not None])
        swing = np.abs(stack.astype(np.float32) - others).min(axis=0)
        return CodeBits(stack > others, swing, Threshold.INVERSE)
    if bright is not None and dark is not None:
        low, high, kind = dark.astype(np.float32), bright.astype(np.float32), Threshold.REFERENCES
    elif sine_mean is not None:
        # The swing is that of the code itself: a pixel that only saw dark stripes has none.
        middle = sine_mean
        swing = np.abs(stack.astype(np.float32) - middle).min(axis=0)
        return CodeBits(stack > middle, 2.0 * swing, Threshold.SINES)
    else:
        low, high, kind = stack.min(axis=0).astype(np.float32), stack.max(axis=0).astype(np.float32), Threshold.RANGE
    return CodeBits(stack > 0.5 * (low + high), high - low, kind)


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
