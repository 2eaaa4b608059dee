"""Owns the scratch row: one float32 buffer in which a row's quantities lie at constant distances.

LLVM turns a loop into vector instructions only when it knows that what is written is not what is read next. Separate
arrays need a test at run time for each pair, and beyond eight pairs it gives up. Within one array, at distances that are
constants, it needs none, so that a loop may have as many inputs and outputs as the formula has.

``s[GAP + x]`` is then what ``gap[x]`` would be. A row that needs those above it has a scratch row of its own: they take
turns, and nothing is copied from one to the next. What only the chunk in work needs lies in one more such buffer, always at its
beginning: it stays in the first-level cache, while the rows' own quantities, of all columns, fit into the second one.
"""

from __future__ import annotations

MAX_WIDTH_PX = 4096
_SLOT = MAX_WIDTH_PX + 272
"""Places between two quantities: 17 cache lines more than a multiple of 4096 bytes. Equal places in different slots must
not compete for the same lines, nor may a load look, by its last 12 bits, like a store that has just been made."""
_NAMES = 44
(
    P, Q,  # left coordinates
    U, V, U_START, V_START,  # right image point, and the pixel at which its Newton step begins
    UP, UQ, VQ, VP,  # inverse derivatives: px of the right image per px of the pattern
    PC, PL, PR, PT, PB, QC, QL, QR, QT, QB,  # right coordinates: centre, left, right, top, bottom
    SLOPE, MODULATION, MODULATION_RIGHT, OFFSET,
    BEND_RIGHT, RIGHT_SHARE, POINT_VARIANCE,  # towards sigma
    PHASE_VARIANCE, PHASE_VARIANCE_RIGHT,  # px² of the pattern, where maps carry it
    X1, Y1, SX1, SY1, X2, Y2, SX2, SY2, SHIFT, SHIFT_SLOPE,  # rays
    X, Y, Z, GAP, SIGMA,
) = (k * _SLOT + 8 for k in range(_NAMES))  # fmt: skip
"""First places of the quantities, eight before the first column: the neighbours of a row's ends are inside the slot."""
SIZE = _NAMES * _SLOT
"""Number of places in a scratch row."""

COORDINATE, MODULATION_HALF_DN = (k * _SLOT + 8 for k in range(2))
DECODING_SIZE = 2 * _SLOT
"""Number of places in the scratch row of a row that is being decoded."""
