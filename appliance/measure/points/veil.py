"""Backscatter fringes: the fringes that backscatter keeps along the pattern's rows, and their removal.

A camera's ray crosses a thousand columns of the projected pattern but hardly a row. So backscatter averages fringes
across the baseline away and keeps those along it. The phasor of the rows is the object's plus that of the backscatter
fringes, Z = B e^{iφ} + A e^{iψ}, while that of the columns is the object's alone. The decoded rows are off by
P/2π arg(1 + A/B e^{i(ψ − φ)}), towards those of the backscatter.

- *Position*: ψ is the mean row that lights the water on the ray's way to the surface. The row that lights a point of
  the water follows from the scan's own points: rows are a smooth function of the direction in which the projector sends
  light, as if it stood half way between the cameras behind a port like theirs. Its position is known only to the
  tolerance of its mount.
- *Strength*: columns give B, and |Z|² = B² + A² + 2AB cos(ψ − φ) gives A. Where backscatter is so weak that blur by the
  surface's slope matters as much, A is the usual share of the backscatter, which is measured in the middles of stripes.

Both A and the rows of the backscatter fringes are smooth over the image, and are kept as polynomials of it.

VeilFringes, SideVeil     the backscatter fringes of one scan, and of one of its cameras
looks_veiled, find_veil   whether there may be any, and their estimation
remove_veil               their removal from the rows of one camera

Symbols: P period; A ``strength_dn``, B ``own_dn``; δ = ψ − φ. All phasors in grey values of modulation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import VeilGaps
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.port import Port, air_directions
from appliance.measure.points.table import Cloud

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

FEWEST_POINTS = 300
MOST_POINTS = 1_000
TRACED = 100
"""Number of points whose rays are followed through the water."""
NODES = 8
"""Number of nodes on each of these rays (Gauss-Legendre quadrature)."""
ATTENUATION_PER_M = 1.5
"""Attenuation assumed along the rays: turbid water.

It moves the centre of a ray's backscatter by a few per cent.
"""
STRIPES_PX = (32.0, 64.0)
"""Widths of the Gray stripes in whose middles backscatter is measured."""
MIDDLE = 0.15
"""Largest distance of a point from a stripe's middle, in widths, at which backscatter is measured."""
KEPT = 0.05
"""Share of the light between the stripes that keeps fringes along the rows: 0.9 of light scattered once, nothing of
light scattered often or scattered from the object's bright stripes."""
KEPT_SPREAD = 0.7
"""Relative standard deviation of that share."""
RATIO_SPREAD = 0.004
"""Standard deviation of the rows' modulation over the columns' without backscatter, after ``PIXEL_PX2``."""
PIXEL_PX2 = 0.1
"""Variance of a pixel's footprint, in px²: it attenuates the fringes of the direction in which the surface slopes."""
START_SPREAD_MM = (0.7, 2.5)
"""Standard deviations of the projector's position across the rows and along its axis: mount, frame of a calibration
against the drawing, and a port that may be 5 mm nearer to it than a camera's."""
SHAPE_SPREAD = 0.4
"""Standard deviation, smooth over the image, of the rows' error, relative to the error per px between ψ and φ."""
TELLING = 0.002
"""Least share of the object's fringes that counts: less moves rows by at most 0.005 px."""
REMOVED = 0.06
"""Least share of the object's fringes that is removed from the rows."""
INSEPARABLE = 0.9
"""Largest A |sin δ| / B at which the object's phase can be separated."""
_TERMS_ROWS, _TERMS_STRENGTH = 10, 6
_CONTRADICTION = np.uint8(4)


@dataclass(frozen=True, slots=True)
class SideVeil:
    """The backscatter fringes in one camera, as polynomials of the image place x, y (±1 over the width)."""

    rows_px: tuple[float, ...]
    """(10,): coefficients of the pattern row of the backscatter fringes, cubic."""
    strength_dn: tuple[float, ...]
    """(6,): coefficients of A, quadratic."""
    of_object: float
    """Median of A over B."""


