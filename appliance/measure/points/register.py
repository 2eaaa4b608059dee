"""Registration of two clouds of the same surface: the rigid motion between two exposures.

It is a robust point-to-plane ICP on the lattice of the left pixels, from rest. Motions that do not change the surface
(a plane that slides in itself) remain zero, which does no harm.

Each point p of the second cloud has a distance d along the normal n of the surface below it. A small translation x and
rotation ω about the cloud's middle change it by n·x + ((p − middle) × n)·ω: iterated weighted least squares on d.
Rotations are in mm at the cloud's mean distance from its middle, so that all six parameters have one unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.points.surface import Below, Surface, below, pixels_of, thinned
from appliance.measure.points.table import Cloud

Array = NDArray[np.float64]
SAMPLES = 10_000
"""Number of points of the second cloud that are used."""
LEAST_SHARED = 400
"""Least number of samples that must lie on the first surface."""
ROUNDS = 14
REACH_MM = 6.0
"""Largest distance from the surface of points used in the first round, mm; halved with each, down to that of noise."""
MANY_SIGMA = 4.0
SETTLED = 0.1
"""Largest displacement by the last step of an ICP that has converged, over the standard deviation of a distance."""
WEAKEST = 1e-4
"""Least eigenvalue of a motion that is estimated, over the largest: a plane that slides in itself has a smaller one."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A rigid motion that maps points p of the second cloud into the first cloud's frame.

    ``rotation`` @ p + ``translation_mm`` is the mapped point.
    """

    rotation: Array
    """(3, 3)."""
    translation_mm: Array
    """(3,)."""
    moved_mm: float
    """Median displacement of the second cloud's points."""
    moved_px: float
    """The same, in pixels of the left image."""
    turned_deg: float
    residual: float
    """Robust rms distance of the two surfaces over its standard deviation: 1 for the same rigid object."""
    residual_mm: float
    shared: float
    """Share 0..1 of the second cloud's samples with a surface below that lie on it within the noise."""

    def apply(self, points_mm: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return points (n, 3) float32 of the second cloud in the first one's frame."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm, np.float32)


def register_exposures(surface: Surface, second: Cloud) -> Registration | None:
    """Return the motion of ``second`` onto ``surface``; ``None``: too little overlap, or no convergence."""
    chosen = thinned(len(second.pixel), SAMPLES)
    if len(chosen) < LEAST_SHARED:
        return None
    points, errors = second.points_mm[chosen].astype(np.float64), second.sigma_mm[chosen].astype(np.float64)
    middle = points.mean(axis=0)
    lever_mm = math.sqrt(float(np.mean(np.sum((points - middle) ** 2, axis=1)))) + 1e-9
    rotation, translation = np.eye(3), np.zeros(3)
    reach_mm, last_mm = REACH_MM, math.inf
    # Iteratively reweighted least squares: distances are linear in the step only near the surface.
    for _ in range(ROUNDS):
        moved = points @ rotation.T + translation
        surface_below = below(surface, moved)
        near = _near(surface_below, reach_mm)
        if len(near) < LEAST_SHARED:
            return None
        apart_mm, sigma_mm = surface_below.apart_mm[near], np.hypot(surface_below.sigma_mm[near], errors[near])
        # Tukey's biweight on the distances over their noise, or over their scatter if that is larger.
        z = apart_mm / sigma_mm
        spread = max(1.0, MAD_TO_SIGMA * float(np.median(np.abs(z))))
        weight = np.clip(1.0 - (z / (MANY_SIGMA * spread)) ** 2, 0.0, None) ** 2 / sigma_mm**2
        # Rows (n, (p − middle) × n) of the linear equations, in mm.
        normal = surface_below.normal[near]
        jacobian = np.concatenate([normal, np.cross((moved[near] - middle) / lever_mm, normal)], 1)
        weighted = (jacobian * weight[:, None]).T
        step = _solve(weighted @ jacobian, -weighted @ apart_mm)
        # The step rotates about the middle, after the transform so far.
        step_rotation = rotation_matrix(step[3:] / lever_mm)
        rotation, translation = step_rotation @ rotation, step_rotation @ (translation - middle) + middle + step[:3]
        last_mm = float(np.sqrt(np.mean((jacobian @ step) ** 2)))
        # Points farther away than the scatter belong to another surface.
        reach_mm = max(0.5 * reach_mm, 5.0 * spread * float(np.median(sigma_mm)))
        reach_mm = min(reach_mm, REACH_MM)
    moved = points @ rotation.T + translation
    surface_below = below(surface, moved)
    near = _near(surface_below, reach_mm)
    sigma_mm = np.hypot(surface_below.sigma_mm[near], errors[near])
    if len(near) < LEAST_SHARED or last_mm > SETTLED * float(np.median(sigma_mm)):
        return None
    # Residual and displacement are of the final motion, with all points that it brings near.
    way_px = pixels_of(surface, moved) - pixels_of(surface, points)
    return Registration(
        rotation=rotation,
        translation_mm=translation,
        moved_mm=float(np.median(np.linalg.norm(moved - points, axis=1))),
        moved_px=float(np.median(np.linalg.norm(way_px, axis=1))),
        turned_deg=math.degrees(math.acos(float(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0)))),
        residual=MAD_TO_SIGMA * float(np.median(np.abs(surface_below.apart_mm[near] / sigma_mm))),
        residual_mm=MAD_TO_SIGMA * float(np.median(np.abs(surface_below.apart_mm[near]))),
        shared=float(len(near) / surface_below.exists.sum()),
    )


def _near(surface_below: Below, reach_mm: float) -> NDArray[np.intp]:
    """Return the indices of the points with the surface below, closer than ``reach_mm``."""
    indices = np.flatnonzero(surface_below.exists)
    return indices[np.abs(surface_below.apart_mm[indices]) < reach_mm]


def _solve(normal: Array, right: Array) -> Array:
    """Solve the normal equations by least squares, without the motions that do not change the surface."""
    values, vectors = np.linalg.eigh(normal)
    # Eigenvectors of small eigenvalues are motions that change no distance.
    determined = values > WEAKEST * values[-1]
    return np.asarray(vectors[:, determined] @ ((vectors[:, determined].T @ right) / values[determined]), np.float64)
