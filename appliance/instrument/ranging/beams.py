"""Owns the beams of the laser pointers, and the rig frame that they are given in.

    RigFrame       the instrument's own frame as a calibration states it; distances are told along its axis
    PointerBeam    one pointer's beam: a line, as drawn at first, then as its dots show it
    Pointers       both pointers as drawn

The line is x = x0 + sx (z − z0), y = y0 + sy (z − z0) in the rig frame. Its four values have a covariance, that of the
drawing's tolerance in the beginning; each dot that both cameras saw makes it smaller (Kalman's update for a constant).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure import StereoRig

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RigFrame:
    """Rotation and origin of the rig frame (``docs/conventions.md``) in the left camera frame: p_left = R p_rig + t."""

    R: Array
    t_mm: Array

    @classmethod
    def of(cls, rig: StereoRig) -> RigFrame:
        """Return the frame with its origin in the middle between both projection centres, x towards the right one, z
        along the mean of both axes.

        Raises ValueError where the centres coincide or an axis runs along the baseline.
        """
        centres = [np.asarray(camera.translation_mm, np.float64) for camera in (rig.left, rig.right)]
        axes = [np.asarray(camera.rotation, np.float64)[:, 2] for camera in (rig.left, rig.right)]
        x, z = centres[1] - centres[0], axes[0] + axes[1]
        y = np.cross(z, x)
        if not np.linalg.norm(y) > 1e-6:
            raise ValueError(
                "the cameras have no baseline across their axes; check the calibration's relative orientation"
            )
        x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
        return cls(np.stack([x, y, np.cross(x, y)], axis=1), 0.5 * (centres[0] + centres[1]))

    def to_left(self, points_mm: Array) -> Array:
        """Return points (..., 3) of the rig frame in the left camera frame."""
        return np.asarray(points_mm @ self.R.T + self.t_mm)

    def from_left(self, points_mm: Array) -> Array:
        """Return points (..., 3) of the left camera frame in the rig frame."""
        return np.asarray((points_mm - self.t_mm) @ self.R)

    def turn_from_left(self, directions: Array) -> Array:
        """Return directions (..., 3) of the left camera frame in the rig frame."""
        return np.asarray(directions @ self.R)


WINDOW_SD_MM = 0.7
"""Standard deviation of the place where a beam as drawn leaves its window: mount, and the frame of a calibration
against the drawing."""
DOT_SD_MM = 0.5
"""Standard deviation of a dot against its beam: on an edge of albedo its bright part is not its middle, and speckle
moves it."""
FLOOR_SD_MM = 0.2
"""However many dots were seen: what all of them share, as a calibration's error."""
STEP_MM = 4.0
"""A dot teaches only when it has moved so far along the beam since the last that did: what holds still is seen once."""


@dataclass(frozen=True, slots=True)
class PointerBeam:
    """One pointer's beam in the rig frame."""

    z0_mm: float
    line: tuple[float, float, float, float]
    """x0, y0 in mm, sx, sy."""
    covariance: tuple[tuple[float, ...], ...]
    """(4, 4) of ``line``."""
    learned: int = 0
    """Dots that taught it."""
    last_z_mm: float = math.inf
    """Depth of the latest of them."""

    def at(self, z_mm: Array) -> Array:
        """Return points (..., 3) of the beam at depths (...)."""
        x0, y0, sx, sy = self.line
        ahead = np.asarray(z_mm, np.float64) - self.z0_mm
        return np.stack([x0 + sx * ahead, y0 + sy * ahead, ahead + self.z0_mm], axis=-1)

    def sd_mm(self, z_mm: Array) -> Array:
        """Return the standard deviation (...) of the beam's place across it at depths (...), the larger of both
        directions."""
        P = np.asarray(self.covariance)
        ahead = np.asarray(z_mm, np.float64) - self.z0_mm
        # Variance of x0 + sx · (z − z0), with the covariance of both; never below what a dot itself leaves.
        x = P[0, 0] + 2.0 * ahead * P[0, 2] + ahead**2 * P[2, 2]
        y = P[1, 1] + 2.0 * ahead * P[1, 3] + ahead**2 * P[3, 3]
        return np.asarray(np.sqrt(np.maximum(x, y) + FLOOR_SD_MM**2))

    def taught(self, dot_mm: Array) -> PointerBeam:
        """Return the beam improved by one more dot (3,) that both cameras saw; itself where that dot says nothing
        new."""
        z = float(dot_mm[2])
        if abs(z - self.last_z_mm) < STEP_MM:
            return self
        ahead = z - self.z0_mm
        H = np.array([[1.0, 0.0, ahead, 0.0], [0.0, 1.0, 0.0, ahead]])
        P = np.asarray(self.covariance)
        # Kalman update of a line that stands still: K = P Hᵀ (H P Hᵀ + R)⁻¹.
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + DOT_SD_MM**2 * np.eye(2))
        line = np.asarray(self.line) + gain @ (dot_mm[:2] - H @ np.asarray(self.line))
        left = np.eye(4) - gain @ H
        # Joseph's form stays symmetric and positive whatever is rounded; P − K H P does not over thousands of dots.
        P = left @ P @ left.T + DOT_SD_MM**2 * gain @ gain.T
        x0, y0, sx, sy = (float(v) for v in line)
        rows = tuple(tuple(float(v) for v in row) for row in P)
        return replace(self, line=(x0, y0, sx, sy), covariance=rows, learned=self.learned + 1, last_z_mm=z)


@dataclass(frozen=True, slots=True)
class Pointers:
    """Both pointers as drawn, in the rig frame: the right one, which the left one mirrors."""

    window_mm: tuple[float, float, float]
    aim_mm: tuple[float, float, float]
    tolerance_deg: float

    def beams(self) -> tuple[PointerBeam, PointerBeam]:
        """Return both beams as drawn, left and right."""
        (x, y, z), (to_x, to_y, to_z) = self.window_mm, self.aim_mm
        sx, sy = (to_x - x) / (to_z - z), (to_y - y) / (to_z - z)
        lean = math.radians(self.tolerance_deg)
        variances = (WINDOW_SD_MM**2, WINDOW_SD_MM**2, lean**2, lean**2)
        rows = tuple(tuple(v if i == k else 0.0 for k in range(4)) for i, v in enumerate(variances))
        return PointerBeam(z, (-x, y, -sx, sy), rows), PointerBeam(z, (x, y, sx, sy), rows)
