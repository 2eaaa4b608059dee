"""Owns reading between pixels and between nodes: grey values and ways, one at a time.

Grey values are weighed by the cubic B-spline, which does not pass through them: it sees a spot of 0.6 px, wherever it looks.
Sharper kernels see a border of paint differently by where between pixels it lies, and of four sines in which it lies
differently they make a wrong phase.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)
_SIXTH, _TWO_THIRDS = np.float32(1.0 / 6.0), np.float32(2.0 / 3.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def spline(s: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of pixels at −1, 0, 1, 2 for a place ``s`` (0 … 1): the cubic B-spline."""
    r = _ONE - s
    a0, a3 = _SIXTH * r * r * r, _SIXTH * s * s * s
    a1 = _TWO_THIRDS - s * s * (_ONE - _HALF * s)
    return a0, a1, _ONE - a0 - a1 - a3, a3


@numba.njit(nogil=True, cache=True, error_model="numpy")
def smooth(pixels: NDArray[np.uint8], start: int, width: int, u: np.float32, v: np.float32) -> np.float32:
    """The picture from ``start`` on at (u, v), at least 1 px inside, seen as a spot of 0.6 px; NaN where it is saturated."""
    i, j = int(u), int(v)
    s, t = u - np.float32(i), v - np.float32(j)
    a0, a1, a2, a3 = spline(s)
    b0, b1, b2, b3 = spline(t)
    value = np.float32(0.0)
    # Unsigned, for what may be negative is asked each time.
    at, stride = np.uint64(start + (j - 1) * width + i - 1), np.uint64(width)
    for m in range(4):
        b = b0 if m == 0 else (b1 if m == 1 else (b2 if m == 2 else b3))
        value += b * (
            a0 * np.float32(pixels[at])
            + a1 * np.float32(pixels[at + np.uint64(1)])
            + a2 * np.float32(pixels[at + np.uint64(2)])
            + a3 * np.float32(pixels[at + np.uint64(3)])
        )
        at += stride
    nearest = np.uint64(start + (j + int(t > _HALF)) * width + i + int(s > _HALF))
    return value if pixels[nearest] != np.uint8(255) else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def left_of_noise(u: np.float32, v: np.float32) -> np.float32:
    """Variance of a value looked up by ``smooth`` at (u, v), of that of one pixel: the sum of its weights' squares."""
    a0, a1, a2, a3 = spline(u - np.floor(u))
    b0, b1, b2, b3 = spline(v - np.floor(v))
    return np.float32((a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) * (b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def at(c: NDArray[np.float32], k: int, t: np.float32) -> np.float32:
    """The parabola whose coefficients begin at place ``k``, at ``t``."""
    return np.float32(c[k] + t * (c[k + 1] + t * c[k + 2]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def spread(nodes: NDArray[np.float32], step: int, row: int, upper: NDArray[np.float32]) -> None:
    """The nodes of a row of pixels, from those above and below it, into ``upper`` (columns, count)."""
    j = row // step
    share = np.float32((row - j * step) / step)
    for i in range(nodes.shape[1]):
        for k in range(nodes.shape[2]):
            upper[i, k] = nodes[j, i, k] + share * (nodes[j + 1, i, k] - nodes[j, i, k])
