"""Owns the instrument's own frame as a calibration states it: where its axis is, on which distances are told."""

from __future__ import annotations

from dataclasses import dataclass

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
