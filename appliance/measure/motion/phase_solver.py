"""New pattern coordinates of the pixels: the x-sines read where each point went, and solved with their true phase steps.

A pixel's depth, its displacement and its phase depend on each other, so each pixel is solved in rounds: at a depth t
its four sines are read and solved (least squares), the phase and the Gray images make a column p, and p makes a better
t. The first depth is that of the row above, corrected as there: the ripple that motion makes runs along the fringes and
is nearly the same in both. Where that leads to nothing, the decoded depth is tried, at last a rough surface that is
known everywhere.

Nearly every pixel of a row settles in the first round, and each round takes all pixels that are left at once, in short
loops whose numbers lie in one array at constant distances: LLVM turns them into vector instructions
(``appliance.measure.decode.scratch`` says why).

Rows need no sines: where the depth is known, the fitted projector tells the row q to a tenth of a px, the same for both
cameras, better than a hand leaves it. So points that lost sight of the y-sines, or moved along with them, stay.

Legend of the kernels, per pixel number x of a list; ``s`` is a record of ``ROW``::

    t            depth, −1 … 1 (``displacement``); p, q pattern coordinates, px
    k            0 … 3, number of the x-sine
    y_k          grey value read for sine k, over the frame's gain; noise_k its variance as a share of a pixel's
    ψ_k          phase step of sine k: k π/2 and what the motion added
    a, m_c, m_s  offset and the two parts of the modulation: y_k = a + m_c cos ψ_k − m_s sin ψ_k; phase φ = atan2(m_s, m_c)
    n            (4,) the vector that contradicts every a, m_c, m_s
    V            variance of p, px²: (P/2π)² Var φ, P the fringes' period
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import MIN_MODULATION_DN
from appliance.measure.decode.phase import ATAN_TURNS
from appliance.measure.decode.scratch import MAX_WIDTH_PX
from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.motion.displacement import (
    FIRST_FRAME,
    FRAME_COEFFICIENTS,
    OF_PHASE,
    P_OF_T,
    Q_OF_T,
    DisplacementField,
    interpolate_row,
)
from appliance.measure.motion.row_reader import (
    Pictures,
    RowPixels,
    coefficient_row,
    locate,
    noise_row,
    parabola_row,
    places_in_frame,
    read_nearest,
    read_row,
)

Scratch = NDArray[np.void]
"""(1,) of ``ROW``. A kernel hands the array on, not its record: a record alone does not keep the memory alive."""

BRIGHT, FIRST_GRAY = 4, 5
"""Places of the followed frames behind the 4 x-sines: the bright frame, then the Gray images of x, then those of y."""
MAX_GRAY = 8
"""Number of Gray images of one direction that there is room for."""
MAX_ROUNDS = 4
"""Rounds from one beginning before a pixel is given up or taken as it is."""
BEGINNINGS = 3
"""Depths that a pixel is begun with: that of the row above, the decoded one, the rough one around."""
MAX_CONTRARY = np.float32(0.5)
"""Most that all Gray images together may say against an order, as a share of one image's full swing."""
MAX_T = np.float32(2.5)
"""Depths beyond are no depths."""
MAX_CONTRARY_DN = 20.0
"""Contradictions above this are no harmonic: the four sines saw different surfaces."""
MOST_SHARE = 1e3
"""Largest variance of an offset, in variances of a grey value, that the sines' light is told by; steps of 15° leave
200."""

