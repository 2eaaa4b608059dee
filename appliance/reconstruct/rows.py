"""Owns the way of one block of left rows to points: match, triangulate, choose, row by row, all in one cache."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.match import RightMaps, match_row
from appliance.reconstruct.scratch import (
    GAP,
    LIGHT,
    MODULATION,
    P_ABOVE,
    Q_ABOVE,
    SIGMA,
    SIZE,
    Z_ABOVE,
    Z_MIDDLE,
    P,
    Q,
    X,
    Y,
    Z,
)
from appliance.reconstruct.select import Limits, Points, append, count_neighbours, judge
from appliance.reconstruct.triangulate import Rays, SigmaFactors, triangulate_row

_NAN = np.float32(np.nan)


class LeftMaps(NamedTuple):
    """What is reconstructed, all (h, w)."""

    p_px: NDArray[np.float32]
    """NaN where there is no coordinate."""
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    bright: NDArray[np.uint8]
    light: NDArray[np.uint8]
    """Mean of the sine images, which is the middle between bright and dark."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _load(row: NDArray[Any], stride: int, factor: np.float32, target: NDArray[np.float32]) -> None:
    if stride == 1:
        for x in range(target.size):
            target[x] = factor * np.float32(row[x])
    else:
        for x in range(target.size):
            target[x] = factor * np.float32(row[x * stride])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _copy(source: NDArray[np.float32], target: NDArray[np.float32]) -> None:
    for x in range(target.size):
        target[x] = source[x]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ends(row: NDArray[np.float32]) -> tuple[int, int]:
    """First column with a coordinate, and the one behind the last."""
    first, stop = 0, row.size
    while first < stop and row[first] != row[first]:
        first += 1
    while stop > first and row[stop - 1] != row[stop - 1]:
        stop -= 1
    return first, stop


@numba.njit(nogil=True, cache=True, error_model="numpy")
def reconstruct_rows(
    left: LeftMaps,
    right: RightMaps,
    rays: Rays,
    limits: Limits,
    factors: SigmaFactors,
    start: int,
    stop: int,
    stride: int,
    points: Points,
    offset: int,
) -> int:
    """Write the points of left rows ``start`` … ``stop`` − 1 (every ``stride``-th) into ``points`` from ``offset`` on.

    Returns how many. ``start`` is a multiple of ``stride``. One row beyond either end is computed as well: a point is
    chosen by its eight neighbours. Every ``stride``-th row and column is a grid of its own, so that neighbours of a
    coarse cloud are ``stride`` px apart.
    """
    rows, columns = left.p_px.shape
    n = (columns + stride - 1) // stride
    s, kept = np.full(SIZE, _NAN, np.float32), np.full(SIZE, _NAN, np.float32)
    at = np.zeros(columns, np.int32)
    good = np.zeros(n, np.uint8)
    count = offset
    above = max(start - stride, 0)
    for y in range(above, min(stop, rows) + stride, stride):
        # What is in Z belongs to the row above.
        _copy(s[Z_MIDDLE : Z_MIDDLE + n], s[Z_ABOVE : Z_ABOVE + n])
        _copy(s[Z : Z + n], s[Z_MIDDLE : Z_MIDDLE + n])
        for quantity in (X, Y, GAP, SIGMA):
            _copy(s[quantity : quantity + n], kept[quantity : quantity + n])
        s[Z : Z + n] = _NAN
        if y < rows:
            _copy(s[P : P + n], s[P_ABOVE : P_ABOVE + n])
            _copy(s[Q : Q + n], s[Q_ABOVE : Q_ABOVE + n])
            _load(left.p_px[y], stride, np.float32(1.0), s[P : P + n])
            _load(left.q_px[y], stride, np.float32(1.0), s[Q : Q + n])
            _load(left.modulation_half_dn[y], stride, np.float32(0.5), s[MODULATION : MODULATION + n])
            _load(left.light[y], stride, np.float32(1.0), s[LIGHT : LIGHT + n])
            first, end = _ends(s[P : P + n])
            match_row(right, s[first:], end - first, stride == 1 and y > above, at)
            triangulate_row(rays, y, first * stride, stride, factors, s[first:], end - first)
        done = y - stride
        if start <= done < stop:
            count_neighbours(s, n, limits.max_step_mm)
            judge(s, kept, n, limits, good)
            count = append(
                kept,
                s,
                good,
                left.bright[done],
                left.modulation_half_dn[done],
                n,
                stride,
                done * columns,
                points,
                count,
            )
    return count - offset
