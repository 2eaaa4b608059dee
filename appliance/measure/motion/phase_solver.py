"""Owns the pixels' new pattern coordinates: the x-sines read where each point went, and solved with their true phase steps.

A pixel's depth, its displacement and its phase depend on each other, so each pixel is solved in rounds: at a depth t its four
sines are read and solved (least squares), the phase and the Gray images make a column p, and p makes a better t. The first depth
is that of the row above, corrected as there: the ripple that motion makes runs along the fringes and is nearly the same in both.
Where that leads to nothing, the decoded depth is tried, at last a rough surface that is known everywhere.

Rows need no sines: where the depth is known, the fitted projector tells the row q to a tenth of a px, the same for both cameras,
better than a hand leaves it. So points that lost sight of the y-sines, or moved along with them, stay.

Legend of the kernels, per pixel (column x, row)::

    t            depth, −1 … 1 (``displacement``); p, q pattern coordinates, px
    c            coefficients of the pixel's parabolas in t: p, q, then (u, v, phase) of each followed frame
    k            0 … 3, number of the x-sine
    y_k          grey value read for sine k, over the frame's gain; noise_k its variance as a share of a pixel's
    ψ_k          phase step of sine k: k π/2 and what the motion added
    a, m_c, m_s  offset and the two parts of the modulation: y_k = a + m_c cos ψ_k − m_s sin ψ_k; phase φ = atan2(m_s, m_c)
    weights      rows 0 … 2: how a, m_c, m_s follow from y; row 3: the unit vector that contradicts them all
    e, w         offset that the albedo makes expect, and its weight against one grey value
    b_a, b_c, b_s  how a, m_c, m_s follow from e
    phase_variance  Var φ · m⁴ / σ², with σ² = dark + shot · a the variance of a grey value
    V            variance of p, px²: (P/2π)² Var φ, P the fringes' period
"""

from __future__ import annotations

from typing import NamedTuple, cast

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.motion.displacement import (
    FIRST_FRAME,
    FRAME_COEFFICIENTS,
    OF_PHASE,
    OF_V,
    P_OF_T,
    Q_OF_T,
    DisplacementField,
    interpolate_pixel,
    interpolate_row,
    parabola_at,
    read_spline,
    spline_noise_share,
)
from appliance.measure.motion.residuals import apply_steps, invert_steps
from appliance.measure.motion.row_reader import parabola_row, place_row, shares_of
from appliance.measure.motion.row_solver import (
    COLUMN,
    CONTRARY,
    DEPTH,
    EXPECTED,
    GRAY,
    LINE,
    MISFIT,
    MODULATION,
    NEARER,
    OFFSET,
    PHASE,
    PLAIN_OFFSET,
    PLAIN_SHARE,
    RESPONSE,
    SETTLED,
    SIZE,
    VARIANCE,
    WEIGHT,
    U,
    V,
    number_fringes,
    read_nearest,
    read_sines,
    settle,
    solve_sines,
)

SINES = PHASE_STEPS
BRIGHT, FIRST_GRAY = 4, 5
"""Places of the followed frames behind the 4 x-sines: the bright frame, then the Gray images of x, then those of y."""
MAX_GRAY = 8
"""Number of Gray images of one direction that there is room for."""
MAX_ROUNDS = 3
"""Corrections of a depth before a pixel is given up or taken as it is."""
MAX_CONTRARY = np.float32(0.5)
"""Most that all Gray images together may say against an order, as a share of one image's full swing."""
MAX_T = np.float32(2.5)
"""Depths beyond are no depths."""
NEAR_RAD = 0.03
"""Cosine and sine are carried on to the second order over so small an angle: right to 5e-6."""
MAX_CONTRARY_DN = 20.0
"""Contradictions above this are no harmonic: the four sines saw different surfaces."""
MOST_SHARE = 1e3
"""Largest variance of an offset, in variances of a grey value, that the sines' light is told by; steps of 15° leave 200."""
LEAST_DOUBT = 1e-3
"""Least variance of the albedo, in variances of a grey value: it keeps the weight finite."""
_NAN, _ZERO, _HALF, _ONE, _TWO, _MOST = (np.float32(x) for x in (np.nan, 0.0, 0.5, 1.0, 2.0, 255.0))
_TURN = 2.0 * np.pi
_NONE = cast(int, np.int64(0))
"""Zero of a type of its own: for a plain one, numba would compile what is called with it twice."""


