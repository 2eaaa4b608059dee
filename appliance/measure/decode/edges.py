"""Owns which pixels see an edge: where a coordinate jumps, or bends more than noise and curvature can.

Such a pixel's grey values are a mixture of two surfaces, and so would be its point. A jump is a first difference to one
of the four neighbours, a bend a second difference across the pixel, along a row or a column.

Symbols, of one coordinate c at row y, column x: left = c(x) − c(x − 1), right = c(x + 1) − c(x), up and down the same
along the column; jump is the greatest of their sizes, bend the greater of |right − left| and |down − up|, all in px of
the pattern.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.phase import AxisDecoding, close_row
from appliance.measure.decode.scratch import COORDINATE, DECODING_SIZE, borrowed

EDGE = np.uint8(5)
_NAN, _ZERO = np.float32(np.nan), np.float32(0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def keep_smooth(
    above: NDArray[np.float32],
    around: NDArray[np.float32],
    below: NDArray[np.float32],
    jump_px: np.float32,
    bend_px: np.float32,
    coordinate: NDArray[np.float32],
    edge: NDArray[np.uint8],
) -> bool:
    """Write into ``coordinate`` what is no edge, NaN for the others, and 1 into ``edge`` there; return whether there
    was one.

    All are (n,), but for ``around`` (n + 2,), which begins one column before. In the form ``a if a > m else m`` a
    missing neighbour (NaN) says nothing.
    """
    found = np.int32(0)
    for x in range(coordinate.size):
        here = around[x + 1]
        left, right = here - around[x], around[x + 2] - here
        up, down = here - above[x], below[x] - here
        # Greatest first difference, then greatest second one.
        jump = abs(left) if abs(left) > _ZERO else _ZERO
        jump = abs(right) if abs(right) > jump else jump
        jump = abs(up) if abs(up) > jump else jump
        jump = abs(down) if abs(down) > jump else jump
        bend = abs(right - left) if abs(right - left) > _ZERO else _ZERO
        bend = abs(down - up) if abs(down - up) > bend else bend
        bad = (jump > jump_px) | (bend > bend_px)
        coordinate[x] = _NAN if bad else here
        edge[x] = np.uint8(1) if bad else np.uint8(0)
        found = np.int32(found | (np.int32(1) if bad else np.int32(0)))
    return bool(found != np.int32(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _drop(flags: NDArray[np.uint8], m: NDArray[np.float32]) -> None:
    """Write NaN into ``m`` (n,) where a flag is set."""
    for x in range(flags.size):
        m[x] = _NAN if flags[x] != np.uint8(0) else m[x]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _name(edge: NDArray[np.uint8], mask: NDArray[np.uint8]) -> None:
    """Write EDGE into ``mask`` (n,) where ``edge`` is set."""
    for x in range(edge.size):
        mask[x] = EDGE if edge[x] != np.uint8(0) else mask[x]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def close_axis(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    illuminated: NDArray[np.int32],
    axis: AxisDecoding,
    jump_px: np.float32,
    bend_px: np.float32,
    other: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """Close the illuminated part (h, 2) of one direction's (h, w) maps and mask its edges, while each row is in the
    cache.

    ``other`` is the map of the direction that was closed before (in the second one): what fails now loses its
    coordinate there too. Each pixel is judged by its four neighbours as they were before edges were masked: three rows
    wait in scratch, and row y − 1 is judged, and written, when row y is closed. Beyond its illuminated part, a row in
    scratch is NaN.
    """
    # Each row takes a dozen views.
    i0, i1, i2, i3, half_period = borrowed(i0), borrowed(i1), borrowed(i2), borrowed(i3), borrowed(half_period)
    other, coordinate, half_dn, mask = borrowed(other), borrowed(coordinate), borrowed(half_dn), borrowed(mask)
    rows, columns = coordinate.shape
    # Rows y − 2, y − 1 and y, in turns.
    scratch = np.full((3, DECODING_SIZE), _NAN, np.float32)
    edge = np.empty(columns, np.uint8)
    begin, end = 0, 0
    for y in range(rows + 1):
        # Close row y into its scratch row.
        # Behind the last row comes one of NaN, as if the image went on dark.
        s = scratch[y % 3]
        s[COORDINATE : COORDINATE + columns] = _NAN
        if y < rows:
            first, stop = illuminated[y]
            failed = close_row(
                i0[y, first:stop],
                i1[y, first:stop],
                i2[y, first:stop],
                i3[y, first:stop],
                half_period[y, first:stop],
                axis,
                s[first:],
                half_dn[y, first:stop],
                mask[y, first:stop],
            )
            # A point needs both coordinates: what has no second one loses the first.
            if failed and axis.second:
                _drop(mask[y, first:stop], other[y, first:stop])
        else:
            first, stop = 0, 0
        # Row y − 1 has both neighbours now: judge it, and write it.
        if y > 0:
            # One place more at either end, for the neighbours to the left and to the right.
            above, around = scratch[(y - 2) % 3, COORDINATE:], scratch[(y - 1) % 3, COORDINATE - 1 :]
            done, judged = slice(begin, end), edge[: end - begin]
            if keep_smooth(
                above[begin:end],
                around[begin:],
                s[COORDINATE + begin : COORDINATE + end],
                jump_px,
                bend_px,
                coordinate[y - 1, done],
                judged,
            ):
                _name(judged, mask[y - 1, done])
                if axis.second:
                    _drop(judged, other[y - 1, done])
        begin, end = first, stop
