"""Edges: pixels in which a coordinate jumps, or bends more than by noise and curvature.

The grey values of such a pixel are a mixture of two surfaces, and so would be its point. A jump is a first difference
to one of the four neighbours, a bend a second difference across the pixel, along a row or a column.

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
    """Write the coordinates that are at no edge, NaN for the others; return True if there are edges.

    ``edge`` becomes 1 at edges. All are (n,), except ``around`` (n + 2,), which begins one column before. In the form
    ``a if a > m else m`` a missing neighbour (NaN) has no effect.
    """
    any_edge = np.int32(0)
    for x in range(coordinate.size):
        centre = around[x + 1]
        left, right = centre - around[x], around[x + 2] - centre
        up, down = centre - above[x], below[x] - centre
        # Greatest first difference, then greatest second one.
        jump = abs(left) if abs(left) > _ZERO else _ZERO
        jump = abs(right) if abs(right) > jump else jump
        jump = abs(up) if abs(up) > jump else jump
        jump = abs(down) if abs(down) > jump else jump
        bend = abs(right - left) if abs(right - left) > _ZERO else _ZERO
        bend = abs(down - up) if abs(down - up) > bend else bend
        bad = (jump > jump_px) | (bend > bend_px)
        coordinate[x] = _NAN if bad else centre
        edge[x] = np.uint8(1) if bad else np.uint8(0)
        any_edge = np.int32(any_edge | (np.int32(1) if bad else np.int32(0)))
    return bool(any_edge != np.int32(0))


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
    first_coordinate: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """Close the illuminated part (h, 2) of one direction's (h, w) maps and mask its edges, row by row.

    ``first_coordinate`` is the map of the direction that was closed before (in the second one): a pixel that fails now
    loses its coordinate there too. Each pixel is judged by its four neighbours as they were before edges were masked:
    three rows are kept in scratch, and row y − 1 is judged and written when row y is closed. Beyond its illuminated
    part, a row in scratch is NaN.
    """
    # Borrowed, since each row takes a dozen views.
    i0, i1, i2, i3, half_period = borrowed(i0), borrowed(i1), borrowed(i2), borrowed(i3), borrowed(half_period)
    first_coordinate, coordinate, half_dn, mask = (
        borrowed(first_coordinate),
        borrowed(coordinate),
        borrowed(half_dn),
        borrowed(mask),
    )
    rows, columns = coordinate.shape
    # Rows y − 2, y − 1 and y, in turns.
    scratch = np.full((3, DECODING_SIZE), _NAN, np.float32)
    edge = np.empty(columns, np.uint8)
    begin, end = 0, 0
    for y in range(rows + 1):
        # Close row y into its scratch row.
        # A row of NaN follows the last row, as if the image were dark beyond.
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
            # A point needs both coordinates: a pixel without the second one loses the first.
            if failed and axis.second:
                _drop(mask[y, first:stop], first_coordinate[y, first:stop])
        else:
            first, stop = 0, 0
        # Row y − 1 has both neighbours now: judge it, and write it.
        if y > 0:
            # One more element at either end, for the neighbours to the left and to the right.
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
                    _drop(judged, first_coordinate[y - 1, done])
        begin, end = first, stop
