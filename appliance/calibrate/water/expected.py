"""Owns how wrong an adjustment's lengths and planes may be: its covariance, carried to bars and planes all over the
volume."""

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
"""Depths at which the depth error that all scans share is looked at: those of hand-held scans of large things."""
ROLLS_DEG, LEANS_DEG = (0.0, 45.0, 90.0, -45.0), (0.0, 35.0, -35.0)
"""Each depth has a bar of each roll; the lean (out of the picture's plane) changes from one to the next."""
PLANE_HALF_MM = (100.0, 75.0)
"""Half of the part of a plane that is looked at in the standard housing."""
PLANE_POINTS = (9, 7)
CAP = 0.6
"""Share of a ball's radius over which seven points stand for what is seen of it."""
FLAT_RANGE = 6.0
"""Standard deviations of a bent plane's height from its lowest to its highest place."""
SURE = 2.0
"""Standard deviations of what is stated: 95 % of a single length."""
LENGTH_PERCENT, MANY_LENGTH_PERCENT, FLAT_PERCENT = 0.05, 0.025, 0.05
"""Errors that a calibration of four recordings, and one of ten, should not exceed (``docs/accuracy.md``)."""
MANY_BARS, MANY_PLANES = 4, 6
MUCH_REST_PX = 0.01
PIXEL_STEP, INDEX_STEP = 1e-3, 1e-5


@dataclass(frozen=True, slots=True)
class Expected:
    """Errors to be expected of objects that were not recorded, in percent; 95 of 100 are smaller."""

    length_percent: float
    """Error of a length, in the worst of twelve directions and places."""
    flat_percent: float
    """Bend of a plane, from its lowest to its highest place, as a share of the diagonal of the part looked at."""


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """The uncertainty that an adjustment leaves."""

    covariance: Array
    """(n, n) of all its unknowns."""
    by_index: Array
    """(n,): what they would change by with the index of the water."""
    index_sd: float
    """Standard deviation of that index."""
    rest_px: float
    """Residual left over patches of the image though the model should explain it: each place is supposed to have an
    error of that size of its own."""


def expected(rig: StereoRig, bar: Recording, doubt: Doubt, columns: Columns) -> Expected:
    """Return the errors to be expected of ``rig`` as an adjustment left it, of bars like ``bar``."""
    covariance, rest_px = doubt.covariance, doubt.rest_px
    water_index = bar.water.index
    length_mm, radius_mm = float(bar.length_mm or 0.0), float(bar.radius_mm or 0.0)
    bars, along = _bars(rig, water_index, length_mm, radius_mm)
    planes, normal = _planes(rig, water_index)
    n = bars.shape[2]
    by_all, by_pixel, by_water = _slopes(rig, water_index, bars.reshape(-1, 3), columns, len(covariance))
    by_water = (by_water + by_all @ doubt.by_index).reshape(len(bars), 2, n, 3).mean(axis=2)
    by_all = by_all.reshape(len(bars), 2, n, 3, -1).mean(axis=2)
    lengths = np.einsum("bx,bxk->bk", along, by_all[:, 1] - by_all[:, 0]) / length_mm
    # What is left misplaces each ball as a whole: the right camera's pixel across, times how far that moves the point.
    own = by_pixel.reshape(len(bars), 2, n, 3).mean(axis=2)
    own_variance = rest_px**2 * np.sum(np.einsum("bx,bsx->bs", along, own) ** 2, axis=1) / length_mm**2
    of_water = np.einsum("bx,bx->b", along, by_water[:, 1] - by_water[:, 0]) / length_mm * doubt.index_sd
    variance = np.sum((lengths @ covariance) * lengths, axis=1) + own_variance + of_water**2
    flat = []
    for plane in planes:
        by_all, by_pixel, by_water = _slopes(rig, water_index, plane, columns, len(covariance))
        # A plane's lean and offset are its own; only what is left beside the best plane is a bend.
        design = np.column_stack([np.ones(len(plane)), plane - plane.mean(axis=0)])
        aside = np.eye(len(plane)) - design @ np.linalg.pinv(design)
        heights = aside @ np.einsum("x,pxk->pk", normal, by_all)
        mean_square = np.mean(np.sum((heights @ covariance) * heights, axis=1))
        of_water = aside @ ((by_water + by_all @ doubt.by_index) @ normal) * doubt.index_sd
        flat.append(mean_square + np.mean(of_water**2) + rest_px**2 * np.mean((by_pixel @ normal) ** 2))
    diagonal = 2.0 * rig.volume.scaled(float(np.hypot(*PLANE_HALF_MM)))
    return Expected(
        100.0 * SURE * float(np.sqrt(variance.max())), 100.0 * FLAT_RANGE * float(np.sqrt(max(flat))) / diagonal
    )


