"""Owns the half periods of whole pieces of a surface: phases continue from pixel to pixel, and bits beyond doubt tell
the rest together.

Where backscatter outshines the object hardly a pixel is beyond doubt in all of its Gray images, but nearly each in
some. Within a piece, in which the wrapped phase goes on from neighbour to neighbour, all pixels share one unknown: the
number of whole periods that the first of them is off. Each bit beyond doubt, of whichever image and pixel, votes on it.
What an image alone leaves open (is more of the water lit, or is it the object?) the others decide, and nothing is
carried on by extrapolation.

Symbols: c a pixel's coordinate in periods, from the piece's first pixel's own phase on; K the number that makes it the
pattern's. r is twice c, whole: a half period. States are those of ``backscatter``: a bit 0 or 1, _OPEN where it is in
doubt, _NONE where nothing is seen.

It also owns the half periods that a pixel's neighbours tell where its own Gray bits leave it in doubt.

Noise in milk may carry a Gray bit across its threshold, while the fringes' phase is known to a hundredth of a period:
what is in doubt is only which of a few periods it is, and the next period is farther off on the pattern than neighbours
on one surface are from each other. So a pixel in doubt takes the period in which its phase continues theirs, if its own
bits, apart from those in doubt, name it, too. Neighbours that were told so tell others: two sweeps, down and up again.

Symbols, in periods of the pattern: ``turns`` wrapped phase −½ … ½, c a neighbour's coordinate, whole the number of
whole periods of a pixel's.
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


Floats = NDArray[np.float32]


"""Largest step of the phase, in periods, from one sample to the next of a piece: half a period could be either way."""
INSIDE = 0.3
"""Distance from the middle of a half period, in half periods, within which a sample's bits are not those of a stripe's
blurred border."""
LEAST_AHEAD = 20
"""Least number of votes by which K must be ahead of any other."""
MOST_AGAINST = 0.1
"""Largest share of the votes of coarse images against it: pieces that run over a step of the surface contradict
themselves."""
REACH = 128
"""Half periods to either side of a piece's first pixel."""
UNTOLD = -1000
"""K of a piece that nothing tells."""
_ONE_BIT, _OPEN, _NONE = np.uint8(1), np.uint8(2), np.uint8(3)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _grow(
    first: int, turns: Floats, ahead: Floats, piece: NDArray[np.int32], mine: int, queue: NDArray[np.int32]
) -> int:
    """Write c of all samples that hang together with ``first`` into ``ahead``, and ``mine`` into ``piece``; return how
    many are queued."""
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
            # NaN, where nothing is seen, is near to nothing.
            if abs(step) <= np.float32(NEAR) and abs(ahead[y, x] + step) < np.float32(REACH // 2 - 1):
                ahead[j, i], piece[j, i], queue[size] = ahead[y, x] + step, mine, j * columns + i
                size += 1
    return size


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _settle(
    members: NDArray[np.int32], ahead: Floats, states: NDArray[np.uint8], coarse: int, votes: NDArray[np.int32]
) -> int:
    """Return K of a piece, as its members' bits beyond doubt name it; UNTOLD where they do not agree on one.

    ``states`` (images, h, w), of which the first ``coarse`` are those of wide stripes; ``votes`` (images, 2 REACH, 2)
    is room.
    """
    images, columns = states.shape[0], ahead.shape[1]
    # Tally the bits beyond doubt by image and half period r.
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
    best, second, chosen = 2**30, 2**30, UNTOLD
    against, asked = 0, 0
    for whole in range(-(highest - REACH) // 2 - 1, (halves - (lowest - REACH)) // 2 + 1):
        if lowest - REACH + 2 * whole < 0 or highest - REACH + 2 * whole >= halves:
            continue
        wrong, wrong_coarse, of_coarse = 0, 0, 0
        for place in range(lowest, highest + 1):
            number = place - REACH + 2 * whole
            # Reflected Gray code: g = b xor b/2.
            gray = number ^ (number >> 1)
            for k in range(images):
                other = 1 - ((gray >> (images - 1 - k)) & 1)
                wrong += votes[k, place, other]
                if k < coarse:
                    wrong_coarse += votes[k, place, other]
                    of_coarse += votes[k, place, 0] + votes[k, place, 1]
        # The least contradicted K, and how much the next one is.
        if wrong < best:
            best, second, chosen, against, asked = wrong, best, whole, wrong_coarse, of_coarse
        elif wrong < second:
            second = wrong
    # One must be clearly better than the next; a piece of two surfaces has votes against any.
    if second - best < LEAST_AHEAD or against > MOST_AGAINST * asked:
        return UNTOLD
    return chosen


@numba.njit(nogil=True, cache=True, error_model="numpy")
def find_pieces(turns: Floats) -> tuple[Floats, NDArray[np.int32], NDArray[np.int32]]:
    """Return c (h, w), the samples' flat indices piece by piece, and where in these each piece ends.

    ``turns`` (h, w) float32 is the wrapped phase in periods, NaN where it is unknown. Pieces too small to be told are
    left out.
    """
    rows, columns = turns.shape
    piece, ahead = np.zeros((rows, columns), np.int32), np.zeros((rows, columns), np.float32)
    members = np.empty(rows * columns, np.int32)
    ends = np.empty(rows * columns // LEAST_AHEAD + 1, np.int32)
    size, found, grown = 0, 0, 0
    for first in range(rows * columns):
        y, x = first // columns, first % columns
        if piece[y, x] == 0 and turns[y, x] == turns[y, x]:
            grown += 1
            count = _grow(first, turns, ahead, piece, grown, members[size:])
            if count >= LEAST_AHEAD:
                size += count
                ends[found] = size
                found += 1
    return ahead, members[:size], ends[:found]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def tell_pieces(
    ahead: Floats,
    members: NDArray[np.int32],
    ends: NDArray[np.int32],
    told: NDArray[np.bool_],
    states: NDArray[np.uint8],
    coarse: int,
) -> int:
    """Complete ``states`` (images, h, w) uint8 in pieces (``find_pieces``) whose K is told and was not; return how many
    are.

    ``told`` (pieces,) says of which K is known. Samples whose fine bits do not all
    say the same as the piece, or that lie on a stripe's border, get _OPEN in all images.
    """
    images, columns = states.shape[0], states.shape[2]
    votes = np.empty((images, 2 * REACH, 2), np.int32)
    new = 0
    for k in range(ends.size):
        if told[k]:
            continue
        mine = members[(ends[k - 1] if k > 0 else 0) : ends[k]]
        whole = _settle(mine, ahead, states, coarse, votes)
        if whole == UNTOLD:
            continue
        told[k] = True
        new += 1
        for member in mine:
            y, x = member // columns, member % columns
            half = np.float32(2.0) * ahead[y, x]
            r = int(np.floor(half))
            number = r + 2 * whole
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
