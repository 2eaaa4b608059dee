"""Owns which pixels see an edge: where a coordinate jumps, or bends more than noise and curvature can.

Such a pixel's grey values are a mixture of two surfaces, and so would be its point.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.phase import Axis, close_row

EDGE = np.uint8(5)
_NAN = np.float32(np.nan)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _along(
    before: NDArray[np.float32],
    here: NDArray[np.float32],
    after: NDArray[np.float32],
    jump_px: np.float32,
    bend_px: np.float32,
    bad: NDArray[np.uint8],
) -> None:
    """Any comparison with a missing neighbour (NaN) is false: it says nothing."""
    for i in range(bad.size):
        a, b = here[i] - before[i], after[i] - here[i]
        edge = (abs(a) > jump_px) | (abs(b) > jump_px) | (abs(b - a) > bend_px)
        bad[i] = bad[i] | (np.uint8(1) if edge else np.uint8(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _any(flags: NDArray[np.uint8]) -> bool:
    found = np.uint8(0)
    for i in range(flags.size):
        found = found | flags[i]
    return bool(found != np.uint8(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _failed_now(mask: NDArray[np.uint8], other: NDArray[np.float32], flags: NDArray[np.uint8]) -> None:
    for i in range(flags.size):
        flags[i] = np.uint8(1) if (mask[i] != np.uint8(0)) & (other[i] == other[i]) else np.uint8(0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _drop(flags: NDArray[np.uint8], m: NDArray[np.float32]) -> None:
    for i in range(flags.size):
        m[i] = _NAN if flags[i] != np.uint8(0) else m[i]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _name(bad: NDArray[np.uint8], mask: NDArray[np.uint8]) -> None:
    for i in range(bad.size):
        edge = (bad[i] != np.uint8(0)) & (mask[i] == np.uint8(0))
        mask[i] = EDGE if edge else mask[i]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _judge_row(
    m: NDArray[np.float32], y: int, nothing: NDArray[np.float32], jump_px: np.float32, bend_px: np.float32,
    first: int, stop: int, bad: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Whether pixels ``first`` … ``stop`` − 1 of row ``y`` are edges."""
    rows, columns = m.shape
    here = m[y]
    above, below = m[y - 1] if y > 0 else nothing, m[y + 1] if y + 1 < rows else nothing
    _along(above[first:stop], here[first:stop], below[first:stop], jump_px, bend_px, bad[first:stop])
    begin, end = max(first, 1), min(stop, columns - 1)
    _along(here[begin - 1 : end - 1], here[begin:end], here[begin + 1 : end + 1], jump_px, bend_px, bad[begin:end])
    # The two ends of a row have one neighbour each.
    last = columns - 1
    _along(nothing[:1], here[:1], here[1:2], jump_px, bend_px, bad[:1])
    _along(here[last - 1 : last], here[last:], nothing[:1], jump_px, bend_px, bad[last:])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _lit(mask: NDArray[np.uint8]) -> tuple[int, int]:
    """First pixel of a row that is not masked, and the one behind the last."""
    first, stop = 0, mask.size
    while first < stop and mask[first] != 0:
        first += 1
    while stop > first and mask[stop - 1] != 0:
        stop -= 1
    return first, stop


@numba.njit(nogil=True, cache=True, error_model="numpy")
def close_axis(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    axis: Axis,
    jump_px: np.float32,
    bend_px: np.float32,
    other: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """Close one direction of (h, w) maps and mask its edges, while each row is in the cache.

    ``other`` is the map of the direction that was closed before (in the second one): what fails now loses its
    coordinate there too. Each pixel is judged by its four neighbours as they were before edges were masked: row y − 1 is
    judged when row y is closed, and loses its coordinates one row later.
    """
    rows, columns = coordinate.shape
    scratch = np.empty((3, columns), np.float32)
    nothing = np.full(columns, _NAN, np.float32)
    bad, flags = np.zeros((2, columns), np.uint8), np.zeros(columns, np.uint8)
    first, stop = 0, 0
    for y in range(rows + 2):
        before_first, before_stop = first, stop
        if y < rows:
            first, stop = _lit(mask[y])
            coordinate[y, :first] = _NAN
            coordinate[y, stop:] = _NAN
            a, b, c, d = i0[y, first:stop], i1[y, first:stop], i2[y, first:stop], i3[y, first:stop]
            m = mask[y, first:stop]
            close_row(
                a, b, c, d, half_period[y, first:stop], axis, scratch,
                coordinate[y, first:stop], half_dn[y, first:stop], m,
            )  # fmt: skip
            if axis.second:
                _failed_now(m, other[y, first:stop], flags[first:stop])
                if _any(flags[first:stop]):
                    _drop(flags[first:stop], other[y, first:stop])
        if 1 <= y <= rows:
            now = bad[(y - 1) % 2]
            now[:] = np.uint8(0)
            if before_stop > before_first:
                _judge_row(coordinate, y - 1, nothing, jump_px, bend_px, before_first, before_stop, now)
        if y >= 2:
            done = bad[y % 2]
            if _any(done):
                _name(done, mask[y - 2])
                _drop(done, coordinate[y - 2])
                if axis.second:
                    _drop(done, other[y - 2])
