"""Beams of the laser pointers, and the rig frame in which they are given.

    RigFrame       the rig frame that a calibration defines; distances are measured along its axis
    PointerBeam    one pointer's beam: a line, nominal at first, then corrected by its dots
    Pointers       both pointers as designed

The line is x = x0 + sx (z − z0), y = y0 + sy (z − z0) in the rig frame. Its four values have a covariance, at first
that of the design's tolerance; each dot that both cameras see makes it smaller (Kalman's update for a constant).
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
    """The rig frame (``docs/conventions.md``) in the left camera frame: p_left = R p_rig + t."""

    R: Array
    t_mm: Array

    @classmethod
    def of(cls, rig: StereoRig) -> RigFrame:
        """Return the frame with its origin in the middle between both projection centres.

        x points towards the right one, z along the mean of both axes. Raises ValueError where the centres coincide or
        an axis runs along the baseline.
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
"""Standard deviation of where a nominal beam leaves its port: mount, and the calibration's frame against the design."""
DOT_SD_MM = 0.5
"""Standard deviation of a dot against its beam, from speckle and edges of the albedo."""
FLOOR_SD_MM = 0.2
"""Least standard deviation, for errors that all dots share, such as the calibration's."""
STEP_MM = 4.0
"""Least movement of a dot along the beam for another update: dots at rest are not independent."""


@dataclass(frozen=True, slots=True)
class PointerBeam:
    """One pointer's beam in the rig frame."""

    z0_mm: float
    line: tuple[float, float, float, float]
    """x0, y0 in mm, sx, sy."""
    covariance: tuple[tuple[float, ...], ...]
    """Covariance (4, 4) of ``line``."""
    learned: int = 0
    """Number of dots that updated the beam."""
    last_z_mm: float = math.inf
    """Depth of the latest of them."""

    def at(self, z_mm: Array) -> Array:
        """Return points (..., 3) of the beam at depths (...)."""
        x0, y0, sx, sy = self.line
        ahead = np.asarray(z_mm, np.float64) - self.z0_mm
        return np.stack([x0 + sx * ahead, y0 + sy * ahead, ahead + self.z0_mm], axis=-1)

    def sd_mm(self, z_mm: Array) -> Array:
        """Return the standard deviation (...) of the beam across its direction at depths (...).

        The larger one of both directions.
        """
        P = np.asarray(self.covariance)
        ahead = np.asarray(z_mm, np.float64) - self.z0_mm
        # Variance of x0 + sx · (z − z0), with the covariance of both, and the floor of errors that all dots share.
        x = P[0, 0] + 2.0 * ahead * P[0, 2] + ahead**2 * P[2, 2]
        y = P[1, 1] + 2.0 * ahead * P[1, 3] + ahead**2 * P[3, 3]
        return np.asarray(np.sqrt(np.maximum(x, y) + FLOOR_SD_MM**2))

    def updated(self, dot_mm: Array) -> PointerBeam:
        """Return the beam updated by a dot (3,) that both cameras see; unchanged if the dot has not moved."""
        z = float(dot_mm[2])
        if abs(z - self.last_z_mm) < STEP_MM:
            return self
        ahead = z - self.z0_mm
        H = np.array([[1.0, 0.0, ahead, 0.0], [0.0, 1.0, 0.0, ahead]])
        P = np.asarray(self.covariance)
        # Kalman update of a constant line: K = P Hᵀ (H P Hᵀ + R)⁻¹.
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + DOT_SD_MM**2 * np.eye(2))
        line = np.asarray(self.line) + gain @ (dot_mm[:2] - H @ np.asarray(self.line))
        remainder = np.eye(4) - gain @ H
        # Joseph's form stays symmetric and positive despite rounding; P − K H P does not over thousands of dots.
        P = remainder @ P @ remainder.T + DOT_SD_MM**2 * gain @ gain.T
        x0, y0, sx, sy = (float(v) for v in line)
        rows = tuple(tuple(float(v) for v in row) for row in P)
        return replace(self, line=(x0, y0, sx, sy), covariance=rows, learned=self.learned + 1, last_z_mm=z)


@dataclass(frozen=True, slots=True)
class Pointers:
    """Both pointers as designed, in the rig frame: values of the right one, mirrored for the left one."""

    window_mm: tuple[float, float, float]
    aim_mm: tuple[float, float, float]
    tolerance_deg: float

    def beams(self) -> tuple[PointerBeam, PointerBeam]:
        """Return the nominal beams, left and right."""
        (x, y, z), (to_x, to_y, to_z) = self.window_mm, self.aim_mm
        sx, sy = (to_x - x) / (to_z - z), (to_y - y) / (to_z - z)
        tolerance = math.radians(self.tolerance_deg)
        variances = (WINDOW_SD_MM**2, WINDOW_SD_MM**2, tolerance**2, tolerance**2)
        rows = tuple(tuple(v if i == k else 0.0 for k in range(4)) for i, v in enumerate(variances))
        return PointerBeam(z, (-x, y, -sx, sy), rows), PointerBeam(z, (x, y, sx, sy), rows)
