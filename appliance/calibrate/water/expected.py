"""Expected errors of lengths and planes after an adjustment: its covariance propagated over the whole volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording
from appliance.calibrate.water.artefact import nearest_points
from appliance.measure import (
    BORDER,
    DEPTH_ERROR_TERMS,
    DISTANCE_MM,
    RIG_PARAMETERS,
    SplineGrid,
    StereoRig,
    WorkingVolume,
    shapes,
)

Array = NDArray[np.float64]

DEPTHS = (0.93, 1.0, 1.07)
"""Depths of the bars and planes, as shares of the distance of the volume's middle."""
SHARED_DEPTHS = (0.92, 1.0, 1.09, 1.17)
"""Depths at which the common depth error of all scans is evaluated: those of hand-held scans of large objects."""
ROLLS_DEG, LEANS_DEG = (0.0, 45.0, 90.0, -45.0), (0.0, 35.0, -35.0)
"""Each depth has a bar of each roll; the lean (out of the image plane) changes from one to the next."""
PLANE_HALF_MM = (100.0, 75.0)
"""Half the size of the evaluated part of a plane in the standard housing."""
PLANE_POINTS = (9, 7)
CAP = 0.6
"""Share of a ball's radius within which seven points represent its visible part."""
FLAT_RANGE = 6.0
"""Range of a bent plane's height in standard deviations."""
SURE = 2.0
"""Coverage factor of the stated errors: 95 % of single lengths are within."""
LENGTH_PERCENT, MANY_LENGTH_PERCENT, FLAT_PERCENT = 0.05, 0.025, 0.05
"""Limits of the length error after four and after ten recordings, and of the flatness error (``docs/accuracy.md``)."""
MANY_BARS, MANY_PLANES = 4, 6
MUCH_REST_PX = 0.01
PIXEL_STEP, INDEX_STEP = 1e-3, 1e-5


@dataclass(frozen=True, slots=True)
class ExpectedErrors:
    """Expected errors of objects that were not recorded, in percent; 95 of 100 are smaller."""

    length_percent: float
    """Error of a length, in the worst of twelve directions and positions."""
    flat_percent: float
    """Flatness error of a plane, from its lowest to its highest point, over the diagonal of the evaluated part."""


@dataclass(frozen=True, slots=True, eq=False)
class AdjustmentUncertainty:
    """Uncertainty of the parameters after an adjustment."""

    covariance: Array
    """(n, n) of all parameters."""
    by_index: Array
    """(n,): derivative of the parameters by the refractive index."""
    index_sd: float
    """Standard deviation of the refractive index."""
    rest_px: float
    """Systematic residual over patches of the image, which the model does not explain: each position of the image is
    assumed to have an independent error of that size."""


def expected_errors(
    rig: StereoRig, bar: Recording, uncertainty: AdjustmentUncertainty, columns: Columns
) -> ExpectedErrors:
    """Return the expected errors of ``rig`` as an adjustment left it, for bars like ``bar``."""
    covariance, rest_px = uncertainty.covariance, uncertainty.rest_px
    water_index = bar.water.index
    length_mm, radius_mm = float(bar.length_mm or 0.0), float(bar.radius_mm or 0.0)
    bars, directions = _bars(rig, water_index, length_mm, radius_mm)
    planes, normal = _planes(rig, water_index)
    n = bars.shape[2]
    by_all, by_pixel, by_water = _slopes(rig, water_index, bars.reshape(-1, 3), columns, len(covariance))
    by_water = (by_water + by_all @ uncertainty.by_index).reshape(len(bars), 2, n, 3).mean(axis=2)
    by_all = by_all.reshape(len(bars), 2, n, 3, -1).mean(axis=2)
    lengths = np.einsum("bx,bxk->bk", directions, by_all[:, 1] - by_all[:, 0]) / length_mm
    # The systematic residual displaces each ball as a whole: the right camera's pixel across, times the resulting
    # motion of the point.
    ball_motion = by_pixel.reshape(len(bars), 2, n, 3).mean(axis=2)
    ball_variance = rest_px**2 * np.sum(np.einsum("bx,bsx->bs", directions, ball_motion) ** 2, axis=1) / length_mm**2
    water_errors = np.einsum("bx,bx->b", directions, by_water[:, 1] - by_water[:, 0]) / length_mm * uncertainty.index_sd
    variance = np.sum((lengths @ covariance) * lengths, axis=1) + ball_variance + water_errors**2
    plane_variances = []
    for plane in planes:
        by_all, by_pixel, by_water = _slopes(rig, water_index, plane, columns, len(covariance))
        # Tilt and offset of a plane are arbitrary; only the deviation from the best-fit plane is a flatness error.
        design = np.column_stack([np.ones(len(plane)), plane - plane.mean(axis=0)])
        remove_plane = np.eye(len(plane)) - design @ np.linalg.pinv(design)
        heights = remove_plane @ np.einsum("x,pxk->pk", normal, by_all)
        mean_square = np.mean(np.sum((heights @ covariance) * heights, axis=1))
        water_errors = remove_plane @ ((by_water + by_all @ uncertainty.by_index) @ normal) * uncertainty.index_sd
        plane_variances.append(mean_square + np.mean(water_errors**2) + rest_px**2 * np.mean((by_pixel @ normal) ** 2))
    diagonal = 2.0 * rig.volume.scaled(float(np.hypot(*PLANE_HALF_MM)))
    return ExpectedErrors(
        100.0 * SURE * float(np.sqrt(variance.max())),
        100.0 * FLAT_RANGE * float(np.sqrt(max(plane_variances))) / diagonal,
    )


