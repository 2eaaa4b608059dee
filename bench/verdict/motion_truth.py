"""True noise that a motion adds to the points.

Every point's distance to the true surface is measured, at rest and moving, without camera noise, after a rigid
displacement of the entire cloud, which does not harm it. The added noise is the excess of the mean square over that of
the scan at rest (errors by light and albedo are in both). The noise is the error that camera noise then adds to the
same points. 0.3 % of the points are left out, as usual.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from appliance.measure.points.pipeline import Cloud
from hw_sim.rendering.render import Renderer, Surface
from tests.support.truth import left_to_rig

FALSE_MM = 1.0
"""Error of a false correspondence."""
KEPT = 0.997
_FIT_POINTS, _TURN, _ROBUST_MM = 3000, 1e-2, 0.1

Array = NDArray[np.float64]


def displacement(surface: Surface, points_mm: Array) -> tuple[Array, Array]:
    """Fit centre (3,) and small rigid displacement (6,) of points (n, 3) to the surface, by robust least squares."""
    near = np.flatnonzero(np.abs(surface.distance_mm(points_mm)) < FALSE_MM)
    points = points_mm[near[:: max(1, len(near) // _FIT_POINTS)]]
    middle = points.mean(0) if len(points) else np.zeros(3)

    def rest(x: Array) -> Array:
        return surface.distance_mm(displaced(points, middle, x))

    def cost(r: Array) -> float:
        return float(np.sum(np.log1p((r / _ROBUST_MM) ** 2)))

    x, damping = np.zeros(6), 1e-3
    if len(points) < 50:
        return middle, x
    r = rest(x)
    for _ in range(6):
        slopes = np.stack([(rest(x + step) - r) / 1e-3 for step in 1e-3 * np.eye(6)], -1)
        weight = 1.0 / (1.0 + (r / _ROBUST_MM) ** 2)
        normal = slopes.T @ (weight[:, None] * slopes) + 0.1 * damping * len(points) * np.eye(6)
        candidate = x - np.linalg.solve(normal, slopes.T @ (weight * r))
        after = rest(candidate)
        better = cost(after) < cost(r)
        x, r = (candidate, after) if better else (x, r)
        damping *= 0.3 if better else 10.0
    return middle, x


def displaced(points_mm: Array, middle: Array, x: Array) -> Array:
    """Return points (n, 3) after rotation (hundredths of a radian) and translation (mm) by ``x`` (6,)."""
    return np.asarray(points_mm + np.cross(_TURN * x[:3], points_mm - middle) + x[3:])


def errors_mm(
    renderer: Renderer, cloud: Cloud, time_s: float, fit: tuple[Array, Array] | None = None
) -> tuple[Array, tuple[Array, Array]]:
    """Return distances (n,) of a cloud to the surface at ``time_s`` after a displacement, and that displacement."""
    points = left_to_rig(renderer.truth, cloud.points_mm)
    surface = renderer.surface(time_s)
    fit = fit or displacement(surface, points)
    return surface.distance_mm(displaced(points, *fit)), fit


def rms_mm(values: Array) -> float:
    """Return the RMS without false values and without the largest 0.3 %."""
    squared = np.sort(values[np.abs(values) < FALSE_MM] ** 2)
    trimmed = squared[: int(KEPT * squared.size)]
    return math.sqrt(float(np.mean(trimmed))) if trimmed.size else math.nan


def noise_mm(clean: Cloud, clean_errors: Array, noisy: Cloud, noisy_errors: Array) -> float:
    """Return the RMS error of points by noise, across the surface."""
    _, clean_rows, noisy_rows = np.intersect1d(clean.pixel, noisy.pixel, return_indices=True)
    return rms_mm(noisy_errors[noisy_rows] - clean_errors[clean_rows])