_SLOT = MAX_WIDTH_PX + 272
"""Room for a quantity of one row: so that equal places of two quantities do not compete for the same cache lines."""
ROW = np.dtype([(name, np.float32, (*shape, _SLOT)) for name, shape in {
    "depth": (),  # t at the round's beginning
    "u": (), "v": (), "turns": (), "grey": (),  # of the frame that is read: place, change of phase, grey value
    "sine_grey": (4,), "sine_noise": (4,), "sine_turns": (4,), "step_cosine": (4,), "step_sine": (4,),  # y_k, noise_k, ψ_k
    "offset": (), "modulation": (), "phase": (), "variance": (), "misfit": (),  # solved; phase in turns, NaN: not good
    "offset_share": (),  # variance of the offset, in variances of a grey value
    "contrary": (), "response": (),  # contradiction of the sines, and what a harmonic makes of it
    "p_parabola": (3,),
    "order": (), "agreed": (),  # fringe order, and whether the Gray images bear it out (1 or 0)
    "clarity": (MAX_GRAY,), "carry": (MAX_GRAY,),  # of each Gray image: −1 … 1, how clearly it is dark or bright; whole (half)
    # periods that its phase is on
    "column": (), "nearer": (), "line": (), "change": (),  # p, the depth that follows from it, q there, by how much the depth
    # changed; NaN where the round led to nothing
}.items()])  # fmt: skip
"""The quantities of one row of pixels. They lie in one piece of memory at constant distances, so that LLVM turns loops over them into
vector instructions without asking whether one overlaps another."""
_NAN, _ZERO, _QUARTER, _HALF, _ONE, _TWO, _THREE, _FOUR, _SIX, _MOST = (
    np.float32(x) for x in (np.nan, 0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 255.0)
)
_P, _Q, _FIRST_GRAY, _NONE = (cast(int, np.int64(k)) for k in (P_OF_T, Q_OF_T, FIRST_GRAY, 0))
"""Whole numbers of a type of their own: for plain ones, numba would compile what is called with them for each value."""
_TURN, _TINY = np.float32(2.0 * np.pi), np.float32(1e-9)
_TAYLOR = tuple(np.float32(1.0 / math.factorial(n)) for n in range(9))
_LEAST_MODULATION = np.float32(MIN_MODULATION_DN)


class Sources(NamedTuple):
    """The images and maps that one camera is decoded from. Maps are (h, w)."""

    frames: NDArray[np.uint8]
    """(n, h, w): the sequence; every kind of array, writable or not, would be compiled for itself."""
    followed: NDArray[np.int64]
    """Numbers of the followed frames: 4 x-sines, bright, Gray images."""
    gains: NDArray[np.float32]
    """(8,): what the sine frames are multiplied by."""
    p_px: NDArray[np.float32]
    """Columns as decoded without regard to motion: where a pixel's depth is looked for first."""
    rough_t: NDArray[np.float32]
    """Depth everywhere, smooth: where it is looked for when that leads to nothing.

    NaN: the pixel is not asked, it sees no fringes.
    """


class Terms(NamedTuple):
    """Numbers of one scan and camera."""

    period_px: np.float32
    width_px: np.float32
    height_px: np.float32
    noise_dn: np.float32
    """Standard deviation of grey values at the object's mean light."""
    dark_dn2: np.float32
    """Variance at grey value 0."""
    shot_dn: np.float32
    """Variance per grey value."""
    gray: int
    """Number of Gray images of the first direction."""
    fill_px: int
    """Distance over which a depth is carried to pixels that have none."""
    settled_t: np.float32
    """A correction of the depth that changes nothing that is read."""
    harmonic: np.float32
    """Second harmonic of the fringes, as a share of the first."""