def expected_depth_error_mm2(
    rig: StereoRig, water_index: float, uncertainty: AdjustmentUncertainty, columns: Columns
) -> Array:
    """Return the covariance (n, n), mm², of the common smooth depth error of all scans of ``rig``.

    See ``calibration.depth_error``.
    """
    u, v = np.meshgrid(np.linspace(-BORDER, BORDER, 11), np.linspace(-0.75 * BORDER, 0.75 * BORDER, 9))
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    points = np.concatenate([share * rig.volume.scaled(DISTANCE_MM) * rays for share in SHARED_DEPTHS])
    by_all, by_pixel, by_water = _slopes(rig, water_index, points, columns, len(uncertainty.covariance))
    is_visible = np.abs(by_pixel).sum(axis=1) > 0.0
    # Only the depth counts, because a motion along the surface changes no distance.
    by_parameters = coefficients_of(points[is_visible], by_all[is_visible, 2], rig.volume)
    by_index = by_water[is_visible, 2] + by_all[is_visible, 2] @ uncertainty.by_index
    water_error = coefficients_of(points[is_visible], by_index, rig.volume) * uncertainty.index_sd
    # The systematic residual displaces each position of the image independently; all depths of one ray are one
    # position.
    residual_error = (
        coefficients_of(points[is_visible], np.diag(by_pixel[is_visible, 2]), rig.volume) * uncertainty.rest_px
    )
    return np.asarray(
        by_parameters @ uncertainty.covariance @ by_parameters.T
        + np.outer(water_error, water_error)
        + len(SHARED_DEPTHS) * residual_error @ residual_error.T
    )


def coefficients_of(points_mm: Array, depth_error_mm: Array, volume: WorkingVolume) -> Array:
    """Return the coefficients (COUNT, …) of depth errors (n, …) at points (n, 3), by least squares.

    Shift along the view, tilts and scale are removed with them, because overlaps absorb these.
    """
    z = points_mm[:, 2]
    u, v = points_mm[:, 0] / z / BORDER, points_mm[:, 1] / z / BORDER
    depth = z / volume.scaled(DISTANCE_MM)
    absorbed = np.stack([np.ones_like(z), u * depth, v * depth, depth], axis=1)
    design = np.concatenate([shapes(points_mm, volume), absorbed], axis=1)
    return np.asarray(np.linalg.lstsq(design, depth_error_mm, rcond=None)[0][:DEPTH_ERROR_TERMS])


def warnings_about_expected(
    expected: ExpectedErrors, recordings: Sequence[Recording], rest_px: float, fields_known: bool
) -> tuple[str, ...]:
    """Return a warning if the expected length or plane errors exceed the usual limits.

    ``fields_known``: the start has the lenses' fields from air, or none were to be adjusted.
    """
    bars = sum(r.kind is ArtefactKind.BALL_BAR for r in recordings)
    has_many = bars >= MANY_BARS and len(recordings) - bars >= MANY_PLANES
    limit = MANY_LENGTH_PERCENT if has_many else LENGTH_PERCENT
    if expected.length_percent <= limit and expected.flat_percent <= FLAT_PERCENT:
        return ()
    if not fields_known:
        remedy = "calibrate in air again: this start has no image correction of its lenses"
    elif has_many or rest_px > MUCH_REST_PX:
        remedy = (
            f"{rest_px:.3f} px of the residual are not explained by the model; calibrate in air again, with "
            "boards to the edges of both images, then record bars and planes again, at rest"
        )
    else:
        remedy = f"record {MANY_BARS} bars in different directions and {MANY_PLANES} planes, near and far"
    warning = (
        f"lengths may be wrong by {expected.length_percent:.3f} % (at most {limit:g} % is usual), planes bent by "
        f"{expected.flat_percent:.3f} % of their size (at most {FLAT_PERCENT:g} %): {remedy}"
    )
    return (warning,)


@dataclass(frozen=True, slots=True)
class Columns:
    """Columns of an adjustment's parameters: rig parameters (of ``RIG_PARAMETERS``), then nodes of surfaces."""

    active: tuple[int, ...]
    nodes: tuple[slice, slice]
    """Nodes of the left and the right image correction; empty without one."""


