"""The phase of a pixel: four sine images and a Gray code become a pattern coordinate and a modulation.

close_row, AxisDecoding     our sequence, four steps of 90°
fit_steps                   any number of steps, for other rigs' images
choose_fringes              the fringe order from fringes of several periods, for other rigs' images

Step k shows I_k = A + B cos(φ + k·90°), so that I0 − I2 = 2B cos φ and I3 − I1 = 2B sin φ: the length of that vector is
the modulation B in half grey values, its angle the phase. The Gray code numbers half periods; the middle of the half
period determines the fringe order.

The kernels work row by row, each row in short loops whose floats lie in one array at constant distances, which LLVM
vectorises (see ``scratch``); results between the loops stay in the first-level cache. Numbers in a loop have 32 bits,
also where eight would suffice: mixed widths cost more than they save.

Symbols: cosine = I0 − I2, sine = I3 − I1; a, b are their sizes, t = min/max of them, r an angle in turns. P is the
period, middle the middle of the Gray half period in periods, off the phase less middle; the coordinate is p = P (middle
+ off) − ½ px.

``fit_steps`` and ``phase`` convert cosine and sine to a phase by the same function, and C = (I0 − I2) / 2, S = (I3 −
I1) / 2 of four steps of 90° are exact in float32: the same four images give the same phase, byte for byte. Its symbols:
image k shows I_k = A + B cos(φ + δ_k) = A + C cos δ_k − S sin δ_k; A, C and S are weights times the images.

``choose_fringes`` tries all fringes of the finest period. Its symbols: e = P (own + k) is the place of fringe k, P the
finest period and ``own_phase`` its phase in turns, 0 … 1; another period Q has there the phase e / Q + begin.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.scratch import COORDINATE, MODULATION_HALF_DN

_ZERO = np.float32(0.0)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def fit_steps(
    images: NDArray[Any],
    weights: NDArray[np.float32],
    columns: NDArray[np.float32],
    white: np.float32,
    results: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    saturated: NDArray[np.bool_],
) -> None:
    """Fit sines to ``images`` (n, h, w) by ``weights`` (3, n), which give A, C and S.

    ``columns`` (2, n) are cos δ_k and sin δ_k. Writes phase in turns, modulation B, offset A and RMS residual into
    ``results``, four (h, w), and to ``saturated`` (h, w) whether an image reaches ``white``. The residual of three
    steps is 0.
    """
    count, height, width = images.shape
    mean, cosine = np.empty(width, np.float32), np.empty(width, np.float32)
    sine, residual = np.empty(width, np.float32), np.empty(width, np.float32)
    phase, modulation, offset, misfit = results
    freedom = np.float32(max(count - 3, 1))
    for y in range(height):
        mean[:], cosine[:], sine[:], residual[:] = _ZERO, _ZERO, _ZERO, _ZERO
        saturated[y] = False
        # Image by image along the row: sums of weights times images.
        for k in range(count):
            a, c, s = weights[0, k], weights[1, k], weights[2, k]
            for x in range(width):
                value = np.float32(images[k, y, x])
                mean[x] += a * value
                cosine[x] += c * value
                sine[x] += s * value
                saturated[y, x] |= value >= white
        # Residual: I_k − A − C cos δ_k + S sin δ_k.
        for k in range(count):
            along, across = columns[0, k], columns[1, k]
            for x in range(width):
                off = np.float32(images[k, y, x]) - mean[x] - along * cosine[x] + across * sine[x]
                residual[x] += off * off
        for x in range(width):
            phase[y, x] = turns_of(cosine[x], sine[x])
            modulation[y, x] = np.sqrt(cosine[x] * cosine[x] + sine[x] * sine[x])
            offset[y, x] = mean[x]
            misfit[y, x] = np.sqrt(residual[x] / freedom)


_FAR = np.float32(np.inf)
_TURN = np.float32(2.0 * math.pi)
_TURNS_OF_COSINE = np.float32(2.0**0.5 / (2.0 * math.pi))
"""A cosine's slope is 2π / √2 to a turn, on the mean."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def choose_fringes(
    own_phase: NDArray[np.float32],
    period_px: np.float32,
    end_px: np.float32,
    fringes: int,
    other_phases: NDArray[np.float32],
    conventions: NDArray[np.float32],
    cosines: bool,
    results: NDArray[np.float32],
) -> None:
    """Write the places in px of the best fringes that begin before ``end_px``, and their disagreement.

    ``results`` (2, n): places, and sums of the squared disagreement of the other phases, in turns. ``other_phases``
    (m, n) are these phases in turns, or their ``cosines``; ``conventions`` (2, m) their periods in px and beginnings in
    turns.
    """
    best_px, best = results
    best_px[:], best[:] = _ZERO, _FAR
    edge_px, apart = np.empty_like(own_phase), np.empty_like(own_phase)
    for fringe in range(fringes):
        for x in range(own_phase.size):
            edge_px[x] = period_px * (own_phase[x] + np.float32(fringe))
            apart[x] = _ZERO
        # Each loop is short and of one kind, so that LLVM vectorises it.
        for k in range(len(other_phases)):
            phase_or_cosine, other_px, begin = other_phases[k], conventions[0, k], conventions[1, k]
            if cosines:
                for x in range(own_phase.size):
                    if apart[x] < best[x]:
                        off = (np.cos(_TURN * (edge_px[x] / other_px + begin)) - phase_or_cosine[x]) * _TURNS_OF_COSINE
                        apart[x] += off * off
            else:
                for x in range(own_phase.size):
                    off = edge_px[x] / other_px + begin - phase_or_cosine[x]
                    off -= np.rint(off)
                    apart[x] += off * off
        # A place beyond the pattern looks like its other end if one fringe covers the pattern.
        for x in range(own_phase.size):
            if apart[x] < best[x] and edge_px[x] < end_px:
                best[x], best_px[x] = apart[x], edge_px[x]


