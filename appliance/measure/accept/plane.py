"""The best-fit plane of points, and the search for it in a cloud."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.accept.points import (
    Array,
    FitPoints,
    NotFound,
    PointSource,
    finite_rows,
    thinned,
    without_outliers,
)

BELONGS_MM = 5.0
"""Largest distance of a plane's points from it; more than the depth error of the worst calibration, so that no outlier
is removed by it."""
AGREES_MM = 1.5
CELL_MM = 3.0
TRIALS = 200
LEAST_POINTS = 500
LEAST_SHARE = 0.5
ROUNDS = 3
SEED = 20


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane with axes: points are centre + x·axis_x + y·axis_y."""

    centre_mm: tuple[float, float, float]
    """Mean of the points to which it was fitted."""
    normal: tuple[float, float, float]
    """Unit normal, pointing away from the instrument."""
    axis_x: tuple[float, float, float]
    axis_y: tuple[float, float, float]
    covariance: Array
    """(3, 3) of the offset along the normal (mm) and of the slopes along the axes (mm/mm), from the residuals' scatter.
    """

    def distance_mm(self, points: Array) -> Array:
        """Return the signed distances (n,) of points (n, 3), positive behind the plane."""
        normal = np.array(self.normal)
        return np.asarray(points @ normal - np.array(self.centre_mm) @ normal)

    def coordinates_mm(self, points: Array) -> Array:
        """Return the coordinates (n, 2) in the plane."""
        axes = np.array([self.axis_x, self.axis_y]).T
        return np.asarray(points @ axes - np.array(self.centre_mm) @ axes)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A plane in a cloud and its points."""

    plane: Plane
    used: FitPoints
    coordinates_mm: Array
    """(n, 2) of the used points in the plane."""
    elsewhere: int
    """Number of points of the cloud that are not on the plane."""


def orthogonal_plane(points: Array) -> Plane:
    """Return the plane with the least sum of squared orthogonal distances to points (n >= 3, 3)."""
    centre = points.mean(axis=0)
    p = points - centre
    # Total least squares: the normal is the eigenvector of the least eigenvalue of the scatter matrix, and that
    # eigenvalue is the sum of squared distances.
    scatter = p.T @ p
    values, vectors = np.linalg.eigh(scatter)  # ascending: the normal first
    normal = vectors[:, 0] if vectors[:, 0] @ centre > 0.0 else -vectors[:, 0]
    axis_x = np.cross([0.0, 1.0, 0.0], normal)  # as the instrument sees it: x to the right, y down
    if np.linalg.norm(axis_x) < 1e-3:
        axis_x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    axis_x /= np.linalg.norm(axis_x)
    axis_y = np.cross(normal, axis_x)
    axes = np.stack([axis_x, axis_y])
    information = np.zeros((3, 3))  # about the middle of the points, offset and slopes are independent
    information[0, 0], information[1:, 1:] = len(p), axes @ scatter @ axes.T
    # Three parameters: n − 3 degrees of freedom.
    variance = max(float(values[0]), 0.0) / max(1, len(points) - 3)
    covariance = np.asarray(variance * np.linalg.pinv(information), np.float64)
    return Plane(_triple(centre), _triple(normal), _triple(axis_x), _triple(axis_y), covariance)


def fit_plane(cloud: PointSource) -> PlaneFit | NotFound:
    """Return the plane on which most of the cloud lies, with at most 0.3 % outliers. Deterministic."""
    rows = finite_rows(cloud.points_mm)
    if rows.size < LEAST_POINTS:
        return NotFound(
            f"the cloud has only {rows.size} points; bring the plane into the light of the projector, at the working "
            "distance, or check that the calibration is of this instrument"
        )
    points = cloud.points_mm[rows].astype(np.float64)
    plane = _most_agreed(points[thinned(points, CELL_MM)])
    mine = np.zeros(len(points), bool)
    # Points and plane depend on each other; the first plane goes through three points.
    for _ in range(ROUNDS):
        mine = np.abs(plane.distance_mm(points)) < BELONGS_MM
        plane = orthogonal_plane(points[mine])
    if mine.mean() < LEAST_SHARE:
        return NotFound(f"only {100 * mine.mean():.0f} % of the points lie on one plane; show nothing but the plane")
    near = np.flatnonzero(mine)
    keep = np.ones(near.size, bool)
    for _ in range(ROUNDS):
        keep = without_outliers(np.abs(plane.distance_mm(points[near])))
        plane = orthogonal_plane(points[near[keep]])
    inliers = near[keep]
    used = FitPoints(rows[inliers], cloud.pixel[rows[inliers]], plane.distance_mm(points[inliers]), rows[near[~keep]])
    return PlaneFit(plane, used, plane.coordinates_mm(points[inliers]), int(len(points) - near.size))


def _most_agreed(points: Array) -> Plane:
    """Return the plane with the most inliers, of those through three points drawn with a fixed seed."""
    # RANSAC with a fixed seed: the same cloud gives the same result.
    rng = np.random.default_rng(SEED)
    best, most_inliers = points, -1
    for _ in range(TRIALS):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 100.0:  # mm²: too small or too thin a triangle
            continue
        agrees = np.abs((points - a) @ (normal / length)) < AGREES_MM
        if (count := int(agrees.sum())) > most_inliers:
            best, most_inliers = points[agrees], count
    return orthogonal_plane(best)


def _triple(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
