"""The print of the ChArUco board, exact to fractions of a camera pixel.

The drawing is bilevel and consists of small squares (``CELL_MM``) without a remainder: the chessboard's, and the
markers' modules. A camera pixel sees the mean over its footprint.
"""

# Symbols:
#   x, y          point of the board's front in its own frame, mm; column, row the same in cells of the drawing
#   a, b          steps from a pixel to its right and lower neighbour, in cells: the pixel is the parallelogram ±a/2 ± b/2
#   i0..i1, j0..j1   cells that the parallelogram touches

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.shapes import (
    BOARD_BOW,
    BOARD_FORM,
    BOARD_HALF_X_MM,
    BOARD_HALF_Y_MM,
    BOARD_SCALE,
    S_PEAK,
    SIZES,
    rise,
)

Array = NDArray[np.float64]
Ink = NDArray[np.uint8]

ACROSS, DOWN = 15, 12
SQUARE_MM, MARKER_MM = 18.0, 13.5
DICTIONARY = cv2.aruco.DICT_5X5_250
CELLS = 56
"""Cells along a square: 7 of them lie between square and marker, 6 make a module of a marker (7 modules with its rim)."""
CELL_MM = SQUARE_MM / CELLS
PAPER, INK = 0.6, 0.04
"""Albedos."""
EDGE_MM, LEAST_SLOPE = 0.01, 0.2
"""Distance from the plate's edge and slope of the ray below which ``front_met`` is not used."""
SAMPLES, TURN = 233, 144
"""A Fibonacci lattice: evenly spread over a pixel. Only where more than one edge crosses a pixel."""