@dataclass(frozen=True, slots=True)
class VeilFringes:
    """The backscatter fringes of one scan."""

    sides: Mapping[str, SideVeil]
    gaps: VeilGaps
    """Ray gaps by the backscatter fringes in the present maps, place by place."""

    @property
    def removable(self) -> bool:
        """True if they are strong enough to be removed from the maps."""
        return max(side.of_object for side in self.sides.values()) > REMOVED

    @property
    def doubt_um(self) -> float:
        """Root mean square uncertainty of the ray gaps by the backscatter fringes."""
        return float(np.sqrt(np.mean(np.sum(self.gaps.doubts_um**2, axis=1) + self.gaps.shape_um**2)))

    def removed(self) -> VeilFringes:
        """Return them as they are after the removal from the maps: only their uncertainty is left."""
        return replace(self, gaps=replace(self.gaps, gap_um=np.zeros_like(self.gaps.gap_um)))


@dataclass(frozen=True, slots=True)
class SideSample:
    """One camera's light and rows at n points of the cloud."""

    place: Array
    """(n, 2): x, y."""
    own_dn: Array
    """(n,): modulation of the columns."""
    both_dn: Array
    """(n,): modulation of the rows, corrected for the pixel's footprint to be comparable with that of the columns."""
    row_px: Array
    """(n,): pattern row, as decoded."""
    backscatter_dn: Array
    """(n,): backscatter in the bright frame; NaN where no stripe's middle is near."""


def sample_side(
    sequence: PatternSequence, frames: NDArray[np.uint8], p_px: Floats, q_px: Floats, uv_px: Array
) -> SideSample:
    """Read one camera's ``frames`` (n, h, w) and maps (h, w) at the pixels next to ``uv_px`` (n, 2)."""
    height, width = p_px.shape
    u = np.clip(np.rint(uv_px[:, 0]), 0, width - 1).astype(np.intp)
    v = np.clip(np.rint(uv_px[:, 1]), 0, height - 1).astype(np.intp)

    def frame_dn(k: int) -> Array:
        return np.asarray(frames[k][v, u], np.float64)

    def modulation(direction: Direction) -> Array:
        i0, i1, i2, i3 = (frame_dn(k) for k in sequence.axis(direction).sine)
        return np.asarray(0.5 * np.hypot(i0 - i2, i3 - i1))

    bright, black, p = frame_dn(sequence.bright), frame_dn(sequence.dark), p_px[v, u].astype(np.float64)
    gray = sequence.axis(Direction.X).gray
    total, count = np.zeros(len(p)), np.zeros(len(p))
    for bit, k in enumerate(gray):
        width_px = float(sequence.period_px * 2 ** (len(gray) - 1 - bit))
        if not STRIPES_PX[0] <= width_px <= STRIPES_PX[1]:
            continue
        # In the middle of a dark stripe half of the backscatter remains; in that of a bright one half is missing.
        place = (p + 0.5) / width_px - 0.5
        stripe = np.floor(place)
        half = np.where(stripe % 2.0 == 0.0, bright - frame_dn(k), frame_dn(k) - black)
        middle = np.abs(place - stripe - 0.5) < MIDDLE
        total += np.where(middle, half, 0.0)
        count += middle
    backscatter = np.where(count > 0, 2.0 * total / np.maximum(count, 1.0), np.nan)
    # A footprint of variance s attenuates fringes by exp(−2π² s |∇|²/P²), ∇ the gradient of the coordinate.
    steeper = _steepness(q_px, u, v) - _steepness(p_px, u, v)
    even = np.exp(2.0 * math.pi**2 * PIXEL_PX2 / sequence.period_px**2 * np.nan_to_num(steeper))
    place_xy = np.stack([2.0 * u / width - 1.0, (2.0 * v - height) / width], -1)
    return SideSample(
        place_xy, modulation(Direction.X), modulation(Direction.Y) * even, q_px[v, u].astype(np.float64), backscatter
    )


def _steepness(px: Floats, u: NDArray[np.intp], v: NDArray[np.intp]) -> Array:
    """Return the squared gradient (n,) of a map (h, w) at pixels (n,); NaN beside missing coordinates."""
    height, width = px.shape
    across = px[v, np.minimum(u + 1, width - 1)] - px[v, np.maximum(u - 1, 0)]
    down = px[np.minimum(v + 1, height - 1), u] - px[np.maximum(v - 1, 0), u]
    return np.asarray(0.25 * (across * across + down * down), np.float64)


