"""Owns what a movement adds to the noise of the points, as it follows from the drift maps of both cameras.

Lateral movement of a surface that faces the instrument changes only what albedo a pixel sees, for both cameras alike: their
coordinates are wrong together, and points stay right. Depth moves the fringes in both cameras *against each other*. With
E = ε left − ε right, in pattern px per frame, the ripple of the difference of both coordinates has a mean square of

- E² (s²/8 + 2 κ²): four steps of 90° (their error is s E/2 · cos 2φ, with s = 1 of a steady movement, see ``course``), and what the
  projector's second harmonic, κ of the first, adds as it drifts along (2 E κ · sin 2φ (cos φ − sin φ)). The right coordinate is read off
  between pixels, where short ripples are read too small, so that in place of E² stands what is left of ε left and ε right then;
- E² (P/2π)² g²: albedo with a gradient g, in modulations per px, that both cameras see at two places
  (E · g · P/2π · (cos φ + sin φ)); where it goes to and fro, with half the way from an image to the next but one;
- what is uneven in the phase error that moving albedo makes in both cameras alike: they sample it at different places.

Where the way from image to image is not steady, each counts with the way between the two images that matter to it. Noise is that
of four steps in both cameras' light. Both are taken across the surface (``SurfaceMap``), so harm is a ratio of two known things.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.optics.model import StereoRig
from appliance.reconstruct.table import Cloud
from appliance.verdict.motion.cells import CELL_PX
from appliance.verdict.motion.drift import DriftMap

Array = NDArray[np.float64]

MIN_POINTS = 4
"""Least number of a cell's points with neighbours on all sides; fewer say nothing of how it stands."""


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
    pixel = cloud.pixel[inside]
    p, q = p_px.ravel()[pixel], q_px.ravel()[pixel]
    rows, columns = shape
    known = (p >= 0.0) & (q >= 0.0) & (p < columns * CELL_PX) & (q < rows * CELL_PX) & np.isfinite(cosine)
    cell = (q[known] / CELL_PX).astype(np.int64) * columns + (p[known] / CELL_PX).astype(np.int64)
    # Errors along a ray count across the surface by cos θ, squared where variances are added up.
    square = cosine[known].astype(np.float64) ** 2
    noise = square * variance_px2[inside][known].astype(np.float64)

    def summed(values: Array | None = None) -> Array:
        return np.bincount(cell, values, rows * columns).reshape(shape).astype(np.float64)

    points = summed()
    enough = points >= MIN_POINTS
    with np.errstate(invalid="ignore", divide="ignore"):
        across, noise_px = (np.where(enough, np.sqrt(summed(x) / points), np.nan) for x in (square, noise))
    return SurfaceMap(points, across, noise_px)


