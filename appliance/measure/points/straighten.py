"""Response correction: the phase error by the projector's response, measured in the scan and removed.

The harmonics of the recorded fringes make a four-step phase wrong by a function of the phase alone, with 4, 8, 12 …
cycles a period (``appliance.measure.light.patterns.phase_error_rad``): e(p) = Σ b_k sin kθ, θ = 8π (p + ½)/P, of the
decoded coordinate p. It has no cosines, since light is an even function of the fringe's phase, and it is the same for
both directions and both cameras. On a smooth surface the second difference of p is that of e, whose regressors sin kθ
are known at all three places. Least squares over samples of all four maps give the b_k. Each b_k that is significant is
subtracted from every coordinate.

A projector that makes grey by bit planes has another response for each exposure that covers a part of its frame
(``docs/phase-bias.md``). The response measured here is that of the scan's exposure, through its cameras, blur and their
own response included.

Symbols: y = p₋ + p₊ − 2 p is the second difference over a distance of d pixels; r_k that of sin kθ; m the normal
equations' matrix Σ r_j r_k, v their right side Σ r_k y; rate = 4/P cycles of θ per px.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numba
import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]

ORDERS = 4
"""Number of terms b_k: of 16 cycles a period at most, which a large third harmonic still makes."""
SAMPLES = 1_500
"""Number of pixels of each map that are sampled."""
ROUNDS = 2
"""Rounds of least squares; the first one excludes outliers from zero, the second one outliers from the fit."""
CLIP_PERIODS, FIRST_CLIP_PERIODS = 1.0 / 16.0, 1.0 / 6.0
"""Largest second difference that is no edge, in periods: from the fit, and in the first round from zero."""
SURE = 5.0
"""Least significance of a term, in its standard errors: noise exceeds it in one of a million scans."""
FEWEST = 80
"""Fewest samples for a fit."""
WORTH = 0.1
"""Least RMS phase error that is corrected, over the coordinates' noise: a tenth adds half a percent to errors."""
BEST_TURNS = 0.35
"""Cycles of θ over the distance d: sin θ has a large second difference there, and sin 2θ a useful one."""
MOST_APART_PX = 16
PHASES = 256
"""Number of phases in a mean over the fringe."""
_S1, _S3, _S5, _S7, _S9 = (np.float32(c) for c in (6.2830558, -41.331214, 81.366815, -74.478003, 32.781398))
"""sin 2πt ≈ t (S1 + t² (S3 + …)), |t| ≤ ½: the minimax fit, with an error of at most 6e-6."""
_C0, _C2, _C4, _C6, _C8 = (np.float32(c) for c in (0.9999598, -19.731042, 64.673432, -82.403552, 45.646558))
"""cos 2πt ≈ C0 + t² (C2 + …), likewise, 4e-5."""
_ONE, _HALF, _TWO, _THREE, _FOUR = (np.float32(x) for x in (1.0, 0.5, 2.0, 3.0, 4.0))


@dataclass(frozen=True, slots=True)
class PhaseBend:
    """The phase error of a coordinate by the response, as a function of its phase."""

    terms_px: tuple[float, ...]
    """b_1 … b_``ORDERS`` in pattern px; 0 if not significant."""
    noise_px: float
    """Standard deviation of a coordinate without it, including the unevenness of the surface."""

    @property
    def rms_px(self) -> float:
        """RMS over the fringe."""
        return math.sqrt(0.5 * sum(b * b for b in self.terms_px))

    @property
    def counts(self) -> bool:
        """True if it increases errors noticeably."""
        return self.rms_px > WORTH * self.noise_px

    def variance_factor(self, period_px: int) -> float:
        """Return the factor by which the correction multiplies a coordinate's variance; mean over pixels.

        At a decoded p, p − e(p) has (1 − e')² times its variance; and of pixels spread evenly over the fringe, 1 − e'
        times as many are decoded there.
        """
        theta = np.linspace(0.0, 2.0 * np.pi, PHASES, endpoint=False)
        orders = np.arange(1, ORDERS + 1)
        slope = (8.0 * math.pi / period_px) * np.cos(np.outer(theta, orders)) @ (orders * np.array(self.terms_px))
        return float(np.mean(np.abs(1.0 - slope) ** 3))


STRAIGHT = PhaseBend((0.0,) * ORDERS, 0.0)


