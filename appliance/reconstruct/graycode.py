"""Owns the Gray code of a pixel: which threshold, and which half period its bits name."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

SHADOW = np.uint8(1)
_ONE, _ZERO = np.uint8(1), np.uint8(0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def threshold(
    bright: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    min_contrast_dn: np.uint8,
    middle: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """The middle between bright and dark, rounded up, and SHADOW where they differ too little; arrays (n,) uint8."""
    for i in range(middle.size):
        middle[i] = np.uint8((np.uint16(bright[i]) + np.uint16(dark[i]) + np.uint16(1)) >> np.uint16(1))
        contrast = np.uint8(bright[i] - dark[i])
        mask[i] = SHADOW if (bright[i] < dark[i]) | (contrast < min_contrast_dn) else _ZERO


@numba.njit(nogil=True, cache=True, error_model="numpy")
def count_lit(mask: NDArray[np.uint8]) -> int:
    """How many pixels are not in the shadow, before anything else has masked them."""
    dark = 0
    for i in range(mask.size):
        dark += mask[i]
    return int(mask.size) - dark


@numba.njit(nogil=True, cache=True, error_model="numpy")
def add_bit(frame: NDArray[np.uint8], middle: NDArray[np.uint8], half_period: NDArray[np.uint8]) -> None:
    """Append one bit, most significant first; arrays (n,) uint8.

    A bit of the number is the Gray bit, inverted when the bit before is set: the number of the half period comes out
    without a table.
    """
    for i in range(half_period.size):
        bit = _ONE if frame[i] >= middle[i] else _ZERO
        half_period[i] = np.uint8(half_period[i] << _ONE) | ((half_period[i] & _ONE) ^ bit)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def add_two_bits(
    frame: NDArray[np.uint8], following: NDArray[np.uint8], middle: NDArray[np.uint8], half_period: NDArray[np.uint8]
) -> None:
    """As ``add_bit`` for two frames at once: the code is read and written half as often."""
    for i in range(half_period.size):
        bit = (half_period[i] & _ONE) ^ (_ONE if frame[i] >= middle[i] else _ZERO)
        last = bit ^ (_ONE if following[i] >= middle[i] else _ZERO)
        half_period[i] = np.uint8(half_period[i] << np.uint8(2)) | np.uint8(bit << _ONE) | last


@numba.njit(nogil=True, cache=True, error_model="numpy")
def add_four_bits(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    third: NDArray[np.uint8],
    fourth: NDArray[np.uint8],
    middle: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
) -> None:
    """As ``add_bit`` for four frames at once."""
    for i in range(half_period.size):
        a = (half_period[i] & _ONE) ^ (_ONE if first[i] >= middle[i] else _ZERO)
        b = a ^ (_ONE if second[i] >= middle[i] else _ZERO)
        c = b ^ (_ONE if third[i] >= middle[i] else _ZERO)
        d = c ^ (_ONE if fourth[i] >= middle[i] else _ZERO)
        bits = np.uint8(a << np.uint8(3)) | np.uint8(b << np.uint8(2)) | np.uint8(c << _ONE) | d
        half_period[i] = np.uint8(half_period[i] << np.uint8(4)) | bits
