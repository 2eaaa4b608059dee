"""Owns a rigid motion, which is what registration looks for: where one scan lies in the frame of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.base import one_line
from appliance.measure.light.rotation import rotation_matrix, rotation_vector
from appliance.measure.overlap.patches import Array


@dataclass(frozen=True, slots=True, eq=False)
class Rigid:
    """A rigid motion: x' = rotation x + translation_mm."""

    rotation: Array
    """(3, 3)."""
    translation_mm: Array
    """(3,)."""

    __repr__ = one_line

    def of(self, points_mm: Array) -> Array:
        """Return the moved points (…, 3)."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def then(self, later: Rigid) -> Rigid:
        """Return the motion that does this one and then ``later``."""
        return Rigid(later.rotation @ self.rotation, later.rotation @ self.translation_mm + later.translation_mm)

    @property
    def inverse(self) -> Rigid:
        """The motion that undoes it."""
        return Rigid(self.rotation.T, -self.rotation.T @ self.translation_mm)

    @classmethod
    def along_screw(cls, turn: Array, shift_mm: Array, middle_mm: Array) -> Rigid:
        """Return the motion along one screw: ``turn`` (3,) rad and ``shift_mm`` (3,) of ``middle_mm`` (3,), both at
        once and evenly."""
        angle = float(np.linalg.norm(turn))
        # The left Jacobian of SO(3): what goes across the axis goes round, what goes along it goes on.
        first, second = (
            (0.5, 1.0 / 6.0) if angle < 1e-6 else ((1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3)
        )
        gone = shift_mm + first * np.cross(turn, shift_mm) + second * np.cross(turn, np.cross(turn, shift_mm))
        rotation = rotation_matrix(turn)
        return cls(rotation, middle_mm + gone - rotation @ middle_mm)

    def screw(self, middle_mm: Array) -> tuple[Array, Array]:
        """Return the turn (3,) rad and the shift (3,) mm of ``middle_mm`` whose one screw is this motion: undoes
        ``along_screw`` up to half a turn."""
        turn, gone = rotation_vector(self.rotation), self.of(middle_mm) - middle_mm
        angle = float(np.linalg.norm(turn))
        second = 1.0 / 12.0 if angle < 1e-3 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
        return turn, gone - 0.5 * np.cross(turn, gone) + second * np.cross(turn, np.cross(turn, gone))