def expected_depth_error_mm2(rig: StereoRig, water_index: float, doubt: Doubt, columns: Columns) -> Array:
    """Return the covariance (n, n), mm², of the smooth depth error that all scans of ``rig`` share
    (``calibration.depth_error``)."""
    u, v = np.meshgrid(np.linspace(-BORDER, BORDER, 11), np.linspace(-0.75 * BORDER, 0.75 * BORDER, 9))
    ray = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    points = np.concatenate([share * rig.volume.scaled(DISTANCE_MM) * ray for share in SHARED_DEPTHS])
    by_all, by_pixel, by_water = _slopes(rig, water_index, points, columns, len(doubt.covariance))
    seen = np.abs(by_pixel).sum(axis=1) > 0.0
    # What a point moves aside on the ray's own surface changes no distance: depth alone.
    depth = coefficients_of(points[seen], by_all[seen, 2], rig.volume)
    by_index = by_water[seen, 2] + by_all[seen, 2] @ doubt.by_index
    of_water = coefficients_of(points[seen], by_index, rig.volume) * doubt.index_sd
    # What is left misplaces each place by itself; those of one ray at all depths are one place.
    each = coefficients_of(points[seen], np.diag(by_pixel[seen, 2]), rig.volume) * doubt.rest_px
    return np.asarray(
        depth @ doubt.covariance @ depth.T + np.outer(of_water, of_water) + len(SHARED_DEPTHS) * each @ each.T
    )


def coefficients_of(points_mm: Array, depth_error_mm: Array, volume: WorkingVolume) -> Array:
    """Return the coefficients (COUNT, …) of depth errors (n, …) at points (n, 3), by least squares.

    What shifts along the view, tilts or scales is taken away beside them: overlaps absorb it.
    """
    z = points_mm[:, 2]
    u, v = points_mm[:, 0] / z / BORDER, points_mm[:, 1] / z / BORDER
    far = z / volume.scaled(DISTANCE_MM)
    others = np.stack([np.ones_like(z), u * far, v * far, far], axis=1)
    design = np.concatenate([shapes(points_mm, volume), others], axis=1)
    return np.asarray(np.linalg.lstsq(design, depth_error_mm, rcond=None)[0][:DEPTH_ERROR_TERMS])


def warnings_about_expected(
    found: Expected, recordings: Sequence[Recording], rest_px: float, fields_known: bool
) -> tuple[str, ...]:
    """Return a warning if lengths or planes are to be expected worse than such a calibration should be.

    ``fields_known``: the start knew the lenses' fields from air, or none were to be adjusted.
    """
    bars = sum(r.kind is ArtefactKind.BALL_BAR for r in recordings)
    many = bars >= MANY_BARS and len(recordings) - bars >= MANY_PLANES
    limit = MANY_LENGTH_PERCENT if many else LENGTH_PERCENT
    if found.length_percent <= limit and found.flat_percent <= FLAT_PERCENT:
        return ()
    if not fields_known:
        remedy = "calibrate in air again: this start does not know what its lenses do beyond their coefficients"
    elif many or rest_px > MUCH_REST_PX:
        remedy = (
            f"{rest_px:.3f} px are left that the model does not explain; calibrate in air again, with boards to the "
            "edges of "
            f"both images, then record the bars and planes again at rest"
        )
    else:
        remedy = f"record {MANY_BARS} bars in different directions and {MANY_PLANES} planes, near and far"
    said = (
        f"lengths may be wrong by {found.length_percent:.3f} % (at most {limit:g} % is usual), planes bent by "
        f"{found.flat_percent:.3f} % of their size (at most {FLAT_PERCENT:g} %): {remedy}"
    )
    return (said,)


