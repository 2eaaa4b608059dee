"""Owns the pixels' new coordinates: the sine frames followed to where each point went, and solved with their true steps."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.compensation.lookup import at, between, cubic, left_of_noise, linear, spread
from appliance.compensation.residuals import apply_steps, invert_steps
from appliance.compensation.ways import FIRST_WAY, P_OF_T, PER_FRAME, Q_OF_T, Ways

BRIGHT, FIRST_GRAY = 8, 9
"""Places of what is followed beside the 8 sine frames: the bright frame, then the Gray images of x, then of y."""
MAX_ROUNDS = 3
SETTLED_T = np.float32(0.002)
"""0.2 mm of depth: moves no way by more than 0.02 px."""
MAX_CONTRARY = np.float32(0.5)
"""Of a Gray image's full swing: what bits may say against an order altogether."""
MAX_ASIDE_PX = np.float32(4.0)
"""Between a pattern row and where the fitted projector has it for this pixel and column."""
MAX_T = np.float32(2.5)
NEAR_RAD = 0.03
"""Within it cosine and sine are carried on to the second order: right to 5e-6."""
_NAN, _ZERO, _HALF, _ONE = np.float32(np.nan), np.float32(0.0), np.float32(0.5), np.float32(1.0)
MIN_RATIO = np.float32(0.1)
MAX_ROUGH_T = np.float32(0.02)
"""2 mm of depth; beyond, the surface around a pixel is no smooth one."""
MIN_SLOPE2 = np.float32(0.01)
"""Of a pattern coordinate, in (px/px)²: on steeper limbs nothing is read beside the way."""


class Sources(NamedTuple):
    """What is looked up. Pictures are (h, w)."""

    frames: NDArray[np.uint8]
    """(n, h, w)."""
    followed: NDArray[np.int64]
    """Their numbers: 8 sines, bright, Gray images."""
    p_px: NDArray[np.float32]
    """As decoded without motion: where a pixel's depth comes from."""
    depth: NDArray[np.float32]
    """t, smooth, NaN where it is not known; (0, 0) where every point is followed all the way."""
    by_column: NDArray[np.float32]
    """Change of ``depth`` per column."""
    by_row: NDArray[np.float32]
    paint: NDArray[np.float32]
    """Grey values under full light."""
    veil: NDArray[np.float32]
    """Grey values without light."""
    doubt: NDArray[np.float32]
    """Variance of the paint, as a share of its square."""


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
    harmonic_x: np.float32
    """Second harmonic of the fringes, as a share of the first."""
    harmonic_y: np.float32
    gray_x: int
    """How many Gray images of the first direction."""
    gray_y: int
    fill_px: int
    """So far is a depth carried over pixels that have none."""
    follow_x: np.float32
    """Share of a point's way within the x-sines that is followed; what remains is read beside it, paint divided out."""
    follow_y: np.float32


