"""Owns the first guess of an artefact: points of two rays each, and the plane or sphere that fits them best."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure import StereoRig

Array = NDArray[np.float64]

SPHERE_STEPS = 20


def triangulate(rig: StereoRig, left_px: Array, right_px: Array, water_index: float) -> Array:
    """Return points (n, 3), left camera frame, mm: the middles of the shortest lines between the rays of each pair."""
    return nearest_points(*rig.left.rays(left_px, water_index), *rig.right.rays(right_px, water_index))


def nearest_points(p: Array, a: Array, q: Array, b: Array) -> Array:
    """Return the middles (n, 3) of the shortest lines between rays p + s·a and q + t·b, unit directions."""
    # Minimise |p + s a − q − t b|²: two linear equations in s and t with determinant 1 − (a·b)².
    w = p - q
    cosine = np.sum(a * b, -1)
    da, db = np.sum(a * w, -1), np.sum(b * w, -1)
    det = 1.0 - cosine**2
    s = (cosine * db - da) / det
    t = (db - cosine * da) / det
    return np.asarray(0.5 * (p + s[:, None] * a + q + t[:, None] * b))


def fit_plane(points_mm: Array) -> tuple[Array, float]:
    """Return the unit normal n towards +z and offset e of the plane n·X = e nearest to points (n, 3)."""
    middle = points_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(points_mm - middle, full_matrices=False)
    normal = axes[2] if axes[2][2] > 0.0 else -axes[2]
    return normal, float(normal @ middle)


def fit_sphere(points_mm: Array, radius_mm: float | None = None) -> tuple[Array, float]:
    """Return the centre and radius of the sphere nearest to points (n, 3) by orthogonal distance; the radius fixed if
    given."""
    middle = points_mm.mean(axis=0)
    local = points_mm - middle
    # Algebraic start: |X|² = 2 c·X + (r² − |c|²) is linear in c and r² − |c|². It is biased on a part of a sphere,
    # hence the orthogonal iteration below.
    design = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, *_ = np.linalg.lstsq(design, np.sum(local**2, axis=1), rcond=None)
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 0.0)))
    if radius_mm is not None:
        radius = radius_mm
    for _ in range(SPHERE_STEPS):
        away = local - centre
        distance = np.linalg.norm(away, axis=1)
        jacobian = -away / distance[:, None]
        if radius_mm is None:
            jacobian = np.column_stack([jacobian, -np.ones(len(local))])
        step, *_ = np.linalg.lstsq(jacobian, radius - distance, rcond=None)
        centre = centre + step[:3]
        if radius_mm is None:
            radius += float(step[3])
        if float(np.abs(step).max()) < 1e-10:
            break
    return centre + middle, radius
