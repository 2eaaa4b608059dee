"""Owns the half periods that a pixel's neighbours tell where its own Gray bits leave it in doubt.

Noise in milk may carry a Gray bit across its threshold, while the fringes' phase is known to a hundredth of a period: what is in doubt is only
which of a few periods it is, and the next period is farther off on the pattern than neighbours on one surface are from each other.
So a pixel in doubt takes the period in which its phase continues theirs, if its own bits, apart from those in doubt, name it, too.
Neighbours that were told so tell others: two sweeps, down and up again.

Symbols, in periods of the pattern: ``turns`` wrapped phase −½ … ½, c a neighbour's coordinate, whole the number of whole periods of a pixel's.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.gray_code import periods

NEAR = 0.3
"""Largest distance, in periods, of neighbours on one surface; half a period would name two periods alike."""
AGREEING = 3
"""Least number of neighbours, of eight, that must name the same period; none may name another."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _turns(frames: NDArray[np.uint8], sine: NDArray[np.int64], y: int, x: int) -> float:
    """Return the wrapped phase of a pixel, as −½ … ½ of a period."""
    cosine = np.float32(frames[sine[0], y, x]) - np.float32(frames[sine[2], y, x])
    quadrature = np.float32(frames[sine[3], y, x]) - np.float32(frames[sine[1], y, x])
    turns: float = np.float32(0.5 / np.pi) * np.arctan2(quadrature, cosine)
    return turns


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ask(
    frames: NDArray[np.uint8],
    sine: NDArray[np.int64],
    y: int,
    x: int,
    soft: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> bool:
    """Write the half period of one pixel in doubt as its neighbours tell it; return whether they do."""
    turns = _turns(frames, sine, y, x)
    votes, whole = 0, 0
    for j in range(y - 1, y + 2):
        for i in range(x - 1, x + 2):
            if doubtful[j, i] == 0:
                theirs = _turns(frames, sine, j, i)
                ahead = np.float32(periods(half_period[j, i], theirs)) + theirs - turns
                named = int(np.floor(ahead + np.float32(0.5)))
                if abs(ahead - np.float32(named)) <= np.float32(NEAR):
                    if votes > 0 and named != whole:
                        return False
                    votes, whole = votes + 1, named
    if votes < AGREEING or whole + turns < 0.0:
        return False
    number = int(np.floor(np.float32(2.0) * (np.float32(whole) + turns)))
    # Its own bits that are beyond doubt must say the same. On the border of two half periods either may be said.
    said = int(half_period[y, x]) ^ (int(half_period[y, x]) >> 1)
    beyond_doubt = 255 ^ int(soft[y, x])
    for other in (number, number - 1, number + 1):
        same = ((other ^ (other >> 1)) ^ said) & beyond_doubt == 0
        if same and 0 <= other < 256 and periods(other, turns) == whole:
            half_period[y, x] = np.uint8(other)
            return True
    return False


@numba.njit(nogil=True, cache=True, error_model="numpy")
def ask_neighbours(
    frames: NDArray[np.uint8],
    sine: NDArray[np.int64],
    soft: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> int:
    """Settle pixels in doubt by their neighbours: write ``half_period`` and 0 into ``doubtful``; return how many.

    All maps are (h, w) uint8: ``soft`` holds a 1 in each Gray bit that is in doubt, ``doubtful`` 1 where that matters.
    ``frames`` are (n, h, w) uint8; ``sine`` (4,) names those that tell the phase.
    """
    rows, columns = doubtful.shape
    settled = 0
    for sweep in range(2):
        for k in range(1, rows - 1):
            y = k if sweep == 0 else rows - 1 - k
            for i in range(1, columns - 1):
                x = i if sweep == 0 else columns - 1 - i
                if doubtful[y, x] == 1 and _ask(frames, sine, y, x, soft, half_period, doubtful):
                    doubtful[y, x] = np.uint8(0)
                    settled += 1
    return settled
