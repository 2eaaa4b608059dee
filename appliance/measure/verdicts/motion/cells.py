"""Owns the sums over the pixels of each cell of the pattern, from which the drift of the fringes is solved.

The sine images of X say everything but the row of cells, which is known when Y is decoded. So the sums are made of
short runs of pixels along the image's rows as soon as X is there, while Y is being recorded; afterwards each run whose
pixels all lie in one cell and have kept their coordinates is added to the cell's sums as a whole. The pixels of other
runs, at borders of cells and of surfaces, are summed anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence

CELL_PX = 64
"""Side of a cell in pattern px: 16 mm; one fringe of the longest period."""
SAMPLES = 120_000
"""Pixels of a camera that are looked at, about."""
RUN = 32
"""Most pixels of a run: sums of so few are exact enough in 32 bits."""
TERMS = 8
# Symbols of the kernels. At a pixel (u, v) with pattern coordinates (p, q): a, b, c, d are the four sine images I₀..I₃,
# (cosine, sine) = B (cos φ, sin φ), and C = a − b + c − d. x holds the terms that C is fitted by: B, B cos φ, B sin φ,
# B cos 2φ, B sin 2φ, the mean light, B cos 6φ and B sin 6φ; and behind them C. A row of sums holds the lower triangle
# of Σ x xᵀ, each of its rows filled up to a multiple of three; the same of what x differs by from the pixel to the one
# below; and the sums named by the constants below.

_SIZE = TERMS + 1
_AT_ONCE = 3
_PLACES = np.cumsum([0] + [-(-(row + 1) // _AT_ONCE) * _AT_ONCE for row in range(_SIZE)])
_PRODUCTS = int(_PLACES[-1])
COUNT, U, V, INVERSE, LIGHT, SLOPE, SLOPES, TEXTURE, TEXTURES, APART_NOISE, APART_SCALE = (
    2 * _PRODUCTS + k for k in range(11)
)
COLUMNS = APART_SCALE + 1
# A pixel's code: 0 for one that does not count; else its column of cells plus 1, shifted by two bits, one of which says
# that both neighbours along the row have coordinates, the other that the one below has.
_BESIDE, _BELOW, _SHIFT = 2, 1, 2
# Rows of numbers that the kernel works in, one for each pixel of a run: the four values of the pixel and of the one
# below, side by side; the sums of the four of both neighbours, and their coordinates; whether the pixel, its neighbours
# and the one below count, as 1 or 0; and x of the pixel and of the one below. All in one array at known distances, or
# the compiler would not make vectors of loops over them.
_BOTH = 2 * RUN
_VALUES = 0
_BEFORE, _AFTER, _P_BEFORE, _P_AFTER, _GOOD, _SLOPED, _PAIRED = (4 * _BOTH + RUN * k for k in range(7))
_X = _PAIRED + RUN
_WORK = _X + _SIZE * _BOTH

_HALF, _QUARTER, _EIGHTH = np.float32(0.5), np.float32(0.25), np.float32(0.125)
_ZERO, _ONE, _TWO, _THREE, _FOUR = (np.float32(x) for x in range(5))
_STEEP = np.float32(0.1)
_PER_PX = np.float32(1.0 / CELL_PX)

Images = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class RunSums:
    """Sums of one camera's runs, as X alone tells them."""

    code: NDArray[np.int16]
    """(rows, columns): codes of the pixels that are looked at."""
    sums: NDArray[np.float32]
    """(runs, ``COLUMNS``): of those runs that have pixels which count, row by row."""


@dataclass(frozen=True, slots=True)
class CellSums:
    """Sums of one camera's cells, (rows, columns, …) float64 of the pattern's cells."""

    here: NDArray[np.float64]
    """(…, ``TERMS`` + 1, ``TERMS`` + 1): Σ x xᵀ, of x with C behind it."""
    apart: NDArray[np.float64]
    """The same of the differences between a pixel and the one below it."""
    ones: NDArray[np.float64]
    """(…, ``COLUMNS``): all sums, of which ``COUNT`` to ``APART_SCALE`` are what is not named above."""


