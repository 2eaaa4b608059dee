"""Owns which of the finest fringes agrees best with what other periods say, as a kernel: all of them are tried.

Symbols: e = P (own + k) is the place of fringe k, P the finest period and ``own`` its phase in turns, 0 … 1; another period Q has there the
phase e / Q + begin.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

_ZERO, _FAR = np.float32(0.0), np.float32(np.inf)
_TURN = np.float32(2.0 * math.pi)
_TURNS_OF_COSINE = np.float32(2.0**0.5 / (2.0 * math.pi))
"""A cosine's slope is 2π / √2 to a turn, on the mean."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def choose_fringes(
    own: NDArray[np.float32],
    period_px: np.float32,
    end_px: np.float32,
    fringes: int,
    others: NDArray[np.float32],
    conventions: NDArray[np.float32],
    cosines: bool,
    found: NDArray[np.float32],
) -> None:
    """Write the places in px of the best fringes that begin before ``end_px``, and the sum of the squares, in turns, by which others disagree
    there, into ``found`` (2, n).

    ``others`` (m, n) are the others' phases in turns, or their ``cosines``; ``conventions`` (2, m) their periods in px and beginnings in turns.
    """
    best_px, best = found
    best_px[:], best[:] = _ZERO, _FAR
    edge_px, apart = np.empty_like(own), np.empty_like(own)
    for fringe in range(fringes):
        for x in range(own.size):
            edge_px[x] = period_px * (own[x] + np.float32(fringe))
            apart[x] = _ZERO
        # Each loop is short, and of one kind: so LLVM makes vector instructions of it.
        for k in range(len(others)):
            seen, other_px, begin = others[k], conventions[0, k], conventions[1, k]
            if cosines:
                for x in range(own.size):
                    if apart[x] < best[x]:
                        off = (np.cos(_TURN * (edge_px[x] / other_px + begin)) - seen[x]) * _TURNS_OF_COSINE
                        apart[x] += off * off
            else:
                for x in range(own.size):
                    off = edge_px[x] / other_px + begin - seen[x]
                    off -= np.rint(off)
                    apart[x] += off * off
        # What lies beyond the pattern looks like its other end where one fringe covers it.
        for x in range(own.size):
            if apart[x] < best[x] and edge_px[x] < end_px:
                best[x], best_px[x] = apart[x], edge_px[x]
