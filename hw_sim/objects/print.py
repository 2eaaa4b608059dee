"""Owns the print of the ChArUco board: where there is ink, to the last fraction of a camera pixel.

The drawing is bilevel and consists of small squares (``CELL_MM``) without a remainder: the chessboard's, and the
markers' modules. A camera pixel sees the mean of what lies before it.
"""

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.shapes import BOARD_SCALE

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
SAMPLES, TURN = 233, 144
"""A Fibonacci lattice: evenly spread over a pixel whatever the direction of an edge."""


def board_print() -> Ink:
    """The drawing (DOWN × CELLS, ACROSS × CELLS) uint8: 1 for paper, 0 for ink; the top left square is row 0."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARY)
    board = cv2.aruco.CharucoBoard((ACROSS, DOWN), SQUARE_MM, MARKER_MM, dictionary)
    drawn = np.asarray(board.generateImage((ACROSS * CELLS, DOWN * CELLS)), np.uint8)
    return (drawn > 127).astype(np.uint8)


def corners_mm(scale: float = 1.0) -> Array:
    """The inner corners ((ACROSS − 1)(DOWN − 1), 3) of the print in the object frame, row by row; without the bow."""
    x, y = np.meshgrid(np.arange(1, ACROSS) - 0.5 * ACROSS, np.arange(1, DOWN) - 0.5 * DOWN)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1) * (SQUARE_MM * scale)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _paper(ink: Ink, column: float, row: float) -> float:
    """1 where there is paper; all around the print, too."""
    i, j = math.floor(column), math.floor(row)
    if i < 0 or j < 0 or i >= ink.shape[1] or j >= ink.shape[0]:
        return 1.0
    return float(ink[j, i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def printed(
    ink: Ink, sizes: Array, x: float, y: float, right_x: float, right_y: float, down_x: float, down_y: float
) -> float:
    """Mean albedo of what a pixel sees that looks at (x, y) of the object frame, mm; ``right`` and ``down`` lead to what
    its neighbours look at."""
    per_mm = 1.0 / (CELL_MM * sizes[BOARD_SCALE])
    column, row = x * per_mm + 0.5 * ink.shape[1], y * per_mm + 0.5 * ink.shape[0]
    ax, ay, bx, by = right_x * per_mm, right_y * per_mm, down_x * per_mm, down_y * per_mm
    reach_x, reach_y = 0.5 * (abs(ax) + abs(bx)), 0.5 * (abs(ay) + abs(by))
    first = _paper(ink, column, row)
    same = True
    for j in range(math.floor(row - reach_y), math.floor(row + reach_y) + 1):
        for i in range(math.floor(column - reach_x), math.floor(column + reach_x) + 1):
            same = same and _paper(ink, float(i), float(j)) == first
    share = first
    if not same:
        share = 0.0
        for k in range(SAMPLES):
            u = (k + 0.5) / SAMPLES - 0.5
            v = ((k * TURN) % SAMPLES + 0.5) / SAMPLES - 0.5
            share += _paper(ink, column + u * ax + v * bx, row + u * ay + v * by)
        share /= SAMPLES
    return INK + (PAPER - INK) * share