class Sources(NamedTuple):
    """The images and maps that one camera is decoded from. Maps are (h, w)."""

    frames: NDArray[np.uint8]
    """(n, h, w): the sequence; every kind of array, writable or not, would be compiled for itself."""
    followed: NDArray[np.int64]
    """Numbers of the followed frames: 4 x-sines, bright, Gray images."""
    p_px: NDArray[np.float32]
    """Columns as decoded without regard to motion: where a pixel's depth is looked for first."""
    rough_t: NDArray[np.float32]
    """Depth everywhere, smooth: where it is looked for when that leads to nothing. NaN: the pixel is not asked, it sees no fringes."""
    albedo_dn: NDArray[np.float32]
    """Grey values under full light, NaN where they are not known; (0, 0) where they are not used."""
    backscatter_dn: NDArray[np.float32]
    """Grey values without light: backscatter and ambient light; (0, 0) likewise."""
    albedo_variance_dn2: NDArray[np.float32]
    """Variance of the albedo; (0, 0) likewise."""


class Terms(NamedTuple):
    """Numbers of one scan and camera."""

    period_px: np.float32
    width_px: np.float32
    height_px: np.float32
    min_modulation_dn: np.float32
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
    mean_share: np.float32
    """Mean of the sines' light, as a share of full light; 0 where the albedo is not used."""


class RedecodedMaps(NamedTuple):
    """The maps (h, w) of one camera at the reference time."""

    p_px: NDArray[np.float32]
    """NaN where there is no coordinate."""
    q_px: NDArray[np.float32]
    """Row that the fitted projector shows there."""
    modulation_half_dn: NDArray[np.uint8]
    variance_px2: NDArray[np.float32]
    """Variance of p by the camera's noise and the albedo's, in px² of the pattern; NaN where there is no column."""
    misfit: NDArray[np.float32]
    """Contradiction of the x-sines, squared, over what noise makes it: 1 in the mean; NaN where there is no column."""
    bright: NDArray[np.uint8]
    offset_dn: NDArray[np.uint8]
    illuminated_columns: NDArray[np.int32]
    """(h, 2): first column of each row that has a coordinate, and the one behind the last."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _cos_sin(known: NDArray[np.float64], psi: float) -> tuple[float, float]:
    """Return cosine and sine of ``psi``, carried on from those ``known`` (3,): angle, cosine, sine.

    cos(ψ₀ + δ) ≈ (1 − δ²/2) cos ψ₀ − δ sin ψ₀: neighbouring pixels differ by hardly anything.
    """
    apart = psi - known[0]
    if not abs(apart) < NEAR_RAD:
        known[0], known[1], known[2] = psi, np.cos(psi), np.sin(psi)
        return known[1], known[2]
    less = 1.0 - 0.5 * apart * apart
    return less * known[1] - apart * known[2], less * known[2] + apart * known[1]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def weigh_offset(
    cosine: NDArray[np.float64], sine: NDArray[np.float64], weight: float, weights: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Solve y_k = a + m_c cos ψ_k − m_s sin ψ_k by least squares where also a = e is known, with ``weight`` against one y.

    Writes how a, m_c and m_s follow from y into ``weights`` (3, 4), and returns how they follow from e.
    """
    # N = AᵀA with A = (1, cos, −sin) and one more row (√w, 0, 0).
    n00, n01, n02, n11, n12, n22 = 4.0 + weight, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(SINES):
        n01 += cosine[k]
        n02 -= sine[k]
        n11 += cosine[k] * cosine[k]
        n12 -= cosine[k] * sine[k]
        n22 += sine[k] * sine[k]
    # N⁻¹ by its adjugate i, then N⁻¹ Aᵀ.
    i00, i01, i02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    i11, i12, i22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
    scale = 1.0 / (n00 * i00 + n01 * i01 + n02 * i02)
    for k in range(SINES):
        weights[0, k] = scale * (i00 + i01 * cosine[k] - i02 * sine[k])
        weights[1, k] = scale * (i01 + i11 * cosine[k] - i12 * sine[k])
        weights[2, k] = scale * (i02 + i12 * cosine[k] - i22 * sine[k])
    return scale * weight * i00, scale * weight * i01, scale * weight * i02


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _depth_of(p_px: np.float32, c0: np.float32, c1: np.float32, c2: np.float32) -> np.float32:
    """Return the t at which the parabola c0 + c1 t + c2 t² is ``p_px``: t₁ = (p − c0) / c1, then t₁ − c2 t₁² / c1."""
    first = (p_px - c0) / c1
    return np.float32(first - c2 * first * first / c1)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _row_depths(
    at_row: NDArray[np.float32], step: int, p_px: NDArray[np.float32], fill_px: int, t: NDArray[np.float32]
) -> None:
    """Write the depth of each pixel of a row by its column ``p_px`` (w,); where it has none, that of the nearest one.

    ``at_row`` are the row's nodes; NaN where no column is nearer than ``fill_px``.
    """
    width = p_px.size
    c = np.empty(3, np.float32)
    # From the left: each gap gets the depth before it.
    last, at = _NAN, -1
    for x in range(width):
        t[x] = _NAN
        if p_px[x] == p_px[x]:
            interpolate_pixel(at_row, step, x, P_OF_T, c)
            last = _depth_of(p_px[x], c[0], c[1], c[2])
            at = x
            t[x] = last
        elif at >= 0 and x - at <= fill_px:
            t[x] = last
    # From the right: of the two ends of a gap the nearer one.
    last, at = _NAN, -1
    for x in range(width - 1, -1, -1):
        if p_px[x] == p_px[x]:
            last, at = t[x], x
        elif at >= 0 and at - x <= fill_px:
            before = t[x]
            if before != before or _nearer(p_px, x, at - x):
                t[x] = last


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _nearer(p_px: NDArray[np.float32], x: int, distance: int) -> bool:
    """Return whether no pixel with a column lies closer before ``x`` than ``distance``."""
    for k in range(1, distance):
        if x - k < 0:
            return True
        if p_px[x - k] == p_px[x - k]:
            return False
    return True


