"""Owns reading between pixels and between nodes: grey values and ways, one at a time."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)
_SQUARED2, _SQUARED3 = np.float32(4.5), np.float32(5.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def cubic(pixels: NDArray[np.uint8], start: int, width: int, u: np.float32, v: np.float32) -> np.float32:
    """Cubic convolution at (u, v), at least 1 px inside, of the picture from ``start`` on; NaN where it is saturated."""
    i, j = int(u), int(v)
    s, t = u - np.float32(i), v - np.float32(j)
    s2, t2 = s * s, t * t
    s3, t3 = s2 * s, t2 * t
    three, five = np.float32(1.5), np.float32(2.5)
    a0, a1 = -_HALF * s + s2 - _HALF * s3, _ONE - five * s2 + three * s3
    a3 = -_HALF * s2 + _HALF * s3
    a2 = _ONE - a0 - a1 - a3
    b0, b1 = -_HALF * t + t2 - _HALF * t3, _ONE - five * t2 + three * t3
    b3 = -_HALF * t2 + _HALF * t3
    b2 = _ONE - b0 - b1 - b3
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
    """Variance of a value looked up by ``cubic`` at (u, v), of that of one pixel: the sum of its weights' squares."""
    s, t = u - np.floor(u), v - np.floor(v)
    s, t = s * (_ONE - s), t * (_ONE - t)
    s, t = s * s, t * t
    # Exact at 0 and to 0.02 elsewhere without the cube; the cube of s (1 − s) is its square times its root.
    return np.float32(
        (_ONE - (_SQUARED2 + _SQUARED3 * np.sqrt(s)) * s) * (_ONE - (_SQUARED2 + _SQUARED3 * np.sqrt(t)) * t)
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def between(picture: NDArray[np.float32], u: np.float32, v: np.float32) -> np.float32:
    """The same of a picture (h, w) of float32; NaN outside and where one of the 16 pixels is."""
    i, j = int(np.floor(u)), int(np.floor(v))
    if not (i >= 1 and j >= 1 and i < picture.shape[1] - 2 and j < picture.shape[0] - 2):
        return _NAN
    s, t = u - np.float32(i), v - np.float32(j)
    s2, t2 = s * s, t * t
    s3, t3 = s2 * s, t2 * t
    three, five = np.float32(1.5), np.float32(2.5)
    a0, a1 = -_HALF * s + s2 - _HALF * s3, _ONE - five * s2 + three * s3
    a3 = -_HALF * s2 + _HALF * s3
    a2 = _ONE - a0 - a1 - a3
    b0, b1 = -_HALF * t + t2 - _HALF * t3, _ONE - five * t2 + three * t3
    b3 = -_HALF * t2 + _HALF * t3
    b2 = _ONE - b0 - b1 - b3
    value = np.float32(0.0)
    for m in range(4):
        b = b0 if m == 0 else (b1 if m == 1 else (b2 if m == 2 else b3))
        y = j - 1 + m
        value += b * (a0 * picture[y, i - 1] + a1 * picture[y, i] + a2 * picture[y, i + 1] + a3 * picture[y, i + 2])
    return value


@numba.njit(nogil=True, cache=True, error_model="numpy")
def linear(picture: NDArray[np.float32], u: np.float32, v: np.float32) -> np.float32:
    """Between four pixels of a picture (h, w) that is smooth; NaN outside and where one of the four is."""
    i, j = int(np.floor(u)), int(np.floor(v))
    if not (i >= 0 and j >= 0 and i < picture.shape[1] - 1 and j < picture.shape[0] - 1):
        return _NAN
    s, t = u - np.float32(i), v - np.float32(j)
    upper = picture[j, i] + s * (picture[j, i + 1] - picture[j, i])
    lower = picture[j + 1, i] + s * (picture[j + 1, i + 1] - picture[j + 1, i])
    return np.float32(upper + t * (lower - upper))


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
