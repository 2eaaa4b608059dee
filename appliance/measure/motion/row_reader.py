"""Owns reading a row of pixels where their points went: many neighbours at once, of each frame the same few lines.

Neighbours lie at nearly the same depth, so their points are displaced by nearly the same whole number of pixels: along such a
**run** all sixteen pixels that the B-spline asks for lie side by side in memory with those of the next one, and the processor works
on eight or sixteen at once. What comes out is to the last bit what ``displacement.read_spline`` reads one by one.

Legend of the kernels, per pixel of a row (column x)::

    t            depth, NaN for pixels that are not asked
    share        place between two nodes, 0 … 1, by the pixel's distance from the left one
    u, v         place in the frame, px
    cell         number of the pixel up to the left of (u, v), less its place in the row: what those of a run have in common
    s, r         rest of u and v in 0 … 1; a0 … a3 and b0 … b3 the B-spline's weights of columns and lines
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.motion.displacement import spline_weights

Row = NDArray[np.float32]

OUTSIDE = np.int32(-(2**30))
"""Cell of a pixel whose point lies in no picture."""
_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)
_SATURATED = np.float32(255.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def shares_of(step: int) -> Row:
    """Return the place between two nodes (``step``,) of each pixel from the left one on."""
    shares = np.empty(step, np.float32)
    for x in range(step):
        shares[x] = np.float32(x / step)
    return shares


@numba.njit(nogil=True, cache=True, error_model="numpy")
def parabola_row(at_row: NDArray[np.float32], shares: Row, k: int, t: Row, first: int, stop: int, values: Row) -> None:
    """Write the parabola that begins at place ``k`` of the row's nodes ``at_row``, at each pixel's depth ``t`` (w,), into ``values``.

    For columns ``first`` to ``stop`` − 1, between the nodes by ``shares``.
    """
    step = shares.size
    for i in range(first // step, (stop - 1) // step + 1):
        # Between two nodes each coefficient is linear in the column.
        c0, c1, c2 = at_row[i, k], at_row[i, k + 1], at_row[i, k + 2]
        d0, d1, d2 = at_row[i + 1, k] - c0, at_row[i + 1, k + 1] - c1, at_row[i + 1, k + 2] - c2
        begin, end = max(first, i * step), min(stop, (i + 1) * step)
        share, depth, value = shares[begin - i * step : end - i * step], t[begin:end], values[begin:end]
        for x in range(depth.size):
            value[x] = (c0 + share[x] * d0) + depth[x] * ((c1 + share[x] * d1) + depth[x] * (c2 + share[x] * d2))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def coefficient_row(at_row: NDArray[np.float32], shares: Row, k: int, first: int, stop: int, values: Row) -> None:
    """Write the coefficient at place ``k`` of the row's nodes, between them by ``shares``, into ``values`` (w,)."""
    step = shares.size
    for i in range(first // step, (stop - 1) // step + 1):
        c, d = at_row[i, k], at_row[i + 1, k] - at_row[i, k]
        begin, end = max(first, i * step), min(stop, (i + 1) * step)
        share, value = shares[begin - i * step : end - i * step], values[begin:end]
        for x in range(value.size):
            value[x] = c + share[x] * d


@numba.njit(nogil=True, cache=True, error_model="numpy")
def place_row(row: int, first: int, stop: int, u: Row, v: Row) -> None:
    """Make places in the frame of the displacements ``u`` and ``v`` (w,) of columns ``first`` to ``stop`` − 1 of a ``row``."""
    u, v = u[first:stop], v[first:stop]
    for x in range(u.size):
        u[x] = np.float32(first + x) + u[x]
        v[x] = np.float32(row) + v[x]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_row(
    pixels: NDArray[np.uint8], start: int, height: int, width: int, u: Row, v: Row, first: int, stop: int,
    cell: NDArray[np.int32], grey: Row,
) -> None:  # fmt: skip
    """Write what ``read_spline`` reads at (u, v) of the frame that begins at ``start``, for columns ``first`` to ``stop`` − 1.

    ``grey`` (w,) is NaN where a point lies less than 1 px inside of the frame, or is saturated. ``cell`` (w,) is scratch.
    """
    limit_u, limit_v = np.float32(width - 2), np.float32(height - 2)
    # Counted from zero: of an index that may be negative, numba asks each time whether it is.
    u_here, v_here, cell_here, last = u[first:stop], v[first:stop], cell[first:stop], np.int32(width)
    for x in range(u_here.size):
        i, j = u_here[x], v_here[x]
        inside = (i >= _ONE) & (j >= _ONE) & (i < limit_u) & (j < limit_v)
        # Of what is outside, NaN above all, no whole number is asked.
        i, j = i if inside else _ONE, j if inside else _ONE
        cell_here[x] = np.int32(j) * last + np.int32(i) - np.int32(x) if inside else OUTSIDE
    x = first
    while x < stop:
        end = x + 1
        while end < stop and cell[end] == cell[x]:
            end += 1
        if cell[x] == OUTSIDE:
            grey[x:end] = _NAN
        else:
            _read_run(pixels, start + cell[x] + x - first - width - 1, width, u[x:end], v[x:end], grey[x:end])
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
            a0 * np.float32(line0[x]) + a1 * np.float32(line0[x + 1]) + a2 * np.float32(line0[x + 2]) + a3 * np.float32(line0[x + 3])
        )  # fmt: skip
        value += b1 * (a0 * np.float32(line1[x]) + a1 * p11 + a2 * p12 + a3 * np.float32(line1[x + 3]))
        value += b2 * (a0 * np.float32(line2[x]) + a1 * p21 + a2 * p22 + a3 * np.float32(line2[x + 3]))
        value += b3 * (
            a0 * np.float32(line3[x]) + a1 * np.float32(line3[x + 1]) + a2 * np.float32(line3[x + 2]) + a3 * np.float32(line3[x + 3])
        )  # fmt: skip
        # Of the sixteen pixels the nearest one decides whether light was cut off.
        above, below = p12 if s > _HALF else p11, p22 if s > _HALF else p21
        nearest = below if r > _HALF else above
        grey[x] = value if nearest != _SATURATED else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def noise_row(u: Row, v: Row, cell: NDArray[np.int32], first: int, stop: int, share: Row) -> None:
    """Write the variance of what ``read_row`` read, as a share of one pixel's, into ``share`` (w,); NaN for points in no picture."""
    u, v, cell, share = u[first:stop], v[first:stop], cell[first:stop], share[first:stop]
    for x in range(u.size):
        inside = cell[x] != OUTSIDE
        i, j = u[x] if inside else _ONE, v[x] if inside else _ONE
        a0, a1, a2, a3 = spline_weights(i - np.float32(np.int32(i)))
        b0, b1, b2, b3 = spline_weights(j - np.float32(np.int32(j)))
        # Σ a² · Σ b² of the weights.
        both = (a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) * (b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3)
        share[x] = both if inside else _NAN
