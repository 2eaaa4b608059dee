"""Half-period orders of pixels with doubtful Gray bits, from their piece or their neighbours.

Pieces. Where backscatter is brighter than the object, hardly a pixel has reliable bits in all of its Gray images, but
nearly each in some. Within a piece, in which the wrapped phase continues from neighbour to neighbour, all pixels share
one unknown: the fringe order of the first pixel. Each reliable bit, of whichever image and pixel, votes on it.
A bit that is ambiguous in one image (is more of the water illuminated, or the object?) is decided by the others, and
nothing is extrapolated.

Symbols: c a pixel's coordinate in periods, counted from the phase of the piece's first pixel; K the number that makes
it the pattern's. r is the integer part of 2 c: a half period. States are those of ``backscatter``: a bit 0 or 1, _OPEN
if it is doubtful, _NONE without light.

Neighbours. Noise in turbid water may carry a Gray bit across its threshold, while the phase is known to a hundredth of
a period. Only the fringe order is in doubt, and the next order is farther away on the pattern than neighbours on one
surface are from each other. So a doubtful pixel takes the order in which its phase continues theirs, if its reliable
bits agree. Pixels that were decided so decide others: two sweeps, down and up again.

Symbols, in periods of the pattern: ``turns`` wrapped phase −½ … ½, c a neighbour's coordinate, order a pixel's fringe
order.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.gray_code import periods

NEAR = 0.3
"""Largest distance, in periods, of neighbours on one surface; half a period would be ambiguous."""
AGREEING = 3
"""Least number of neighbours, of eight, that must give the same fringe order; none may give another."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _turns(frames: NDArray[np.uint8], sine: NDArray[np.int64], y: int, x: int) -> float:
    """Return the wrapped phase of a pixel, as −½ … ½ of a period."""
    cosine = np.float32(frames[sine[0], y, x]) - np.float32(frames[sine[2], y, x])
    quadrature = np.float32(frames[sine[3], y, x]) - np.float32(frames[sine[1], y, x])
    turns: float = np.float32(0.5 / np.pi) * np.arctan2(quadrature, cosine)
    return turns


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _decide_by_neighbours(
    frames: NDArray[np.uint8],
    sine: NDArray[np.int64],
    y: int,
    x: int,
    soft: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> bool:
    """Write the half-period order of one doubtful pixel from its neighbours; return True if decided."""
    turns = _turns(frames, sine, y, x)
    votes, order = 0, 0
    for j in range(y - 1, y + 2):
        for i in range(x - 1, x + 2):
            if doubtful[j, i] == 0:
                theirs = _turns(frames, sine, j, i)
                ahead = np.float32(periods(half_period[j, i], theirs)) + theirs - turns
                named = int(np.floor(ahead + np.float32(0.5)))
                if abs(ahead - np.float32(named)) <= np.float32(NEAR):
                    if votes > 0 and named != order:
                        return False
                    votes, order = votes + 1, named
    if votes < AGREEING or order + turns < 0.0:
        return False
    number = int(np.floor(np.float32(2.0) * (np.float32(order) + turns)))
    # The pixel's reliable bits must agree. At the border of two half periods either is accepted.
    code = int(half_period[y, x]) ^ (int(half_period[y, x]) >> 1)
    beyond_doubt = 255 ^ int(soft[y, x])
    for candidate in (number, number - 1, number + 1):
        same = ((candidate ^ (candidate >> 1)) ^ code) & beyond_doubt == 0
        if same and 0 <= candidate < 256 and periods(candidate, turns) == order:
            half_period[y, x] = np.uint8(candidate)
            return True
    return False


@numba.njit(nogil=True, cache=True, error_model="numpy")
def decide_by_neighbours(
    frames: NDArray[np.uint8],
    sine: NDArray[np.int64],
    soft: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    doubtful: NDArray[np.uint8],
) -> int:
    """Decide doubtful pixels by their neighbours; return the number of decided pixels.

    Writes ``half_period`` and 0 into ``doubtful``. All maps are (h, w) uint8: ``soft`` holds a 1 in each doubtful Gray
    bit, ``doubtful`` 1 where that matters. ``frames`` are (n, h, w) uint8; ``sine`` (4,) are the indices of the sine
    frames.
    """
    rows, columns = doubtful.shape
    settled = 0
    for sweep in range(2):
        for k in range(1, rows - 1):
            y = k if sweep == 0 else rows - 1 - k
            for i in range(1, columns - 1):
                x = i if sweep == 0 else columns - 1 - i
                if doubtful[y, x] == 1 and _decide_by_neighbours(frames, sine, y, x, soft, half_period, doubtful):
                    doubtful[y, x] = np.uint8(0)
                    settled += 1
    return settled


Floats = NDArray[np.float32]


"""Largest step of the phase, in periods, between neighbouring samples of a piece; half a period would be ambiguous."""
INSIDE = 0.3
"""Largest distance of a sample from the middle of its half period, in half periods, outside of a stripe's blur."""
LEAST_AHEAD = 20
"""Least number of votes by which K must be ahead of any other."""
MOST_AGAINST = 0.1
"""Largest share of contrary votes of coarse images: a piece across a depth discontinuity has more."""
REACH = 128
"""Number of half periods to either side of a piece's first pixel."""
UNDECIDED = -1000
"""K of an undecided piece."""
_ONE_BIT, _OPEN, _NONE = np.uint8(1), np.uint8(2), np.uint8(3)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _grow(
    first: int, turns: Floats, ahead: Floats, piece: NDArray[np.int32], mine: int, queue: NDArray[np.int32]
) -> int:
    """Write c of all samples that are connected with ``first`` into ``ahead``; return their number.

    Their ``piece`` becomes ``mine``.
    """
    columns = turns.shape[1]
    y, x = first // columns, first % columns
    ahead[y, x], piece[y, x], queue[0] = turns[y, x], mine, first
    done, size = 0, 1
    while done < size:
        y, x = queue[done] // columns, queue[done] % columns
        done += 1
        for side in range(4):
            # Right, left, below, above.
            j, i = (
                y + (1 if side == 2 else 0) - (1 if side == 3 else 0),
                x + (1 if side == 0 else 0) - (1 if side == 1 else 0),
            )
            if j < 0 or i < 0 or j >= turns.shape[0] or i >= columns or piece[j, i] != 0:
                continue
            step = turns[j, i] - turns[y, x]
            step -= np.floor(step + np.float32(0.5))
            # NaN, without light, is near to no phase.
            if abs(step) <= np.float32(NEAR) and abs(ahead[y, x] + step) < np.float32(REACH // 2 - 1):
                ahead[j, i], piece[j, i], queue[size] = ahead[y, x] + step, mine, j * columns + i
                size += 1
    return size


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _settle(
    members: NDArray[np.int32], ahead: Floats, states: NDArray[np.uint8], coarse: int, votes: NDArray[np.int32]
) -> int:
    """Return K of a piece by the reliable bits of its members; UNDECIDED if they do not agree on one.

    ``states`` (images, h, w), of which the first ``coarse`` are those of wide stripes; ``votes`` (images, 2 REACH, 2)
    is scratch.
    """
    images, columns = states.shape[0], ahead.shape[1]
    # Count the reliable bits by image and half period r.
    votes[:] = 0
    lowest, highest = 2 * REACH, 0
    for member in members:
        y, x = member // columns, member % columns
        half = np.float32(2.0) * ahead[y, x]
        r = int(np.floor(half))
        if abs(half - np.float32(r) - np.float32(0.5)) <= np.float32(INSIDE):
            lowest, highest = min(lowest, r + REACH), max(highest, r + REACH)
            for k in range(images):
                if states[k, y, x] <= _ONE_BIT:
                    votes[k, r + REACH, states[k, y, x]] += 1
    # Try each K that leaves all numbers r + 2 K within the pattern; wrong counts the votes against it.
    halves = 2**images
    best, second, chosen = 2**30, 2**30, UNDECIDED
    against, votes_asked = 0, 0
    for order in range(-(highest - REACH) // 2 - 1, (halves - (lowest - REACH)) // 2 + 1):
        if lowest - REACH + 2 * order < 0 or highest - REACH + 2 * order >= halves:
            continue
        wrong, wrong_coarse, of_coarse = 0, 0, 0
        for place in range(lowest, highest + 1):
            number = place - REACH + 2 * order
            # Reflected Gray code: g = b xor b/2.
            gray = number ^ (number >> 1)
            for k in range(images):
                contrary_bit = 1 - ((gray >> (images - 1 - k)) & 1)
                wrong += votes[k, place, contrary_bit]
                if k < coarse:
                    wrong_coarse += votes[k, place, contrary_bit]
                    of_coarse += votes[k, place, 0] + votes[k, place, 1]
        # The least contradicted K, and the next one.
        if wrong < best:
            best, second, chosen, against, votes_asked = wrong, best, order, wrong_coarse, of_coarse
        elif wrong < second:
            second = wrong
    # K must be clearly better than the next; a piece of two surfaces has votes against every K.
    if second - best < LEAST_AHEAD or against > MOST_AGAINST * votes_asked:
        return UNDECIDED
    return chosen


@numba.njit(nogil=True, cache=True, error_model="numpy")
def find_pieces(turns: Floats) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32]]:
    """Return c (h, w), the samples' flat indices piece by piece, and the end of each piece in them.

    ``turns`` (h, w) float32 is the wrapped phase in periods, NaN if unknown. Pieces that are too small are omitted.
    """
    rows, columns = turns.shape
    piece, ahead = np.zeros((rows, columns), np.int32), np.zeros((rows, columns), np.float32)
    members = np.empty(rows * columns, np.int32)
    ends = np.empty(rows * columns // LEAST_AHEAD + 1, np.int32)
    size, piece_count, grown = 0, 0, 0
    for first in range(rows * columns):
        y, x = first // columns, first % columns
        if piece[y, x] == 0 and turns[y, x] == turns[y, x]:
            grown += 1
            count = _grow(first, turns, ahead, piece, grown, members[size:])
            if count >= LEAST_AHEAD:
                size += count
                ends[piece_count] = size
                piece_count += 1
    return ahead, members[:size], ends[:piece_count]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def decide_pieces(
    ahead: Floats,
    members: NDArray[np.int32],
    ends: NDArray[np.int32],
    is_decided: NDArray[np.bool_],
    states: NDArray[np.uint8],
    coarse: int,
) -> int:
    """Complete ``states`` (images, h, w) uint8 in undecided pieces; return the number of decided ones.

    ``is_decided`` (pieces,) marks the decided pieces (``find_pieces``). Samples whose fine bits do not all agree with
    the piece, or that lie on a stripe's border, get _OPEN in all images.
    """
    images, columns = states.shape[0], states.shape[2]
    votes = np.empty((images, 2 * REACH, 2), np.int32)
    new = 0
    for k in range(ends.size):
        if is_decided[k]:
            continue
        mine = members[(ends[k - 1] if k > 0 else 0) : ends[k]]
        order = _settle(mine, ahead, states, coarse, votes)
        if order == UNDECIDED:
            continue
        is_decided[k] = True
        new += 1
        for member in mine:
            y, x = member // columns, member % columns
            half = np.float32(2.0) * ahead[y, x]
            r = int(np.floor(half))
            number = r + 2 * order
            inside = abs(half - np.float32(r) - np.float32(0.5)) <= np.float32(INSIDE)
            gray, agrees = number ^ (number >> 1), inside and number >= 0 and number < 2**images
            for i in range(images):
                bit = (gray >> (images - 1 - i)) & 1
                agrees = agrees and (states[i, y, x] == bit or (i < coarse and states[i, y, x] == _OPEN))
            for i in range(images):
                if states[i, y, x] != _NONE:
                    bit = (gray >> (images - 1 - i)) & 1
                    states[i, y, x] = np.uint8(bit) if agrees else _OPEN
    return new