class RedecodedMaps(NamedTuple):
    """The maps (h, w) of one camera at the reference time."""

    p_px: NDArray[np.float32]
    """NaN where there is no coordinate."""
    q_px: NDArray[np.float32]
    """Row that the fitted projector shows there."""
    modulation_half_dn: NDArray[np.uint8]
    variance_px2: NDArray[np.float32]
    """Variance of p by the camera's noise, in px² of the pattern; NaN where there is no column."""
    misfit: NDArray[np.float32]
    """Contradiction of the x-sines, squared, over what noise makes it: 1 in the mean; NaN where there is no column."""
    bright: NDArray[np.uint8]
    offset_dn: NDArray[np.uint8]
    illuminated_columns: NDArray[np.int32]
    """(h, 2): first column of each row that has a coordinate, and the one behind the last."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _row_depths(
    at_row: NDArray[np.float32],
    every: RowPixels,
    p_px: NDArray[np.float32],
    fill_px: int,
    scratch: Scratch,
    t: NDArray[np.float32],
) -> None:
    """Write the depth of each pixel of a row by its column ``p_px`` (w,); where it has none, that of the nearest one.

    NaN where no column is nearer than ``fill_px``. ``every`` are all pixels of the row.
    """
    s = scratch[0]
    width = p_px.size
    for k in range(3):
        coefficient_row(at_row, every, _P + k, s.p_parabola[k][:width])
    for x in range(width):
        # t₁ = (p − c0) / c1, then t₁ − c2 t₁² / c1.
        c1 = s.p_parabola[1, x]
        first = (p_px[x] - s.p_parabola[0, x]) / c1
        t[x] = first - s.p_parabola[2, x] * first * first / c1
    after = width + fill_px
    for x in range(width - 1, -1, -1):
        after = x if p_px[x] == p_px[x] else after
        s.u[x] = after
    # Of the two ends of a gap the nearer one; of equally near ones the right one.
    before = -fill_px - 1
    for x in range(width):
        after = int(s.u[x])
        if p_px[x] == p_px[x]:
            before = x
        elif after - x <= min(fill_px, x - before):
            t[x] = t[after]
        elif x - before <= fill_px:
            t[x] = t[before]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def depth_rows(p_px: NDArray[np.float32], field: DisplacementField, fill_px: int, t: NDArray[np.float32]) -> None:
    """Write the depths of pixels by their columns ``p_px`` (h, w) into ``t`` (h, w).

    Where a pixel has no column, it gets the depth of the nearest one of its row, NaN beyond ``fill_px``.
    """
    (height, width), (_, nodes, coefficients) = p_px.shape, field.nodes.shape
    at_row, scratch = np.empty((nodes, coefficients), np.float32), np.empty(1, ROW)
    every = _every(width, field.step_px, nodes)
    for row in range(height):
        interpolate_row(field.nodes, field.step_px, row, at_row)
        _row_depths(at_row, every, p_px[row], fill_px, scratch, t[row])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _every(width: int, step: int, nodes: int) -> RowPixels:
    """Return all pixels of a row between its nodes."""
    column = np.arange(width).astype(np.int32)
    return locate(column, step, np.empty(width, np.float32), np.empty(nodes, np.int64))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def solve_rows(
    sources: Sources,
    field: DisplacementField,
    terms: Terms,
    start: int,
    stride: int,
    maps: RedecodedMaps,
    sums: NDArray[np.float64],
) -> None:
    """Solve every ``stride``-th row from ``start`` on into ``maps``; the other rows stay as they were.

    Where ``stride`` is above 1, ``sums`` (2,) adds up Σ contradiction · response and Σ response² of the fringes' second
    harmonic.
    """
    (height, width), (_, nodes, coefficients) = sources.p_px.shape, field.nodes.shape
    frames, step = sources.frames, field.step_px
    pictures = Pictures(frames.reshape(frames.size), sources.followed * (height * width), height, width)
    at_row, scratch = np.empty((nodes, coefficients), np.float32), np.empty(1, ROW)
    every = _every(width, step, nodes)
    column, cell = np.empty(width, np.int32), np.empty(width, np.int32)
    begun, rounds = np.empty(width, np.int32), np.empty(width, np.int32)
    share, begins = np.empty(width, np.float32), np.empty(nodes, np.int64)
    decoded_t, found_t = np.empty(width, np.float32), np.empty(width, np.float32)
    # By how much the row above lies farther than its undecoded ripple said: the next one hardly differs.
    farther = np.zeros(width, np.float32)
    s = scratch[0]
    for row in range(start, height, stride):
        interpolate_row(field.nodes, step, row, at_row)
        _row_depths(at_row, every, sources.p_px[row], terms.fill_px, scratch, decoded_t)
        n = _NONE
        for x in range(width):
            # What a pixel without a coordinate has.
            maps.p_px[row, x], maps.q_px[row, x] = _NAN, _NAN
            maps.variance_px2[row, x], maps.misfit[row, x] = _NAN, _NAN
            maps.modulation_half_dn[row, x], maps.offset_dn[row, x] = 0, 0
            maps.bright[row, x] = frames[sources.followed[BRIGHT], row, x]
            found_t[x] = _NAN
            rough = sources.rough_t[row, x]
            if rough != rough:
                farther[x] = _ZERO
                continue
            if not (abs(decoded_t[x]) < MAX_T):
                decoded_t[x] = rough
            column[n], rounds[n], begun[n] = x, 1, 0 if farther[x] != _ZERO else 1
            t = decoded_t[x] + farther[x]
            s.depth[n] = t if abs(t) < MAX_T else _NAN
            n += 1
        for turn in range(BEGINNINGS * MAX_ROUNDS):
            if n == 0:
                break
            chosen = locate(column[:n], step, share, begins)
            _read_sines(pictures, at_row, chosen, row, cell, scratch)
            _solve_sines(n, sources.gains, terms, scratch)
            if stride > 1 and turn == 0:
                _add_to_sums(n, scratch, sums)
            _number_fringes(pictures, at_row, chosen, row, terms, scratch)
            _settle(at_row, chosen, terms, scratch)
            left = _NONE
            for i in range(n):
                x, t = column[i], s.nearer[i]
                good = s.change[i] == s.change[i]
                if good and (s.change[i] < terms.settled_t or rounds[i] == MAX_ROUNDS):
                    # The row below begins with this correction; one that was carried on is averaged.
                    fresh = t - decoded_t[x]
                    farther[x] = _HALF * (farther[x] + fresh) if begun[i] == 0 else fresh
                    found_t[x] = t
                    maps.p_px[row, x], maps.q_px[row, x] = s.column[i], s.line[i]
                    maps.variance_px2[row, x], maps.misfit[row, x] = s.variance[i], s.misfit[i]
                    maps.modulation_half_dn[row, x] = np.uint8(min(_TWO * s.modulation[i] + _HALF, _MOST))
                    maps.offset_dn[row, x] = np.uint8(min(max(s.offset[i] + _HALF, _ZERO), _MOST))
                    continue
                rounds[left], begun[left] = rounds[i] + 1, begun[i]
                if not good:
                    # From what the row above said, from what was decoded, from what is around.
                    rounds[left], begun[left] = 1, begun[i] + 1
                    t = decoded_t[x] if begun[left] == 1 else sources.rough_t[row, x]
                    if begun[left] == BEGINNINGS or (begun[left] == 2 and abs(t - decoded_t[x]) <= terms.settled_t):
                        farther[x] = _ZERO
                        continue
                column[left], s.depth[left] = x, t
                left += 1
            n = left
        n = _NONE
        for x in range(width):
            if found_t[x] == found_t[x]:
                column[n], s.depth[n] = x, found_t[x]
                n += 1
        maps.illuminated_columns[row, 0] = column[0] if n > 0 else 0
        maps.illuminated_columns[row, 1] = column[n - 1] + 1 if n > 0 else 0
        # The bright frame where the point was then: it colours the cloud.
        chosen, at = locate(column[:n], step, share, begins), FIRST_FRAME + FRAME_COEFFICIENTS * BRIGHT
        u, v = s.u[:n], s.v[:n]
        places_in_frame(at_row, chosen, at, row, s.depth[:n], u, v)
        read_nearest(pictures, BRIGHT, u, v, s.grey[:n])
        for i in range(n):
            if s.grey[i] == s.grey[i]:
                maps.bright[row, column[i]] = np.uint8(s.grey[i])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def cosines(turns: NDArray[np.float32], cosine: NDArray[np.float32], sine: NDArray[np.float32]) -> None:
    """Write cosine and sine of angles in turns (n,): within 3e-7, by Taylor's series."""
    for x in range(turns.size):
        # About the nearest quarter turn, of which odd ones exchange the two.
        quarters = np.floor(_FOUR * turns[x] + _HALF)
        r = _TURN * (turns[x] - _QUARTER * quarters)
        r2 = r * r
        c = _ONE - r2 * (_TAYLOR[2] - r2 * (_TAYLOR[4] - r2 * (_TAYLOR[6] - r2 * _TAYLOR[8])))
        d = r * (_ONE - r2 * (_TAYLOR[3] - r2 * (_TAYLOR[5] - r2 * _TAYLOR[7])))
        # The cosine's sign is that of 1, −1, −1, 1, the sine's that of 1, 1, −1, −1.
        number = quarters - _FOUR * np.floor(_QUARTER * quarters)
        odd = (number == _ONE) | (number == _THREE)
        size_c, size_s = d if odd else c, c if odd else d
        cosine[x] = -size_c if (number == _ONE) | (number == _TWO) else size_c
        sine[x] = -size_s if number >= _TWO else size_s


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _read_sines(
    pictures: Pictures,
    at_row: NDArray[np.float32],
    chosen: RowPixels,
    row: int,
    cell: NDArray[np.int32],
    scratch: Scratch,
) -> None:
    """Read the four sines where points at DEPTH were: GREY, NOISE and TURNS of each."""
    s = scratch[0]
    n = chosen.column.size
    t, u, v = s.depth[:n], s.u[:n], s.v[:n]
    for k in range(PHASE_STEPS):
        at = FIRST_FRAME + FRAME_COEFFICIENTS * k
        places_in_frame(at_row, chosen, at, row, t, u, v)
        parabola_row(at_row, chosen, at + OF_PHASE, t, s.sine_turns[k][:n])
        read_row(pictures, k, u, v, cell, s.sine_grey[k][:n])
        noise_row(u, v, cell, s.sine_noise[k][:n])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _solve_sines(n: int, gains: NDArray[np.float32], terms: Terms, scratch: Scratch) -> None:
    """Solve the four sines of n pixels: offset, modulation, phase, variance, misfit, and the terms of the harmonic."""
    s = scratch[0]
    for k in range(PHASE_STEPS):
        cosines(s.sine_turns[k][:n], s.step_cosine[k][:n], s.step_sine[k][:n])
    g0, g1, g2, g3 = gains[0], gains[1], gains[2], gains[3]
    a0, a1, a2, a3, a4, a5, a6 = ATAN_TURNS
    most_contrary, px_per_rad, harmonic = _SIX * terms.noise_dn, terms.period_px / _TURN, terms.harmonic
    for x in range(n):
        y0, y1, y2, y3 = s.sine_grey[0, x] * g0, s.sine_grey[1, x] * g1, s.sine_grey[2, x] * g2, s.sine_grey[3, x] * g3
        # cos ψ_k and sin ψ_k, of which the turns lack the quarters k/4: (c, s), (−s, c), (−c, −s), (s, −c).
        c0, s0, c1, s1 = s.step_cosine[0, x], s.step_sine[0, x], -s.step_sine[1, x], s.step_cosine[1, x]
        c2, s2, c3, s3 = -s.step_cosine[2, x], -s.step_sine[2, x], s.step_sine[3, x], -s.step_cosine[3, x]
        # The contradiction's vector n: n_k = ± sums of x_ij = sin(ψ_j − ψ_i), of the steps other than k.
        x01, x02, x03 = s1 * c0 - c1 * s0, s2 * c0 - c2 * s0, s3 * c0 - c3 * s0
        x12, x13, x23 = s2 * c1 - c2 * s1, s3 * c1 - c3 * s1, s3 * c2 - c3 * s2
        n0, n1, n2, n3 = x12 + x23 - x13, x03 - x02 - x23, x01 + x13 - x03, x02 - x01 - x12
        size2 = n0 * n0 + n1 * n1 + n2 * n2 + n3 * n3
        per_size = _ONE / np.sqrt(size2)
        # N = AᵀA with A = (1, cos, −sin), n00 = 4, and its adjugate i.
        n01, n02 = c0 + c1 + c2 + c3, -(s0 + s1 + s2 + s3)
        n11, n22 = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3, s0 * s0 + s1 * s1 + s2 * s2 + s3 * s3
        n12 = -(c0 * s0 + c1 * s1 + c2 * s2 + c3 * s3)
        i00, i01, i02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
        i11, i12, i22 = _FOUR * n22 - n02 * n02, n01 * n02 - _FOUR * n12, _FOUR * n11 - n01 * n01
        scale = _ONE / (_FOUR * i00 + n01 * i01 + n02 * i02)
        # Right sides Aᵀy, first with the harmonic.
        b0, b1 = y0 + y1 + y2 + y3, c0 * y0 + c1 * y1 + c2 * y2 + c3 * y3
        b2 = -(s0 * y0 + s1 * y1 + s2 * y2 + s3 * y3)
        m_c, m_s = scale * (i01 * b0 + i11 * b1 + i12 * b2), scale * (i02 * b0 + i12 * b1 + i22 * b2)
        s.offset_share[x] = scale * i00
        contrary = per_size * (n0 * y0 + n1 * y1 + n2 * y2 + n3 * y3)
        s.contrary[x] = contrary
        # Second harmonic: share · m cos 2(φ + ψ_k), with m cos 2φ = (m_c² − m_s²)/m and m sin 2φ = 2 m_c m_s/m.
        per_m = _ONE / (np.sqrt(m_c * m_c + m_s * m_s) + _TINY)
        co, si = (m_c * m_c - m_s * m_s) * per_m, _TWO * m_c * m_s * per_m
        h0, h1 = co * (c0 * c0 - s0 * s0) - si * (_TWO * s0 * c0), co * (c1 * c1 - s1 * s1) - si * (_TWO * s1 * c1)
        h2, h3 = co * (c2 * c2 - s2 * s2) - si * (_TWO * s2 * c2), co * (c3 * c3 - s3 * s3) - si * (_TWO * s3 * c3)
        response = per_size * (n0 * h0 + n1 * h1 + n2 * h2 + n3 * h3)
        s.response[x] = response
        # The same solution once more, of what is left without the harmonic.
        b0 -= harmonic * (h0 + h1 + h2 + h3)
        b1 -= harmonic * (c0 * h0 + c1 * h1 + c2 * h2 + c3 * h3)
        b2 += harmonic * (s0 * h0 + s1 * h1 + s2 * h2 + s3 * h3)
        contrary -= harmonic * response
        a = scale * (i00 * b0 + i01 * b1 + i02 * b2)
        m_c, m_s = scale * (i01 * b0 + i11 * b1 + i12 * b2), scale * (i02 * b0 + i12 * b1 + i22 * b2)
        modulation2 = m_c * m_c + m_s * m_s
        modulation = np.sqrt(modulation2)
        # A sine must be clear, and four values must nearly be one.
        good = (modulation >= _LEAST_MODULATION) & (abs(contrary) <= max(most_contrary, _QUARTER * modulation))
        # φ = atan2(m_s, m_c) in turns: on the first octant, then folded out.
        abs_c, abs_s = abs(m_c), abs(m_s)
        z = min(abs_c, abs_s) / max(max(abs_c, abs_s), _TINY)
        z2 = z * z
        phase = z * (a0 + z2 * (a1 + z2 * (a2 + z2 * (a3 + z2 * (a4 + z2 * (a5 + z2 * a6))))))
        phase = _QUARTER - phase if abs_s > abs_c else phase
        phase = _HALF - phase if m_c < _ZERO else phase
        phase = -phase if m_s < _ZERO else phase
        # ∂φ/∂y_k · m² = m_s w_c,k − m_c w_s,k, with each y's own noise.
        f0, f1, f2 = m_s * i01 - m_c * i02, m_s * i11 - m_c * i12, m_s * i12 - m_c * i22
        d0, d1, d2, d3 = f0 + f1 * c0 - f2 * s0, f0 + f1 * c1 - f2 * s1, f0 + f1 * c2 - f2 * s2, f0 + f1 * c3 - f2 * s3
        k0, k1, k2, k3 = s.sine_noise[0, x], s.sine_noise[1, x], s.sine_noise[2, x], s.sine_noise[3, x]
        spread = d0 * d0 * k0 + d1 * d1 * k1 + d2 * d2 * k2 + d3 * d3 * k3
        against = n0 * n0 * k0 + n1 * n1 * k1 + n2 * n2 * k2 + n3 * n3 * k3
        # V = (P/2π)² σ² · spread / m⁴; misfit: the contradiction squared over its variance, both by the noise at this
        # offset.
        grey_variance = terms.dark_dn2 + terms.shot_dn * a
        px_per_dn = px_per_rad * scale / modulation2
        s.variance[x] = px_per_dn * px_per_dn * grey_variance * spread
        s.misfit[x] = contrary * contrary * size2 / (against * grey_variance)
        s.offset[x], s.modulation[x] = a, modulation
        s.phase[x] = phase - np.floor(phase) if good else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _number_fringes(
    pictures: Pictures, at_row: NDArray[np.float32], chosen: RowPixels, row: int, terms: Terms, scratch: Scratch
) -> None:
    """Write the fringe ORDER that the depth makes expect, and whether all Gray images have AGREED, each read where the
    point was.

    P_0 … P_2 are written, too. All images but the last change at whole periods only: they number periods. Moving, a
    point may have been in the next period already when one of them was shown: that is known from its phase then.
    """
    s = scratch[0]
    n = chosen.column.size
    t, u, v = s.depth[:n], s.u[:n], s.v[:n]
    for k in range(3):
        coefficient_row(at_row, chosen, _P + k, s.p_parabola[k][:n])
    for x in range(n):
        # The order that makes period · (order + phase) − ½ nearest to the expected column.
        expected_px = s.p_parabola[0, x] + s.depth[x] * (s.p_parabola[1, x] + s.depth[x] * s.p_parabola[2, x])
        s.order[x] = np.floor((expected_px + _HALF) / terms.period_px - s.phase[x] + _HALF)
        s.agreed[x] = _ONE if s.phase[x] == s.phase[x] else _ZERO
    last = terms.gray - 1
    for k in range(terms.gray):
        at = FIRST_FRAME + FRAME_COEFFICIENTS * (_FIRST_GRAY + k)
        places_in_frame(at_row, chosen, at, row, t, u, v)
        parabola_row(at_row, chosen, at + OF_PHASE, t, s.turns[:n])
        read_nearest(pictures, _FIRST_GRAY + k, u, v, s.grey[:n])
        # All images but the last number whole periods; the last one halves them.
        per_period, shift = _ONE if k < last else _TWO, np.int32(last - k)
        for x in range(n):
            # Phase at that time, in half periods for the last image, in whole ones for the others.
            s.carry[k, x] = np.floor(per_period * (s.phase[x] + s.turns[x]))
            s.clarity[k, x] = min(max((s.grey[x] - s.offset[x]) / max(s.offset[x], _ONE), -_ONE), _ONE)
            half = _TWO * s.order[x] + (_TWO * s.carry[k, x] if k < last else s.carry[k, x])
            # Gray code h ^ (h >> 1) of the half period h; of what is not known, nothing is asked.
            h = np.int32(half if s.agreed[x] > _ZERO else _ZERO)
            shown = np.int32(((h ^ (h >> np.int32(1))) >> shift) & np.int32(1))
            lit = np.int32(1) if s.grey[x] > s.offset[x] else np.int32(0)
            s.agreed[x] = s.agreed[x] if (s.grey[x] == s.grey[x]) & (shown == lit) else _ZERO
    for x in range(n):
        if s.agreed[x] == _ZERO and s.phase[x] == s.phase[x]:
            _find_order(x, terms.gray, scratch)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _find_order(x: int, gray: int, scratch: Scratch) -> None:
    """Look for an ORDER of pixel ``x`` that its ``gray`` images bear out, among those near the decoded and the expected
    one."""
    s = scratch[0]
    number, bit = 0, 0
    for k in range(gray):
        grey = s.clarity[k, x]
        if grey != grey:
            return
        # Gray code to binary: each bit is the parity of those before.
        bit ^= int(grey > _ZERO)
        number = 2 * number + bit
    # Orders one beside the decoded one and one beside the expected one: the one that is contradicted least.
    decoded, expected = number // 2, int(s.order[x])
    best, least = expected, _TWO
    for near in range(6):
        order = decoded + near - 1 if near < 3 else expected + near - 4
        contrary = _ZERO
        for k in range(gray):
            carry = int(s.carry[k, x])
            half = 2 * (order + carry) if k < gray - 1 else 2 * order + carry
            shown = ((half ^ (half >> 1)) >> (gray - 1 - k)) & 1
            against = -s.clarity[k, x] if shown == 1 else s.clarity[k, x]
            contrary += max(against, _ZERO)
        if contrary < least:
            best, least = order, contrary
    if least <= MAX_CONTRARY:
        s.order[x], s.agreed[x] = best, _ONE


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _settle(at_row: NDArray[np.float32], chosen: RowPixels, terms: Terms, scratch: Scratch) -> None:
    """Write COLUMN, the depth NEARER that follows from it, the LINE there, and the CHANGE of the depth."""
    s = scratch[0]
    n = chosen.column.size
    for x in range(n):
        p = terms.period_px * (s.order[x] + s.phase[x]) - _HALF
        # t₁ = (p − c0) / c1, then t₁ − c2 t₁² / c1.
        per_slope = _ONE / s.p_parabola[1, x]
        begun = (p - s.p_parabola[0, x]) * per_slope
        s.column[x], s.nearer[x] = p, begun - s.p_parabola[2, x] * begun * begun * per_slope
    parabola_row(at_row, chosen, _Q, s.nearer[:n], s.line[:n])
    for x in range(n):
        p, q, t = s.column[x], s.line[x], s.nearer[x]
        inside = (p >= -_ONE) & (p <= terms.width_px) & (q >= -_ONE) & (q <= terms.height_px) & (abs(t) < MAX_T)
        s.change[x] = abs(t - s.depth[x]) if inside & (s.agreed[x] > _ZERO) else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_to_sums(n: int, scratch: Scratch, sums: NDArray[np.float64]) -> None:
    """Add Σ contradiction · response and Σ response² of n pixels to ``sums`` (2,)."""
    s = scratch[0]
    for x in range(n):
        contrary, response, share = float(s.contrary[x]), float(s.response[x]), float(s.offset_share[x])
        # Steps that are next to nothing tell nothing: what 32 bits make of them is not even noise.
        if abs(contrary) < MAX_CONTRARY_DN and 0.0 < share < MOST_SHARE:
            sums[0] += contrary * response
            sums[1] += response * response
