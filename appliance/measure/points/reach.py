"""The coordinates that the right image can have near each piece of an epipolar curve.

Only pieces that may have a pixel's coordinate are searched (``one_direction.py``).

Symbols: s runs along the curve from −1 to 1 (``measure/light/epipolar.py``), (u, v) is a place in the right image.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from appliance.measure.light.epipolar import RAY_TERMS, EpipolarCurves

PIECE_PX = 8
"""Length of a curve's pieces in the right image, and side of the blocks of which the extremes are kept."""
CUBIC_REACH = 5
"""Number of nodes across and down from which a pixel near a node is interpolated."""
REACH_ROWS = 4
"""Number of rows of cells that are computed together, which bounds the memory."""
TOGETHER = 16
"""Number of pieces that are skipped together where none can have the coordinate: only few can."""
MOST_PIECES = 2_000
"""Largest number of pieces of a curve, more than for any image; beyond it pieces become longer."""


def reach_along(
    curves: EpipolarCurves, coordinate_px: NDArray[np.float32], step_px: float
) -> Iterator[tuple[int, NDArray[np.float32], NDArray[np.float32]]]:
    """Yield, for some rows of cells at a time, their first number and the right coordinate's extremes.

    The extremes are (rows, across, 2, pieces) float32: least and greatest coordinate of the right image, from blocks
    near a piece of a curve of the cell between four nodes; NaN where it has none. Pieces have equal lengths in s. A
    third array has the same of ``TOGETHER`` pieces each. ``coordinate_px`` (h, w) is the right image's map, ``step_px``
    its usual change from pixel to pixel.
    """
    height, width = coordinate_px.shape
    padded = np.full((-(-height // PIECE_PX) * PIECE_PX, -(-width // PIECE_PX) * PIECE_PX), np.nan, np.float32)
    padded[:height, :width] = coordinate_px
    tiles = padded.reshape(-1, PIECE_PX, padded.shape[1] // PIECE_PX, PIECE_PX)
    lowest, greatest = (extreme.reduce(extreme.reduce(tiles, axis=3), axis=1) for extreme in (np.fmin, np.fmax))
    pieces = _pieces(curves)
    s = np.linspace(-1.0, 1.0, pieces + 1)
    down, across = curves.nodes.shape[:2]
    begins = np.arange(0, pieces, TOGETHER)
    # Some rows at a time: all rows of a large image need much memory.
    for begin in range(0, down - 1, REACH_ROWS):
        node_places = places(curves, s, slice(begin, begin + REACH_ROWS + 1))
        reach = np.full((len(node_places) - 1, across - 1, 2, pieces), np.nan, np.float32)
        _fill_reach(node_places, lowest, greatest, width, height, np.float32(step_px), reach)
        low, high = (extreme.reduceat(reach[:, :, k], begins, axis=-1) for k, extreme in enumerate((np.fmin, np.fmax)))
        yield begin, reach, np.stack([low, high], axis=2)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _fill_reach(
    node_places: NDArray[np.float64],
    lowest: NDArray[np.float32],
    greatest: NDArray[np.float32],
    width: int,
    height: int,
    step_px: np.float32,
    reach: NDArray[np.float32],
) -> None:
    """Write the extremes of each cell between four of the node places; NaN where there are none.

    ``node_places``: (rows, columns, ends of pieces, 2).
    """
    for j in range(reach.shape[0]):
        for i in range(reach.shape[1]):
            for k in range(reach.shape[3]):
                # A cell's piece lies within the box around its four nodes' places at both of its ends.
                u0, v0, u1, v1 = np.inf, np.inf, -np.inf, -np.inf
                for corner in range(8):
                    u = node_places[j + corner // 4, i + corner // 2 % 2, k + corner % 2, 0]
                    v = node_places[j + corner // 4, i + corner // 2 % 2, k + corner % 2, 1]
                    if u != u or v != v:
                        u0 = np.nan
                        break
                    u0, v0, u1, v1 = min(u0, u), min(v0, v), max(u1, u), max(v1, v)
                u0, v0, u1, v1 = u0 - 2.0, v0 - 2.0, u1 + 2.0, v1 + 2.0
                if not (u1 > -0.5 and v1 > -0.5 and u0 < width - 0.5 and v0 < height - 0.5):
                    continue
                # Least and greatest of all blocks of the box; NaN is neither less nor greater.
                low, high = np.float32(np.inf), np.float32(-np.inf)
                for y in range(int(max(v0, 0.0)) // PIECE_PX, int(min(v1, height - 1.0)) // PIECE_PX + 1):
                    for x in range(int(max(u0, 0.0)) // PIECE_PX, int(min(u1, width - 1.0)) // PIECE_PX + 1):
                        low = lowest[y, x] if lowest[y, x] < low else low
                        high = greatest[y, x] if greatest[y, x] > high else high
                if low <= high:
                    # A crossing may lie up to a pixel beyond the last one that has a coordinate.
                    reach[j, i, 0, k], reach[j, i, 1, k] = low - step_px, high + step_px


def _pieces(curves: EpipolarCurves) -> int:
    """Return the number of pieces of all curves: none is longer than ``PIECE_PX``."""
    s = np.linspace(-1.0, 1.0, 33)
    speed = np.abs(np.diff(places(curves, s), axis=2)).max(axis=-1) / (s[1] - s[0])
    longest = 2.0 * float(np.nanmax(speed)) if np.isfinite(speed).any() else 0.0
    return min(max(1, math.ceil(longest / PIECE_PX)), MOST_PIECES)


def places(curves: EpipolarCurves, s: NDArray[np.float64], rows: slice = slice(None)) -> NDArray[np.float64]:
    """Return the places (rows, columns, len(s), 2) in px of the nodes' curves.

    NaN where the right camera does not see all places from which a pixel near the node is interpolated.
    """
    terms = curves.nodes[rows, :, RAY_TERMS:]
    terms = terms.reshape(*terms.shape[:2], 2, curves.degree + 1)
    place = np.moveaxis(terms @ s ** np.arange(curves.degree + 1)[:, None], 2, -1)
    # A cubic uses nodes up to two away; three at the border.
    low = ndimage.maximum_filter(curves.seen[..., 0], CUBIC_REACH)[rows, :, None]
    high = ndimage.minimum_filter(curves.seen[..., 1], CUBIC_REACH)[rows, :, None]
    place[(s < low) | (s > high)] = np.nan
    return np.asarray(place)
