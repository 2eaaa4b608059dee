"""Reads the grey values of one row's pixels in each frame at the places to which the motion has brought their points.

``displacement.py`` gives these places on a coarse grid of nodes, as parabolas in depth; between two nodes of a row they
are interpolated for all pixels of a list at once.

Grey values between pixels are read with the cubic B-spline, which does not pass through them: it sees a spot of 0.6 px
(σ) wherever it is read. Sharper kernels see a border of albedo differently by where between pixels it lies, and of four
sine images in which it lies differently they make a wrong phase.

Neighbours lie at nearly the same depth, so their points are displaced by nearly the same whole number of pixels: along such a
**run** all sixteen pixels that the B-spline asks for lie side by side in memory with those of the next one, and the processor works
on eight or sixteen at once.

Legend of the kernels, per pixel of a list (number x, in column ``column[x]``)::

    t            depth, NaN for pixels of which nothing is read
    share        place between two nodes, 0 … 1, by the pixel's distance from the left one
    u, v         place in the frame, px
    cell         number of the pixel up to the left of (u, v), less x: what those of a run have in common
    s, r         rest of u and v in 0 … 1; a0 … a3 and b0 … b3 the B-spline's weights of columns and lines
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.motion.displacement import OF_V

Row = NDArray[np.float32]

OUTSIDE = np.int32(-(2**30))
"""Cell of a pixel whose point lies in no picture."""
_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)
_SIXTH, _TWO_THIRDS = np.float32(1.0 / 6.0), np.float32(2.0 / 3.0)
_SATURATED = np.float32(255.0)


class Pictures(NamedTuple):
    """All pictures of a sequence in one row."""

    pixels: NDArray[np.uint8]
    starts: NDArray[np.int64]
    """Begins of the pictures that are asked, in ``pixels``."""
    height: int
    width: int


class RowPixels(NamedTuple):
    """n pixels of one row, from left to right, and between which nodes of the field they lie."""

    column: NDArray[np.int32]
    """(n,)."""
    share: Row
    """(n,)."""
    begins: NDArray[np.int64]
    """Number of the first pixel right of each node, or at it."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def locate(column: NDArray[np.int32], step: int, share: Row, begins: NDArray[np.int64]) -> RowPixels:
    """Return the pixels in ``column`` (n,) between nodes ``step`` px apart; ``share`` and ``begins`` are room for it."""
    n, at = column.size, 0
    for i in range(begins.size):
        while at < n and column[at] < i * step:
            share[at] = np.float32((column[at] - (i - 1) * step) / step)
            at += 1
        begins[i] = at
    return RowPixels(column, share[:n], begins)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def parabola_row(at_row: NDArray[np.float32], chosen: RowPixels, k: int, t: Row, values: Row) -> None:
    """Write the parabola that begins at place ``k`` of the row's nodes ``at_row``, at each pixel's depth ``t`` (n,),
    into ``values``."""
    for i in range(chosen.begins.size - 1):
        begin, end = chosen.begins[i], chosen.begins[i + 1]
        if begin == end:
            continue
        # Between two nodes each coefficient is linear in the column.
        c0, c1, c2 = at_row[i, k], at_row[i, k + 1], at_row[i, k + 2]
        d0, d1, d2 = at_row[i + 1, k] - c0, at_row[i + 1, k + 1] - c1, at_row[i + 1, k + 2] - c2
        share, depth, value = chosen.share[begin:end], t[begin:end], values[begin:end]
        for x in range(depth.size):
            value[x] = (c0 + share[x] * d0) + depth[x] * ((c1 + share[x] * d1) + depth[x] * (c2 + share[x] * d2))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def coefficient_row(at_row: NDArray[np.float32], chosen: RowPixels, k: int, values: Row) -> None:
    """Write the coefficient at place ``k`` of the row's nodes into ``values`` (n,)."""
    for i in range(chosen.begins.size - 1):
        begin, end = chosen.begins[i], chosen.begins[i + 1]
        if begin == end:
            continue
        c, d = at_row[i, k], at_row[i + 1, k] - at_row[i, k]
        share, value = chosen.share[begin:end], values[begin:end]
        for x in range(value.size):
            value[x] = c + share[x] * d