def _axes(rig: StereoRig, water_index: float) -> tuple[Array, Array]:
    """Return the middle of the volume (3,), and axes (3, 3) along the baseline, down, and away from it."""
    middle = rig.volume_centre_mm(water_index)
    across = np.asarray(rig.right.translation_mm)
    away = middle - 0.5 * across
    across = across / np.linalg.norm(across)
    away = away - (away @ across) * across
    away /= np.linalg.norm(away)
    return middle, np.stack([across, np.cross(away, across), away])


def _bars(rig: StereoRig, water_index: float, length_mm: float, radius_mm: float) -> tuple[Array, Array]:
    """Return points (bars, 2, 7, 3) on the near sides of both balls, and the directions (bars, 3) of the bars."""
    middle, axes = _axes(rig, water_index)
    angles = np.arange(6) * np.pi / 3.0
    cap = CAP * np.concatenate([[[0.0, 0.0]], np.stack([np.cos(angles), np.sin(angles)], 1)])
    near_side = radius_mm * np.column_stack([cap, -np.sqrt(1.0 - np.sum(cap**2, 1))]) @ axes
    points, directions = [], []
    for i, depth in enumerate(DEPTHS):
        for j, roll_deg in enumerate(ROLLS_DEG):
            roll, lean = np.radians([roll_deg, LEANS_DEG[(i + j) % len(LEANS_DEG)]])
            direction = np.array([np.cos(lean) * np.cos(roll), np.cos(lean) * np.sin(roll), np.sin(lean)]) @ axes
            centre = middle + (depth - 1.0) * float(middle @ axes[2]) * axes[2]
            points.append([centre + s * 0.5 * length_mm * direction + near_side for s in (-1.0, 1.0)])
            directions.append(direction)
    return np.array(points), np.array(directions)


def _planes(rig: StereoRig, water_index: float) -> tuple[list[Array], Array]:
    """Return grids (n, 3) on planes across the view, and their normal (3,)."""
    middle, axes = _axes(rig, water_index)
    u, v = (
        np.linspace(-rig.volume.scaled(half), rig.volume.scaled(half), n)
        for half, n in zip(PLANE_HALF_MM, PLANE_POINTS, strict=True)
    )
    flat = np.stack(np.meshgrid(u, v), -1).reshape(-1, 2) @ axes[:2]
    return [middle + (depth - 1.0) * float(middle @ axes[2]) * axes[2] + flat for depth in DEPTHS], axes[2]


def _slopes(
    rig: StereoRig, water_index: float, points: Array, columns: Columns, size: int
) -> tuple[Array, Array, Array]:
    """Return the derivatives of points (n, 3).

    By all parameters, (n, 3, size), by the right camera's pixel across, (n, 3), and by the refractive index, (n, 3).
    """
    left, right = (camera.project(points, water_index) for camera in (rig.left, rig.right))
    # A point that only one camera sees has no derivative.
    is_visible = np.isfinite(np.concatenate([left, right], axis=1)).all(axis=1)
    left, right = np.where(is_visible[:, None], left, 0.0), np.where(is_visible[:, None], right, 0.0)

    def intersect(rig: StereoRig, left: Array = left, right: Array = right, water_index: float = water_index) -> Array:
        return nearest_points(*rig.left.rays(left, water_index), *rig.right.rays(right, water_index))

    current = intersect(rig)
    by_all = np.zeros((len(points), 3, size))
    for column, k in enumerate(columns.active):
        step = RIG_PARAMETERS.steps[k]
        by_all[:, :, column] = (intersect(RIG_PARAMETERS.changed(rig, step, k)) - current) / step
    by_pixel = (intersect(rig, right=right + np.array([PIXEL_STEP, 0.0])) - current) / PIXEL_STEP
    by_water = (intersect(rig, water_index=water_index + INDEX_STEP) - current) / INDEX_STEP
    by_nodes: list[Callable[[Array], Array]] = [
        lambda e: (intersect(rig, left=left - e) - current) / PIXEL_STEP,
        lambda e: (intersect(rig, right=right - e) - current) / PIXEL_STEP,
    ]
    for camera, uv, nodes, by_node in zip((rig.left, rig.right), (left, right), columns.nodes, by_nodes, strict=True):
        if camera.correction is None or nodes.start == nodes.stop:
            continue
        # Derivatives by a surface's nodes: those by its two components, times its basis.
        basis = SplineGrid((camera.width_px, camera.height_px), camera.correction.intervals).matrix(uv)
        count = basis.shape[1]
        for k, step in enumerate(PIXEL_STEP * np.eye(2)):
            first = nodes.start + k * count
            by_all[:, :, first : first + count] = by_node(step)[:, :, None] * basis[:, None, :]
    by_all[~is_visible], by_pixel[~is_visible], by_water[~is_visible] = 0.0, 0.0, 0.0
    return by_all, by_pixel, by_water
