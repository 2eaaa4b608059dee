"""The noise that motion adds to the points, predicted from the drift maps of both cameras.

A lateral motion of a surface that faces the instrument changes the albedo in a pixel, alike for both cameras: their
coordinates have the same error, and the points none. A motion in depth moves the fringes in both cameras *against each
other*. With E = ε left − ε right, in pattern px per frame, the ripple of the difference of both coordinates has a mean
square that is the sum of

- δ²/8, where δ is the mean position of the fringes in the steps 0° and 180° minus that in 90° and 270° (the error is
  δ/2 · cos 2φ). For a steady motion it is E if the steps rise, and 0 if both pairs have the same middle; for an
  unsteady one see ``course``.
- 2 w² κ² E² by the drift of the projector's second harmonic, κ of the first: E κ · sin 2φ (n cos φ − m sin φ), with
  m images from 0° to 180°, n from 90° to 270°, and w² = (m² + n²)/8.
- (P/2π)² g² w² E² by an albedo with a gradient g, in modulations per px, that both cameras see at two places; and
  (P/2π)² g² a²/8 by an albedo that moves by a px on average from one image of a pair to the other. The error has
  g² a²/4, of which half is common to both cameras.
- The uneven part of the phase error by moving albedo. The error is the same in both cameras, but they sample it at
  different places. In the order 0°, 90°, 270°, 180° the contradiction of the steps does not contain the mean light of a
  moving albedo, and so has half of its size with rising steps: there it counts twice.

The noise at rest is that of four steps in both cameras' light. Both are taken across the surface (``SurfaceMap``), so
that their ratio is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import StereoRig
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.points.table import Cloud
from appliance.measure.verdicts.motion.cells import CELL_PX
from appliance.measure.verdicts.motion.drift import DriftMap

Array = NDArray[np.float64]

MIN_POINTS = 4
"""Least number of a cell's points with neighbours on all sides, for the inclination of its surface."""


def warm_up() -> None:
    """Run the kernel that needs points on a single point."""
    _face(np.ones((1, 3), np.float32), np.zeros(1, np.uint32), 1, np.empty(1, np.float32), np.empty(1, np.intp))


@dataclass(frozen=True, slots=True)
class SurfaceMap:
    """Inclination and noise of the surface; arrays (rows, columns) float64 of the pattern's cells."""

    points: Array
    """Number of the cloud's points that have neighbours on all sides."""
    across: Array
    """RMS of cos θ; NaN: fewer than ``MIN_POINTS``. θ is the angle between ray and surface normal."""
    noise_px: Array
    """RMS of the left coordinates' noise, in px of the pattern, times cos θ; NaN as above."""


def surface_map(
    cloud: Cloud,
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    variance_px2: NDArray[np.float32],
    shape: tuple[int, int],
) -> SurfaceMap:
    """Map the inclination and noise of a cloud whose points lie on a grid of the left image.

    ``p_px`` and ``q_px`` (h, w): pattern coordinates; ``variance_px2`` (n,): their variance at the points by the
    camera's noise.
    """
    cosine, inside = facing(cloud, p_px.shape[1])
    sums = np.zeros((3, shape[0] * shape[1]))
    _sum_cells(cosine, inside, cloud.pixel, p_px.ravel(), q_px.ravel(), variance_px2, *shape, sums)
    points, square, noise = sums.reshape(3, *shape)
    enough = points >= MIN_POINTS
    with np.errstate(invalid="ignore", divide="ignore"):
        across, noise_px = (np.where(enough, np.sqrt(x / points), np.nan) for x in (square, noise))
    return SurfaceMap(points, across, noise_px)


