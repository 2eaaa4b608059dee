"""A rigid transform, the result of registration: the pose of one scan in the frame of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.base import one_line
from appliance.measure.light.rotation import rotation_matrix, rotation_vector
from appliance.measure.overlap.patches import Array


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A rigid transform: x' = rotation x + translation_mm."""

    rotation: Array
    """(3, 3)."""
    translation_mm: Array
    """(3,)."""

    __repr__ = one_line

    def of(self, points_mm: Array) -> Array:
        """Return the transformed points (…, 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def then(self, later: Rigid) -> Rigid:
        """Return the transform that applies this one and then ``later``."""
        return Rigid(later.rotation @ self.rotation, later.rotation @ self.translation_mm + later.translation_mm)

    @property
    def inverse(self) -> Rigid:
        """The inverse transform."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation_mm)

    @classmethod
    def along_screw(cls, rotation_rad: Array, shift_mm: Array, middle_mm: Array) -> Rigid:
        """Return the motion along one screw: ``rotation_rad`` (3,) and ``shift_mm`` (3,) of ``middle_mm`` (3,).

        Rotation and translation are simultaneous and uniform.
        """
        angle = float(np.linalg.norm(rotation_rad))
        # The left Jacobian of SO(3): the part of the shift across the axis is bent to an arc, that along it is not.
        first, second = (
            (0.5, 1.0 / 6.0) if angle < 1e-6 else ((1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3)
        )
        displacement = (
            shift_mm
            + first * np.cross(rotation_rad, shift_mm)
            + second * np.cross(rotation_rad, np.cross(rotation_rad, shift_mm))
        )
        rotation = rotation_matrix(rotation_rad)
        return cls(rotation, middle_mm + displacement - rotation @ middle_mm)

    def screw(self, middle_mm: Array) -> tuple[Array, Array]:
        """Return the rotation vector (3,) and the displacement (3,) mm of ``middle_mm`` of this motion's screw.

        It is the inverse of ``along_screw`` up to half a turn.
        """
        rotation_rad, displacement = rotation_vector(self.rotation), self.of(middle_mm) - middle_mm
        angle = float(np.linalg.norm(rotation_rad))
        second = 1.0 / 12.0 if angle < 1e-3 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
        return rotation_rad, displacement - 0.5 * np.cross(rotation_rad, displacement) + second * np.cross(
            rotation_rad, np.cross(rotation_rad, displacement)
        )
