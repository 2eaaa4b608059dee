"""Owns the pixels' new coordinates: the x-sines followed to where each point went, and solved with their true steps.

Rows need no sines: where the column's depth is known, the fitted projector tells the row, better than a hand leaves it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.lookup import at, left_of_noise, smooth, spread
from appliance.compensation.residuals import apply_steps, invert_steps
from appliance.compensation.ways import FIRST_WAY, P_OF_T, PER_FRAME, Q_OF_T, Ways

SINES = 4
BRIGHT, FIRST_GRAY = 4, 5
"""Places of what is followed beside the 4 sine frames: the bright frame, then the Gray images of x, then of y."""
MAX_ROUNDS = 3
MAX_CONTRARY = np.float32(0.5)
"""Of a Gray image's full swing: what bits may say against an order altogether."""
MAX_T = np.float32(2.5)
NEAR_RAD = 0.03
"""Within it cosine and sine are carried on to the second order: right to 5e-6."""
MAX_CONTRARY_DN = 20.0
"""What contradicts more is no harmonic."""
LEAST_DOUBT = 1e-3
"""Of the paint, in variances of a grey value: keeps its weight finite."""
_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)


class Sources(NamedTuple):
    """What is looked up. Pictures are (h, w)."""

    frames: NDArray[np.uint8]
    """(n, h, w)."""
    followed: NDArray[np.int64]
    """Their numbers: 4 sines, bright, Gray images."""
    p_px: NDArray[np.float32]
    """As decoded without motion: where a pixel's depth is looked for first."""
    rough: NDArray[np.float32]
    """t everywhere, smooth: where it is looked for where that leads to nothing."""
    paint: NDArray[np.float32]
    """Grey values under full light, NaN where they are not known; (0, 0) where nobody asks for them."""
    veil: NDArray[np.float32]
    """Grey values without light."""
    doubt_dn2: NDArray[np.float32]
    """Variance of the paint."""


class Terms(NamedTuple):
    """Numbers of one scan and camera."""

    period_px: np.float32
    width_px: np.float32
    height_px: np.float32
    min_modulation_dn: np.float32
    noise_dn: np.float32
    """Of grey values, at the object's mean light."""
    dark_dn2: np.float32
    """Variance at grey value 0."""
    shot_dn: np.float32
    """Variance per grey value."""
    gray: int
    """How many Gray images of the first direction."""
    fill_px: int
    """So far is a depth carried over pixels that have none."""
    settled_t: np.float32
    """What moves no way by more than is looked up exactly."""
    harmonic: np.float32
    """Second harmonic of the fringes, as a share of the first."""
    mean_share: np.float32
    """Mean of the sines' light, of full light; 0: paint is not asked."""