def facing(cloud: Cloud, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return |cos θ| of the points that have neighbours on all four sides, and their numbers.

    Their pixels in an image ``width_px`` wide lie on a grid of rows and columns at equal distances.
    """
    if not cloud.pixel.size:
        return np.empty(0, np.float32), np.empty(0, np.intp)
    cosine, inside = np.empty(cloud.pixel.size, np.float32), np.empty(cloud.pixel.size, np.intp)
    count = _face(cloud.points_mm, cloud.pixel, width_px, cosine, inside)
    return cosine[:count], inside[:count]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _step(is_used: NDArray[np.bool_]) -> tuple[int, int, int]:
    """Return the first and the last index that is True, and the largest step that meets all of them.

    The step is 0 if there is only one.
    """
    first, last, step = -1, -1, 0
    for place in range(is_used.size):
        if is_used[place]:
            # The greatest common divisor of the distances, by Euclid.
            a, b = step, place - last if last >= 0 else 0
            while b:
                a, b = b, a % b
            step = a
            first = place if first < 0 else first
            last = place
    return first, last, step


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _face(
    points_mm: NDArray[np.float32],
    pixel: NDArray[np.uint32],
    width_px: int,
    cosine: NDArray[np.float32],
    inside: NDArray[np.intp],
) -> int:
    """Write ``facing`` of ``points_mm`` (n, 3) to ``cosine`` and ``inside`` (n,); return their count."""
    wide_px, n = np.uint32(width_px), pixel.size
    # Rows and columns that any point lies in, and the grid that has them all.
    highest = np.uint32(0)
    for k in range(n):
        highest = max(highest, pixel[k])
    columns, rows = np.zeros(width_px, np.bool_), np.zeros(int(highest // wide_px) + 1, np.bool_)
    for k in range(n):
        row = pixel[k] // wide_px
        rows[row], columns[pixel[k] - row * wide_px] = True, True
    first_x, last_x, step = _step(columns)
    first_y, last_y, down = _step(rows)
    if step == 0 or down == 0:
        return 0
    # Number of the point at each position of the grid, with an empty border, so that all positions have neighbours.
    wide, high = (last_x - first_x) // step + 3, (last_y - first_y) // down + 3
    point_of = np.full(wide * high, -1, np.int32)
    # The grid column of each column of the image, so that points need no division for it.
    places = np.empty(n, np.int32)
    across = np.empty(width_px, np.int32)
    for x in range(wide - 2):
        across[first_x + x * step] = x + 1
    for k in range(n):
        row = pixel[k] // wide_px
        places[k] = ((int(row) - first_y) // down + 1) * wide + across[pixel[k] - row * wide_px]
        point_of[places[k]] = k
    # The points that have a neighbour on each side.
    count = 0
    for k in range(n):
        place = places[k]
        left, right, above, below = (
            point_of[place - 1],
            point_of[place + 1],
            point_of[place - wide],
            point_of[place + wide],
        )
        if left < 0 or right < 0 or above < 0 or below < 0:
            continue
        # |normal · ray| over both lengths, with the normal of both differences.
        ax, ay = points_mm[right, 0] - points_mm[left, 0], points_mm[right, 1] - points_mm[left, 1]
        bx, by = points_mm[below, 0] - points_mm[above, 0], points_mm[below, 1] - points_mm[above, 1]
        az, bz = points_mm[right, 2] - points_mm[left, 2], points_mm[below, 2] - points_mm[above, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        x, y, z = points_mm[k, 0], points_mm[k, 1], points_mm[k, 2]
        # One root for the product of both lengths.
        cosine[count] = abs(nx * x + ny * y + nz * z) / np.sqrt((nx * nx + ny * ny + nz * nz) * (x * x + y * y + z * z))
        inside[count] = k
        count += 1
    return count


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _sum_cells(
    cosine: NDArray[np.float32],
    inside: NDArray[np.intp],
    pixel: NDArray[np.uint32],
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    variance_px2: NDArray[np.float32],
    rows: int,
    columns: int,
    sums: Array,
) -> None:
    """Add number, cos² θ and variance · cos² θ of the points ``inside`` to ``sums`` (3, cells).

    An error along a ray is cos θ times as large across the surface.
    """
    for k in range(inside.size):
        p, q = p_px[pixel[inside[k]]], q_px[pixel[inside[k]]]
        if not (p >= 0.0 and q >= 0.0 and p < columns * CELL_PX and q < rows * CELL_PX and np.isfinite(cosine[k])):
            continue
        cell = int(q / CELL_PX) * columns + int(p / CELL_PX)
        square = np.float64(cosine[k]) * np.float64(cosine[k])
        sums[0, cell] += 1.0
        sums[1, cell] += square
        sums[2, cell] += square * np.float64(variance_px2[inside[k]])


UNSURE = 4.0
"""Largest standard deviation of a cell's drift over the median of all cells; other cells are left out."""
UNEVEN_LEFT = 0.3
"""Share of the differences between neighbouring pixels that remains of phase errors by albedo.

These errors are the same in both cameras and cancel otherwise. From training scans.
"""
NOISE_UNCERTAINTY = 0.1
"""Excess of the noise over the stated one, as a share of its variance, that does not count as moving albedo."""
MIN_CELLS = 4
READ_NOISE = 0.8
"""Share of a right coordinate's variance that remains after interpolation by a parabola through three pixels, as a mean
over all positions."""


@dataclass(frozen=True, slots=True)
class Harm:
    """Noise that motion adds to the points; maps (rows, columns) of the pattern's cells, NaN: unknown."""

    drift_px: Array
    """E: of the fringes, left less right, pattern px per frame."""
    sd_px: Array
    depth_rate_mm_s: Array
    """Speed at which the surface recedes along the left camera's rays, during the x-sines."""
    ripple_mm: Array
    """RMS of the points' error by motion, across the surface; NaN also where it is below its uncertainty."""
    noise_mm: Array
    """RMS of the points' error by the cameras' noise."""
    weight: Array
    """Number of points of a cell; 0: left out."""
    u_px: Array
    """Mean position in the left image."""
    v_px: Array
    ripple: float | None
    """RMS of the ripple over that of the noise, all cells; ``None``: fewer than ``MIN_CELLS``."""
    ripple_rms_mm: float | None
    noise_rms_mm: float | None
    drift_over_noise: float | None = None
    """Value of ``ripple`` as if the steps had risen: by this, other judges are affected by a drift."""

    @property
    def added(self) -> float | None:
        """Added noise, as a fraction of the points' noise at rest."""
        return None if self.ripple is None else float(np.sqrt(1.0 + self.ripple**2) - 1.0)


@dataclass(frozen=True, slots=True)
class PairOffset:
    """Mean square of δ, the offset of the fringes between the two pairs of steps."""

    of_drift2: float
    """Its part proportional to E², as a multiple of E²."""
    px2: float = 0.0
    """Its constant part, px² of the pattern."""


def steady_offset(sequence: PatternSequence) -> PairOffset:
    """Return the offset of a steady motion: E for rising steps, 0 in the instrument's order."""
    zero, quarter, half, three = sequence.axis(Direction.X).sine
    return PairOffset(0.25 * (zero + half - quarter - three) ** 2)


def predict(
    drift: Mapping[str, DriftMap],
    surface: SurfaceMap,
    pair_way2: float | None,
    rig: StereoRig,
    water_index: float,
    sequence: PatternSequence,
    frame_s: float,
    offset: PairOffset | None = None,
) -> Harm:
    """Predict the noise that motion adds to the points.

    ``drift``: of the x-fringes, by side; ``surface``: its inclination and noise; ``pair_way2``: mean square
    displacement of the albedo in the left image from one image of a pair to the other, px² (``None``: unknown);
    ``offset``: by ``pair_offset``; ``None``: the motion is steady.
    """
    left, right = drift["left"], drift["right"]
    offset, steady = offset or steady_offset(sequence), steady_offset(sequence).of_drift2
    m, n = sequence.axis(Direction.X).pair_frames
    ways2 = (m * m + n * n) / 8.0
    # Mean square phase error by moving albedo, over the part that the contradiction of the steps shows.
    hidden = 2.0 * ways2 / (steady + ways2)
    px_per_rad = sequence.period_px / (2.0 * np.pi)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart_px = left.drift_px - right.drift_px
        variance = left.sd_px**2 + right.sd_px**2
        # Subtract the part of the square that is due to the uncertainty of the drift.
        apart2 = apart_px**2 - variance
        depth = depth_per_px(left, right, rig, water_index)
        across = np.abs(depth) * surface.across
        noise_mm2 = (depth * surface.noise_px) ** 2 * (1.0 + READ_NOISE)
        uneven = 0.5 * (left.uneven_rad2 + right.uneven_rad2)
        uneven -= 2.0 * NOISE_UNCERTAINTY * (left.noise_rad2 + right.noise_rad2)
        texture = 0.5 * (np.nan_to_num(left.texture_per_px2) + np.nan_to_num(right.texture_per_px2))
        albedo_rad2 = UNEVEN_LEFT**2 * hidden * np.maximum(uneven, 0.0) + ways2 * texture * apart2
        if pair_way2 is not None:
            slope2 = 0.5 * (left.slope_per_px**2 + right.slope_per_px**2)
            albedo_rad2 += texture * slope2 * 0.125 * pair_way2
        second2 = 0.5 * (left.second2 + right.second2)
        ripple2 = (0.125 * offset.of_drift2 + 2.0 * ways2 * second2) * apart2 + px_per_rad**2 * albedo_rad2
        ripple2 += 0.125 * offset.px2
        is_known = np.isfinite(apart_px) & np.isfinite(across) & np.isfinite(noise_mm2) & np.isfinite(ripple2)
        if is_known.any():
            is_known &= variance < UNSURE**2 * np.median(variance[is_known])
    weight = np.where(is_known, surface.points, 0.0)
    enough = int(np.count_nonzero(is_known)) >= MIN_CELLS
    ripple = ripple_mm = noise_mm = drift_over_noise = None
    if enough:
        share = weight[is_known] / weight[is_known].sum()
        rising2 = ripple2 + 0.125 * ((1.0 - offset.of_drift2) * apart2 - offset.px2)
        squared = np.array([share @ x[is_known] for x in (ripple2 * across**2, noise_mm2, rising2 * across**2)])
        ripple_mm, noise_mm, rising_mm = (float(np.sqrt(max(x, 0.0))) for x in squared)
        ripple, drift_over_noise = ripple_mm / noise_mm, rising_mm / noise_mm
    with np.errstate(invalid="ignore"):
        return Harm(
            apart_px,
            np.sqrt(variance),
            depth * apart_px / frame_s,
            across * np.sqrt(np.where(is_known & (ripple2 > 0.0), ripple2, np.nan)),
            np.sqrt(noise_mm2),
            weight,
            left.u_px,
            left.v_px,
            ripple,
            ripple_mm,
            noise_mm,
            drift_over_noise,
        )


def depth_per_px(left: DriftMap, right: DriftMap, rig: StereoRig, water_index: float) -> Array:
    """Return the displacement along the left ray, mm, for one px of E; (rows, columns)."""
    left_px = np.stack([left.u_px, left.v_px], -1)
    right_px = np.stack([right.u_px, right.v_px], -1)
    is_known = np.isfinite(left.u_px) & np.isfinite(right.u_px)
    out = np.full(is_known.shape, np.nan)
    if not is_known.any():
        return out
    origin, along = rig.left.rays(left_px[is_known], water_index)
    before, after = (
        _reach(origin, along, *rig.right.rays(right_px[is_known] + np.array([step, 0.0]), water_index))
        for step in (-0.5, 0.5)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        out[is_known] = (after - before) / right.slope_per_px[is_known]
    return out


def _reach(origin: Array, along: Array, other_origin: Array, other_along: Array) -> Array:
    """Return the distance in mm along the first rays (n, 3) to where the second ones pass nearest."""
    # Nearest points of two skew lines with unit directions.
    apart = origin - other_origin
    b = np.sum(along * other_along, -1)
    return np.asarray((b * np.sum(other_along * apart, -1) - np.sum(along * apart, -1)) / (1.0 - b * b))


EVERYWHERE = 0.4
"""Share of the pixels in cells with large added noise from which on no side is named."""
OFF_MIDDLE = 0.12
"""Least distance from the middle of the visible surface, as a share of the image's size, for a side to be named."""


@dataclass(frozen=True, slots=True)
class Place:
    """Centre of the added noise in the left image.

    ``word``: ``left right upper lower everywhere`` or two of them.
    """

    u_px: float
    v_px: float
    word: str


def place_of(harm: Harm, size_px: tuple[int, int]) -> Place | None:
    """Return the place of most of the added noise in an image of ``size_px``; ``None``: no ripple."""
    squared = np.nan_to_num(harm.ripple_mm) ** 2 * harm.weight
    total = float(squared.sum())
    if total <= 0.0:
        return None
    u, v = (float(np.sum(squared * np.nan_to_num(x)) / total) for x in (harm.u_px, harm.v_px))
    pixels = harm.weight.sum()
    strong = np.nan_to_num(harm.ripple_mm) ** 2 > 0.25 * total / pixels
    if float(harm.weight[strong].sum()) > EVERYWHERE * pixels:
        return Place(u, v, "everywhere")
    directions = []
    middle_u, middle_v = (float(np.sum(harm.weight * np.nan_to_num(x)) / pixels) for x in (harm.u_px, harm.v_px))
    for off, size, names in (
        (v - middle_v, size_px[1], ("upper", "lower")),
        (u - middle_u, size_px[0], ("left", "right")),
    ):
        if abs(off) > OFF_MIDDLE * size:
            directions.append(names[int(off > 0.0)])
    return Place(u, v, " ".join(directions) or "middle")