class CoordinateMaps(Protocol):
    """Pattern coordinates that one camera decoded."""

    @property
    def p_px(self) -> Map:
        """Columns (h, w), NaN where there is none."""

    @property
    def q_px(self) -> Map:
        """Rows (h, w), NaN where there is none."""

    @property
    def illuminated_columns(self) -> NDArray[np.int32]:
        """(h, 2): first column of each row's illuminated part, and the one behind it."""


class _Maps(NamedTuple):
    p_px: Map
    q_px: Map
    illuminated_columns: NDArray[np.int32]


def warm_up() -> None:
    """Run every kernel on a few pixels."""
    flat, full_rows = np.tile(np.arange(8, dtype=np.float32), (8, 1)), np.tile(np.array([0, 8], np.int32), (8, 1))
    maps = _Maps(flat, flat.T.copy(), full_rows)
    measure_bend([maps], 16)
    take_out(maps, PhaseBend((0.1,) + (0.0,) * (ORDERS - 1), 0.01), 16)


def measure_bend(cameras: Sequence[CoordinateMaps], period_px: int) -> PhaseBend:
    """Measure the phase error in all coordinates of the ``cameras``; ``STRAIGHT`` if there are too few."""
    sampled = [
        (
            coordinates_px,
            camera.illuminated_columns,
            axis,
            _apart_px(coordinates_px, camera.illuminated_columns, axis, 4.0 / period_px),
        )
        for camera in cameras
        for coordinates_px, axis in ((camera.p_px, 1), (camera.q_px, 0))
    ]
    terms, bend = np.zeros(ORDERS), STRAIGHT
    for number in range(ROUNDS):
        clip_px = period_px * (CLIP_PERIODS if number else FIRST_CLIP_PERIODS)
        sums = _summed(sampled, period_px, terms, clip_px)
        m, v, yy, count = sums[: ORDERS * ORDERS].reshape(ORDERS, ORDERS), sums[-6:-2], sums[-2], int(sums[-1])
        if count < FEWEST:
            return STRAIGHT
        # A small ridge: if a term's cycle is a whole number of pixels, its second differences are almost zero.
        inverse = np.linalg.inv(m + np.eye(ORDERS) * (1e-4 * np.trace(m) + 1e-12))
        terms = inverse @ v
        residual2 = max(yy - 2.0 * terms @ v + terms @ m @ terms, 0.0) / (count - ORDERS)
        error = np.sqrt(np.diag(inverse) * residual2)
        sure = np.where(np.abs(terms) > SURE * error, terms, 0.0)
        # A second difference of white noise has six times its variance.
        bend = PhaseBend(tuple(float(b) for b in sure), math.sqrt(residual2 / 6.0))
    return bend


def take_out(camera: CoordinateMaps, bend: PhaseBend, period_px: int) -> None:
    """Subtract the phase error from the illuminated part of one camera's columns and rows, in place."""
    terms = np.array(bend.terms_px, np.float32)
    for coordinate_px in (camera.p_px, camera.q_px):
        _take_out(coordinate_px, camera.illuminated_columns, terms, np.float32(4.0 / period_px))


def _apart_px(coordinate_px: Map, illuminated: NDArray[np.int32], axis: int, rate: float) -> int:
    """Return the distance of second differences in pixels: about ``BEST_TURNS`` cycles of θ."""
    slopes = _slopes(coordinate_px, illuminated, axis, _stride(coordinate_px))
    typical = float(np.median(slopes)) if slopes.size else 1.0
    return min(max(1, round(BEST_TURNS / max(rate * typical, 1e-6))), MOST_APART_PX)


def _stride(coordinate_px: Map) -> int:
    return max(1, int((coordinate_px.size / SAMPLES) ** 0.5))


