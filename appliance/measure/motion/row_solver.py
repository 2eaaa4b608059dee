"""Owns the first round of ``phase_solver`` for whole rows: nearly every pixel settles in it, and neighbours do the same arithmetic.

A row is solved in short loops whose numbers lie in one array at constant distances, which is what LLVM turns into vector
instructions (``appliance.measure.decode.scratch`` says why). What does not settle here, or is not borne out by every Gray image, is left
to ``phase_solver``, which begins anew with it, pixel by pixel. The equations and symbols are those of its head.

Legend of the scratch row ``s``: quantity ``Q`` of column x is ``s[Q + x]``. Of a pixel that is not asked, ``DEPTH`` is NaN, and with it
everything else.
"""

from __future__ import annotations

from typing import cast

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.phase import ATAN_TURNS
from appliance.measure.decode.scratch import MAX_WIDTH_PX
from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.motion.displacement import FIRST_FRAME, FRAME_COEFFICIENTS, OF_PHASE, OF_V, P_OF_T, Q_OF_T
from appliance.measure.motion.row_reader import coefficient_row, noise_row, parabola_row, place_row, read_row

Scratch = NDArray[np.float32]

_SLOT = MAX_WIDTH_PX + 272
_BEGIN = 8
_NAMES = 45
(
    DEPTH, U, V, TURNS,  # t at the round's beginning; of the frame that is read: place, change of phase
    GREY_0, GREY_1, GREY_2, GREY_3, NOISE_0, NOISE_1, NOISE_2, NOISE_3,  # of the sines
    TURNS_0, COS_0, SIN_0, TURNS_1, COS_1, SIN_1, TURNS_2, COS_2, SIN_2, TURNS_3, COS_3, SIN_3,  # change of phase
    EXPECTED, WEIGHT,  # e and w: the offset that the albedo makes expect
    OFFSET, MODULATION, PHASE, VARIANCE, MISFIT,  # solved; the phase in turns, NaN where it is not good
    PLAIN_OFFSET, PLAIN_SHARE, CONTRARY, RESPONSE,  # a without albedo and its variance; contradiction; response to a harmonic
    P_0, P_1, P_2,  # the parabola of p
    ORDER, AGREED, GRAY,  # fringe order, whether all Gray images so far bear it out (1 or 0), grey value of the one at hand
    COLUMN, NEARER, LINE, SETTLED,  # p, the depth that follows from it, q there; 1 where the round was the last one
) = (k * _SLOT + _BEGIN for k in range(_NAMES))  # fmt: skip
SIZE = _NAMES * _SLOT
"""Number of places in a scratch row."""
_NAN, _ZERO, _QUARTER, _HALF, _ONE, _TWO, _THREE, _FOUR, _SIX = (
    np.float32(x) for x in (np.nan, 0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
)
_P, _Q = (cast(int, np.int64(k)) for k in (P_OF_T, Q_OF_T))
"""Whole numbers of a type of their own: for plain ones, numba would compile what is called with them for each value."""
_TURN, _TINY = np.float32(2.0 * np.pi), np.float32(1e-9)
_C4, _C6, _C8 = (np.float32(1.0 / n) for n in (24.0, 720.0, 40320.0))
_S3, _S5, _S7 = (np.float32(1.0 / n) for n in (6.0, 120.0, 5040.0))
_A0, _A1, _A2, _A3, _A4, _A5, _A6 = ATAN_TURNS


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_sines(
    pixels: NDArray[np.uint8], starts: NDArray[np.int64], height: int, width: int, at_row: NDArray[np.float32],
    shares: NDArray[np.float32], row: int, first: int, stop: int, cell: NDArray[np.int32], s: Scratch,
) -> None:  # fmt: skip
    """Read the four sines where points of columns ``first`` to ``stop`` − 1 at DEPTH were: GREY, NOISE and TURNS of each."""
    t, u, v = s[DEPTH : DEPTH + width], s[U : U + width], s[V : V + width]
    for k in range(PHASE_STEPS):
        at = FIRST_FRAME + FRAME_COEFFICIENTS * k
        grey, noise, turns = GREY_0 + k * _SLOT, NOISE_0 + k * _SLOT, TURNS_0 + 3 * k * _SLOT
        parabola_row(at_row, shares, at, t, first, stop, u)
        parabola_row(at_row, shares, at + OF_V, t, first, stop, v)
        parabola_row(at_row, shares, at + OF_PHASE, t, first, stop, s[turns : turns + width])
        place_row(row, first, stop, u, v)
        read_row(pixels, starts[k], height, width, u, v, first, stop, cell, s[grey : grey + width])
        noise_row(u, v, cell, first, stop, s[noise : noise + width])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def cosines(turns: NDArray[np.float32], cosine: NDArray[np.float32], sine: NDArray[np.float32]) -> None:
    """Write cosine and sine of angles in turns (n,): within 3e-7, by Taylor's series."""
    for x in range(turns.size):
        # About the nearest quarter turn, of which odd ones exchange the two.
        quarters = np.floor(_FOUR * turns[x] + _HALF)
        r = _TURN * (turns[x] - _QUARTER * quarters)
        r2 = r * r
        c = _ONE - r2 * (_HALF - r2 * (_C4 - r2 * (_C6 - r2 * _C8)))
        d = r * (_ONE - r2 * (_S3 - r2 * (_S5 - r2 * _S7)))
        # The cosine's sign is that of 1, −1, −1, 1, the sine's that of 1, 1, −1, −1.
        number = quarters - _FOUR * np.floor(_QUARTER * quarters)
        odd = (number == _ONE) | (number == _THREE)
        size_c, size_s = d if odd else c, c if odd else d
        cosine[x] = -size_c if (number == _ONE) | (number == _TWO) else size_c
        sine[x] = -size_s if number >= _TWO else size_s


@numba.njit(nogil=True, cache=True, error_model="numpy")
def solve_sines(
    first: int, stop: int, gains: NDArray[np.float32], harmonic: np.float32, min_modulation_dn: np.float32,
    noise_dn: np.float32, dark_dn2: np.float32, shot_dn: np.float32, period_px: np.float32, s: Scratch,
) -> None:  # fmt: skip
    """Solve the four sines of columns ``first`` to ``stop`` − 1, with EXPECTED and WEIGHT of the albedo.

    Writes OFFSET, MODULATION, PHASE, VARIANCE and MISFIT, and what the harmonic and the sines' mean follow from.
    """
    s = s[first:]  # counted from zero: of an index that may be negative, numba asks each time whether it is
    for k in range(PHASE_STEPS):
        at, n = 3 * k * _SLOT, stop - first
        cosines(s[TURNS_0 + at :][:n], s[COS_0 + at :][:n], s[SIN_0 + at :][:n])
    g0, g1, g2, g3 = gains[0], gains[1], gains[2], gains[3]
    most_contrary, px_per_rad = _SIX * noise_dn, period_px / _TURN
    for x in range(stop - first):
        y0, y1, y2, y3 = s[GREY_0 + x] * g0, s[GREY_1 + x] * g1, s[GREY_2 + x] * g2, s[GREY_3 + x] * g3
        # cos ψ_k and sin ψ_k, of which the turns lack the quarters k/4: (c, s), (−s, c), (−c, −s), (s, −c).
        c0, s0, c1, s1 = s[COS_0 + x], s[SIN_0 + x], -s[SIN_1 + x], s[COS_1 + x]
        c2, s2, c3, s3 = -s[COS_2 + x], -s[SIN_2 + x], s[SIN_3 + x], -s[COS_3 + x]
        # The contradiction's vector n: n_k = ± sums of x_ij = sin(ψ_j − ψ_i), of the steps other than k.
        x01, x02, x03 = s1 * c0 - c1 * s0, s2 * c0 - c2 * s0, s3 * c0 - c3 * s0
        x12, x13, x23 = s2 * c1 - c2 * s1, s3 * c1 - c3 * s1, s3 * c2 - c3 * s2
        n0, n1, n2, n3 = x12 + x23 - x13, x03 - x02 - x23, x01 + x13 - x03, x02 - x01 - x12
        size2 = n0 * n0 + n1 * n1 + n2 * n2 + n3 * n3
        per_size = _ONE / np.sqrt(size2)
        # N = AᵀA with A = (1, cos, −sin), and its adjugate i; 4 + w is n00 where the offset is known with weight w.
        n01, n02 = c0 + c1 + c2 + c3, -(s0 + s1 + s2 + s3)
        n11, n22 = c0 * c0 + c1 * c1 + c2 * c2 + c3 * c3, s0 * s0 + s1 * s1 + s2 * s2 + s3 * s3
        n12 = -(c0 * s0 + c1 * s1 + c2 * s2 + c3 * s3)
        w = s[WEIGHT + x]
        e, n00 = w * s[EXPECTED + x], _FOUR + w
        i00, i01, i02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
        i11, i12, i22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
        det = _FOUR * i00 + n01 * i01 + n02 * i02
        scale = _ONE / (det + w * i00)
        # Right sides Aᵀy, first with the harmonic.
        b0, b1 = y0 + y1 + y2 + y3 + e, c0 * y0 + c1 * y1 + c2 * y2 + c3 * y3
        b2 = -(s0 * y0 + s1 * y1 + s2 * y2 + s3 * y3)
        m_c, m_s = scale * (i01 * b0 + i11 * b1 + i12 * b2), scale * (i02 * b0 + i12 * b1 + i22 * b2)
        # The offset without the albedo: i00, i01 and i02 do not depend on w.
        per_det = _ONE / det
        s[PLAIN_OFFSET + x] = per_det * (i00 * (b0 - e) + i01 * b1 + i02 * b2)
        s[PLAIN_SHARE + x] = per_det * i00
        contrary = per_size * (n0 * y0 + n1 * y1 + n2 * y2 + n3 * y3)
        s[CONTRARY + x] = contrary
        # Second harmonic: share · m cos 2(φ + ψ_k), with m cos 2φ = (m_c² − m_s²)/m and m sin 2φ = 2 m_c m_s/m.
        per_m = _ONE / (np.sqrt(m_c * m_c + m_s * m_s) + _TINY)
        co, si = (m_c * m_c - m_s * m_s) * per_m, _TWO * m_c * m_s * per_m
        h0, h1 = co * (c0 * c0 - s0 * s0) - si * (_TWO * s0 * c0), co * (c1 * c1 - s1 * s1) - si * (_TWO * s1 * c1)
        h2, h3 = co * (c2 * c2 - s2 * s2) - si * (_TWO * s2 * c2), co * (c3 * c3 - s3 * s3) - si * (_TWO * s3 * c3)
        response = per_size * (n0 * h0 + n1 * h1 + n2 * h2 + n3 * h3)
        s[RESPONSE + x] = response
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
        good = (modulation >= min_modulation_dn) & (abs(contrary) <= max(most_contrary, _QUARTER * modulation))
        # φ = atan2(m_s, m_c) in turns: on the first octant, then folded out.
        abs_c, abs_s = abs(m_c), abs(m_s)
        z = min(abs_c, abs_s) / max(max(abs_c, abs_s), _TINY)
        z2 = z * z
        phase = z * (_A0 + z2 * (_A1 + z2 * (_A2 + z2 * (_A3 + z2 * (_A4 + z2 * (_A5 + z2 * _A6))))))
        phase = _QUARTER - phase if abs_s > abs_c else phase
        phase = _HALF - phase if m_c < _ZERO else phase
        phase = -phase if m_s < _ZERO else phase
        # ∂φ/∂y_k · m² = m_s w_c,k − m_c w_s,k, with each y's own noise, and of e, whose variance is 1 / w.
        f0, f1, f2 = m_s * i01 - m_c * i02, m_s * i11 - m_c * i12, m_s * i12 - m_c * i22
        d0, d1, d2, d3 = f0 + f1 * c0 - f2 * s0, f0 + f1 * c1 - f2 * s1, f0 + f1 * c2 - f2 * s2, f0 + f1 * c3 - f2 * s3
        k0, k1, k2, k3 = s[NOISE_0 + x], s[NOISE_1 + x], s[NOISE_2 + x], s[NOISE_3 + x]
        spread = d0 * d0 * k0 + d1 * d1 * k1 + d2 * d2 * k2 + d3 * d3 * k3 + w * f0 * f0
        against = n0 * n0 * k0 + n1 * n1 * k1 + n2 * n2 * k2 + n3 * n3 * k3
        # V = (P/2π)² σ² · spread / m⁴; misfit: the contradiction squared over its variance, both by the noise at this offset.
        grey_variance = dark_dn2 + shot_dn * a
        px_per_dn = px_per_rad * scale / modulation2
        s[VARIANCE + x] = px_per_dn * px_per_dn * grey_variance * spread
        s[MISFIT + x] = contrary * contrary * size2 / (against * grey_variance)
        s[OFFSET + x], s[MODULATION + x] = a, modulation
        s[PHASE + x] = phase - np.floor(phase) if good else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def number_fringes(
    pixels: NDArray[np.uint8], starts: NDArray[np.int64], count: int, first_gray: int, height: int, width: int,
    at_row: NDArray[np.float32], shares: NDArray[np.float32], row: int, first: int, stop: int, period_px: np.float32,
    s: Scratch,
) -> None:  # fmt: skip
    """Write the fringe ORDER that the depth makes expect, and whether all ``count`` Gray images have AGREED.

    Each is read where the point was; the first one is frame ``first_gray`` of those followed. P_0 … P_2 are written, too.
    """
    here = s[first:]
    t, u, v = s[DEPTH : DEPTH + width], s[U : U + width], s[V : V + width]
    coefficient_row(at_row, shares, _P, first, stop, s[P_0 : P_0 + width])
    coefficient_row(at_row, shares, _P + 1, first, stop, s[P_1 : P_1 + width])
    coefficient_row(at_row, shares, _P + 2, first, stop, s[P_2 : P_2 + width])
    for x in range(stop - first):
        # The order that makes period · (order + phase) − ½ nearest to the expected column.
        depth = here[DEPTH + x]
        expected_px = here[P_0 + x] + depth * (here[P_1 + x] + depth * here[P_2 + x])
        here[ORDER + x] = np.floor((expected_px + _HALF) / period_px - here[PHASE + x] + _HALF)
        here[AGREED + x] = _ONE if here[PHASE + x] == here[PHASE + x] else _ZERO
    for k in range(count):
        at = FIRST_FRAME + FRAME_COEFFICIENTS * (first_gray + k)
        parabola_row(at_row, shares, at, t, first, stop, u)
        parabola_row(at_row, shares, at + OF_V, t, first, stop, v)
        parabola_row(at_row, shares, at + OF_PHASE, t, first, stop, s[TURNS : TURNS + width])
        place_row(row, first, stop, u, v)
        read_nearest(pixels, starts[first_gray + k], height, width, u, v, first, stop, s[GRAY : GRAY + width])
        # All images but the last number whole periods; the last one halves them.
        per_period, shift = _ONE if k < count - 1 else _TWO, np.int32(count - 1 - k)
        for x in range(stop - first):
            # Phase at that time: a point may have been in the next period already.
            carry = np.floor(per_period * (here[PHASE + x] + here[TURNS + x]))
            half = _TWO * here[ORDER + x] + (_TWO * carry if k < count - 1 else carry)
            # Gray code h ^ (h >> 1) of the half period h; of what is not known, nothing is asked.
            h = np.int32(half if here[AGREED + x] > _ZERO else _ZERO)
            shown = np.int32(((h ^ (h >> np.int32(1))) >> shift) & np.int32(1))
            grey = here[GRAY + x]
            lit = np.int32(1) if grey > here[OFFSET + x] else np.int32(0)
            here[AGREED + x] = here[AGREED + x] if (grey == grey) & (shown == lit) else _ZERO


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_nearest(
    pixels: NDArray[np.uint8], start: int, height: int, width: int, u: NDArray[np.float32], v: NDArray[np.float32],
    first: int, stop: int, grey: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the grey values of the pixels nearest to (u, v) of the frame that begins at ``start``; NaN outside of it."""
    last_u, last_v = np.float32(width), np.float32(height)
    for x in range(first, stop):
        i, j = np.floor(u[x] + _HALF), np.floor(v[x] + _HALF)
        if (i >= _ZERO) & (j >= _ZERO) & (i < last_u) & (j < last_v):
            grey[x] = np.float32(pixels[np.uint64(start + np.int64(j) * width + np.int64(i))])
        else:
            grey[x] = _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def settle(
    width: int, at_row: NDArray[np.float32], shares: NDArray[np.float32], first: int, stop: int, period_px: np.float32,
    width_px: np.float32, height_px: np.float32, settled_t: np.float32, max_t: np.float32, s: Scratch,
) -> None:  # fmt: skip
    """Write COLUMN, the depth NEARER that follows from it, the LINE there, and whether they are SETTLED."""
    here = s[first:]
    for x in range(stop - first):
        p = period_px * (here[ORDER + x] + here[PHASE + x]) - _HALF
        # t₁ = (p − c0) / c1, then t₁ − c2 t₁² / c1.
        per_slope = _ONE / here[P_1 + x]
        begun = (p - here[P_0 + x]) * per_slope
        here[COLUMN + x], here[NEARER + x] = p, begun - here[P_2 + x] * begun * begun * per_slope
    parabola_row(at_row, shares, _Q, s[NEARER : NEARER + width], first, stop, s[LINE : LINE + width])
    for x in range(stop - first):
        p, q, t = here[COLUMN + x], here[LINE + x], here[NEARER + x]
        inside = (p >= -_ONE) & (p <= width_px) & (q >= -_ONE) & (q <= height_px) & (abs(t) < max_t)
        near = abs(t - here[DEPTH + x]) < settled_t
        here[SETTLED + x] = _ONE if inside & near & (here[AGREED + x] > _ZERO) else _ZERO
