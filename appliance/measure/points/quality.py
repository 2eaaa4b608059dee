"""The quality of points and clouds: limits, numbers of a cloud, sampled ray gaps and ripple.

QualityLimits, summarise     limits that points must keep, and the numbers that describe a cloud
quantile, median             NumPy's results in a seventh of the time
GapSampler                   signed ray gaps of a scan, before any limit could hide a knock
Ripple, measure_ripple       how much the projector's response ripples a coordinate, measured in the scan itself

``numpy.median`` and ``numpy.quantile`` ask for several ranks at once, which sorts value by value. A single rank is
found with vector instructions, and its neighbour is the least of the values above it.

The gap is w · n / |n|, w the offset of the two rays on the lattice's plane and n the cross product of their directions;
its sign is that of the side on which the right ray passes.

Symbols: the left ray goes along (ax, ay, 1), the right one along (bx, by, 1), and n = (cx, cy, cz); (u, v) and (u', v')
are the left pixel and its match in px.

A third harmonic in the recorded fringes makes a four-step phase wrong four times a period. The surface does not depend
on the fringes, so the part of the second differences of p along rows that goes with the fringe's phase is ripple. It is
measured at its place, behind lens and water, in images of full size. Patterns that are corrected for the response
leave almost none.

A ripple a cos θ + b sin θ, θ = 8π (p + ½)/P, has the second difference (2 cos ω − 2)(a cos θ + b sin θ), ω its phase
per pixel: two regressors c and s, and least squares.

Symbols: y is the second difference of p at a pixel, cycle_rad = 8π/P, share = 2 cos ω − 2; cc, ss, cs, cy, sy, yy are
the sums of products of c, s and y, lost that of ω⁶/(ω⁶ + KNEE), the share that is lost between pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import GapModes
from appliance.measure.calibration.patches import average
from appliance.measure.cloud import CloudSummary, PatchGaps
from appliance.measure.decode.scratch import SIZE, SX1, SX2, SY1, SY2, X1, X2, Y1, Y2, P, Q, U, V, Z
from appliance.measure.light.volume import WorkingVolume
from appliance.measure.points.match import RightMaps, match_row
from appliance.measure.points.select import Points
from appliance.measure.points.triangulate import Rays, triangulate_row


def quantile(values: NDArray[Any], share: float) -> float:
    """Return a quantile of finite ``values`` (n,), interpolated as ``numpy.quantile`` does.

    ``share``: 0 to 1. Raises ValueError without values.
    """
    if not values.size:
        raise ValueError("no values for quantiles; give at least one")
    place = share * (values.size - 1)
    rank = int(place)
    parted = np.partition(values, rank)
    low = float(parted[rank])
    if place == rank:
        return low
    return low + (place - rank) * (float(parted[rank + 1 :].min()) - low)


def median(values: NDArray[Any]) -> float:
    """Return the median of finite ``values`` (n,). Raises ValueError without values."""
    return quantile(values, 0.5)


GAP_SAMPLES = 5_000
"""Number of left pixels that are sampled: a hundred in each patch, so that noise is a tenth of that of a point."""
MAX_GAP_MM = np.float32(20.0)
"""Largest gap of a true match in mm: no camera that still sees the fringes can be displaced so far."""
_DEPTHS_MM = (300.0, 900.0)
"""Depths of the standard housing between which gaps are sampled."""
_NAN = np.float32(np.nan)
_COLUMNS = 7


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sample(
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    right: RightMaps,
    rays: Rays,
    stride: int,
    depths_mm: tuple[np.float32, np.float32],
    samples: NDArray[np.float32],
) -> int:
    """Write the match, gap and coordinates of every ``stride``-th pixel; return the count.

    A row of ``samples`` is u, v, u', v' in px, the signed gap in mm, p and q.
    """
    rows, columns = p_px.shape
    n = (columns + stride - 1) // stride
    s = np.full(SIZE, _NAN, np.float32)
    scratch = np.zeros(columns, np.int32)
    count = 0
    for y in range(stride // 2, rows, stride):
        for x in range(n):
            s[P + x], s[Q + x] = p_px[y, x * stride], q_px[y, x * stride]
        match_row(right, s, s, s, n, False, scratch)
        triangulate_row(rays, y, 0, stride, s, s, n)
        # The limits are wider than those of points, which would exclude the matches that show a knock.
        for x in range(n):
            if not (depths_mm[0] < s[Z + x] < depths_mm[1]):
                continue
            # n = (ax, ay, 1) × (bx, by, 1).
            ax, ay, bx, by = s[SX1 + x], s[SY1 + x], s[SX2 + x], s[SY2 + x]
            cx, cy, cz = ay - by, bx - ax, ax * by - ay * bx
            gap = ((s[X1 + x] - s[X2 + x]) * cx + (s[Y1 + x] - s[Y2 + x]) * cy) / np.sqrt(cx * cx + cy * cy + cz * cz)
            if abs(gap) < MAX_GAP_MM:
                samples[count, 0], samples[count, 1] = np.float32(x * stride), np.float32(y)
                samples[count, 2], samples[count, 3] = s[U + x], s[V + x]
                samples[count, 4] = gap if cy > np.float32(0.0) else -gap
                samples[count, 5], samples[count, 6] = s[P + x], s[Q + x]
                count += 1
    return count


class GapSampler:
    """Samples the ray gaps of one instrument's scans. Buffers are allocated once."""

    def __init__(self, modes: GapModes) -> None:
        self._modes = modes
        width_px, height_px = modes.size_px
        self._stride = max(1, round((width_px * height_px / GAP_SAMPLES) ** 0.5))
        capacity = -(-width_px // self._stride) * -(-height_px // self._stride)
        self._samples = np.empty((capacity, _COLUMNS), np.float32)
        low, high = _DEPTHS_MM
        self._depths_mm = np.float32(modes.volume.scaled(low)), np.float32(modes.volume.scaled(high))

    def matches(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return matched pixels (n, 2) of both cameras: the sample that ``measure`` averages."""
        samples = self._sampled(p_px, q_px, right, rays)
        return samples[:, 0:2], samples[:, 2:4]

    def _sampled(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> NDArray[np.float64]:
        count = int(_sample(p_px, q_px, right, rays, self._stride, self._depths_mm, self._samples))
        return self._samples[:count].astype(np.float64)

    def measure(
        self,
        p_px: NDArray[np.float32],
        q_px: NDArray[np.float32],
        right: RightMaps,
        rays: Rays,
    ) -> PatchGaps:
        """Return the gaps of a decoded scan; ``right`` must have its inverse map."""
        samples = self._sampled(p_px, q_px, right, rays)
        return average(self._modes, samples[:, 0:2], samples[:, 2:4], 1000.0 * samples[:, 4], samples[:, 5:7])


RIPPLE_SAMPLES = 2_500
"""Number of pixels that are sampled: the amplitude is right to some thousandths of a px where it matters."""


@dataclass(frozen=True, slots=True)
class Ripple:
    """Ripple of a pattern coordinate: an error with four cycles a period."""

    amplitude_px: float
    """Amplitude in pattern px, less that of noise; 0 if it is no more than noise."""
    lost_px: float = 0.0
    """RMS error of a coordinate by the part of the ripple that is lost between pixels of the image."""
    noise_px: float = 0.0
    """RMS error of a coordinate without the ripple."""

    @property
    def counts(self) -> bool:
        """True if it increases the standard deviation by more than some percent."""
        return self.lost_px > 0.2 * self.noise_px


STILL = Ripple(0.0)
KNEE = 2500.0
"""Constant of the share t³/(t³ + KNEE) of the squared amplitude that is lost between pixels; √t: phase per px."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sums(
    p_px: NDArray[np.float32], illuminated: NDArray[np.int32], cycle_rad: float, stride: int, most_px: float
) -> tuple[int, float, float, float, float, float, float, float]:
    """Return the count, the sums of products cc, ss, cs, cy, sy, yy, and that of the lost share."""
    count = 0
    cc, ss, cs, cy, sy, yy, lost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    columns = p_px.shape[1]
    for row in range(stride // 2, p_px.shape[0], stride):
        p = p_px[row]
        for x in range(max(int(illuminated[row, 0]), 1), min(int(illuminated[row, 1]), columns - 1), stride):
            before, centre, after = p[x - 1], p[x], p[x + 1]
            y = float(before) + float(after) - 2.0 * float(centre)
            if not abs(y) < most_px:
                continue
            # Phase of the ripple per pixel, and at this pixel.
            omega, theta = 0.5 * cycle_rad * (float(after) - float(before)), cycle_rad * (float(centre) + 0.5)
            share = 2.0 * math.cos(omega) - 2.0
            c, s = share * math.cos(theta), share * math.sin(theta)
            count += 1
            cc += c * c
            ss += s * s
            cs += c * s
            cy += c * y
            sy += s * y
            yy += y * y
            lost += omega**6 / (omega**6 + KNEE)
    return count, cc, ss, cs, cy, sy, yy, lost


def measure_ripple(p_px: NDArray[np.float32], illuminated_columns: NDArray[np.int32], period_px: int) -> Ripple:
    """Measure the ripple of decoded columns ``p_px`` (h, w), NaN where there is none.

    ``illuminated_columns`` (h, 2): the illuminated part of each row.
    """
    stride = max(1, int((p_px.size / RIPPLE_SAMPLES) ** 0.5))
    # Second differences of noise are within this limit; those of edges are not used.
    most_px = period_px / 16.0
    count, cc, ss, cs, cy, sy, yy, lost = _sums(p_px, illuminated_columns, 8.0 * math.pi / period_px, stride, most_px)
    # Two normal equations; the amplitude less that of the residuals' noise.
    det = cc * ss - cs * cs
    if count < 4 or det <= 1e-6 * cc * ss:
        return STILL
    c, s = (ss * cy - cs * sy) / det, (cc * sy - cs * cy) / det
    residual2 = max(yy - c * cy - s * sy, 0.0) / (count - 2)
    amplitude2 = max(c * c + s * s - residual2 * (cc + ss) / det, 0.0)
    return Ripple(math.sqrt(amplitude2), math.sqrt(amplitude2 * lost / count), math.sqrt(residual2 / 6.0))


@dataclass(frozen=True, slots=True)
class QualityLimits:
    """Limits of a point; a point outside of any limit is masked, never moved or invented."""

    max_gap_mm: float = 0.25
    """Largest ray gap: that of a true correspondence is a few hundredths of a mm, and calibration drift adds to it."""
    max_sigma_mm: float = 0.5
    min_depth_mm: float = 380.0
    """Depth limits of the standard housing; ``of`` scales them to another."""
    max_depth_mm: float = 680.0
    max_step_mm: float = 1.5
    """Allowed distance in depth to the median of the 3 × 3 neighbours at full resolution; scales with the pixel."""
    min_neighbours: int = 5
    """Least number of neighbours, of eight; fewer is a fragment of an edge."""

    def of(self, volume: WorkingVolume) -> QualityLimits:
        """Return the limits for a housing of that volume, given those for the standard one."""
        return replace(
            self, min_depth_mm=volume.scaled(self.min_depth_mm), max_depth_mm=volume.scaled(self.max_depth_mm)
        )


SAMPLE = 8_000
"""Number of points from which medians are computed: their standard error is about 1 %."""


def summarise(illuminated_pixels: int, points: Points, pieces: tuple[tuple[int, int], ...]) -> CloudSummary:
    """Return the numbers of the cloud in ``pieces`` (first, stop) of a table.

    ``illuminated_pixels``: their number, counted at the same stride.
    """
    n = sum(stop - first for first, stop in pieces)
    coverage = 100.0 * n / illuminated_pixels if illuminated_pixels else None
    if n == 0:
        return CloudSummary(0, coverage, None, None, None)
    step = max(1, n // SAMPLE)

    def median(column: NDArray[np.float32]) -> float:
        return float(np.median(np.concatenate([column[first:stop:step] for first, stop in pieces])))

    return CloudSummary(
        points=n,
        coverage_percent=coverage,
        distance_mm=median(points.xyz_mm[:, 2]),
        noise_mm=median(points.sigma_mm),
        gap_mm=median(points.gap_mm),
    )