def looks_veiled(sequence: PatternSequence, frames: NDArray[np.uint8], p_px: Floats, q_px: Floats) -> bool:
    """Return True if backscatter at some pixels of one camera is so bright that its fringes count.

    The arguments are those of ``sample_side``.
    """
    stride = max(1, int((p_px.size / MOST_POINTS) ** 0.5))
    v, u = np.nonzero(np.isfinite(p_px[::stride, ::stride]))
    sample = sample_side(sequence, frames, p_px, q_px, stride * np.stack([u, v], -1).astype(np.float64))
    finite = np.isfinite(sample.backscatter_dn)
    if np.count_nonzero(finite) < FEWEST_POINTS // 4:
        return False
    relative = sample.backscatter_dn[finite] / np.maximum(sample.own_dn[finite], 1.0)
    return float(np.median(relative)) * 0.5 * KEPT > TELLING


def find_veil(
    sequence: PatternSequence,
    frames: Mapping[str, NDArray[np.uint8]],
    maps: Mapping[str, tuple[Floats, Floats]],
    cloud: Cloud,
    rig: StereoRig,
    water_index: float,
) -> VeilFringes | None:
    """Estimate the backscatter fringes at points of ``cloud``; ``None``: they are negligible.

    ``frames`` are each side's, (n, h, w) uint8, ``maps`` its pattern columns and rows (h, w).
    """
    every = slice(None, None, max(1, len(cloud.pixel) // MOST_POINTS))
    v, u = np.divmod(cloud.pixel[every].astype(np.int64), rig.left.width_px)
    left_px = np.stack([u, v], -1).astype(np.float64)
    points = cloud.points_mm[every].astype(np.float64)
    if len(points) < FEWEST_POINTS:
        return None
    left = sample_side(sequence, frames["left"], *maps["left"], left_px)
    right = sample_side(sequence, frames["right"], *maps["right"], rig.right.project(points, water_index))
    valid = np.isfinite(left.row_px) & np.isfinite(right.row_px) & (left.own_dn > 1.0) & (right.own_dn > 1.0)
    if np.count_nonzero(valid) < FEWEST_POINTS:
        return None
    samples = {"left": _only(left, valid), "right": _only(right, valid)}
    points, left_px = points[valid], left_px[valid]
    projector = _Projector(rig, water_index)
    rows = projector.rows_fitted(points, samples["left"].row_px)
    if rows is None:
        return None
    sides, moves = {}, {}
    for side, camera in (("left", rig.left), ("right", rig.right)):
        origins = _origins(camera, samples[side].place, water_index)
        sides[side], moves[side] = _side_veil(
            samples[side], points, origins, projector, rows, float(sequence.period_px)
        )
    # Too large a row in the right camera lets the right ray pass above the left one: gap = mm per row (right − left).
    per_row_um = 1000.0 * projector.mm_per_row(points, rows)
    move, *doubts = (per_row_um * (r - n) for r, n in zip(moves["right"][:-1], moves["left"][:-1], strict=True))
    shape = SHAPE_SPREAD * per_row_um * np.hypot(moves["right"][-1], moves["left"][-1])
    return VeilFringes(sides, VeilGaps(left_px, move, np.stack(doubts, -1), shape))


def _side_veil(
    sample: SideSample, points_mm: Array, origins_mm: Array, projector: _Projector, rows: Array, period_px: float
) -> tuple[SideVeil, list[Array]]:
    some = slice(None, None, max(1, len(points_mm) // TRACED))
    ahead = projector.rows_ahead(points_mm[some], sample.row_px[some], origins_mm[some], rows, period_px)
    basis = _powers(sample.place[some], _TERMS_ROWS)
    fits = [_fitted(basis, sample.row_px[some] + off) for off in ahead]
    backscatter = _backscatter(sample)
    strength = _strength(sample, _powers(sample.place, _TERMS_ROWS) @ fits[0], backscatter, period_px)
    size = np.maximum(_powers(sample.place, _TERMS_STRENGTH) @ strength, 0.0)
    veil = SideVeil(
        tuple(float(c) for c in fits[0]),
        tuple(float(c) for c in strength),
        float(np.median(size / sample.own_dn)),
    )
    return veil, _moves(sample, fits, size, backscatter, period_px)


def _only(sample: SideSample, chosen: NDArray[np.bool_]) -> SideSample:
    return SideSample(
        sample.place[chosen],
        sample.own_dn[chosen],
        sample.both_dn[chosen],
        sample.row_px[chosen],
        sample.backscatter_dn[chosen],
    )


def remove_veil(
    veil: SideVeil,
    period_px: int,
    q_px: Floats,
    p_px: Floats,
    modulation_half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> int:
    """Remove the fringes from one camera's rows ``q_px`` (h, w), in place, and mask inseparable pixels.

    Returns the number of masked pixels.
    """
    return int(
        _remove(
            np.array(veil.rows_px, np.float32),
            np.array(veil.strength_dn, np.float32),
            np.float32(period_px),
            q_px,
            p_px,
            modulation_half_dn,
            mask,
        )
    )


def warm_up() -> None:
    """Run the kernel on maps without a coordinate."""
    nothing, zeros = np.full((2, 4, 4), np.nan, np.float32), np.zeros((4, 4), np.uint8)
    remove_veil(SideVeil((0.0,) * _TERMS_ROWS, (0.0,) * _TERMS_STRENGTH, 0.0), 16, nothing[0], nothing[1], zeros, zeros)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _remove(
    rows: Floats,
    strength: Floats,
    period_px: np.float32,
    q_px: Floats,
    p_px: Floats,
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> int:
    """Shift each row coordinate by −P/2π asin(A sin δ / B), with δ against the phase of the sum.

    That is the solution of |Z e^{iφ'} − A e^{iψ}| = B. ``rows`` and ``strength`` are coefficients of polynomials
    (``_powers``).
    """
    height, width = q_px.shape
    rad_per_px = np.float32(2.0 * np.pi) / period_px
    lost = 0
    for v in range(height):
        y = (np.float32(2.0) * np.float32(v) - np.float32(height)) / np.float32(width)
        # Coefficients of this row: polynomials of x.
        r0 = rows[0] + y * (rows[2] + y * (rows[5] + y * rows[9]))
        r1 = rows[1] + y * (rows[4] + y * rows[8])
        r2 = rows[3] + y * rows[7]
        a0 = strength[0] + y * (strength[2] + y * strength[5])
        a1 = strength[1] + y * strength[4]
        for u in range(width):
            q = q_px[v, u]
            if q != q:
                continue
            x = np.float32(2.0) * np.float32(u) / np.float32(width) - np.float32(1.0)
            ahead = r0 + x * (r1 + x * (r2 + x * rows[6])) - q
            size = max(a0 + x * (a1 + x * strength[3]), np.float32(0.0))
            # The smaller modulation of both directions is the columns': B.
            columns_dn = np.float32(0.5) * np.float32(half_dn[v, u])
            sine = size * np.sin(rad_per_px * ahead) / columns_dn
            if abs(sine) > np.float32(INSEPARABLE):
                q_px[v, u], p_px[v, u], mask[v, u] = np.nan, np.nan, _CONTRADICTION
                lost += 1
            else:
                q_px[v, u] = q - np.arcsin(sine) / rad_per_px
    return lost


class _Projector:
    """The nominal projector: half way between the cameras, behind a port like theirs.

    It looks at the middle of the volume.
    """

    def __init__(self, rig: StereoRig, water_index: float) -> None:
        between = np.asarray(rig.right.translation_mm)
        self._at = 0.5 * between
        x = between / np.linalg.norm(between)
        towards = rig.volume_centre_mm(water_index) - self._at
        z = towards - x * (x @ towards)
        z /= np.linalg.norm(z)
        self._axes = np.stack([x, np.cross(z, x), z])
        port = rig.left.port
        self._port = Port((0.0, 0.0, 1.0), port.distance_mm, port.thickness_mm, port.glass_index)
        self._index = water_index

    def _tangents(self, points_mm: Array, off_mm: tuple[float, float] = (0.0, 0.0)) -> tuple[Array, Array]:
        """Return the directions (x, y) in air, as tangents, of the light to points (..., 3); and their depths."""
        local = (points_mm - self._at) @ self._axes.T - np.array([0.0, *off_mm])
        local[..., 2] = np.maximum(local[..., 2], self._port.distance_mm + self._port.thickness_mm + 1.0)
        air = air_directions(self._port, self._index, local)
        return air[..., :2] / air[..., 2:], local[..., 2]

    def rows_fitted(self, points_mm: Array, row_px: Array, off_mm: tuple[float, float] = (0.0, 0.0)) -> Array | None:
        """Return the cubic (10,) of rows over tangents; ``None`` if the points do not determine it."""
        tangents, _ = self._tangents(points_mm, off_mm)
        basis = _powers(tangents, _TERMS_ROWS)
        keep = np.isfinite(row_px)
        fit: Array = np.zeros(_TERMS_ROWS)
        for _ in range(2):
            fit = _fitted(basis[keep], row_px[keep])
            residual_px = np.abs(row_px - basis @ fit)
            keep = residual_px <= 4.0 * float(np.median(residual_px[keep])) + 0.02
        return fit if fit[2] > 0.0 else None

    def mm_per_row(self, points_mm: Array, rows: Array) -> Array:
        """Return the distance of neighbouring rows across the projector's axis at points (n, 3), mm."""
        step = 0.5
        row = [
            _powers(self._tangents(points_mm + sign * step * self._axes[1])[0], _TERMS_ROWS) @ rows
            for sign in (1.0, -1.0)
        ]
        return np.asarray(2.0 * step / np.maximum(row[0] - row[1], 1e-3))

    def rows_ahead(
        self, points_mm: Array, row_px: Array, origins_mm: Array, rows: Array, period_px: float
    ) -> tuple[Array, Array, Array]:
        """Return how many rows the backscatter fringes are ahead of points (n, 3) seen from ``origins_mm``.

        (n,) each: with the nominal projector, and with it moved by ``START_SPREAD_MM`` along its rows' normal and along
        its axis.
        """
        places, shares = np.polynomial.legendre.leggauss(NODES)
        path_mm = points_mm - origins_mm
        along = 0.5 * (places + 1.0)
        nodes = origins_mm[:, None] + along[:, None] * path_mm[:, None]
        length_m = np.linalg.norm(path_mm, axis=-1) / 1000.0
        ahead = []
        for off in ((0.0, 0.0), (START_SPREAD_MM[0], 0.0), (0.0, START_SPREAD_MM[1])):
            fit = rows if off == (0.0, 0.0) else self.rows_fitted(points_mm, row_px, off)
            if fit is None:
                fit = rows
            tangents, depth = self._tangents(nodes, off)
            end, _ = self._tangents(points_mm, off)
            face = self._port.distance_mm + self._port.thickness_mm
            # Light at the node: inverse square of the distance, attenuation to it and back, none beside the pattern.
            reach = np.quantile(end[:, 0], (0.01, 0.99))
            illuminated = (
                (tangents[..., 0] > 1.1 * reach[0]) & (tangents[..., 0] < 1.1 * reach[1]) & (depth > face + 2.0)
            )
            path_m = depth / 1000.0 + along * length_m[:, None]
            weight = shares * illuminated * np.exp(-ATTENUATION_PER_M * path_m) / (depth * depth)
            off_px = (_powers(tangents, _TERMS_ROWS) @ fit) - (_powers(end, _TERMS_ROWS) @ fit)[:, None]
            turned = (weight * np.exp(2j * math.pi / period_px * off_px)).sum(1)
            ahead.append(np.angle(turned) * period_px / (2.0 * math.pi))
        return ahead[0], ahead[1], ahead[2]


def _origins(camera: HousedCamera, place: Array, water_index: float) -> Array:
    """Return the points (n, 3), mm, at which the rays of image places (n, 2) enter the water."""
    u = 0.5 * (place[:, 0] + 1.0) * camera.width_px
    v = 0.5 * (place[:, 1] * camera.width_px + camera.height_px)
    return camera.rays(np.stack([u, v], -1), water_index)[0]


def _powers(xy: Array, terms: int) -> Array:
    """Return the products 1, x, y, x², xy, y², x³, x²y, xy², y³ (..., terms) of places (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    ones = np.ones_like(x)
    return np.stack([ones, x, y, x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3][:terms], -1)


def _fitted(basis: Array, values: Array) -> Array:
    """Return the least-squares coefficients; undetermined ones stay small."""
    # Normal equations: a tenth of the time of a decomposition of the whole basis, and places are of the order of 1.
    normal = basis.T @ basis
    return np.asarray(np.linalg.solve(normal + np.diag(1e-9 * np.diag(normal) + 1e-12), basis.T @ values))


def _backscatter(sample: SideSample) -> Array:
    """Return the backscatter (n,) in DN, smoothed over the image."""
    finite = np.isfinite(sample.backscatter_dn)
    basis = _powers(sample.place, _TERMS_STRENGTH)
    if np.count_nonzero(finite) < 4 * _TERMS_STRENGTH:
        return np.zeros(len(finite))
    fit = _fitted(basis[finite], sample.backscatter_dn[finite])
    residual_dn = np.abs(sample.backscatter_dn - basis @ fit)
    finite &= residual_dn <= 5.0 * np.nanmedian(residual_dn) + 0.01
    fit = _fitted(basis[finite], sample.backscatter_dn[finite])
    return np.maximum(basis @ fit, 0.0)


def _strength(sample: SideSample, rows_px: Array, backscatter_dn: Array, period_px: float) -> Array:
    """Fit the polynomial of A: by the law of cosines point by point, and by the usual backscatter share.

    Both are weighted by their uncertainty.
    """
    columns_dn, rows_dn = sample.own_dn, sample.both_dn
    turned = 2.0 * math.pi / period_px * (rows_px - sample.row_px)
    # δ is against the phase of both: B² = |Z|² + A² − 2 |Z| A cos δ. The root nearer to none.
    sine, cosine = rows_dn * np.sin(turned), rows_dn * np.cos(turned)
    is_solvable = (columns_dn > np.abs(sine) * 1.2) & (cosine > 0.5 * rows_dn)
    by_cosines = cosine - np.sqrt(np.maximum(columns_dn * columns_dn - sine * sine, 0.0))
    usual = 0.5 * KEPT * backscatter_dn
    basis = _powers(sample.place, _TERMS_STRENGTH)
    # The errors of both are common to all points: they are averaged as whole polynomials, each with a single weight.
    ratio = _fitted(basis[is_solvable], by_cosines[is_solvable])
    prior = _fitted(basis, usual)
    if np.count_nonzero(is_solvable) < 20 * _TERMS_STRENGTH:
        return np.asarray(prior)
    by_ratio, by_share = _strength_spreads_dn(columns_dn, backscatter_dn)
    share = by_share**2 / max(by_ratio**2 + by_share**2, 1e-12)
    return np.asarray(share * ratio + (1.0 - share) * prior)


def _moves(
    sample: SideSample, fits: list[Array], size_dn: Array, backscatter_dn: Array, period_px: float
) -> list[Array]:
    """Return the errors (n,) of the rows of a camera's points, px, and their uncertainties.

    They are: the error by the backscatter fringes; its change by one standard deviation of the strength and of the
    projector's position in both directions; and the error per px between ψ and φ.
    """
    basis, columns_dn = _powers(sample.place, _TERMS_ROWS), sample.own_dn
    rad_per_px = 2.0 * math.pi / period_px

    def move(fit: Array, dn: Array) -> Array:
        sine = dn * np.sin(rad_per_px * (basis @ fit - sample.row_px)) / columns_dn
        return np.asarray(np.arcsin(np.clip(sine, -INSEPARABLE, INSEPARABLE)) / rad_per_px)

    nominal = move(fits[0], size_dn)
    by_ratio, by_share = _strength_spreads_dn(columns_dn, backscatter_dn)
    doubt_dn = by_ratio * by_share / max(math.hypot(by_ratio, by_share), 1e-9)
    stronger = move(fits[0], size_dn + doubt_dn)
    return [
        nominal,
        stronger - nominal,
        move(fits[1], size_dn) - nominal,
        move(fits[2], size_dn) - nominal,
        np.minimum(size_dn / columns_dn, 1.0),
    ]


def _strength_spreads_dn(own_dn: Array, backscatter_dn: Array) -> tuple[float, float]:
    """Return the standard deviations of A by the modulations and by the usual share of backscatter."""
    by_ratio = RATIO_SPREAD * float(np.median(own_dn))
    return by_ratio, 0.5 * KEPT * KEPT_SPREAD * float(np.median(backscatter_dn))