def run_sums(
    frames: NDArray[np.uint8], p_px: NDArray[np.float32], sequence: PatternSequence, variance_dn2: tuple[float, float]
) -> RunSums:
    """Sum up one camera's sine images of X, of ``frames`` (n, h, w) uint8, run by run; ``p_px`` (h, w) as decoded so
    far."""
    images = _sines(frames, sequence)
    stride, shape = _stride(p_px.shape), cells_of(sequence)
    height, width = p_px.shape
    code = np.empty((len(range(stride // 2, height, stride)), len(range(stride // 2 + 1, width - 1, stride))), np.int16)
    sums = np.zeros((_encode(p_px, stride, shape[1], code), COLUMNS), np.float32)
    _sum_runs(images, p_px, stride, _single(variance_dn2), code, sums)
    return RunSums(code, sums)


def cell_sums(
    frames: NDArray[np.uint8],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    sequence: PatternSequence,
    variance_dn2: tuple[float, float],
    runs: RunSums | None = None,
) -> CellSums:
    """Sum up one camera's sine images of X, of ``frames`` (n, h, w) uint8, cell by cell; ``p_px`` and ``q_px`` (h, w)
    float32.

    ``variance_dn2``: of the camera's noise as (dark, per grey value). ``runs``: what ``run_sums`` returned, where it
    was asked while the frames arrived.
    """
    runs = runs or run_sums(frames, p_px, sequence, variance_dn2)
    sums = np.zeros((*cells_of(sequence), COLUMNS))
    _collect(
        _sines(frames, sequence), p_px, q_px, _stride(p_px.shape), _single(variance_dn2), runs.code, runs.sums, sums
    )
    row, column = np.tril_indices(_SIZE)
    at = _PLACES[row] + column
    full = np.empty((2, *sums.shape[:2], _SIZE, _SIZE))
    for number, matrix in enumerate(full):
        matrix[..., row, column] = matrix[..., column, row] = sums[..., number * _PRODUCTS + at]
    return CellSums(full[0], full[1], sums)


def cells_of(sequence: PatternSequence) -> tuple[int, int]:
    """Return how many rows and columns of cells a pattern has."""
    return -(-sequence.height_px // CELL_PX), -(-sequence.width_px // CELL_PX)


def _stride(shape: tuple[int, ...]) -> int:
    return max(1, round(math.sqrt(shape[0] * shape[1] / SAMPLES)))


def _sines(frames: NDArray[np.uint8], sequence: PatternSequence) -> Images:
    first, second, third, fourth = sequence.axis(Direction.X).sine
    return frames[first], frames[second], frames[third], frames[fourth]


def _single(variance_dn2: tuple[float, float]) -> tuple[np.float32, np.float32]:
    return np.float32(variance_dn2[0]), np.float32(variance_dn2[1])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _encode_row(
    along: NDArray[np.float32],
    under: NDArray[np.float32],
    last: bool,
    stride: int,
    columns: int,
    code: NDArray[np.int16],
) -> None:
    """Write the codes of every ``stride``-th pixel of one row of coordinates; ``under`` is the row below it, if it is
    not the ``last``."""
    begin, most = stride // 2 + 1, np.float32(columns * CELL_PX)
    for i in range(code.size):
        u = begin + i * stride
        p = along[u]
        counts = p >= _ZERO and p < most
        # NaN differs from itself.
        beside = along[u - 1] == along[u - 1] and along[u + 1] == along[u + 1]
        below = under[u] >= _ZERO and not last
        column = np.int32(p * _PER_PX) + 1
        mine = (column << _SHIFT) + (_BESIDE if beside else 0) + (_BELOW if below else 0)
        code[i] = mine if counts else 0


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _run_at(code: NDArray[np.int16], first: int) -> tuple[int, int]:
    """Return where the run that begins at ``first`` ends, and its column of cells plus 1; 0: none of its pixels counts."""
    column = 0
    for i in range(first, min(first + RUN, code.size)):
        mine = code[i] >> _SHIFT
        if mine != 0:
            if column != 0 and column != mine:
                return i, column
            column = mine
    return min(first + RUN, code.size), column


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _encode(p_px: NDArray[np.float32], stride: int, columns: int, code: NDArray[np.int16]) -> int:
    """Write the codes of every ``stride``-th row and column; return how many runs have pixels that count."""
    runs, height = 0, p_px.shape[0]
    for j in range(code.shape[0]):
        v = stride // 2 + j * stride
        _encode_row(p_px[v], p_px[min(v + 1, height - 1)], v + 1 == height, stride, columns, code[j])
        i = 0
        while i < code.shape[1]:
            i, column = _run_at(code[j], i)
            runs += column != 0
    return runs


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sum_runs(
    images: Images,
    p_px: NDArray[np.float32],
    stride: int,
    variance_dn2: tuple[np.float32, np.float32],
    code: NDArray[np.int16],
    sums: NDArray[np.float32],
) -> None:
    """Add each run with pixels that count to its row of ``sums``, which are zeros."""
    work, x = np.zeros(_WORK, np.float32), np.zeros((2, _SIZE + _AT_ONCE, RUN), np.float32)
    k = 0
    for j in range(code.shape[0]):
        i = 0
        while i < code.shape[1]:
            end, column = _run_at(code[j], i)
            if column != 0:
                _add(images, p_px, stride, variance_dn2, j, i, code[j, i:end], work, x, sums[k])
                k += 1
            i = end


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _collect(
    images: Images,
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    stride: int,
    variance_dn2: tuple[np.float32, np.float32],
    code: NDArray[np.int16],
    runs: NDArray[np.float32],
    sums: NDArray[np.float64],
) -> None:
    """Add to ``sums`` (rows, columns, COLUMNS) what the runs hold, and the pixels of those that must be summed anew."""
    rows, columns = sums.shape[0], sums.shape[1]
    height, width = p_px.shape[0], code.shape[1]
    most = np.float32(rows * CELL_PX)
    now, row = np.empty(width, np.int16), np.empty(width, np.int16)
    work, x = np.zeros(_WORK, np.float32), np.zeros((2, _SIZE + _AT_ONCE, RUN), np.float32)
    here, part = np.empty(RUN, np.int16), np.empty(COLUMNS, np.float32)
    k = 0
    for j in range(code.shape[0]):
        v = stride // 2 + j * stride
        # The pixels' codes as they are now, and their rows of cells: without one, a pixel does not count.
        _encode_row(p_px[v], p_px[min(v + 1, height - 1)], v + 1 == height, stride, columns, now)
        for i in range(width):
            q = q_px[v, stride // 2 + 1 + i * stride]
            counts = q >= _ZERO and q < most
            row[i] = np.int32(q * _PER_PX) if counts else -1
            now[i] = now[i] if counts else 0
        first = 0
        while first < width:
            end, column = _run_at(code[j], first)
            # A run's sums hold if its codes are what they were and all its pixels lie in one row of cells.
            kept, where = column != 0, -1
            for i in range(first, end):
                if now[i] != code[j, i]:
                    kept = False
                    break
                if now[i] != 0:
                    if where >= 0 and where != row[i]:
                        kept = False
                        break
                    where = row[i]
            # Sum of the run, or of its pixels anew.
            if kept:
                for m in range(COLUMNS):
                    sums[where, column - 1, m] += runs[k, m]
            else:
                # Cell by cell: next to a border the pixels of a row may go to and fro.
                for i in range(first, end):
                    if now[i] == 0:
                        continue
                    mine, where = now[i] >> _SHIFT, row[i]
                    # Those that lie in the same cell, which are taken now and not again.
                    for m in range(end - first):
                        same = row[first + m] == where and now[first + m] >> _SHIFT == mine
                        here[m] = now[first + m] if same else 0
                        now[first + m] = 0 if same else now[first + m]
                    # Few pixels are summed in 32 bits, and cells in 64.
                    part[:] = _ZERO
                    _add(images, p_px, stride, variance_dn2, j, first, here[: end - first], work, x, part)
                    for m in range(COLUMNS):
                        sums[where, mine - 1, m] += part[m]
            # Runs without a pixel that counts have no sums.
            k += column != 0
            first = end


_FAST = {"reassoc", "contract", "nsz"}
"""Sums of few numbers, in whatever order is fastest."""


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _add(
    images: Images,
    p_px: NDArray[np.float32],
    stride: int,
    variance_dn2: tuple[np.float32, np.float32],
    j: int,
    first: int,
    code: NDArray[np.int16],
    work: NDArray[np.float32],
    x: NDArray[np.float32],
    sums: NDArray[np.float32],
) -> None:
    """Add the pixels of row ``j`` from the ``first`` one on, as many as ``code`` has and of which it is not 0, to
    ``sums`` (COLUMNS,).

    ``work`` (_WORK,) and ``x`` (2, _SIZE + _AT_ONCE, RUN), whose last rows are zeros, are written to.
    """
    i0, i1, i2, i3 = images
    v = stride // 2 + j * stride
    below = min(v + 1, p_px.shape[0] - 1)
    # No pixel counts until it is seen to.
    for i in range(RUN):
        work[_GOOD + i] = work[_SLOPED + i] = work[_PAIRED + i] = _ZERO
    for i in range(code.size):
        if code[i] == 0:
            continue
        u = stride // 2 + 1 + (first + i) * stride
        work[_GOOD + i] = _ONE
        # I₀..I₃ here.
        work[_VALUES + i], work[_VALUES + _BOTH + i] = i0[v, u], i1[v, u]
        work[_VALUES + 2 * _BOTH + i], work[_VALUES + 3 * _BOTH + i] = i2[v, u], i3[v, u]
        # The same of the pixel below, where it has a coordinate.
        if code[i] & _BELOW:
            work[_PAIRED + i] = _ONE
            work[_VALUES + RUN + i], work[_VALUES + _BOTH + RUN + i] = i0[below, u], i1[below, u]
            work[_VALUES + 2 * _BOTH + RUN + i], work[_VALUES + 3 * _BOTH + RUN + i] = i2[below, u], i3[below, u]
        if code[i] & _BESIDE:
            # Coordinate and I₀ + I₁ + I₂ + I₃ on both sides: their difference is twice the slope, or eight times the
            # light's.
            work[_SLOPED + i] = _ONE
            work[_P_BEFORE + i], work[_P_AFTER + i] = p_px[v, u - 1], p_px[v, u + 1]
            work[_BEFORE + i] = np.int32(i0[v, u - 1]) + i1[v, u - 1] + i2[v, u - 1] + i3[v, u - 1]
            work[_AFTER + i] = np.int32(i0[v, u + 1]) + i1[v, u + 1] + i2[v, u + 1] + i3[v, u + 1]
    # What lies in other places is of earlier runs: numbers, which count zero times.
    _terms(work)
    _add_ones(work, variance_dn2, np.float32(stride // 2 + 1 + first * stride), np.float32(stride), np.float32(v), sums)
    # x of the pixels that count, and its differences of the pairs that do: 0 for all others, which so add nothing.
    for k in range(_SIZE):
        for i in range(RUN):
            here = work[_X + k * _BOTH + i]
            x[0, k, i] = here * work[_GOOD + i]
            x[1, k, i] = (work[_X + k * _BOTH + RUN + i] - here) * work[_PAIRED + i]
    for which in range(2):
        _add_products(x[which], sums[which * _PRODUCTS :])


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _terms(work: NDArray[np.float32]) -> None:
    """Write x and C of all pixels."""
    for i in range(_BOTH):
        a, b = work[_VALUES + i], work[_VALUES + _BOTH + i]
        c, d = work[_VALUES + 2 * _BOTH + i], work[_VALUES + 3 * _BOTH + i]
        # Four steps of 90°: I₀ − I₂ = 2 B cos φ, I₃ − I₁ = 2 B sin φ. With z = e^{2iφ}, z³ is the sixth harmonic.
        cosine, sine = _HALF * (a - c), _HALF * (d - b)
        squared = cosine * cosine + sine * sine
        modulation = np.sqrt(squared if squared > _ONE else _ONE)
        inverse = _ONE / (modulation * modulation)
        second_cosine, second_sine = (cosine * cosine - sine * sine) * inverse, _TWO * cosine * sine * inverse
        sixth_cosine = second_cosine * (second_cosine * second_cosine - _THREE * second_sine * second_sine)
        sixth_sine = second_sine * (_THREE * second_cosine * second_cosine - second_sine * second_sine)
        work[_X + i] = modulation
        work[_X + _BOTH + i] = cosine
        work[_X + 2 * _BOTH + i] = sine
        work[_X + 3 * _BOTH + i] = modulation * second_cosine
        work[_X + 4 * _BOTH + i] = modulation * second_sine
        work[_X + 5 * _BOTH + i] = _QUARTER * (a + b + c + d)
        work[_X + 6 * _BOTH + i] = modulation * sixth_cosine
        work[_X + 7 * _BOTH + i] = modulation * sixth_sine
        work[_X + 8 * _BOTH + i] = a - b + c - d


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _add_ones(
    work: NDArray[np.float32],
    variance_dn2: tuple[np.float32, np.float32],
    first_u: np.float32,
    step_u: np.float32,
    v: np.float32,
    sums: NDArray[np.float32],
) -> None:
    """Add what is not in x xᵀ to ``sums``, and leave out of the good pixels those that have next to no fringes."""
    dark_dn2, per_dn = variance_dn2
    count = place = inverse = light = slopes = with_slope = texture = scale = _ZERO
    apart_noise = apart_scale = _ZERO
    for i in range(RUN):
        cosine, sine, mean = work[_X + _BOTH + i], work[_X + 2 * _BOTH + i], work[_X + 5 * _BOTH + i]
        squared = cosine * cosine + sine * sine
        # Noise of two pixels with four images each, 4 σ² at either's light; 4 B² makes it a phase, squared.
        paired = work[_PAIRED + i]
        apart_noise += paired * _FOUR * (_TWO * dark_dn2 + per_dn * (mean + work[_X + 5 * _BOTH + RUN + i]))
        apart_scale += paired * _FOUR * squared
        good = work[_GOOD + i] if squared >= _FOUR else _ZERO
        work[_GOOD + i] = good
        # Means over the cell: where it lies, 1/B² and light for the noise of its phase.
        count += good
        place += good * np.float32(i)
        inverse += good / (squared if squared > _FOUR else _FOUR)
        light += good * mean
        # The coordinate's slope, where both neighbours have one, and with it the gradient of the light.
        sloped = good * work[_SLOPED + i]
        slope = _HALF * (work[_P_AFTER + i] - work[_P_BEFORE + i])
        slopes += sloped * slope
        with_slope += sloped
        steep = sloped if abs(slope) > _STEEP else _ZERO
        per_slope = _ONE / (slope if abs(slope) > _STEEP else _ONE)
        gradient = _EIGHTH * (work[_AFTER + i] - work[_BEFORE + i]) * per_slope
        # Noise has a gradient, too: of eight grey values.
        own = _EIGHTH * (dark_dn2 + per_dn * mean) * (per_slope * per_slope)
        # Not the mean of ratios: where next to nothing is illuminated, they are large and mean little.
        texture += steep * (gradient * gradient - own)
        scale += steep * squared
    sums[COUNT] += count
    sums[U] += count * first_u + step_u * place
    sums[V] += count * v
    sums[INVERSE] += inverse
    sums[LIGHT] += light
    sums[SLOPE] += slopes
    sums[SLOPES] += with_slope
    sums[TEXTURE] += texture
    sums[TEXTURES] += scale
    sums[APART_NOISE] += apart_noise
    sums[APART_SCALE] += apart_scale


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath=_FAST)
def _add_products(x: NDArray[np.float32], sums: NDArray[np.float32]) -> None:
    """Add the lower triangle of Σ x xᵀ to ``sums``: three products at once, whose sums do not wait for each other."""
    to = 0
    for row in range(_SIZE):
        for column in range(0, row + 1, _AT_ONCE):
            first = second = third = _ZERO
            for i in range(RUN):
                mine = x[row, i]
                first += mine * x[column, i]
                second += mine * x[column + 1, i]
                third += mine * x[column + 2, i]
            sums[to] += first
            sums[to + 1] += second
            sums[to + 2] += third
            to += _AT_ONCE
