"""Owns what a movement adds to the noise of the points, as it follows from the drift maps of both cameras.

Lateral movement of a surface that faces the instrument changes only what albedo a pixel sees, for both cameras alike:
their coordinates are wrong together, and points stay right. Depth moves the fringes in both cameras *against each
other*. With E = ε left − ε right, in pattern px per frame, the ripple of the difference of both coordinates has a mean
square of

- δ²/8, with δ by how much farther the fringes stand in the mean of the steps 0° and 180° than in that of 90° and 270°
  (the error is δ/2 · cos 2φ): of a steady movement E where the steps rise, and 0 where both pairs have the same middle;
  ``course`` says what it is of an unsteady one;
- 2 w² κ² E²: what the projector's second harmonic, κ of the first, adds as it drifts along: E κ · sin 2φ (n cos φ −
  m sin φ), with m images from 0° to 180°, n from 90° to 270°, and w² = (m² + n²)/8;
- (P/2π)² g² w² E²: albedo with a gradient g, in modulations per px, that both cameras see at two places; and
  (P/2π)² g² a²/8 of albedo that goes a px on average from one image of a pair to the other: of the error of g² a²/4
  half is common to both cameras;
- what is uneven in the phase error that moving albedo makes in both cameras alike: they sample it at different places.
  In the order 0°, 90°, 270°, 180° the contradiction of the steps holds no mean light of an albedo that moves, and so
  half of what it holds where they rise: there it counts twice.

Noise is that of four steps in both cameras' light. Both are taken across the
surface (``SurfaceMap``), so harm is a ratio of two known things.
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
"""Least number of a cell's points with neighbours on all sides; fewer say nothing of how it stands."""


def warm_up() -> None:
    """Run the kernel that is asked where there are points on one of them."""
    _face(np.ones((1, 3), np.float32), np.zeros(1, np.uint32), 1, np.empty(1, np.float32), np.empty(1, np.intp))


@dataclass(frozen=True, slots=True)
class SurfaceMap:
    """Arrays (rows, columns) float64 of the pattern's cells."""

    points: Array
    """Number of the cloud's points that have neighbours on all sides."""
    across: Array
    """RMS of cos θ; NaN: fewer than ``MIN_POINTS``."""
    noise_px: Array
    """RMS of the left coordinates' noise, in px of the pattern, times cos θ; NaN as above."""


def surface_map(
    cloud: Cloud,
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    variance_px2: NDArray[np.float32],
    shape: tuple[int, int],
) -> SurfaceMap:
    """Map a cloud whose points lie on a grid of the left image, whose pattern coordinates are ``p_px`` and ``q_px``
    (h, w), and theirs have variances ``variance_px2`` (n,) by the camera's noise."""
    cosine, inside = facing(cloud, p_px.shape[1])
    sums = np.zeros((3, shape[0] * shape[1]))
    _sum_cells(cosine, inside, cloud.pixel, p_px.ravel(), q_px.ravel(), variance_px2, *shape, sums)
    points, square, noise = sums.reshape(3, *shape)
    enough = points >= MIN_POINTS
    with np.errstate(invalid="ignore", divide="ignore"):
        across, noise_px = (np.where(enough, np.sqrt(x / points), np.nan) for x in (square, noise))
    return SurfaceMap(points, across, noise_px)


