"""The best-fit sphere of points: a closed form, then Gauss–Newton on the error along the view.

A point's error lies along the ray of its pixel, and the pixel itself is exact. The fit therefore minimises the distance
between point and sphere *along that ray*, in units of its sigma. Distances along the normal would correlate with their
direction, and make the radius of a small cap wrong by several times sigma²/radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.accept.points import Array, without_outliers

STEPS = 30
STEEPEST_COS = 0.57
"""Least cosine (55°) between the view and the sphere's normal: a pixel averages over its footprint, which is strongly
curved in oblique views. With 65° and pixels of 0.64 mm, the measured radius is 4 µm larger."""
MIN_POINTS = 30
START_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A sphere with its covariance."""

    centre_mm: tuple[float, float, float]
    radius_mm: float
    covariance_mm2: Array
    """(4, 4) of centre and radius, from the scatter of the residuals, without systematic errors."""


@dataclass(frozen=True, slots=True, eq=False)
class SphereSolution:
    """A best-fit sphere and which of the points were used."""

    sphere: Sphere
    used: np.ndarray[tuple[int], np.dtype[np.bool_]]
    outlier: np.ndarray[tuple[int], np.dtype[np.bool_]]
    residual_mm: Array
    """(n,) distance of all points to the sphere along its normal, outwards positive."""


def algebraic_sphere(points: Array) -> tuple[Array, float] | None:
    """Return the centre (3,) and radius by the form that is linear in |p|²; biased for caps: only a start."""
    middle = points.mean(axis=0)
    # Relative to the mean, since |p|² of points half a metre away would lose half of the digits.
    p = points - middle
    columns = np.column_stack([2.0 * p, np.ones(len(p))])
    solved, _, rank, _ = np.linalg.lstsq(columns, np.einsum("ij,ij->i", p, p), rcond=None)
    square = solved[3] + solved[:3] @ solved[:3]
    if rank < 4 or square <= 0.0:
        return None
    return middle + solved[:3], float(np.sqrt(square))


def fit_sphere(points: Array, sigma: Array, start: tuple[Array, float] | None = None) -> SphereSolution | None:
    """Return the sphere through ``points`` (n, 3) with standard deviations ``sigma`` (n,) along the view.

    The view is from the origin. At most 0.3 % of them are left out as outliers, and besides only those that are seen
    flatter than 55°. ``None`` if there are too few points or no such sphere.
    """
    start = start or algebraic_sphere(points)
    if start is None:
        return None
    # The error of a point lies almost only along its view: residuals are measured there, not across the surface, which
    # would bias the radius in oblique views.
    depth = np.linalg.norm(points, axis=1)
    view = points / depth[:, None]
    x = np.array([*start[0], start[1]])
    # The choice of steep rays depends on ray and sphere alone, not on the noisy depth, which would be a bias.
    steep = np.zeros(len(points), bool)
    keep = steep
    covariance = np.zeros((4, 4))
    for round_ in range(START_ROUNDS):
        # The set of steep rays depends on the sphere and the sphere on the set; it converges in a few rounds.
        along, root = _intersection(view, x)
        now = root > STEEPEST_COS * x[3]
        if now.sum() < MIN_POINTS:
            return None
        if round_ and np.array_equal(now, steep):
            break
        steep = now
        rows = np.flatnonzero(steep)
        solution = _gauss_newton(view[rows], depth[rows], sigma[rows], x)
        if solution is None:
            return None
        along, _ = _intersection(view[rows], solution[0])
        keep = np.zeros(len(points), bool)
        keep[rows[without_outliers(np.abs(depth[rows] - along) / sigma[rows])]] = True
        solution = _gauss_newton(view[keep], depth[keep], sigma[keep], solution[0])
        if solution is None:
            return None
        x, covariance = solution
    residual = np.linalg.norm(points - x[:3], axis=1) - x[3]
    sphere = Sphere((float(x[0]), float(x[1]), float(x[2])), float(x[3]), covariance)
    return SphereSolution(sphere, keep, steep & ~keep, residual)


def _intersection(view: Array, x: Array) -> tuple[Array, Array]:
    """Return the distance (n,) from the origin to the near side of the sphere, and half the chord (n,).

    A ray that misses the sphere has chord 0.
    """
    towards = view @ x[:3]
    # |s v − c|² = r² along the unit view v: s = v·c − √((v·c)² − |c|² + r²), the nearer of both.
    square = towards**2 - (x[:3] @ x[:3] - x[3] ** 2)
    root = np.sqrt(np.maximum(square, 0.0))
    return towards - root, root


def _gauss_newton(view: Array, depth: Array, sigma: Array, x: Array) -> tuple[Array, Array] | None:
    """Return parameters (4,) and covariance (4, 4); ``None`` if it does not converge."""
    if len(view) < MIN_POINTS:
        return None
    x = x.copy()
    for _ in range(STEPS):
        along, root = _intersection(view, x)
        # At the occluding contour the derivative has a pole; used rays are far from it, but not in every step.
        root = np.maximum(root, 0.1 * x[3])
        # Along the view: d(along)/d(centre) = normal / (normal·view), and −1/cos for the radius.
        normal = (view * along[:, None] - x[:3]) / x[3]
        cos = root / x[3]
        J = np.column_stack([-normal / cos[:, None], -1.0 / cos]) / sigma[:, None]
        e = (depth - along) / sigma
        normal_matrix = J.T @ J
        try:
            step = np.linalg.solve(normal_matrix, J.T @ e)
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(step).all() or np.abs(step).max() > 10.0 * x[3]:
            return None
        x += step
        if x[3] <= 0.0:
            return None
        if np.abs(step).max() < 1e-9:
            break
    else:
        return None
    along, _ = _intersection(view, x)
    e = (depth - along) / sigma
    # Covariance scaled by the residuals' variance over n − 4 degrees of freedom: sigma may be wrong by a factor.
    return x, np.asarray(float(e @ e) / (len(e) - 4) * np.linalg.inv(normal_matrix), np.float64)
