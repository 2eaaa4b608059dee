"""Owns the choice among a row's points, and their way into the table of results."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.reconstruct.scratch import GAP, SCORE, SIGMA, Z_ABOVE, Z_MIDDLE, X, Y, Z

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


class Limits(NamedTuple):
    """What a point must keep to be chosen."""

    max_gap_mm: np.float32
    max_sigma_mm: np.float32
    min_depth_mm: np.float32
    max_depth_mm: np.float32
    max_step_mm: np.float32
    """Allowed distance in depth to a neighbour of the same surface."""
    min_neighbours: np.float32
    """On the same surface, of eight."""


class Points(NamedTuple):
    """Columns of the table of results, one entry per left pixel at most."""

    xyz_mm: NDArray[np.float32]
    """(n, 3)."""
    gap_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    """In half grey values, as ``intensity`` of the left camera."""
    pixel: NDArray[np.uint32]
    """Flat index of the left pixel."""
    intensity: NDArray[np.uint8]
    """Of the left bright frame."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _compare(
    left: NDArray[np.float32],
    centre: NDArray[np.float32],
    right: NDArray[np.float32],
    middle: NDArray[np.float32],
    max_step_mm: np.float32,
    score: NDArray[np.float32],
) -> None:
    """Add 1 for each of three points in a row that is near the middle one; NaN is near to nothing."""
    for x in range(score.size):
        z = middle[x]
        near = (_ONE if abs(left[x] - z) <= max_step_mm else _ZERO) + (
            _ONE if abs(centre[x] - z) <= max_step_mm else _ZERO
        )
        score[x] += near + (_ONE if abs(right[x] - z) <= max_step_mm else _ZERO)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def count_neighbours(s: NDArray[np.float32], n: int, max_step_mm: np.float32) -> None:
    """SCORE: how many of the eight neighbours of a point in Z_MIDDLE, between Z_ABOVE and Z, are near."""
    score, middle = s[SCORE : SCORE + n], s[Z_MIDDLE : Z_MIDDLE + n]
    score[:] = -_ONE  # the point itself is counted with its own row
    for row in (Z_ABOVE, Z_MIDDLE, Z):
        _compare(s[row - 1 : row - 1 + n], s[row : row + n], s[row + 1 : row + 1 + n], middle, max_step_mm, score)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def judge(s: NDArray[np.float32], kept: NDArray[np.float32], n: int, limits: Limits, good: NDArray[np.uint8]) -> None:
    """1 in ``good`` for points that keep all limits."""
    for x in range(n):
        z = s[Z_MIDDLE + x]
        inside = (z >= limits.min_depth_mm) & (z <= limits.max_depth_mm)
        company = s[SCORE + x] >= limits.min_neighbours
        fine = (kept[GAP + x] <= limits.max_gap_mm) & (kept[SIGMA + x] <= limits.max_sigma_mm)
        good[x] = np.uint8(1) if inside & company & fine else np.uint8(0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _interleave(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], xyz: NDArray[np.float32]
) -> None:
    for k in range(xyz.size // 3):
        xyz[3 * k] = x[k]
        xyz[3 * k + 1] = y[k]
        xyz[3 * k + 2] = z[k]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _copy(source: NDArray[np.float32], target: NDArray[np.float32]) -> None:
    for k in range(target.size):
        target[k] = source[k]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sample(source: NDArray[np.uint8], stride: int, target: NDArray[np.uint8]) -> None:
    if stride == 1:
        for k in range(target.size):
            target[k] = source[k]
    else:
        for k in range(target.size):
            target[k] = source[k * stride]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _number(pixel: NDArray[np.uint32], first: np.uint32, stride: np.uint32) -> None:
    for k in range(pixel.size):
        pixel[k] = first + np.uint32(k) * stride


@numba.njit(nogil=True, cache=True, error_model="numpy")
def append(
    kept: NDArray[np.float32],
    z: NDArray[np.float32],
    good: NDArray[np.uint8],
    bright: NDArray[np.uint8],
    half_dn: NDArray[np.uint8],
    n: int,
    stride: int,
    pixel: int,
    points: Points,
    count: int,
) -> int:
    """Append the good points of a row, run by run; return the new count. ``pixel``: the row's first flat index."""
    x = 0
    while x < n:
        while x < n and good[x] == 0:
            x += 1
        begin = x
        while x < n and good[x] != 0:
            x += 1
        end = count + x - begin
        xyz = points.xyz_mm[count:end].reshape(-1)
        _interleave(kept[X + begin :], kept[Y + begin :], z[Z_MIDDLE + begin :], xyz)
        _copy(kept[GAP + begin :], points.gap_mm[count:end])
        _copy(kept[SIGMA + begin :], points.sigma_mm[count:end])
        _sample(half_dn[begin * stride :], stride, points.modulation_half_dn[count:end])
        _number(points.pixel[count:end], np.uint32(pixel + begin * stride), np.uint32(stride))
        _sample(bright[begin * stride :], stride, points.intensity[count:end])
        count = end
    return count