class Solved(NamedTuple):
    """The maps (h, w) at the reference time."""

    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    worth_half_dn: NDArray[np.uint8]
    """The modulation that four steps of 90° would need for the same noise."""
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
    harmonics: NDArray[np.float64],
) -> None:
    """Solve every ``stride``-th row from ``start`` to ``stop`` − 1 into ``solved``.

    ``harmonics`` (2, 2) gathers Σ contradiction · response and Σ response² of the second harmonic, per direction.
    """
    nodes, step = ways.nodes, ways.step_px
    height, width = sources.p_px.shape
    pixels = sources.frames.reshape(sources.frames.size)
    starts = sources.followed * (height * width)
    bright = sources.frames[sources.followed[BRIGHT]]
    count = nodes.shape[2]
    upper = np.empty((nodes.shape[1], count), np.float32)
    parabola = np.empty((width, 3), np.float32)
    t_row = np.empty(width, np.float32)
    c = np.empty(count, np.float32)
    y, cosine, sine = np.empty(4), np.empty(4), np.empty(4)
    weights, known = np.empty((4, 4)), np.full((8, 3), np.inf)
    seen_gray, carry = np.empty(8, np.float32), np.empty(8, np.int64)
    # By how much the row above lies farther than its undecoded ripple said: the next one hardly differs.
    farther = np.zeros(width, np.float32)
    turns, modulation, light = np.empty(2), np.empty(2), np.empty(2)
    noise, worth, misfit = np.empty(4), 0.0, 0.0
    g_u, g_v = np.empty(6, np.float32), np.empty(6, np.float32)
    own_paint, own_depth, per_step = _ONE, _ZERO, np.float32(1.0 / step)
    per_variance = _ONE / (terms.noise_dn * terms.noise_dn)
    partly = min(terms.follow_x, terms.follow_y) < _ONE
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
        if partly:
            for x in range(width):
                if t_row[x] != t_row[x]:
                    t_row[x] = sources.depth[row, x]
        first, last = width, 0
        for x in range(width):
            solved.p_px[row, x] = _NAN
            solved.q_px[row, x] = _NAN
            solved.modulation_half_dn[row, x] = 0
            solved.worth_half_dn[row, x] = 0
            solved.misfit[row, x] = _NAN
            solved.bright[row, x] = bright[row, x]
            solved.light[row, x] = 0
            t = t_row[x]
            if not (abs(t) < MAX_T):
                continue
            i = x // step
            part = np.float32((x - i * step) / step)
            for k in range(count):
                c[k] = upper[i, k] + part * (upper[i + 1, k] - upper[i, k])
            aside_here = partly and abs(sources.depth[row, x] - t) < MAX_ROUGH_T and sources.paint[row, x] > _ZERO
            if aside_here:
                own_paint, own_depth = sources.paint[row, x], sources.depth[row, x]
                j = row // step
                for k in range(6):
                    g_u[k] = (upper[i + 1, k] - upper[i, k]) * per_step
                    low = nodes[j, i, k] + part * (nodes[j, i + 1, k] - nodes[j, i, k])
                    high = nodes[j + 1, i, k] + part * (nodes[j + 1, i + 1, k] - nodes[j + 1, i, k])
                    g_v[k] = (high - low) * per_step
            good = False
            from_above = farther[x] != 0.0
            if from_above:
                t += farther[x]
            for _ in range(MAX_ROUNDS + 1):
                good = True
                for block in range(2):
                    share = terms.follow_x if block == 0 else terms.follow_y
                    aside = aside_here and share < _ONE
                    shown = P_OF_T if block == 0 else Q_OF_T
                    middle, per_u, per_v = _ZERO, _ZERO, _ZERO
                    if aside:
                        for m in range(4):
                            middle += np.float32(0.25) * at(c, FIRST_WAY + PER_FRAME * (4 * block + m) + 6, t)
                        by_t = c[shown + 1] + np.float32(2.0) * t * c[shown + 2]
                        per_u = at(g_u, shown, t) + by_t * sources.by_column[row, x]
                        per_v = at(g_v, shown, t) + by_t * sources.by_row[row, x]
                        size2 = per_u * per_u + per_v * per_v
                        per_u, per_v = terms.period_px * per_u / size2, terms.period_px * per_v / size2
                        aside = size2 > MIN_SLOPE2
                    for m in range(4):
                        k = 4 * block + m
                        way = FIRST_WAY + PER_FRAME * k
                        way_u, way_v = at(c, way, t), at(c, way + 3, t)
                        t_there, carried, ratio, offset = t, _ZERO, _ONE, _ZERO
                        own_doubt = _ZERO
                        if aside:
                            back = (share - _ONE) * (at(c, way + 6, t) - middle)
                            du, dv = back * per_u, back * per_v
                            t_there = t + linear(sources.depth, np.float32(x) + du, np.float32(row) + dv) - own_depth
                            carried = at(c, shown, t_there) - at(c, shown, t)
                            carried += du * at(g_u, shown, t) + dv * at(g_v, shown, t)
                            carried /= terms.period_px
                            ratio = own_paint / between(sources.paint, np.float32(x) + du, np.float32(row) + dv)
                            if not (ratio > MIN_RATIO and ratio < _ONE / MIN_RATIO and t_there == t_there):
                                good = False
                                break
                            offset = sources.veil[row, x]
                            own_doubt = sources.doubt[int(row + dv + _HALF), int(x + du + _HALF)]
                            way_u += du
                            way_v += dv
                        u, v = np.float32(x) + way_u, np.float32(row) + way_v
                        if not (u >= _ONE and v >= _ONE and u < limit_u and v < limit_v):
                            good = False
                            break
                        y[m] = (cubic(pixels, starts[k], width, u, v) * gains[k] - offset) * ratio + offset
                        noise[m] = float(left_of_noise(u, v)) * ratio * ratio + own_doubt * y[m] * y[m] * per_variance
                        phase = float(at(c, way + 6, t_there)) + float(carried) + 0.25 * m
                        cosine[m], sine[m] = _turn(known[k], turn * phase)
                    if not good:
                        break
                    invert_steps(cosine, sine, weights)
                    _, along_c, along_s, rest = apply_steps(weights, y)
                    size = np.sqrt(along_c * along_c + along_s * along_s)
                    harmonic = terms.harmonic_x if block == 0 else terms.harmonic_y
                    # cos 2(φ + ψ) of the four steps, times the modulation.
                    per_size = 1.0 / (size + 1e-9)
                    co, si = (along_c * along_c - along_s * along_s) * per_size, 2.0 * along_c * along_s * per_size
                    seen = 0.0
                    for m in range(4):
                        c2, s2 = cosine[m] * cosine[m] - sine[m] * sine[m], 2.0 * sine[m] * cosine[m]
                        second = co * c2 - si * s2
                        seen += weights[3, m] * second
                        y[m] -= harmonic * second
                    if stride > 1 and abs(rest) < 20.0:
                        harmonics[block, 0] += rest * seen
                        harmonics[block, 1] += seen * seen
                    light[block], along_c, along_s, rest = apply_steps(weights, y)
                    size = np.sqrt(along_c * along_c + along_s * along_s)
                    if not (size >= terms.min_modulation_dn and abs(rest) <= max(6.0 * terms.noise_dn, 0.25 * size)):
                        good = False
                        break
                    turns[block] = np.arctan2(along_s, along_c) / turn
                    modulation[block] = size
                    spread_of, against = 0.0, 0.0
                    for m in range(4):
                        by = along_s * weights[1, m] - along_c * weights[2, m]
                        spread_of += by * by * noise[m]
                        against += weights[3, m] * weights[3, m] * noise[m]
                    if block == 0:
                        variance_dn2 = terms.dark_dn2 + terms.shot_dn * light[0]
                        misfit = rest * rest / (against * variance_dn2)
                        worth = size * size / np.sqrt(2.0 * spread_of + 1e-9)
                p = q = _NAN
                if good:
                    p = _place(
                        pixels, starts, height, width, c, FIRST_GRAY, terms.gray_x, t, x, row, turns[0], light[0],
                        at(c, P_OF_T, t), terms.period_px, seen_gray, carry,
                    )  # fmt: skip
                    q = _place(
                        pixels, starts, height, width, c, FIRST_GRAY + terms.gray_x, terms.gray_y, t, x, row, turns[1],
                        light[1], at(c, Q_OF_T, t), terms.period_px, seen_gray, carry,
                    )  # fmt: skip
                    good = bool(-_ONE <= p <= terms.width_px) and bool(-_ONE <= q <= terms.height_px)
                if not good:
                    if from_above:
                        from_above, t = False, t_row[x]
                        continue
                    break
                nearer = (p - c[P_OF_T]) / c[P_OF_T + 1]
                nearer -= c[P_OF_T + 2] * nearer * nearer / c[P_OF_T + 1]
                solved.p_px[row, x], solved.q_px[row, x] = p, q
                settled = abs(nearer - t) < SETTLED_T
                t = np.float32(nearer)
                if settled or not (abs(t) < MAX_T):
                    break
            if not good or not (abs(solved.q_px[row, x] - at(c, Q_OF_T, t)) <= MAX_ASIDE_PX):
                solved.p_px[row, x] = _NAN
                solved.q_px[row, x] = _NAN
                farther[x] = 0.0
                continue
            fresh = t - t_row[x]
            farther[x] = _HALF * (farther[x] + fresh) if from_above else fresh
            solved.modulation_half_dn[row, x] = np.uint8(min(2.0 * min(modulation[0], modulation[1]) + 0.5, 255.0))
            solved.misfit[row, x] = misfit
            solved.worth_half_dn[row, x] = np.uint8(
                min(2.0 * min(1.0, modulation[1] / modulation[0]) * worth + 0.5, 255.0)
            )
            solved.light[row, x] = np.uint8(min(max(light[0] + 0.5, 0.0), 255.0))
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
    first: int,
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
        way = FIRST_WAY + PER_FRAME * (first + k)
        u = int(np.floor(np.float32(x) + at(c, way, t) + _HALF))
        v = int(np.floor(np.float32(row) + at(c, way + 3, t) + _HALF))
        if not (0 <= u < width and 0 <= v < height):
            return _NAN
        grey = np.float32(pixels[np.uint64(starts[first + k] + v * width + u)])
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
