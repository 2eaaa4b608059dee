"""The selection of a row's points by limits, and their copy into the table of results.

A point needs neighbours of similar depth: eight differences of Z, in the rows above and below and in its own.

Symbols: z is the point's depth, near the number of its neighbours on the same surface. A run is source … source + size
− 1 of the scratch row, and goes to target … of the table; pixel is the flat index of the row's first column in the
image.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import GAP, SIGMA, X, Y, Z

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
_EIGHT_GOOD = np.uint64(0x0101010101010101)
_X, _Y, _Z, _GAP, _SIGMA = (np.uint64(place) for place in (X, Y, Z, GAP, SIGMA))


class PointLimits(NamedTuple):
    """Limits that a point must keep to be selected."""

    max_gap_mm: np.float32
    max_sigma_mm: np.float32
    min_depth_mm: np.float32
    max_depth_mm: np.float32
    max_step_mm: np.float32
    """Largest distance in depth to a neighbour of the same surface."""
    min_neighbours: np.float32
    """Least number of neighbours on the same surface, of eight."""


class Points(NamedTuple):
    """Columns of the table of results, one entry per left pixel at most."""

    xyz_mm: NDArray[np.float32]
    """(n, 3)."""
    gap_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    """Modulation of the left camera in half grey values."""
    pixel: NDArray[np.uint32]
    """Flat index of the left pixel."""
    intensity: NDArray[np.uint8]
    """Grey value of the left bright frame."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def judge(
    above: NDArray[np.float32],
    row: NDArray[np.float32],
    below: NDArray[np.float32],
    n: int,
    limits: PointLimits,
    good: NDArray[np.uint8],
) -> None:
    """Write 1 into ``good`` for the points of scratch row ``row`` that keep all limits, else 0.

    NaN keeps no limit.
    """
    max_gap_mm, max_sigma_mm, min_depth_mm, max_depth_mm, max_step_mm, min_neighbours = limits
    for x in range(n):
        z = row[Z + x]
        # Neighbours on the same surface; a sum of ones and zeros is a vector instruction, a branch is none.
        near = _ONE if abs(above[Z + x - 1] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(above[Z + x] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(above[Z + x + 1] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(row[Z + x - 1] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(row[Z + x + 1] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(below[Z + x - 1] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(below[Z + x] - z) <= max_step_mm else _ZERO
        near += _ONE if abs(below[Z + x + 1] - z) <= max_step_mm else _ZERO
        # All limits at once: NaN keeps none.
        inside = (z >= min_depth_mm) & (z <= max_depth_mm) & (near >= min_neighbours)
        fine = (row[GAP + x] <= max_gap_mm) & (row[SIGMA + x] <= max_sigma_mm)
        good[x] = np.uint8(1) if inside & fine else np.uint8(0)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def append(
    row: NDArray[np.float32],
    good: NDArray[np.uint8],
    bright: NDArray[np.uint8],
    half_dn: NDArray[np.uint8],
    n: int,
    stride: int,
    pixel: int,
    points: Points,
    count: int,
) -> int:
    """Append the good points of scratch row ``row``, run by run; return the new count.

    ``good`` has a multiple of eight elements. ``pixel``: flat index of the row's first column.

    A run is short, ten to a row: slices of the columns would count references, which takes longer than copying.
    Unsigned indices need no check for negative ones.
    """
    columns_xyz, gap_mm, sigma_mm, modulation_half_dn, pixels, intensity = points
    # X, Y and Z of point k lie at 3 k, 3 k + 1 and 3 k + 2.
    xyz_mm = columns_xyz.reshape(-1)
    step = np.uint64(stride)
    # Eight flags of one byte each, read as one number: 0x01…01 where all eight are good.
    eights = good.view(np.uint64)
    x = 0
    while x < n:
        # Find the next run of good points; eight flags are one comparison.
        while x < n and good[x] == 0:
            x += 1
        begin = x
        while x < n and good[x] != 0:
            x += 8 if x % 8 == 0 and x + 8 <= n and eights[x // 8] == _EIGHT_GOOD else 1
        size, source, target = np.uint64(x - begin), np.uint64(begin), np.uint64(count)
        # Copy it, one quantity after the other.
        first_xyz = np.uint64(3 * count)
        for k in range(size):
            place = first_xyz + k + k + k
            xyz_mm[place] = row[_X + source + k]
            xyz_mm[place + np.uint64(1)] = row[_Y + source + k]
            xyz_mm[place + np.uint64(2)] = row[_Z + source + k]
        for k in range(size):
            gap_mm[target + k] = row[_GAP + source + k]
        for k in range(size):
            sigma_mm[target + k] = row[_SIGMA + source + k]
        # Neighbours in the grid are ``stride`` columns apart in the image.
        first_pixel = np.uint32(pixel + begin * stride)
        for k in range(size):
            pixels[target + k] = first_pixel + np.uint32(k) * np.uint32(stride)
        # In the maps, neighbours in the grid are ``stride`` columns apart, too.
        if stride == 1:
            for k in range(size):
                modulation_half_dn[target + k] = half_dn[source + k]
            for k in range(size):
                intensity[target + k] = bright[source + k]
        else:
            for k in range(size):
                modulation_half_dn[target + k] = half_dn[(source + k) * step]
                intensity[target + k] = bright[(source + k) * step]
        count += x - begin
    return count