ATAN_TURNS = tuple(
    np.float32(c)
    for c in (
        0.15915432572364807,
        -0.0530262365937233,
        0.03152511641383171,
        -0.021061517298221588,
        0.01267249882221222,
        -0.0053482758812606335,
        0.0010841300245374441,
    )
)
"""Coefficients of the minimax polynomial of atan(t)/2π on 0 … 1, odd powers of t.

Its error in float32 is 5.3e-8 turns, 8.5e-7 px of a 16-px period.
"""

_HALF, _QUARTER, _TINY = np.float32(0.5), np.float32(0.25), np.float32(1e-30)
_ONE, _MOST, _NAN = np.float32(1.0), np.float32(255.0), np.float32(np.nan)
_SATURATED, _WEAK, _CONTRADICTION, _VALID = np.int32(2), np.int32(3), np.int32(4), np.int32(0)
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = ATAN_TURNS


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def turns_of(cosine: np.float32, sine: np.float32) -> np.float32:
    """Return atan2(sine, cosine)/2π in turns, −½ … ½, within 6e-8; 0 if both are 0."""
    # atan on the first octant, then the other octants by symmetry.
    a, b = abs(cosine), abs(sine)
    t = min(a, b) / max(max(a, b), _TINY)
    t2 = t * t
    r = t * (_C0 + t2 * (_C1 + t2 * (_C2 + t2 * (_C3 + t2 * (_C4 + t2 * (_C5 + t2 * _C6))))))
    r = _QUARTER - r if b > a else r
    r = _HALF - r if cosine < _ZERO else r
    return -r if sine < _ZERO else r


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def phase(
    i0: NDArray[np.uint8], i1: NDArray[np.uint8], i2: NDArray[np.uint8], i3: NDArray[np.uint8], s: NDArray[np.float32]
) -> None:
    """Write the wrapped phase atan2(i3 − i1, i0 − i2)/2π in turns, −½ … ½, within 6e-8, into ``s``.

    It goes into COORDINATE; the length of that vector, the modulation in half grey values, into MODULATION_HALF_DN.
    Without modulation the phase is 0.
    """
    for x in range(i0.size):
        cosine, sine = np.float32(i0[x]) - np.float32(i2[x]), np.float32(i3[x]) - np.float32(i1[x])
        s[COORDINATE + x] = turns_of(cosine, sine)
        s[MODULATION_HALF_DN + x] = np.sqrt(cosine * cosine + sine * sine)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _mark_saturated(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> bool:
    """Mask pixels with a saturated sine image, unless they are masked already; return True if any."""
    any_reason = np.uint8(0)
    for x in range(mask.size):
        top = max(max(i0[x], i1[x]), max(i2[x], i3[x]))
        reason = np.uint8(_SATURATED) if top == np.uint8(255) else np.uint8(0)
        reason = reason if mask[x] == np.uint8(0) else np.uint8(0)
        any_reason = np.uint8(any_reason | reason)
        mask[x] = np.uint8(mask[x] | reason)
    return bool(any_reason != np.uint8(0))


class AxisDecoding(NamedTuple):
    """Parameters of closing one direction."""

    period_px: np.float32
    size_px: np.float32
    min_modulation_half_dn: np.float32
    max_offset: np.float32
    """Largest distance of the phase from the middle of its half period, in periods, without a contradiction."""
    second: bool
    """True if the other direction has been closed: the smaller modulation of both counts."""


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _place(
    half_period: NDArray[np.uint8],
    axis: AxisDecoding,
    s: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> bool:
    """Convert COORDINATE from turns to px: the middle of the Gray half period determines the fringe order.

    Writes mask and modulation. Returns True if further pixels were masked.
    """
    any_new = _VALID
    period_px, size_px, min_half_dn, max_offset = axis[:4]
    any_before = np.int32(0) if axis.second else np.int32(255)
    for x in range(mask.size):
        # off: phase less middle, wrapped to −½ … ½; p = P (middle + off) − ½.
        middle = _HALF * np.float32(half_period[x]) + _QUARTER
        off = s[COORDINATE + x] - middle
        off -= np.floor(off + _HALF)
        coordinate = period_px * middle + (period_px * off - _HALF)
        modulation = s[MODULATION_HALF_DN + x]
        # The first reason that applies remains: an earlier one, too little modulation, contradiction.
        wrong = (abs(off) > max_offset) | (coordinate < -_ONE) | (coordinate > size_px)
        reason = _CONTRADICTION if wrong else _VALID
        reason = _WEAK if modulation < min_half_dn else reason
        masked = np.int32(mask[x])
        reason = masked if masked != _VALID else reason
        any_new = np.int32(any_new | np.int32(reason ^ masked))
        mask[x] = np.uint8(reason)
        s[COORDINATE + x] = coordinate if reason == _VALID else _NAN
        # The smaller modulation of both directions, rounded, at most 255.
        before = np.int32(np.int32(half_dn[x]) | any_before)
        half_dn[x] = np.uint8(min(before, np.int32(min(modulation + _HALF, _MOST))))
    return bool(any_new != _VALID)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def close_row(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    axis: AxisDecoding,
    s: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> bool:
    """Close one row: COORDINATE of ``s`` in px (NaN where masked), modulation in half grey values, mask.

    Arrays are (n,). Returns True if further pixels were masked.
    """
    phase(i0, i1, i2, i3, s)
    saturated = _mark_saturated(i0, i1, i2, i3, mask)
    return _place(half_period, axis, s, half_dn, mask) or saturated