def board_print() -> Ink:
    """Return the drawing (DOWN × CELLS, ACROSS × CELLS) uint8: 1 for paper, 0 for ink.

    The top left square is row 0.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    board = cv2.aruco.CharucoBoard((ACROSS, DOWN), SQUARE_MM, MARKER_MM, dictionary)
    drawn = np.asarray(board.generateImage((ACROSS * CELLS, DOWN * CELLS)), np.uint8)
    return (drawn > 127).astype(np.uint8)


def corners_mm(scale: float = 1.0) -> Array:
    """Return the inner corners ((ACROSS − 1)(DOWN − 1), 3) float64 of the print, mm, row by row.

    They are in the object frame, without the bow.
    """
    x, y = np.meshgrid(np.arange(1, ACROSS) - 0.5 * ACROSS, np.arange(1, DOWN) - 0.5 * DOWN)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1) * (SQUARE_MM * scale)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _paper(ink: Ink, i: int, j: int) -> float:
    """Return 1 for paper, which is also around the print, and 0 for ink."""
    if i < 0 or j < 0 or i >= ink.shape[1] or j >= ink.shape[0]:
        return 1.0
    return float(ink[j, i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _before(edge: float, a: float, b: float) -> float:
    """Return the share of a pixel before an edge; its coordinate is a u + b v, u and v in ±½."""
    # u a + v b with u, v even in ±½ has a trapezoid as density: flat within wide − narrow, zero beyond wide + narrow.
    wide, narrow = 0.5 * max(abs(a), abs(b)), 0.5 * min(abs(a), abs(b))
    end = wide + narrow - abs(edge)
    if end <= 0.0:
        beyond = 0.0
    elif abs(edge) >= wide - narrow:
        beyond = end * end / (8.0 * wide * narrow)
    else:
        beyond = 0.5 - 0.5 * abs(edge) / wide
    return beyond if edge < 0.0 else 1.0 - beyond


@numba.njit(nogil=True, cache=True, error_model="numpy")
def printed(
    ink: Ink, sizes: Array, x: float, y: float, right_x: float, right_y: float, down_x: float, down_y: float
) -> float:
    """Return the mean albedo of a pixel's footprint at (x, y) of the object frame, mm.

    ``right`` and ``down`` lead to the footprints of its neighbours.
    """
    per_mm = 1.0 / (CELL_MM * sizes[BOARD_SCALE])
    column, row = x * per_mm + 0.5 * ink.shape[1], y * per_mm + 0.5 * ink.shape[0]
    ax, ay, bx, by = right_x * per_mm, right_y * per_mm, down_x * per_mm, down_y * per_mm
    reach_x, reach_y = 0.5 * (abs(ax) + abs(bx)), 0.5 * (abs(ay) + abs(by))
    i0, i1 = math.floor(column - reach_x), math.floor(column + reach_x)
    j0, j1 = math.floor(row - reach_y), math.floor(row + reach_y)
    share = -1.0
    # At most four cells: where one straight edge parts them, its share is exact.
    if i1 <= i0 + 1 and j1 <= j0 + 1:
        a, b, c, d = _paper(ink, i0, j0), _paper(ink, i1, j0), _paper(ink, i0, j1), _paper(ink, i1, j1)
        if a == b and c == d:
            share = a if a == c else c + (a - c) * _before(j1 - row, ay, by)
        elif a == c and b == d:
            share = b + (a - b) * _before(i1 - column, ax, bx)
    if share < 0.0:
        share = 0.0
        for k in range(SAMPLES):
            # Otherwise average over the lattice: u evenly, v by the golden ratio (TURN / SAMPLES).
            u = (k + 0.5) / SAMPLES - 0.5
            v = ((k * TURN) % SAMPLES + 0.5) / SAMPLES - 0.5
            share += _paper(ink, math.floor(column + u * ax + v * bx), math.floor(row + u * ay + v * by))
        share /= SAMPLES
    return INK + (PAPER - INK) * share


@numba.njit(nogil=True, cache=True, error_model="numpy")
def front_met(sizes: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Return the length, mm, of a ray to the board's printed front; NaN if it is oblique or misses.

    It is the result of ``shapes.march`` in a fifth of the time: the front is nearly a plane, and each round makes the
    error a thousand times smaller.
    """
    if dz < LEAST_SLOPE:
        return math.nan
    formed = sizes.size > SIZES
    far = -oz / dz
    for _ in range(3):
        x, y = ox + far * dx, oy + far * dy
        # Fixed point: intersect with the plane at the front's height at the last intersection.
        bent = sizes[BOARD_BOW] * (1.0 - (x * x + y * y) * (2.0 / (BOARD_HALF_X_MM * BOARD_HALF_X_MM)))
        if formed:
            bent = rise(sizes, BOARD_BOW, BOARD_FORM, BOARD_HALF_X_MM, x, y)
        far = (bent - oz) / dz
    x, y = ox + far * dx, oy + far * dy
    if abs(x) > BOARD_HALF_X_MM - EDGE_MM or abs(y) > BOARD_HALF_Y_MM - EDGE_MM:
        return math.nan
    return far


@numba.njit(nogil=True, cache=True, error_model="numpy")
def lean(sizes: Array, x: float, y: float) -> tuple[float, float]:
    """Return the slopes dz/dx, dz/dy of the bent front.

    They are the derivative of z = bow (1 − 2 r²/a²), or of ``shapes.rise``.
    """
    k = -4.0 * sizes[BOARD_BOW] / (BOARD_HALF_X_MM * BOARD_HALF_X_MM)
    slope_x, slope_y = k * x, k * y
    if sizes.size > SIZES:
        p, q = x / BOARD_HALF_X_MM, y / BOARD_HALF_X_MM
        saddle, twist = 2.0 * sizes[BOARD_FORM], 2.0 * sizes[BOARD_FORM + 1]
        bend = sizes[BOARD_FORM + 2] * S_PEAK * (1.0 - 3.0 * p * p)
        slope_x += (saddle * p + twist * q + bend) / BOARD_HALF_X_MM
        slope_y += (twist * p - saddle * q) / BOARD_HALF_X_MM
    return slope_x, slope_y
