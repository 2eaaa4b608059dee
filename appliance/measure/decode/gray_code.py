"""The Gray code of a pixel: its threshold, and its half-period order.

Symbols: a … g are the Gray images, most significant bit first; m is the pixel's threshold.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import borrowed

BITS_AT_ONCE = 7
"""Number of images read in one loop: LLVM checks at most eight inputs, the threshold included, for overlap with the
output."""
_SHADOW = np.uint8(1)
_ONE, _ZERO = np.uint8(1), np.uint8(0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def threshold(
    bright: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    min_contrast_dn: np.uint8,
    gray_threshold: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """Write the middle between bright and dark, rounded up, and 1 into ``mask`` for too little contrast.

    Arrays are (n,) uint8.
    """
    for i in range(gray_threshold.size):
        gray_threshold[i] = np.uint8((np.uint16(bright[i]) + np.uint16(dark[i]) + np.uint16(1)) >> np.uint16(1))
        # The difference wraps around if bright is below dark, which is tested first.
        contrast = np.uint8(np.int16(bright[i]) - np.int16(dark[i]))
        mask[i] = _SHADOW if (bright[i] < dark[i]) | (contrast < min_contrast_dn) else _ZERO


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _number(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    c: NDArray[np.uint8],
    d: NDArray[np.uint8],
    e: NDArray[np.uint8],
    f: NDArray[np.uint8],
    g: NDArray[np.uint8],
    gray_threshold: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
) -> None:
    """Write the half-period order of each pixel of a row.

    A bit of the number is the Gray bit, inverted when the bit before is set (b_k = g_k xor b_{k−1}): no table is
    needed.
    """
    for x in range(half_period.size):
        m = gray_threshold[x]
        bit = _ONE if a[x] >= m else _ZERO
        number = bit
        bit = np.uint8(bit ^ (_ONE if b[x] >= m else _ZERO))
        number = np.uint8(number + number + bit)
        bit = np.uint8(bit ^ (_ONE if c[x] >= m else _ZERO))
        number = np.uint8(number + number + bit)
        bit = np.uint8(bit ^ (_ONE if d[x] >= m else _ZERO))
        number = np.uint8(number + number + bit)
        bit = np.uint8(bit ^ (_ONE if e[x] >= m else _ZERO))
        number = np.uint8(number + number + bit)
        bit = np.uint8(bit ^ (_ONE if f[x] >= m else _ZERO))
        number = np.uint8(number + number + bit)
        bit = np.uint8(bit ^ (_ONE if g[x] >= m else _ZERO))
        half_period[x] = np.uint8(number + number + bit)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def number_half_periods(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    c: NDArray[np.uint8],
    d: NDArray[np.uint8],
    e: NDArray[np.uint8],
    f: NDArray[np.uint8],
    g: NDArray[np.uint8],
    gray_threshold: NDArray[np.uint8],
    illuminated: NDArray[np.int32],
    half_period: NDArray[np.uint8],
) -> None:
    """Write the half-period order by seven Gray images, most significant first, in the illuminated parts.

    Images are (h, w) uint8; for fewer than seven, put the dark image in front: it is a zero bit in illuminated pixels.
    """
    a, b, c, d, e, f, g = borrowed(a), borrowed(b), borrowed(c), borrowed(d), borrowed(e), borrowed(f), borrowed(g)
    gray_threshold, half_period = borrowed(gray_threshold), borrowed(half_period)
    for y in range(half_period.shape[0]):
        first, stop = illuminated[y]
        _number(
            a[y, first:stop],
            b[y, first:stop],
            c[y, first:stop],
            d[y, first:stop],
            e[y, first:stop],
            f[y, first:stop],
            g[y, first:stop],
            gray_threshold[y, first:stop],
            half_period[y, first:stop],
        )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def add_bit(frame: NDArray[np.uint8], gray_threshold: NDArray[np.uint8], half_period: NDArray[np.uint8]) -> None:
    """Append one more bit to each half-period order; arrays (n,) uint8."""
    for i in range(half_period.size):
        bit = _ONE if frame[i] >= gray_threshold[i] else _ZERO
        half_period[i] = np.uint8(half_period[i] << _ONE) | ((half_period[i] & _ONE) ^ bit)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def plain_number(gray: int) -> int:
    """Return the number of a reflected Gray code of up to eight bits."""
    number = gray ^ (gray >> 1)
    number ^= number >> 2
    return number ^ (number >> 4)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def periods(number: int, turns: float) -> int:
    """Return the fringe order that follows from phase and half period."""
    middle = np.float32(0.5) * np.float32(number) + np.float32(0.25)
    return int(np.floor(middle - turns + np.float32(0.5)))