def facing(cloud: Cloud, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return |cos θ| of the points that have neighbours on all four sides, and which points (n,) those are.

    Of flat pixel numbers of an image ``width_px`` wide, that lie on a grid of rows and columns at equal distances.
    """
    v, u = np.divmod(cloud.pixel.astype(np.int64), width_px)
    columns, rows = np.unique(u), np.unique(v)
    # A single column or row has no step: gcd of nothing is 0.
    step, down = (int(np.gcd.reduce(np.diff(places))) for places in (columns, rows))
    if step == 0 or down == 0:
        return np.empty(0, np.float32), np.empty(0, np.intp)
    # A border of nothing spares the question what lies beside.
    x, y = (u - columns[0]) // step + 1, (v - rows[0]) // down + 1
    wide = int(x.max()) + 1
    place = y * wide + x
    at = np.full(wide * (int(y.max()) + 2), -1, np.int64)
    at[place] = np.arange(len(place))
    left, right, above, below = (at[place + offset] for offset in (-1, 1, -wide, wide))
    inside = np.flatnonzero((left >= 0) & (right >= 0) & (above >= 0) & (below >= 0))
    points = cloud.points_mm
    normal = np.cross(points[right[inside]] - points[left[inside]], points[below[inside]] - points[above[inside]])
    ray = points[inside]
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(np.einsum("ij,ij->i", normal, ray))
        cosine /= np.sqrt(np.einsum("ij,ij->i", normal, normal) * np.einsum("ij,ij->i", ray, ray))
    return cosine, inside


UNSURE = 4.0
"""Cells whose drift is this many times less certain than the median cell's are left out."""
UNEVEN_LEFT = 0.3
"""Phase errors that albedo makes in both cameras alike cancel, but for what differs from one pixel to the next: so much of
that is left. From training scans."""
NOISE_UNCERTAINTY = 0.1
"""Share of its variance by which the noise may exceed what is stated, before what is over counts as moving albedo."""
MIN_CELLS = 4
READ_NOISE = 0.8
"""Share of a right coordinate's variance that is left where it is read off between pixels, along a parabola through three of them:
its mean over all places."""
_PLACES, _SHARES = (x / 2.0 for x in np.polynomial.legendre.leggauss(5))
"""Places between pixels, from −½ to ½, and their weights in a mean over all of them."""


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

    @property
    def added(self) -> float | None:
        """Noise that the movement adds to the points' own, as a fraction of it."""
        return None if self.ripple is None else float(np.sqrt(1.0 + self.ripple**2) - 1.0)


def predict(
    left: DriftMap,
    right: DriftMap,
    surface: SurfaceMap,
    double_step2: float | None,
    rig: StereoRig,
    water_index: float,
    period_px: int,
    frame_s: float,
    steps2: float = 1.0,
) -> Harm:
    """Predict the harm from the drift across the x-fringes that both cameras saw, from how the surface stands, and
    from ``double_step2``, the mean square way of the albedo over the left image in two frames, px² (``None``: there
    is none to see).

    ``steps2`` is the square of the mean first and last step of the x-sines over that of their drift (``course.steps2``).
    """
    px_per_rad = period_px / (2.0 * np.pi)
    with np.errstate(invalid="ignore", divide="ignore"):
        drift = left.drift_px - right.drift_px
        variance = left.sd_px**2 + right.sd_px**2
        depth = depth_per_px(left, right, rig, water_index)
        across = np.abs(depth) * surface.across
        noise_mm2 = (depth * surface.noise_px) ** 2 * (1.0 + READ_NOISE * _noisier(left, right))
        # Each half of the fringe is drawn by two images: it matters how far the pattern goes between the two.
        double2 = 0.5 * ((left.early_px - right.early_px) ** 2 + (left.late_px - right.late_px) ** 2)
        texture = 0.5 * (np.nan_to_num(left.texture_per_px2) + np.nan_to_num(right.texture_per_px2))
        noise2 = left.noise_rad2 + right.noise_rad2
        uneven = 0.5 * (left.uneven_rad2 + right.uneven_rad2) - 2.0 * NOISE_UNCERTAINTY * noise2
        albedo_rad2 = UNEVEN_LEFT**2 * np.maximum(uneven, 0.0)
        if double_step2 is not None:
            # C has one sum of four ways, which may well be none while the ways are long: to and fro.
            slope2 = 0.5 * (left.slope_per_px**2 + right.slope_per_px**2)
            albedo_rad2 = albedo_rad2 + texture * slope2 * 0.25 * double_step2
        second2 = 0.5 * (left.second2 + right.second2)
        # E² (s²/8 + 2 κ²) as it is left by reading, without what the drift's own uncertainty adds to its square.
        first, second, third = (
            _read(left, right, cycles * abs(right.slope_per_px) / period_px) for cycles in (1, 2, 3)
        )
        ripple2 = 0.125 * steps2 * (second - variance) + second2 * (first + third - 2.0 * variance)
        # E² (P/2π)² g² of both halves of the fringe, and what moving albedo leaves.
        ripple2 += px_per_rad**2 * ((double2 - 2.0 * variance) * texture + albedo_rad2)
        known = np.isfinite(drift) & np.isfinite(across) & np.isfinite(noise_mm2) & np.isfinite(ripple2)
        if known.any():
            known &= variance < UNSURE**2 * np.median(variance[known])
    weight = np.where(known, surface.points, 0.0)
    enough = int(np.count_nonzero(known)) >= MIN_CELLS
    ripple = ripple_mm = noise_mm = None
    if enough:
        share = weight[known] / weight[known].sum()
        squared = np.array([share @ x[known] for x in (ripple2 * across**2, noise_mm2)])
        ripple_mm, noise_mm = (float(np.sqrt(max(x, 0.0))) for x in squared)
        ripple = ripple_mm / noise_mm
    with np.errstate(invalid="ignore"):
        return Harm(
            drift,
            np.sqrt(variance),
            depth * drift / frame_s,
            across * np.sqrt(np.where(known & (ripple2 > 0.0), ripple2, np.nan)),
            np.sqrt(noise_mm2),
            weight,
            left.u_px,
            left.v_px,
            ripple,
            ripple_mm,
            noise_mm,
        )


def _noisier(left: DriftMap, right: DriftMap) -> float:
    """Return the variance of the right coordinates over that of the left ones: of most cells, since where the pattern ends each camera sees another
    part of one."""
    ratio = right.noise_rad2 / left.noise_rad2
    known = np.isfinite(ratio)
    return float(np.median(ratio[known])) if known.any() else np.nan


def _read(left: DriftMap, right: DriftMap, turns: Array) -> Array:
    """Return E² (rows, columns) as it acts on a ripple that has so many ``turns`` per px of the right image.

    The left coordinate is that of a pixel, the right one is read off along a parabola through three, with
    H(f) = 1 − f² (1 − cos ω) + i f sin ω in place of e^{iωf}: short ripples are read too small, and late.
    """
    omega = 2.0 * np.pi * turns[..., None]
    read = 1.0 - _PLACES**2 * (1.0 - np.cos(omega)) + 1j * _PLACES * np.sin(omega)
    left_over = left.drift_px[..., None] - right.drift_px[..., None] * read * np.exp(-1j * omega * _PLACES)
    return np.asarray(np.abs(left_over) ** 2 @ _SHARES)


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