class Solved(NamedTuple):
    """The maps (h, w) at the reference time."""

    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]
    """What the fitted projector shows there."""
    modulation_half_dn: NDArray[np.uint8]
    worth_dn: NDArray[np.float32]
    """The modulation that four steps of 90° would need for the same noise; 0 where there is no column."""
    misfit: NDArray[np.float32]
    """What contradicts in the x-sines, squared, of what noise makes it: 1 in the mean; NaN where there is no column."""
    bright: NDArray[np.uint8]
    light: NDArray[np.uint8]
    lit_columns: NDArray[np.int32]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _turn(known: NDArray[np.float64], psi: float) -> tuple[float, float]:
    """Cosine and sine of ``psi``, carried on from those ``known`` (3,): angle, cosine, sine."""
    apart = psi - known[0]
    if not abs(apart) < NEAR_RAD:
        known[0], known[1], known[2] = psi, np.cos(psi), np.sin(psi)
        return known[1], known[2]
    less = 1.0 - 0.5 * apart * apart
    return less * known[1] - apart * known[2], less * known[2] + apart * known[1]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def weigh_offset(
    cosine: NDArray[np.float64], sine: NDArray[np.float64], told: float, weights: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Least squares of y_k = a + c cos ψ_k − s sin ψ_k over four steps where also a is ``told``, with that weight against one
    y: how a, c and s follow from y, into ``weights`` (3, 4), and how a, c and s follow from what a is told to be."""
    n00, n01, n02, n11, n12, n22 = 4.0 + told, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(SINES):
        n01 += cosine[k]
        n02 -= sine[k]
        n11 += cosine[k] * cosine[k]
        n12 -= cosine[k] * sine[k]
        n22 += sine[k] * sine[k]
    i00, i01, i02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    i11, i12, i22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
    scale = 1.0 / (n00 * i00 + n01 * i01 + n02 * i02)
    for k in range(SINES):
        weights[0, k] = scale * (i00 + i01 * cosine[k] - i02 * sine[k])
        weights[1, k] = scale * (i01 + i11 * cosine[k] - i12 * sine[k])
        weights[2, k] = scale * (i02 + i12 * cosine[k] - i22 * sine[k])
    return scale * told * i00, scale * told * i01, scale * told * i02


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _depths(row: NDArray[np.float32], p_px: NDArray[np.float32], fill_px: int, t: NDArray[np.float32]) -> None:
    """t of each pixel of a row; where it has no column, that of the nearest one, NaN beyond ``fill_px``.

    ``row`` (w, 3): parabolas of p.
    """
    width = p_px.size
    last, at = _NAN, -1
    for x in range(width):
        t[x] = _NAN
        if p_px[x] == p_px[x]:
            first = (p_px[x] - row[x, 0]) / row[x, 1]
            last = first - row[x, 2] * first * first / row[x, 1]
            at = x
            t[x] = last
        elif at >= 0 and x - at <= fill_px:
            t[x] = last
    last, at = _NAN, -1
    for x in range(width - 1, -1, -1):
        if p_px[x] == p_px[x]:
            last, at = t[x], x
        elif at >= 0 and at - x <= fill_px:
            before = t[x]
            # Of the two ends of a gap the nearer one.
            if before != before or _nearer(p_px, x, at - x):
                t[x] = last


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _nearer(p_px: NDArray[np.float32], x: int, distance: int) -> bool:
    """Whether no pixel with a column lies closer before ``x`` than ``distance``."""
    for k in range(1, distance):
        if x - k < 0:
            return True
        if p_px[x - k] == p_px[x - k]:
            return False
    return True


@numba.njit(nogil=True, cache=True, error_model="numpy")
def solve_rows(
    sources: Sources,
    ways: Ways,
    gains: NDArray[np.float32],
    terms: Terms,
    start: int,
    stop: int,
    stride: int,
    solved: Solved,
    gathered: NDArray[np.float64],
) -> None:
    """Solve every ``stride``-th row from ``start`` to ``stop`` − 1 into ``solved``.

    ``gathered`` (2, 2) gathers Σ contradiction · response and Σ response² of the second harmonic, then Σ offset · paint and
    Σ paint² of the sines' mean.
    """
    nodes, step = ways.nodes, ways.step_px
    height, width = sources.p_px.shape
    pixels = sources.frames.reshape(sources.frames.size)
    starts = sources.followed * (height * width)
    bright = sources.frames[sources.followed[BRIGHT]]
    count = FIRST_WAY + PER_FRAME * (FIRST_GRAY + terms.gray)
    upper = np.empty((nodes.shape[1], nodes.shape[2]), np.float32)
    parabola = np.empty((width, 3), np.float32)
    t_row = np.empty(width, np.float32)
    c = np.empty(count, np.float32)
    y, cosine, sine, noise = np.empty(SINES), np.empty(SINES), np.empty(SINES), np.empty(SINES)
    weights, known = np.empty((4, SINES)), np.full((SINES, 3), np.inf)
    seen_gray, carry = np.empty(8, np.float32), np.empty(8, np.int64)
    # By how much the row above lies farther than its undecoded ripple said: the next one hardly differs.
    farther = np.zeros(width, np.float32)
    per_variance = 1.0 / (float(terms.noise_dn) * float(terms.noise_dn))
    painting = sources.paint.shape[0] == height
    limit_u, limit_v = np.float32(width - 2), np.float32(height - 2)
    turn = 2.0 * np.pi
    for row in range(start, stop, stride):
        spread(nodes, step, row, upper)
        for x in range(width):
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(3):
                parabola[x, k] = upper[i, P_OF_T + k] + part * (upper[i + 1, P_OF_T + k] - upper[i, P_OF_T + k])
        _depths(parabola, sources.p_px[row], terms.fill_px, t_row)
        first, last = width, 0
        for x in range(width):
            solved.p_px[row, x] = _NAN
            solved.q_px[row, x] = _NAN
            solved.modulation_half_dn[row, x] = 0
            solved.worth_dn[row, x] = 0.0
            solved.misfit[row, x] = _NAN
            solved.bright[row, x] = bright[row, x]
            solved.light[row, x] = 0
            if not (abs(t_row[x]) < MAX_T):
                t_row[x] = sources.rough[row, x]
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(count):
                c[k] = upper[i, k] + part * (upper[i + 1, k] - upper[i, k])
            paint = float(sources.paint[row, x]) if painting else 0.0
            painted, doubt = paint > 0.0, 0.0
            if painted:
                doubt = per_variance * float(sources.doubt_dn2[row, x]) + LEAST_DOUBT
            good, t, p, q = False, _NAN, _NAN, _NAN
            offset, size, worth, misfit, turns = 0.0, 0.0, 0.0, 0.0, 0.0
            for start_from in range(3):
                # From what the row above said, from what was decoded, from what is around.
                if start_from == 0:
                    if farther[x] == 0.0:
                        continue
                    t = t_row[x] + farther[x]
                elif start_from == 1:
                    t = t_row[x]
                else:
                    t = sources.rough[row, x]
                    if abs(t - t_row[x]) <= terms.settled_t:
                        break
                for _ in range(MAX_ROUNDS + 1):
                    good = bool(abs(t) < MAX_T)
                    if not good:
                        break
                    for k in range(SINES):
                        way = FIRST_WAY + PER_FRAME * k
                        u, v = np.float32(x) + at(c, way, t), np.float32(row) + at(c, way + 3, t)
                        if not (u >= _ONE and v >= _ONE and u < limit_u and v < limit_v):
                            good = False
                            break
                        y[k] = smooth(pixels, starts[k], width, u, v) * gains[k]
                        noise[k] = float(left_of_noise(u, v))
                        cosine[k], sine[k] = _turn(known[k], turn * (float(at(c, way + 6, t)) + 0.25 * k))
                    if not good:
                        break
                    invert_steps(cosine, sine, weights)
                    offset, along_c, along_s, rest = apply_steps(weights, y)
                    told, told_a, told_c, told_s, expected = 0.0, 0.0, 0.0, 0.0, 0.0
                    if painted:
                        if stride > 1 and abs(rest) < MAX_CONTRARY_DN:
                            spare = 0.0
                            for k in range(SINES):
                                spare += weights[0, k] * weights[0, k]
                            gathered[1, 0] += (offset - sources.veil[row, x]) * paint / spare
                            gathered[1, 1] += paint * paint / spare
                        if terms.mean_share > 0.0:
                            expected = float(sources.veil[row, x]) + float(terms.mean_share) * paint
                            told = 1.0 / (float(terms.mean_share) ** 2 * doubt)
                            told_a, told_c, told_s = weigh_offset(cosine, sine, told, weights)
                            along_c, along_s = told_c * expected, told_s * expected
                            for k in range(SINES):
                                along_c += weights[1, k] * y[k]
                                along_s += weights[2, k] * y[k]
                    # cos 2(φ + ψ) of the four steps, times the modulation.
                    per_size = 1.0 / (np.sqrt(along_c * along_c + along_s * along_s) + 1e-9)
                    co, si = (along_c * along_c - along_s * along_s) * per_size, 2.0 * along_c * along_s * per_size
                    seen = 0.0
                    for k in range(SINES):
                        c2, s2 = cosine[k] * cosine[k] - sine[k] * sine[k], 2.0 * sine[k] * cosine[k]
                        second = co * c2 - si * s2
                        seen += weights[3, k] * second
                        y[k] -= terms.harmonic * second
                    if stride > 1 and abs(rest) < MAX_CONTRARY_DN:
                        gathered[0, 0] += rest * seen
                        gathered[0, 1] += seen * seen
                    offset, along_c, along_s, rest = apply_steps(weights, y)
                    if told > 0.0:
                        offset += told_a * expected
                        along_c += told_c * expected
                        along_s += told_s * expected
                    size = np.sqrt(along_c * along_c + along_s * along_s)
                    good = size >= terms.min_modulation_dn and abs(rest) <= max(6.0 * terms.noise_dn, 0.25 * size)
                    if not good:
                        break
                    turns = np.arctan2(along_s, along_c) / turn
                    spread_of, against = 0.0, 0.0
                    for k in range(SINES):
                        by = along_s * weights[1, k] - along_c * weights[2, k]
                        spread_of += by * by * noise[k]
                        against += weights[3, k] * weights[3, k] * noise[k]
                    if told > 0.0:
                        by = along_s * told_c - along_c * told_s
                        spread_of += by * by / told
                    misfit = rest * rest / (against * (float(terms.dark_dn2) + float(terms.shot_dn) * offset))
                    worth = size * size / np.sqrt(2.0 * spread_of + 1e-9)
                    p = _place(
                        pixels, starts, height, width, c, terms.gray, t, x, row, turns, offset,
                        at(c, P_OF_T, t), terms.period_px, seen_gray, carry,
                    )  # fmt: skip
                    good = bool(-_ONE <= p <= terms.width_px)
                    if not good:
                        break
                    nearer = (p - c[P_OF_T]) / c[P_OF_T + 1]
                    nearer -= c[P_OF_T + 2] * nearer * nearer / c[P_OF_T + 1]
                    settled = abs(nearer - t) < terms.settled_t
                    t = np.float32(nearer)
                    q = at(c, Q_OF_T, t)
                    good = bool(abs(t) < MAX_T) and bool(-_ONE <= q <= terms.height_px)
                    if settled or not good:
                        break
                if good:
                    fresh = t - t_row[x]
                    farther[x] = _HALF * (farther[x] + fresh) if start_from == 0 else fresh
                    break
            if not good:
                farther[x] = 0.0
                continue
            solved.p_px[row, x], solved.q_px[row, x] = p, q
            solved.modulation_half_dn[row, x] = np.uint8(min(2.0 * size + 0.5, 255.0))
            solved.misfit[row, x] = misfit
            solved.worth_dn[row, x] = worth
            solved.light[row, x] = np.uint8(min(max(offset + 0.5, 0.0), 255.0))
            way = FIRST_WAY + PER_FRAME * BRIGHT
            column, line = int(x + at(c, way, t) + _HALF), int(row + at(c, way + 3, t) + _HALF)
            if 0 <= column < width and 0 <= line < height:
                solved.bright[row, x] = bright[line, column]
            first, last = min(first, x), max(last, x + 1)
        solved.lit_columns[row, 0] = min(first, last)
        solved.lit_columns[row, 1] = last


@numba.njit(nogil=True, cache=True, error_model="numpy")
def depth_rows(
    p_px: NDArray[np.float32], ways: Ways, fill_px: int, start: int, stop: int, depth: NDArray[np.float32]
) -> None:
    """t of the pixels of rows ``start`` to ``stop`` − 1, by their columns; where one has none, that of the nearest."""
    nodes, step = ways.nodes, ways.step_px
    upper = np.empty((nodes.shape[1], nodes.shape[2]), np.float32)
    parabola = np.empty((p_px.shape[1], 3), np.float32)
    for row in range(start, stop):
        spread(nodes, step, row, upper)
        for x in range(p_px.shape[1]):
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(3):
                parabola[x, k] = upper[i, P_OF_T + k] + part * (upper[i + 1, P_OF_T + k] - upper[i, P_OF_T + k])
        _depths(parabola, p_px[row], fill_px, depth[row])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _place(
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
    light: float,
    expected_px: np.float32,
    period_px: np.float32,
    seen: NDArray[np.float32],
    carry: NDArray[np.int64],
) -> np.float32:
    """Pattern coordinate of a phase by the order that its Gray images bear out, each where the point was then; NaN where
    none of those near to the decoded and to the expected one is borne out. ``seen`` and ``carry`` (8,) are scratch.

    All images but the last change at whole periods only: they number periods. Moving, a point may have been in the next
    period already when one of them was shown: that is known from its phase then.
    """
    phase = turns - np.floor(turns)
    wanted = int(np.floor((expected_px + _HALF) / period_px - phase + 0.5))
    number, bit = 0, 0
    per_light = np.float32(1.0 / max(light, 1.0))
    agreed = True
    for k in range(count):
        way = FIRST_WAY + PER_FRAME * (FIRST_GRAY + k)
        u = int(np.floor(np.float32(x) + at(c, way, t) + _HALF))
        v = int(np.floor(np.float32(row) + at(c, way + 3, t) + _HALF))
        if not (0 <= u < width and 0 <= v < height):
            return _NAN
        grey = np.float32(pixels[np.uint64(starts[FIRST_GRAY + k] + v * width + u)])
        seen[k] = min(max((grey - np.float32(light)) * per_light, -_ONE), _ONE)
        lit = int(seen[k] > 0)
        bit ^= lit
        number = 2 * number + bit
        then = phase + at(c, way + 6, t)
        # In half periods for the last image, whole ones for the others.
        carry[k] = int(np.floor(then)) if k < count - 1 else int(np.floor(2.0 * then))
        half = 2 * (wanted + carry[k]) if k < count - 1 else 2 * wanted + carry[k]
        agreed = agreed and ((half ^ (half >> 1)) >> (count - 1 - k)) & 1 == lit
    if agreed:
        # No other order is contradicted less.
        return np.float32(period_px * (wanted + phase) - _HALF)
    decoded = number // 2
    best, least = -1000, np.float32(10.0)
    for near in range(6):
        period = decoded + near - 1 if near < 3 else wanted + near - 4
        contrary = np.float32(0.0)
        for k in range(count):
            half = 2 * (period + carry[k]) if k < count - 1 else 2 * period + carry[k]
            shown = ((half ^ (half >> 1)) >> (count - 1 - k)) & 1
            against = -seen[k] if shown == 1 else seen[k]
            contrary += max(against, np.float32(0.0))
        if contrary < least:
            best, least = period, contrary
    if least > MAX_CONTRARY:
        return _NAN
    return np.float32(period_px * (best + phase) - _HALF)
