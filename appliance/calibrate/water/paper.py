"""Water calibration as published by Bräuer-Burchardt et al. 2015.

Its models are pinholes (PM), perpendicular ports at searched distances (RM), and these with a distortion operator
(RMD). RM has the pair (d1, d2) that minimises T, the sum of squares of the relative length errors of ball bars and the
relative flatness errors of planes (UIDD, Eqs. 5-7). Rays are those of ``HousedCamera``, which is the meaning of the
misprinted Eq. 1. Flatness is a range, whose floor is the noise, so that T has a valley along d1 - d2. Tilted ports
cannot be found this way: ``bundle`` finds them.

For the operator D every point of the planes is moved to its fitted plane and projected back; the differences in the
images are approximated by a bivariate cubic (ten coefficients per coordinate and camera). A bicubic spline contains
every cubic, so that the calibration file keeps the operator as an ordinary image correction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording, RecordingError, thinned
from appliance.calibrate.water.artefact import fit_plane, fit_sphere, nearest_points, triangulate
from appliance.calibrate.water.method import BEFORE_OPERATOR, Method, WaterResult
from appliance.measure import SIDES, Calibration, HousedCamera, Lens, SplineGrid, StereoRig, Water, WorkingVolume

Array = NDArray[np.float64]

REACH_MM = 4.0
"""Limit of the search, around the starting distances."""
STEPS_MM = (1.0, 0.25, 0.05)
"""Step widths: each search is around the best pair of the one before, two of its steps to each side."""
FIELD_MM = 250.0
"""Reference length d_r, by which the flatness errors are divided."""
OUTLIERS = 0.003
"""Share of the points of a plane that are left out as outliers."""
SEARCHED_POINTS = 600
"""Points of each recording that the search uses."""
LEAST_POINTS = 100
"""Least number of points for the operator: ten for each coefficient."""
DEPTHS_MM = (430.0, 480.0, 530.0, 580.0)
"""Depths along the rays, from the port, in the standard housing: its working volume and some more behind it."""
GRID = (25, 19)
"""Rays across and down the image to which a pinhole is fitted."""


def calibrate_as_published(recordings: Sequence[Recording], start: Calibration) -> WaterResult:
    """Search the distances, then the operator, then the distances again; the result also has PM and RM.

    It is not repeated, because the distances would move along the valley of T. Raises RecordingError without a bar or
    two planes.
    """
    first = search_distances(recordings, start)
    corrected = replace(first.calibration, rig=with_operator(recordings, first.calibration))
    again = search_distances(recordings, corrected)
    calibration = replace(
        again.calibration, method="search of distances, operator", made_from=first.calibration.made_from
    )
    models = mapped_through_ports(start, recordings[0].water), first.calibration
    before = dict(zip(BEFORE_OPERATOR, models, strict=True))
    return WaterResult(Method.PAPER, calibration, again.warnings, before=before)


def flatness_error(points_mm: Array) -> float:
    """Return E_F of points (n, 3): the range of their distances from the best-fit plane over d_r (Eq. 7)."""
    normal, offset = fit_plane(points_mm)
    distances_mm = np.sort(points_mm @ normal - offset)
    cut = int(0.5 * OUTLIERS * len(distances_mm))
    return float(distances_mm[-1 - cut] - distances_mm[cut]) / FIELD_MM


def search_distances(
    recordings: Sequence[Recording],
    start: Calibration,
    flatness: Callable[[Array], float] = flatness_error,
    reach_mm: float = REACH_MM,
    steps_mm: Sequence[float] = STEPS_MM,
) -> WaterResult:
    """Search d1 and d2 for ports that are otherwise as in ``start``; warn where the result is at the limit.

    Raises RecordingError without a bar or a plane.
    """
    for kind in ArtefactKind:
        if not any(r.kind is kind for r in recordings):
            raise RecordingError(
                f"no recording of a {kind.value}; the statistic T needs ball bars and planes; record one"
            )
    used = [thinned(r, SEARCHED_POINTS) for r in recordings]
    rig = start.rig
    best = np.array([rig.left.port.distance_mm, rig.right.port.distance_mm])
    # An interface distance below zero would put the port behind the projection centre.
    nearest_mm, farthest_mm = np.maximum(best - reach_mm, 0.0), best + reach_mm
    least_statistic, reach = np.inf, reach_mm
    for step in steps_mm:
        count = int(np.ceil(reach / step))
        offsets = np.arange(-count, count + 1) * step
        axes = []
        for side, camera in enumerate((rig.left, rig.right)):
            distances = np.unique(np.clip(best[side] + offsets, nearest_mm[side], farthest_mm[side]))
            # Rays depend on the distance of their own camera only: m + n traces serve all m · n pairs.
            axes.append([(d, _rays(_with_distance(camera, float(d)), used, side)) for d in distances])
        for d1, left in axes[0]:
            for d2, right in axes[1]:
                statistic = _statistic(used, left, right, flatness)
                if statistic < least_statistic:
                    best, least_statistic = np.array([d1, d2]), statistic
        reach = 2.0 * step
    warnings = tuple(
        f"{side} interface distance {d:.2f} mm is at the limit of the search: the port is not as modelled; use "
        f"{Method.SPLINE.value}"
        for side, d, nearest, farthest in zip(SIDES, best, nearest_mm, farthest_mm, strict=True)
        if min(d - nearest, farthest - d) < 0.5 * steps_mm[-1]
    )
    calibration = replace(
        start,
        method="search of distances",
        made_from=(*start.made_from, *(f"recording {r.name}" for r in recordings)),
        water=used[0].water,
        rig=replace(
            rig, left=_with_distance(rig.left, float(best[0])), right=_with_distance(rig.right, float(best[1]))
        ),
        air_covariance=None,
        air_field=None,
    )
    return WaterResult(Method.PAPER, calibration, warnings)


def _with_distance(camera: HousedCamera, distance_mm: float) -> HousedCamera:
    return replace(camera, port=replace(camera.port, distance_mm=distance_mm))


def _rays(camera: HousedCamera, recordings: Sequence[Recording], side: int) -> list[tuple[Array, Array]]:
    return [camera.rays(r.left_px if side == 0 else r.right_px, r.water.index) for r in recordings]


def _statistic(
    recordings: Sequence[Recording],
    left: Sequence[tuple[Array, Array]],
    right: Sequence[tuple[Array, Array]],
    flatness: Callable[[Array], float],
) -> float:
    """Return T of Eq. 5: squared relative errors of the bars' lengths, Eq. 6, and of the planes' flatness."""
    total = 0.0
    for recording, left_rays, right_rays in zip(recordings, left, right, strict=True):
        points = nearest_points(*left_rays, *right_rays)
        if recording.length_mm is None:
            error = flatness(points)
        else:
            a, b = (fit_sphere(points[recording.sphere == k], recording.radius_mm)[0] for k in (0, 1))
            error = float(np.linalg.norm(b - a)) / recording.length_mm - 1.0
        total += error * error
    return total


def with_operator(recordings: Sequence[Recording], calibration: Calibration) -> StereoRig:
    """Return the rig with the operator of both cameras. Raises RecordingError for fewer than two planes."""
    planes = [r for r in recordings if r.kind is ArtefactKind.PLANE]
    if len(planes) < 2:
        raise RecordingError(f"{len(planes)} recordings of a plane; the method needs two, near and far; record them")
    rig = calibration.rig
    differences: dict[str, list[tuple[Array, Array]]] = {"left": [], "right": []}
    for plane in planes:
        points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
        normal, offset = fit_plane(points)
        # The nearest point of the plane counts as the true one, and the difference from it as distortion, even if it
        # comes from the port. That is the limit of the method.
        on_plane = points - (points @ normal - offset)[:, None] * normal
        differences["left"].append((plane.left_px, plane.left_px - rig.left.project(on_plane, plane.water.index)))
        differences["right"].append((plane.right_px, plane.right_px - rig.right.project(on_plane, plane.water.index)))
    return replace(rig, left=_operator(rig.left, differences["left"]), right=_operator(rig.right, differences["right"]))


def cubic(uv: Array) -> Array:
    """Return the ten monomials (n, 10) of a bivariate cubic at coordinates (n, 2)."""
    x, y = uv[:, 0], uv[:, 1]
    return np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], -1)


def _operator(camera: HousedCamera, differences: Sequence[tuple[Array, Array]]) -> HousedCamera:
    uv, missing = (np.concatenate(parts) for parts in zip(*differences, strict=True))
    is_finite = np.isfinite(missing).all(axis=1)
    uv, missing = uv[is_finite], missing[is_finite]
    if len(uv) < LEAST_POINTS:
        raise RecordingError(
            f"{len(uv)} points of the planes lie in the water in front of a camera; {LEAST_POINTS} are "
            "needed; check the "
            "start, and record again"
        )
    coefficients = np.linalg.lstsq(cubic(_unit(camera, uv)), missing, rcond=None)[0]
    spline = SplineGrid((camera.width_px, camera.height_px))
    grid_px = _grid(camera, *(4 * n + 1 for n in spline.intervals))
    # The spline's nodes follow from the cubic on a grid four times finer than the intervals. This is exact except for
    # rounding, because a cubic is a spline.
    nodes = np.linalg.lstsq(spline.matrix(grid_px), cubic(_unit(camera, grid_px)) @ coefficients, rcond=None)[0]
    return replace(camera, correction=spline.correction(nodes))


def _unit(camera: HousedCamera, uv_px: Array) -> Array:
    """Return image coordinates scaled to −1 … 1."""
    return np.asarray(2.0 * (uv_px + 0.5) / [camera.width_px, camera.height_px] - 1.0)


def _grid(camera: HousedCamera, across: int, down: int) -> Array:
    """Return pixels (n, 2) on a grid over the whole image, row by row."""
    u, v = np.meshgrid(np.linspace(0.0, camera.width_px - 1.0, across), np.linspace(0.0, camera.height_px - 1.0, down))
    return np.stack([u.ravel(), v.ravel()], -1)


def mapped_through_ports(start: Calibration, water: Water) -> Calibration:
    """Return the pinholes nearest to the refracted rays of ``start``, camera by camera; valid in ``water`` only."""
    volume = start.rig.volume
    left, right = (_mapped(camera, volume, water) for camera in (start.rig.left, start.rig.right))
    return replace(
        start,
        method="pinhole, mapped through the ports as drawn",
        water=water,
        rig=replace(start.rig, left=left, right=right),
        residual_px=None,
        air_covariance=None,
        air_field=None,
    )


def _mapped(camera: HousedCamera, volume: WorkingVolume, water: Water) -> HousedCamera:
    uv = _grid(camera, *GRID)
    origin, direction = camera.at_origin().rays(uv, water.index)
    points = np.concatenate([origin + volume.scaled(s) * direction for s in DEPTHS_MM])
    target_px = np.tile(uv, (len(DEPTHS_MM), 1))
    f_px, ratio = camera.lens.f_px[0], camera.lens.f_px[1] / camera.lens.f_px[0]

    def lens_of(x: Array) -> tuple[Lens, float]:
        k1, k2, p1, p2, k3 = (float(k) for k in x[3:8])
        f = float(x[0]) * f_px
        return Lens((f, f * ratio), (float(x[1]), float(x[2])), (k1, k2, p1, p2, k3)), float(x[8])

    def residual(x: Array) -> Array:
        lens, back_mm = lens_of(x)
        # From the middle of the volume, refracted rays seem to come from a centre behind the true one, and the focal
        # length is longer by the index: both are the start of the search.
        return np.asarray((lens.to_pixels(points[:, :2] / (points[:, 2:] + back_mm)) - target_px).ravel())

    import scipy.optimize  # half a second that a start of the service does not need

    start = np.array([water.index, *camera.lens.c_px, *camera.lens.distortion, 0.3 * camera.port.distance_mm])
    solution = scipy.optimize.least_squares(
        residual, start, x_scale=[1e-3, 1.0, 1.0, 1e-2, 1e-2, 1e-4, 1e-4, 1e-2, 1.0]
    )
    lens, back_mm = lens_of(solution.x)
    centre = np.asarray(camera.translation_mm) - back_mm * np.asarray(camera.rotation)[:, 2]
    return replace(
        camera,
        lens=lens,
        translation_mm=(float(centre[0]), float(centre[1]), float(centre[2])),
        lens_in_water=True,
    )