@numba.njit(nogil=True, cache=True, error_model="numpy")
def depth_rows(
    p_px: NDArray[np.float32], field: DisplacementField, fill_px: int, start: int, stop: int, t: NDArray[np.float32]
) -> None:
    """Write the depths of the pixels of rows ``start`` to ``stop`` − 1 by their columns ``p_px`` (h, w) into ``t`` (h, w).

    Where a pixel has no column, it gets the depth of the nearest one of its row, NaN beyond ``fill_px``.
    """
    nodes, step = field.nodes, field.step_px
    at_row = np.empty((nodes.shape[1], nodes.shape[2]), np.float32)
    for row in range(start, stop):
        interpolate_row(nodes, step, row, at_row)
        _row_depths(at_row, step, p_px[row], fill_px, t[row])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def solve_rows(
    sources: Sources,
    field: DisplacementField,
    gains: NDArray[np.float32],
    terms: Terms,
    start: int,
    stop: int,
    stride: int,
    maps: RedecodedMaps,
    sums: NDArray[np.float64],
) -> None:
    """Solve every ``stride``-th row from ``start`` to ``stop`` − 1 into ``maps``; the other rows stay as they were.

    ``gains`` (8,) multiply the sine frames. Where ``stride`` is above 1, ``sums`` (2, 2) adds up Σ contradiction · response and
    Σ response² of the fringes' second harmonic, then Σ offset · albedo and Σ albedo² of the sines' mean.
    """
    nodes, step = field.nodes, field.step_px
    height, width = sources.p_px.shape
    pixels = sources.frames.reshape(sources.frames.size)
    starts = sources.followed * (height * width)
    shares, cell, s = shares_of(step), np.empty(width, np.int32), np.empty(SIZE, np.float32)
    bright = sources.frames[sources.followed[BRIGHT]]
    # Of the Gray images only those of the first direction are needed.
    count = FIRST_FRAME + FRAME_COEFFICIENTS * (FIRST_GRAY + terms.gray)
    at_row = np.empty((nodes.shape[1], nodes.shape[2]), np.float32)
    decoded_t = np.empty(width, np.float32)
    c = np.empty(count, np.float32)
    y, cosine, sine, noise = np.empty(SINES), np.empty(SINES), np.empty(SINES), np.empty(SINES)
    weights, known_steps = np.empty((4, SINES)), np.full((SINES, 3), np.inf)
    bits, carry = np.empty(MAX_GRAY, np.float32), np.empty(MAX_GRAY, np.int64)
    # By how much the row above lies farther than its undecoded ripple said: the next one hardly differs.
    farther = np.zeros(width, np.float32)
    per_variance = 1.0 / (float(terms.noise_dn) * float(terms.noise_dn))
    px_per_rad = float(terms.period_px) / _TURN
    use_albedo = sources.albedo_dn.shape[0] == height
    limit_u, limit_v = np.float32(width - 2), np.float32(height - 2)
    for row in range(start, stop, stride):
        interpolate_row(nodes, step, row, at_row)
        _row_depths(at_row, step, sources.p_px[row], terms.fill_px, decoded_t)
        asked_first, asked_stop = width, _NONE
        for x in range(width):
            # What a pixel without a coordinate has.
            maps.p_px[row, x] = _NAN
            maps.q_px[row, x] = _NAN
            maps.modulation_half_dn[row, x] = 0
            maps.variance_px2[row, x] = _NAN
            maps.misfit[row, x] = _NAN
            maps.bright[row, x] = bright[row, x]
            maps.offset_dn[row, x] = 0
            rough = sources.rough_t[row, x]
            asked = rough == rough
            if not (abs(decoded_t[x]) < MAX_T):
                decoded_t[x] = rough
            # Where the first beginning of a pixel is: farther by as much as in the row above.
            t = decoded_t[x] + farther[x] if asked else _NAN
            s[DEPTH + x] = t if abs(t) < MAX_T else _NAN
            # The offset that the albedo makes expect, and its weight against one grey value; 0 where it is not known.
            s[EXPECTED + x], s[WEIGHT + x] = _ZERO, _ZERO
            if use_albedo and terms.mean_share > _ZERO and sources.albedo_dn[row, x] > _ZERO:
                doubt = per_variance * float(sources.albedo_variance_dn2[row, x]) + LEAST_DOUBT
                s[EXPECTED + x] = sources.backscatter_dn[row, x] + terms.mean_share * sources.albedo_dn[row, x]
                s[WEIGHT + x] = np.float32(1.0 / (float(terms.mean_share) ** 2 * doubt))
            asked_first, asked_stop = min(asked_first, x) if asked else asked_first, x + 1 if asked else asked_stop
        if asked_first < asked_stop:
            read_sines(pixels, starts, height, width, at_row, shares, row, asked_first, asked_stop, cell, s)
            solve_sines(
                asked_first, asked_stop, gains, terms.harmonic, terms.min_modulation_dn, terms.noise_dn, terms.dark_dn2,
                terms.shot_dn, terms.period_px, s,
            )  # fmt: skip
            if stride > 1:
                _add_to_sums(sources, row, asked_first, asked_stop, use_albedo, s, sums)
            number_fringes(
                pixels, starts, terms.gray, FIRST_GRAY, height, width, at_row, shares, row, asked_first, asked_stop,
                terms.period_px, s,
            )  # fmt: skip
            settle(
                width, at_row, shares, asked_first, asked_stop, terms.period_px, terms.width_px, terms.height_px,
                terms.settled_t, MAX_T, s,
            )  # fmt: skip
            # The bright frame where the point was then: it colours the cloud.
            at = FIRST_FRAME + FRAME_COEFFICIENTS * BRIGHT
            u_row, v_row, t_row = s[U : U + width], s[V : V + width], s[NEARER : NEARER + width]
            parabola_row(at_row, shares, at, t_row, asked_first, asked_stop, u_row)
            parabola_row(at_row, shares, at + OF_V, t_row, asked_first, asked_stop, v_row)
            place_row(row, asked_first, asked_stop, u_row, v_row)
            read_nearest(
                pixels, starts[BRIGHT], height, width, u_row, v_row, asked_first, asked_stop, s[GRAY : GRAY + width]
            )
        first, last = width, 0
        for x in range(asked_first, asked_stop):
            if sources.rough_t[row, x] != sources.rough_t[row, x]:
                farther[x] = 0.0
                continue
            if s[SETTLED + x] > _ZERO:
                # The row below begins with this correction; one that was carried on is averaged.
                fresh = s[NEARER + x] - decoded_t[x]
                farther[x] = fresh if farther[x] == 0.0 else _HALF * (farther[x] + fresh)
                maps.p_px[row, x], maps.q_px[row, x] = s[COLUMN + x], s[LINE + x]
                maps.modulation_half_dn[row, x] = np.uint8(min(_TWO * s[MODULATION + x] + _HALF, _MOST))
                maps.variance_px2[row, x], maps.misfit[row, x] = s[VARIANCE + x], s[MISFIT + x]
                maps.offset_dn[row, x] = np.uint8(min(max(s[OFFSET + x] + _HALF, _ZERO), _MOST))
                if s[GRAY + x] == s[GRAY + x]:
                    maps.bright[row, x] = np.uint8(s[GRAY + x])
                first, last = min(first, x), max(last, x + 1)
                continue
            # The pixel's own parabolas in t, linear between the field's nodes.
            interpolate_pixel(at_row, step, x, 0, c)
            # What the last round leaves; nothing is written of a pixel that never was good.
            good, t, p, q = False, _NAN, _NAN, _NAN
            a, modulation, variance_px2, misfit, turns = 0.0, 0.0, 0.0, 0.0, 0.0
            # Where the row's round found no phase, its beginning leads to nothing.
            failed = (0 if farther[x] != 0.0 else 1) if s[PHASE + x] != s[PHASE + x] else -1
            for begun in range(3):
                # From what the row above said, from what was decoded, from what is around.
                if begun == 0:
                    if farther[x] == 0.0:
                        continue
                    t = decoded_t[x] + farther[x]
                elif begun == 1:
                    t = decoded_t[x]
                else:
                    t = sources.rough_t[row, x]
                    if abs(t - decoded_t[x]) <= terms.settled_t:
                        break
                if begun == failed:
                    continue
                for _ in range(MAX_ROUNDS + 1):
                    good = bool(abs(t) < MAX_T)
                    if not good:
                        break
                    # y_k, its noise, cos ψ_k and sin ψ_k, read where a point at depth t was in sine k.
                    for k in range(SINES):
                        at = FIRST_FRAME + FRAME_COEFFICIENTS * k
                        u, v = np.float32(x) + parabola_at(c, at, t), np.float32(row) + parabola_at(c, at + OF_V, t)
                        if not (u >= _ONE and v >= _ONE and u < limit_u and v < limit_v):
                            good = False
                            break
                        y[k] = read_spline(pixels, starts[k], width, u, v) * gains[k]
                        noise[k] = float(spline_noise_share(u, v))
                        psi = _TURN * (float(parabola_at(c, at + OF_PHASE, t)) + 0.25 * k)
                        cosine[k], sine[k] = _cos_sin(known_steps[k], psi)
                    if not good:
                        break
                    # Least squares of y_k = a + m_c cos ψ_k − m_s sin ψ_k.
                    invert_steps(cosine, sine, weights)
                    a, m_c, m_s, contrary = apply_steps(weights, y)
                    w, b_a, b_c, b_s, e = 0.0, 0.0, 0.0, 0.0, 0.0
                    if s[WEIGHT + x] > _ZERO:
                        # The offset is known but for the albedo's variance: one more value of the least squares.
                        e, w = float(s[EXPECTED + x]), float(s[WEIGHT + x])
                        b_a, b_c, b_s = weigh_offset(cosine, sine, w, weights)
                        m_c, m_s = b_c * e, b_s * e
                        for k in range(SINES):
                            m_c += weights[1, k] * y[k]
                            m_s += weights[2, k] * y[k]
                    # Second harmonic: share · m cos 2(φ + ψ_k), with m cos 2φ = (m_c² − m_s²) / m and
                    # m sin 2φ = 2 m_c m_s / m. It is taken out of y.
                    per_m = 1.0 / (np.sqrt(m_c * m_c + m_s * m_s) + 1e-9)
                    co, si = (m_c * m_c - m_s * m_s) * per_m, 2.0 * m_c * m_s * per_m
                    for k in range(SINES):
                        c2, s2 = cosine[k] * cosine[k] - sine[k] * sine[k], 2.0 * sine[k] * cosine[k]
                        y[k] -= terms.harmonic * (co * c2 - si * s2)
                    # The same solution once more, of what is left without the harmonic.
                    a, m_c, m_s, contrary = apply_steps(weights, y)
                    if w > 0.0:
                        a += b_a * e
                        m_c += b_c * e
                        m_s += b_s * e
                    # A sine must be clear, and four values must nearly be one.
                    modulation = np.sqrt(m_c * m_c + m_s * m_s)
                    good = modulation >= terms.min_modulation_dn and abs(contrary) <= max(
                        6.0 * terms.noise_dn, 0.25 * modulation
                    )
                    if not good:
                        break
                    turns = np.arctan2(m_s, m_c) / _TURN
                    # ∂φ/∂y_k = (m_c w_s,k − m_s w_c,k) / m², with each y's own noise, and of e, whose variance is 1 / w.
                    phase_variance, against = 0.0, 0.0
                    for k in range(SINES):
                        by = m_s * weights[1, k] - m_c * weights[2, k]
                        phase_variance += by * by * noise[k]
                        against += weights[3, k] * weights[3, k] * noise[k]
                    if w > 0.0:
                        by = m_s * b_c - m_c * b_s
                        phase_variance += by * by / w
                    # Contradiction squared, over its variance by the camera's noise at this offset.
                    grey_variance = float(terms.dark_dn2) + float(terms.shot_dn) * a
                    misfit = contrary * contrary / (against * grey_variance)
                    # V = (P/2π)² σ² · phase_variance / m⁴; steps of 90° have phase_variance = m²/2.
                    px_per_dn = px_per_rad / (modulation * modulation)
                    variance_px2 = px_per_dn * px_per_dn * grey_variance * phase_variance
                    p = _column(
                        pixels, starts, height, width, c, terms.gray, t, x, row, turns, a,
                        parabola_at(c, P_OF_T, t), terms.period_px, bits, carry,
                    )  # fmt: skip
                    good = bool(-_ONE <= p <= terms.width_px)
                    if not good:
                        break
                    # The depth of that column, and the row q(t) that the projector shows there.
                    nearer = _depth_of(p, c[P_OF_T], c[P_OF_T + 1], c[P_OF_T + 2])
                    settled = abs(nearer - t) < terms.settled_t
                    t = nearer
                    q = parabola_at(c, Q_OF_T, t)
                    good = bool(abs(t) < MAX_T) and bool(-_ONE <= q <= terms.height_px)
                    if settled or not good:
                        break
                if good:
                    # The row below begins with this correction; one that was carried on is averaged.
                    fresh = t - decoded_t[x]
                    farther[x] = _HALF * (farther[x] + fresh) if begun == 0 else fresh
                    break
            if not good:
                farther[x] = 0.0
                continue
            maps.p_px[row, x], maps.q_px[row, x] = p, q
            maps.modulation_half_dn[row, x] = np.uint8(min(2.0 * modulation + 0.5, 255.0))
            maps.misfit[row, x] = misfit
            maps.variance_px2[row, x] = variance_px2
            maps.offset_dn[row, x] = np.uint8(min(max(a + 0.5, 0.0), 255.0))
            # The bright frame where the point was then: it colours the cloud.
            at = FIRST_FRAME + FRAME_COEFFICIENTS * BRIGHT
            u_bright = int(x + parabola_at(c, at, t) + _HALF)
            v_bright = int(row + parabola_at(c, at + OF_V, t) + _HALF)
            if 0 <= u_bright < width and 0 <= v_bright < height:
                maps.bright[row, x] = bright[v_bright, u_bright]
            first, last = min(first, x), max(last, x + 1)
        maps.illuminated_columns[row, 0] = min(first, last)
        maps.illuminated_columns[row, 1] = last


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_to_sums(
    sources: Sources,
    row: int,
    first: int,
    stop: int,
    use_albedo: bool,
    s: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:
    """Add what columns ``first`` to ``stop`` − 1 of a row tell of the fringes' harmonic and the sines' mean to ``sums`` (2, 2)."""
    for x in range(first, stop):
        contrary, response, share = float(s[CONTRARY + x]), float(s[RESPONSE + x]), float(s[PLAIN_SHARE + x])
        # Steps that are next to nothing leave no offset: what 32 bits make of it is not even noise.
        if not (abs(contrary) < MAX_CONTRARY_DN and 0.0 < share < MOST_SHARE):
            continue
        sums[0, 0] += contrary * response
        sums[0, 1] += response * response
        albedo = float(sources.albedo_dn[row, x]) if use_albedo else 0.0
        if albedo > 0.0:
            # Mean light of the sines: a − backscatter = share · albedo, over the variance of a.
            sums[1, 0] += (float(s[PLAIN_OFFSET + x]) - float(sources.backscatter_dn[row, x])) * albedo / share
            sums[1, 1] += albedo * albedo / share


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _column(
    pixels: NDArray[np.uint8],
    starts: NDArray[np.int64],
    height: int,
    width: int,
    c: NDArray[np.float32],
    count: int,
    t: np.float32,
    x: int,
    row: int,
    turns: float,
    offset: float,
    expected_px: np.float32,
    period_px: np.float32,
    bits: NDArray[np.float32],
    carry: NDArray[np.int64],
) -> np.float32:
    """Return the pattern column of a phase, by the order that its ``count`` Gray images bear out, each read where the point was.

    NaN where none of the orders near the decoded and the expected one is borne out. ``bits`` and ``carry`` (8,) are scratch.

    All images but the last change at whole periods only: they number periods. Moving, a point may have been in the next
    period already when one of them was shown: that is known from its phase then.
    """
    # The order that makes period · (order + phase) − ½ nearest to the expected column.
    phase = turns - np.floor(turns)
    expected = int(np.floor((expected_px + _HALF) / period_px - phase + 0.5))
    number, bit = 0, 0
    per_offset = np.float32(1.0 / max(offset, 1.0))
    agreed = True
    for k in range(count):
        at = FIRST_FRAME + FRAME_COEFFICIENTS * (FIRST_GRAY + k)
        u = int(np.floor(np.float32(x) + parabola_at(c, at, t) + _HALF))
        v = int(np.floor(np.float32(row) + parabola_at(c, at + OF_V, t) + _HALF))
        if not (0 <= u < width and 0 <= v < height):
            return _NAN
        # −1 … 1: how clearly the image is dark or bright there.
        grey = np.float32(pixels[np.uint64(starts[FIRST_GRAY + k] + v * width + u)])
        bits[k] = min(max((grey - np.float32(offset)) * per_offset, -_ONE), _ONE)
        illuminated = int(bits[k] > 0)
        # Gray code to binary: each bit is the parity of those before.
        bit ^= illuminated
        number = 2 * number + bit
        # Phase at that time, in half periods for the last image, in whole ones for the others.
        then = phase + parabola_at(c, at + OF_PHASE, t)
        carry[k] = int(np.floor(then)) if k < count - 1 else int(np.floor(2.0 * then))
        # The expected order's own bit: Gray code h ^ (h >> 1) of its half period h, as it was then.
        half = 2 * (expected + carry[k]) if k < count - 1 else 2 * expected + carry[k]
        agreed = agreed and ((half ^ (half >> 1)) >> (count - 1 - k)) & 1 == illuminated
    if agreed:
        # No other order is contradicted less.
        return np.float32(period_px * (expected + phase) - _HALF)
    # Orders one beside the decoded one and one beside the expected one: the one that is contradicted least.
    decoded = number // 2
    best, least = -1000, np.float32(10.0)
    for near in range(6):
        period = decoded + near - 1 if near < 3 else expected + near - 4
        contrary = np.float32(0.0)
        for k in range(count):
            half = 2 * (period + carry[k]) if k < count - 1 else 2 * period + carry[k]
            shown = ((half ^ (half >> 1)) >> (count - 1 - k)) & 1
            against = -bits[k] if shown == 1 else bits[k]
            contrary += max(against, np.float32(0.0))
        if contrary < least:
            best, least = period, contrary
    if least > MAX_CONTRARY:
        return _NAN
    return np.float32(period_px * (best + phase) - _HALF)
