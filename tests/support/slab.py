"""Owns a plane-parallel slab found from points seen through it: thickness, distance and tilt, each with its uncertainty.

A window before water and a tank of water in a room are the same thing: one medium between two others. Where that points lie
is known in a frame of their own, whose place before the camera is found along with the slab.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import Matrix3
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port, air_directions
from appliance.measure.light.rotation import matrix3, rotation_matrix

Array = NDArray[np.float64]

LEAST_POINTS = 6
"""Number of points that a pinhole's pose needs, which the search begins with."""
START_SHARE = 0.1
"""Distance and thickness that the search begins with, as shares of the nearest point's depth."""
UNSEEN_PX = 1e4
"""Residual of a point that lies within the slab: no step that puts one there is taken."""


@dataclass(frozen=True, slots=True)
class FoundSlab:
    """A slab before a camera, in the camera's frame; each ``sigma`` is a standard uncertainty (k = 1) by the points' own scatter."""

    port: Port
    tilt_deg: tuple[float, float]
    """Angles of the normal from the camera's axis towards x and towards y."""
    tilt_sigma_deg: tuple[float, float]
    thickness_sigma_mm: float
    distance_sigma_mm: float | None
    """``None`` if the media before and behind it are the same: no ray depends on where it stands then, and ``port`` has it at 0."""
    rotation: Matrix3
    """Rotation from the points' frame into the camera's, before ``translation_mm`` is added."""
    translation_mm: tuple[float, float, float]
    translation_sigma_mm: tuple[float, float, float]
    residual_px: float
    """Root mean square of the distances between points as seen and as predicted."""


def fit_slab(lens: Lens, points_mm: Array, uv_px: Array, index: float, index_behind: float) -> FoundSlab:
    """Find the slab of ``index`` through which ``lens`` sees points (n, 3), in mm in a frame of their own, at pixels (n, 2).

    Behind the slab, where the points are, the index is ``index_behind``; both relate to the medium before the camera. Raises ValueError for
    less than 6 points. What the points leave free has an uncertainty larger than itself.
    """
    if len(points_mm) < LEAST_POINTS:
        raise ValueError(f"a slab from {len(points_mm)} points; give at least {LEAST_POINTS}, not all in one plane")
    points = np.asarray(points_mm, np.float64)
    # A pinhole's pose is wrong by a part of the thickness, and near enough to begin with.
    _, turn, moved = cv2.solvePnP(points, lens.to_normalised(uv_px), np.eye(3), np.zeros(5))
    first, before = np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(moved, np.float64).ravel()
    nearest_mm = float(np.min((points @ first.T + before)[:, 2]))
    start = np.array([0.0, 0.0, 0.0, *before, 0.0, 0.0, START_SHARE * nearest_mm, START_SHARE * nearest_mm])
    # Between equal media a slab shifts each ray aside by its thickness alone.
    free = 9 if index_behind == 1.0 else 10
    start[free:] = 0.0

    def port_of(x: Array) -> Port:
        a, b, c = np.array([x[6], x[7], 1.0]) / np.hypot(1.0, np.hypot(x[6], x[7]))
        return Port((float(a), float(b), float(c)), float(x[9]), float(x[8]), index)

    def miss(values: Array) -> Array:
        x = np.concatenate([values, start[free:]])
        seen = air_directions(port_of(x), index_behind, points @ (rotation_matrix(x[:3]) @ first).T + x[3:6])
        return np.nan_to_num(lens.to_pixels(seen[:, :2] / seen[:, 2:]) - uv_px, nan=UNSEEN_PX).ravel()

    import scipy.optimize  # half a second that a start of the service does not need

    scale = [0.01, 0.01, 0.01, 1.0, 1.0, 1.0, 0.01, 0.01, 1.0, 1.0][:free]
    found = scipy.optimize.least_squares(miss, start[:free], method="lm", x_scale=scale, xtol=1e-12, ftol=1e-12)
    slopes = np.asarray(found.jac, np.float64)
    variance = float(found.fun @ found.fun) / (found.fun.size - free)
    sigma = np.sqrt(variance * np.diag(np.linalg.inv(slopes.T @ slopes)))
    x = np.concatenate([found.x, start[free:]])
    tilt_sigma_deg = np.degrees(sigma[6:8] / (1.0 + x[6:8] ** 2))
    return FoundSlab(
        port_of(x),
        (float(np.degrees(np.arctan(x[6]))), float(np.degrees(np.arctan(x[7])))),
        (float(tilt_sigma_deg[0]), float(tilt_sigma_deg[1])),
        float(sigma[8]),
        float(sigma[9]) if free == 10 else None,
        matrix3(rotation_matrix(x[:3]) @ first),
        (float(x[3]), float(x[4]), float(x[5])),
        (float(sigma[3]), float(sigma[4]), float(sigma[5])),
        float(np.sqrt(2.0 * np.mean(found.fun**2))),
    )