def facing(cloud: Cloud, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return |cos θ| of the points that have neighbours on all four sides, and which points (n,) those are.

    Of flat pixel numbers of an image ``width_px`` wide, that lie on a grid of rows and columns at equal distances.
    """
    if not cloud.pixel.size:
        return np.empty(0, np.float32), np.empty(0, np.intp)
    cosine, inside = np.empty(cloud.pixel.size, np.float32), np.empty(cloud.pixel.size, np.intp)
    count = _face(cloud.points_mm, cloud.pixel, width_px, cosine, inside)
    return cosine[:count], inside[:count]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _step(there: NDArray[np.bool_]) -> tuple[int, int, int]:
    """Return the first and the last of the places that are there, and the greatest step that leads to all of them; 0:
    there is but one."""
    first, last, step = -1, -1, 0
    for place in range(there.size):
        if there[place]:
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
    """Write ``facing`` of ``points_mm`` (n, 3) to the beginnings of ``cosine`` and ``inside`` (n,); return how many
    there are."""
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
    # Number of the point at each place of the grid, with a border of nothing that spares the question what lies beside.
    wide, high = (last_x - first_x) // step + 3, (last_y - first_y) // down + 3
    at = np.full(wide * high, -1, np.int32)
    # The place of each column of the image, so that no point needs a division for it.
    places = np.empty(n, np.int32)
    across = np.empty(width_px, np.int32)
    for x in range(wide - 2):
        across[first_x + x * step] = x + 1
    for k in range(n):
        row = pixel[k] // wide_px
        places[k] = ((int(row) - first_y) // down + 1) * wide + across[pixel[k] - row * wide_px]
        at[places[k]] = k
    # The points that have a neighbour on each side.
    count = 0
    for k in range(n):
        place = places[k]
        left, right, above, below = at[place - 1], at[place + 1], at[place - wide], at[place + wide]
        if left < 0 or right < 0 or above < 0 or below < 0:
            continue
        # |normal · ray| over both lengths, with the normal of both differences.
        ax, ay = points_mm[right, 0] - points_mm[left, 0], points_mm[right, 1] - points_mm[left, 1]
        bx, by = points_mm[below, 0] - points_mm[above, 0], points_mm[below, 1] - points_mm[above, 1]
        az, bz = points_mm[right, 2] - points_mm[left, 2], points_mm[below, 2] - points_mm[above, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        x, y, z = points_mm[k, 0], points_mm[k, 1], points_mm[k, 2]
        # Of both lengths at once: one root is enough.
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
    """Add to ``sums`` (3, cells) the points ``inside``, cos² θ and variance · cos² θ: errors along a ray count across
    the surface by cos θ."""
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
"""Cells whose drift is this many times less certain than the median cell's are left out."""
UNEVEN_LEFT = 0.3
"""Phase errors that albedo makes in both cameras alike cancel, but for what differs from one pixel to the next: so much
of that is left. From training scans."""
NOISE_UNCERTAINTY = 0.1
"""Share of its variance by which the noise may exceed what is stated, before what is over counts as moving albedo."""
MIN_CELLS = 4
READ_NOISE = 0.8
"""Share of a right coordinate's variance that is left where it is read off between pixels, along a parabola through
three of them: its mean over all places."""


@dataclass(frozen=True, slots=True)
class Harm:
    """Maps are (rows, columns) float64 of the pattern's cells, NaN where nothing is known."""

    drift_px: Array
    """E: of the fringes, left less right, pattern px per frame."""
    sd_px: Array
    depth_rate_mm_s: Array
    """Speed at which the surface recedes along the left camera's rays, during the x-sines."""
    ripple_mm: Array
    """RMS of what the movement adds to the points across the surface; NaN also where it is lost in uncertainty."""
    noise_mm: Array
    """RMS of what the cameras' noise makes of them."""
    weight: Array
    """Points of a cell; 0: left out."""
    u_px: Array
    """Mean place in the left image."""
    v_px: Array
    ripple: float | None
    """All cells: RMS of the ripple over that of the noise; ``None``: fewer than ``MIN_CELLS``."""
    ripple_rms_mm: float | None
    noise_rms_mm: float | None
    drift_over_noise: float | None = None
    """The same as ``ripple``, as if the steps had risen: other judges see a drift so, whatever it makes of the points.
    """

    @property
    def added(self) -> float | None:
        """Noise that the movement adds to the points' own, as a fraction of it."""
        return None if self.ripple is None else float(np.sqrt(1.0 + self.ripple**2) - 1.0)


@dataclass(frozen=True, slots=True)
class PairOffset:
    """Mean square of δ, by which the fringes stand farther in one pair of steps than in the other."""

    of_drift2: float
    """Its part that goes with E², as a multiple of it."""
    px2: float = 0.0
    """Its part that is the same everywhere, px² of the pattern."""


def steady_offset(sequence: PatternSequence) -> PairOffset:
    """Return the offset of a steady movement: E where the steps rise, none in the instrument's order."""
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
    """Predict the harm of a movement.

    It follows from the ``drift`` across the x-fringes that both cameras saw (keyed by side), from how the surface
    stands, and from ``pair_way2``, the mean square way of the albedo over the left image from one image of a pair to
    the other, px² (``None``: there is none to see). ``offset``: as ``pair_offset`` has it; ``None``: the movement is
    steady.
    """
    left, right = drift["left"], drift["right"]
    offset, steady = offset or steady_offset(sequence), steady_offset(sequence).of_drift2
    m, n = sequence.axis(Direction.X).pair_frames
    ways2 = (m * m + n * n) / 8.0
    # Mean square phase error of moving albedo, over what the contradiction of the steps shows of it.
    hidden = 2.0 * ways2 / (steady + ways2)
    px_per_rad = sequence.period_px / (2.0 * np.pi)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart_px = left.drift_px - right.drift_px
        variance = left.sd_px**2 + right.sd_px**2
        # Without what the drift's own uncertainty adds to its square.
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
        known = np.isfinite(apart_px) & np.isfinite(across) & np.isfinite(noise_mm2) & np.isfinite(ripple2)
        if known.any():
            known &= variance < UNSURE**2 * np.median(variance[known])
    weight = np.where(known, surface.points, 0.0)
    enough = int(np.count_nonzero(known)) >= MIN_CELLS
    ripple = ripple_mm = noise_mm = drift_over_noise = None
    if enough:
        share = weight[known] / weight[known].sum()
        rising2 = ripple2 + 0.125 * ((1.0 - offset.of_drift2) * apart2 - offset.px2)
        squared = np.array([share @ x[known] for x in (ripple2 * across**2, noise_mm2, rising2 * across**2)])
        ripple_mm, noise_mm, rising_mm = (float(np.sqrt(max(x, 0.0))) for x in squared)
        ripple, drift_over_noise = ripple_mm / noise_mm, rising_mm / noise_mm
    with np.errstate(invalid="ignore"):
        return Harm(
            apart_px,
            np.sqrt(variance),
            depth * apart_px / frame_s,
            across * np.sqrt(np.where(known & (ripple2 > 0.0), ripple2, np.nan)),
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
    """Return how many mm farther along the left ray a surface lies whose fringes moved by one px of E; (rows,
    columns)."""
    left_px = np.stack([left.u_px, left.v_px], -1)
    right_px = np.stack([right.u_px, right.v_px], -1)
    known = np.isfinite(left.u_px) & np.isfinite(right.u_px)
    out = np.full(known.shape, np.nan)
    if not known.any():
        return out
    origin, along = rig.left.rays(left_px[known], water_index)
    here, beside = (
        _reach(origin, along, *rig.right.rays(right_px[known] + np.array([step, 0.0]), water_index))
        for step in (-0.5, 0.5)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        out[known] = (beside - here) / right.slope_per_px[known]
    return out


def _reach(origin: Array, along: Array, other: Array, other_along: Array) -> Array:
    """Return how far along the first rays (n, 3) the second ones pass nearest, mm."""
    # Nearest points of two skew lines with unit directions.
    apart = origin - other
    b = np.sum(along * other_along, -1)
    return np.asarray((b * np.sum(other_along * apart, -1) - np.sum(along * apart, -1)) / (1.0 - b * b))


EVERYWHERE = 0.4
"""Share of the pixels in harmed cells from which on no side is named."""
OFF_MIDDLE = 0.12
"""Least distance from the middle of what is seen, as a share of the image's size, for a side to be named."""


@dataclass(frozen=True, slots=True)
class Place:
    """Middle of the harm in px of the left image, and ``left right upper lower everywhere`` or two of them."""

    u_px: float
    v_px: float
    word: str


def place_of(harm: Harm, size_px: tuple[int, int]) -> Place | None:
    """Return the place of most of the harm in an image of ``size_px``; ``None``: no cell has a ripple."""
    squared = np.nan_to_num(harm.ripple_mm) ** 2 * harm.weight
    total = float(squared.sum())
    if total <= 0.0:
        return None
    u, v = (float(np.sum(squared * np.nan_to_num(x)) / total) for x in (harm.u_px, harm.v_px))
    pixels = harm.weight.sum()
    strong = np.nan_to_num(harm.ripple_mm) ** 2 > 0.25 * total / pixels
    if float(harm.weight[strong].sum()) > EVERYWHERE * pixels:
        return Place(u, v, "everywhere")
    words = []
    middle_u, middle_v = (float(np.sum(harm.weight * np.nan_to_num(x)) / pixels) for x in (harm.u_px, harm.v_px))
    for off, size, names in (
        (v - middle_v, size_px[1], ("upper", "lower")),
        (u - middle_u, size_px[0], ("left", "right")),
    ):
        if abs(off) > OFF_MIDDLE * size:
            words.append(names[int(off > 0.0)])
    return Place(u, v, " ".join(words) or "middle")