@dataclass(frozen=True, slots=True)
class Columns:
    """Places of an adjustment's unknowns: rig parameters (of ``RIG_PARAMETERS``), then nodes of surfaces."""

    active: tuple[int, ...]
    nodes: tuple[slice, slice]
    """Nodes of the left and of the right image correction; empty where there is none."""


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
    """Return points (bars, 2, 7, 3) of both balls' near sides, and the bars' directions (bars, 3)."""
    middle, axes = _axes(rig, water_index)
    turn = np.arange(6) * np.pi / 3.0
    cap = CAP * np.concatenate([[[0.0, 0.0]], np.stack([np.cos(turn), np.sin(turn)], 1)])
    near = radius_mm * np.column_stack([cap, -np.sqrt(1.0 - np.sum(cap**2, 1))]) @ axes
    points, along = [], []
    for i, depth in enumerate(DEPTHS):
        for j, roll_deg in enumerate(ROLLS_DEG):
            roll, lean = np.radians([roll_deg, LEANS_DEG[(i + j) % len(LEANS_DEG)]])
            way = np.array([np.cos(lean) * np.cos(roll), np.cos(lean) * np.sin(roll), np.sin(lean)]) @ axes
            at = middle + (depth - 1.0) * float(middle @ axes[2]) * axes[2]
            points.append([at + s * 0.5 * length_mm * way + near for s in (-1.0, 1.0)])
            along.append(way)
    return np.array(points), np.array(along)


def _planes(rig: StereoRig, water_index: float) -> tuple[list[Array], Array]:
    """Return grids (n, 3) of planes across the view, and their normal (3,)."""
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
    """Return how points (n, 3) move with all unknowns, (n, 3, size), with the right camera's pixel across, (n, 3), and
    with the index of the water, (n, 3)."""
    left, right = (camera.project(points, water_index) for camera in (rig.left, rig.right))
    # Seen by one camera only: such a point says nothing.
    seen = np.isfinite(np.concatenate([left, right], axis=1)).all(axis=1)
    left, right = np.where(seen[:, None], left, 0.0), np.where(seen[:, None], right, 0.0)

    def met(rig: StereoRig, left: Array = left, right: Array = right, water_index: float = water_index) -> Array:
        return nearest_points(*rig.left.rays(left, water_index), *rig.right.rays(right, water_index))

    now = met(rig)
    found = np.zeros((len(points), 3, size))
    for column, k in enumerate(columns.active):
        step = RIG_PARAMETERS.steps[k]
        found[:, :, column] = (met(RIG_PARAMETERS.changed(rig, step, k)) - now) / step
    by_pixel = (met(rig, right=right + np.array([PIXEL_STEP, 0.0])) - now) / PIXEL_STEP
    by_water = (met(rig, water_index=water_index + INDEX_STEP) - now) / INDEX_STEP
    by_nodes: list[Callable[[Array], Array]] = [
        lambda e: (met(rig, left=left - e) - now) / PIXEL_STEP,
        lambda e: (met(rig, right=right - e) - now) / PIXEL_STEP,
    ]
    for camera, uv, nodes, by in zip((rig.left, rig.right), (left, right), columns.nodes, by_nodes, strict=True):
        if camera.correction is None or nodes.start == nodes.stop:
            continue
        # Slopes by a surface's nodes: those by its two components, times its basis.
        basis = SplineGrid((camera.width_px, camera.height_px), camera.correction.intervals).matrix(uv)
        count = basis.shape[1]
        for k, step in enumerate(PIXEL_STEP * np.eye(2)):
            first = nodes.start + k * count
            found[:, :, first : first + count] = by(step)[:, :, None] * basis[:, None, :]
    found[~seen], by_pixel[~seen], by_water[~seen] = 0.0, 0.0, 0.0
    return found, by_pixel, by_water