@numba.njit(nogil=True, cache=True, error_model="numpy")
def places_in_frame(at_row: NDArray[np.float32], chosen: RowPixels, k: int, row: int, t: Row, u: Row, v: Row) -> None:
    """Write where points at depth ``t`` (n,) are in the frame whose parabolas begin at place ``k`` into ``u`` and ``v``
    (n,)."""
    parabola_row(at_row, chosen, k, t, u)
    parabola_row(at_row, chosen, k + OF_V, t, v)
    for x in range(u.size):
        u[x] = np.float32(chosen.column[x]) + u[x]
        v[x] = np.float32(row) + v[x]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def spline_weights(s: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return the cubic B-spline's weights of the pixels at −1, 0, 1, 2 for a place ``s`` in 0 … 1."""
    r = _ONE - s
    a0, a3 = _SIXTH * r * r * r, _SIXTH * s * s * s
    a1 = _TWO_THIRDS - s * s * (_ONE - _HALF * s)
    return a0, a1, _ONE - a0 - a1 - a3, a3


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_row(pictures: Pictures, number: int, u: Row, v: Row, cell: NDArray[np.int32], grey: Row) -> None:
    """Write the grey values at (u, v), each (n,), of a picture into ``grey``.

    NaN where a point lies less than 1 px inside of the frame, or is saturated. ``cell`` (n,) is scratch.
    """
    width, stop = pictures.width, u.size
    limit_u, limit_v, last = np.float32(width - 2), np.float32(pictures.height - 2), np.int32(width)
    for x in range(stop):
        i, j = u[x], v[x]
        inside = (i >= _ONE) & (j >= _ONE) & (i < limit_u) & (j < limit_v)
        # Of what is outside, NaN above all, no whole number is asked.
        i, j = i if inside else _ONE, j if inside else _ONE
        cell[x] = np.int32(j) * last + np.int32(i) - np.int32(x) if inside else OUTSIDE
    x = 0
    while x < stop:
        end = x + 1
        while end < stop and cell[end] == cell[x]:
            end += 1
        if cell[x] == OUTSIDE:
            grey[x:end] = _NAN
        else:
            first = pictures.starts[number] + cell[x] + x - width - 1
            _read_run(pictures.pixels, first, width, u[x:end], v[x:end], grey[x:end])
        x = end


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _read_run(pixels: NDArray[np.uint8], at: int, width: int, u: Row, v: Row, grey: Row) -> None:
    """Read the n points (u, v) of a run, the first one's sixteen pixels from ``at`` on, into ``grey`` (n,)."""
    n = u.size
    line0, line1 = pixels[at : at + n + 3], pixels[at + width : at + width + n + 3]
    line2, line3 = pixels[at + 2 * width : at + 2 * width + n + 3], pixels[at + 3 * width : at + 3 * width + n + 3]
    for x in range(n):
        s, r = u[x] - np.float32(np.int32(u[x])), v[x] - np.float32(np.int32(v[x]))
        a0, a1, a2, a3 = spline_weights(s)
        b0, b1, b2, b3 = spline_weights(r)
        p11, p12 = np.float32(line1[x + 1]), np.float32(line1[x + 2])
        p21, p22 = np.float32(line2[x + 1]), np.float32(line2[x + 2])
        value = b0 * (
            a0 * np.float32(line0[x])
            + a1 * np.float32(line0[x + 1])
            + a2 * np.float32(line0[x + 2])
            + a3 * np.float32(line0[x + 3])
        )
        value += b1 * (a0 * np.float32(line1[x]) + a1 * p11 + a2 * p12 + a3 * np.float32(line1[x + 3]))
        value += b2 * (a0 * np.float32(line2[x]) + a1 * p21 + a2 * p22 + a3 * np.float32(line2[x + 3]))
        value += b3 * (
            a0 * np.float32(line3[x])
            + a1 * np.float32(line3[x + 1])
            + a2 * np.float32(line3[x + 2])
            + a3 * np.float32(line3[x + 3])
        )
        # Of the sixteen pixels the nearest one decides whether light was cut off.
        above, below = p12 if s > _HALF else p11, p22 if s > _HALF else p21
        nearest = below if r > _HALF else above
        grey[x] = value if nearest != _SATURATED else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def noise_row(u: Row, v: Row, cell: NDArray[np.int32], share: Row) -> None:
    """Write the variance of what ``read_row`` read, as a share of one pixel's, into ``share`` (n,); NaN for points in
    no picture."""
    for x in range(u.size):
        inside = cell[x] != OUTSIDE
        i, j = u[x] if inside else _ONE, v[x] if inside else _ONE
        a0, a1, a2, a3 = spline_weights(i - np.float32(np.int32(i)))
        b0, b1, b2, b3 = spline_weights(j - np.float32(np.int32(j)))
        # Σ a² · Σ b² of the weights.
        both = (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) * (b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3)
        share[x] = both if inside else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_nearest(pictures: Pictures, number: int, u: Row, v: Row, grey: Row) -> None:
    """Write the grey values of the pixels nearest to (u, v) of a picture; NaN outside of it."""
    start, last_u, last_v = pictures.starts[number], np.float32(pictures.width), np.float32(pictures.height)
    for x in range(u.size):
        i, j = np.floor(u[x] + _HALF), np.floor(v[x] + _HALF)
        if (i >= 0) & (j >= 0) & (i < last_u) & (j < last_v):
            grey[x] = np.float32(pictures.pixels[np.uint64(start + np.int64(j) * pictures.width + np.int64(i))])
        else:
            grey[x] = _NAN
