"""The reconstruction of a block of left rows: match, triangulate and select, row by row, in the cache.

Three scratch rows are used in turns: while a row is matched and triangulated, the one above it, whose neighbours are
complete then, is judged and appended to the points.

Symbols: y is the row that is matched, done the one that is judged; s, row and above are the scratch rows of y, of done
and of the one above it, w that of the current chunk. Places count in the grid of every stride-th pixel: first … end − 1
are illuminated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import MODULATION, OFFSET, PHASE_VARIANCE, SIZE, P, Q, Z, borrowed
from appliance.measure.points.match import NO_VARIANCE, RightMaps, match_row
from appliance.measure.points.select import PointLimits, Points, append, judge
from appliance.measure.points.sigma import SigmaFactors, expect_row
from appliance.measure.points.triangulate import Rays, triangulate_row

CHUNK = 256
"""Number of columns that pass through all stages together: their quantities fit into the first-level cache."""
_NAN = np.float32(np.nan)


class LeftMaps(NamedTuple):
    """Maps of the left camera that are reconstructed, (h, w) except ``illuminated_columns``."""

    p_px: NDArray[np.float32]
    """Pattern column; NaN where there is no coordinate."""
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    bright: NDArray[np.uint8]
    gray_threshold: NDArray[np.uint8]
    """Grey value half way between bright and dark."""
    illuminated_columns: NDArray[np.int32]
    """(h, 2): first column of each row that may have a coordinate, and the one behind the last."""
    offset_per_threshold: np.float32 = np.float32(1.0)
    """Mean of the sine images (the fringes' offset) over ``gray_threshold``: less than 1 for a convex response."""
    variance_px2: NDArray[np.float32] = NO_VARIANCE
    """Variance of either coordinate, in px² of the pattern, if it does not follow from modulation and offset, as in
    merged maps. It is used if the right maps have one as well."""


def scratch_rows() -> NDArray[np.float32]:
    """Return the scratch memory (4, SIZE) of one thread for ``reconstruct_rows``.

    Three rows are used in turns for a row and the two above it, the fourth for one chunk.
    """
    return np.full((4, SIZE), _NAN, np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _load(row: NDArray[Any], stride: int, factor: np.float32, target: NDArray[np.float32]) -> None:
    """Write ``factor`` times every ``stride``-th element of ``row`` to ``target``."""
    if stride == 1:
        for x in range(target.size):
            target[x] = factor * np.float32(row[x])
    else:
        for x in range(target.size):
            target[x] = factor * np.float32(row[x * stride])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _load_row(left: LeftMaps, y: int, first: int, end: int, stride: int, s: NDArray[np.float32]) -> None:
    """Load places ``first`` … ``end`` − 1 of a row from the left maps, from column first·stride on."""
    column = first * stride
    _load(left.p_px[y, column:], stride, np.float32(1.0), s[P + first : P + end])
    _load(left.q_px[y, column:], stride, np.float32(1.0), s[Q + first : Q + end])
    _load(left.modulation_half_dn[y, column:], stride, np.float32(0.5), s[MODULATION + first : MODULATION + end])
    _load(left.gray_threshold[y, column:], stride, left.offset_per_threshold, s[OFFSET + first : OFFSET + end])
    if left.variance_px2.size:
        _load(left.variance_px2[y, column:], stride, np.float32(1.0), s[PHASE_VARIANCE + first : PHASE_VARIANCE + end])
    s[P + first - 1], s[P + end] = _NAN, _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def reconstruct_rows(
    left: LeftMaps,
    right: RightMaps,
    rays: Rays,
    limits: PointLimits,
    factors: SigmaFactors,
    start: int,
    stop: int,
    stride: int,
    scratch: NDArray[np.float32],
    points: Points,
    offset: int,
) -> int:
    """Write the points of left rows ``start`` … ``stop`` − 1 into ``points`` from ``offset`` on.

    Returns their number. Only every ``stride``-th row and column is used, as a grid of its own, so that neighbours of a
    coarse cloud are ``stride`` px apart; ``start`` is a multiple of ``stride``. One row beyond either end is computed
    as well, since a point is chosen by its eight neighbours. ``scratch`` is from ``scratch_rows``.
    """
    # Borrowed, since rows and chunks are views by the hundred thousand.
    left, right, rays, scratch, points = (
        borrowed(left),
        borrowed(right),
        borrowed(rays),
        borrowed(scratch),
        borrowed(points),
    )
    rows, columns = left.p_px.shape
    # The maps' variances are used only if both cameras have them, since the noise is V_left + V_right.
    variances_given = left.variance_px2.size > 0 and right.variance_px2.size > 0
    n = (columns + stride - 1) // stride
    corner, good = np.empty(CHUNK, np.int32), np.empty((n + 7) // 8 * 8, np.uint8)
    # Clear the row above the first one: a point of an earlier scan would count as a neighbour.
    scratch[:3, Z : Z + n] = _NAN
    w = scratch[3]
    count = offset
    begin = max(start - stride, 0)
    first, end = 0, 0
    for y in range(begin, min(stop, rows) + stride, stride):
        row_number = y // stride
        s, row, above = scratch[row_number % 3], scratch[(row_number - 1) % 3], scratch[(row_number - 2) % 3]
        # Match and triangulate the illuminated part of row y.
        # first … end are columns of the grid, rounded up, so that none lies before the first illuminated column.
        row_first, row_end = first, end
        first, end = 0, 0
        if y < rows:
            first = (left.illuminated_columns[y, 0] + stride - 1) // stride
            end = max(first, (left.illuminated_columns[y, 1] + stride - 1) // stride)
        s[Z : Z + first] = _NAN
        s[Z + end : Z + n] = _NAN
        if first < end:
            _load_row(left, y, first, end, stride, s)
        # (p, q) → (u, v) in the right image → its standard deviation in px → X, Y, Z, gap and sigma in mm.
        for chunk in range(first, end, CHUNK):
            size = min(CHUNK, end - chunk)
            match_row(right, row[chunk:], s[chunk:], w, size, stride == 1 and y > begin, corner)
            expect_row(factors, stride == 1, variances_given, s[chunk:], w, size)
            triangulate_row(rays, y, chunk * stride, stride, s[chunk:], w, size)
        # The row above has all eight neighbours now: judge it.
        done = y - stride
        if start <= done < stop:
            # The eight neighbours in the grid: three of the row above, two of the same row, three of row y.
            column = row_first * stride
            judge(above[row_first:], row[row_first:], s[row_first:], row_end - row_first, limits, good)
            count = append(
                row[row_first:],
                good,
                left.bright[done, column:],
                left.modulation_half_dn[done, column:],
                row_end - row_first,
                stride,
                done * columns + column,
                points,
                count,
            )
    return count - offset