def _summed(
    maps: Iterable[tuple[Map, NDArray[np.int32], int, int]], period_px: int, terms: NDArray[np.float64], clip_px: float
) -> NDArray[np.float64]:
    sums = np.zeros(ORDERS * ORDERS + ORDERS + 2)
    for coordinate_px, illuminated, axis, apart in maps:
        stride = _stride(coordinate_px)
        _add_sums(coordinate_px, illuminated, axis, apart, stride, 8.0 * math.pi / period_px, terms, clip_px, sums)
    return sums


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _slopes(p_px: Map, illuminated: NDArray[np.int32], axis: int, stride: int) -> NDArray[np.float64]:
    """Return the absolute slopes along ``axis`` at every ``stride``-th pixel that has one."""
    rows, columns = p_px.shape
    slopes = np.empty((rows // stride + 1) * (columns // stride + 1))
    count = 0
    down, right = (1, 0) if axis == 0 else (0, 1)
    for y in range(stride // 2, rows - down, stride):
        for x in range(max(int(illuminated[y, 0]), 0), min(int(illuminated[y, 1]), columns - right), stride):
            slope = abs(float(p_px[y + down, x + right]) - float(p_px[y, x]))
            if slope == slope:
                slopes[count] = slope
                count += 1
    return slopes[:count]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add_sums(
    p_px: Map,
    illuminated: NDArray[np.int32],
    axis: int,
    apart: int,
    stride: int,
    cycle_rad: float,
    terms: NDArray[np.float64],
    clip_px: float,
    sums: NDArray[np.float64],
) -> None:
    """Add m (row by row), v, Σ y² and the count of one map to ``sums``, without outliers.

    An outlier differs from ``terms`` by more than ``clip_px``.
    """
    rows, columns = p_px.shape
    # Neighbours lie along the direction in which this coordinate grows.
    down, right = (apart, 0) if axis == 0 else (0, apart)
    orders = terms.size
    r = np.empty(orders)
    for row in range(stride // 2, rows, stride):
        if row < down or row + down >= rows:
            continue
        first, last = max(int(illuminated[row, 0]), right), min(int(illuminated[row, 1]), columns - right)
        # Staggered from row to row; otherwise all rows of a plane would have the same few phases.
        for x in range(first + row // stride % stride, last, stride):
            before, centre, after = (
                float(p_px[row - down, x - right]),
                float(p_px[row, x]),
                float(p_px[row + down, x + right]),
            )
            # y = p₋ + p₊ − 2 p; NaN where one of the three has no coordinate, which fails the comparison.
            y = before + after - 2.0 * centre
            if not abs(y) < 1e6:
                continue
            # r_k by recursion: sin (k+1)θ = 2 cos θ sin kθ − sin (k−1)θ, at each of the three places.
            for k in range(orders):
                r[k] = 0.0
            for place in range(3):
                theta = cycle_rad * ((before if place == 0 else (after if place == 1 else centre)) + 0.5)
                weight = -2.0 if place == 2 else 1.0
                sine, twice = math.sin(theta), 2.0 * math.cos(theta)
                last_sine = 0.0
                for k in range(orders):
                    r[k] += weight * sine
                    sine, last_sine = twice * sine - last_sine, sine
            # An edge is far from the fit of the last round.
            fitted = 0.0
            for k in range(orders):
                fitted += terms[k] * r[k]
            if abs(y - fitted) > clip_px:
                continue
            # Normal equations: m_jk = Σ r_j r_k, v_j = Σ r_j y.
            for j in range(orders):
                for k in range(orders):
                    sums[j * orders + k] += r[j] * r[k]
                sums[orders * orders + j] += r[j] * y
            sums[orders * orders + orders] += y * y
            sums[orders * orders + orders + 1] += 1.0


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _take_out(p_px: Map, illuminated: NDArray[np.int32], terms: NDArray[np.float32], rate: np.float32) -> None:
    """Subtract e(p) from each coordinate, in a loop without branches that is vectorised; NaN stays NaN."""
    b1, b2, b3, b4 = terms[0], _TWO * terms[1], terms[2], _FOUR * terms[3]
    for row in range(p_px.shape[0]):
        p = p_px[row, illuminated[row, 0] : illuminated[row, 1]]
        for x in range(p.size):
            turns = (p[x] + _HALF) * rate
            # Coordinates begin at −½ px: truncation is rounding down, and half a cycle more makes it rounding.
            t = turns - np.float32(np.int32(turns + _HALF))
            u = t * t
            s = t * (_S1 + u * (_S3 + u * (_S5 + u * (_S7 + u * _S9))))
            c = _C0 + u * (_C2 + u * (_C4 + u * (_C6 + u * _C8)))
            # sin 2θ = 2 s c, sin 3θ = s (3 − 4 s²), sin 4θ = 4 s c (1 − 2 s²)
            sc, ss = s * c, s * s
            p[x] -= b1 * s + b2 * sc + b3 * s * (_THREE - _FOUR * ss) + b4 * sc * (_ONE - _TWO * ss)
