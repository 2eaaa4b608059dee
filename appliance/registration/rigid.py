"""Owns a rigid motion, which is what registration looks for: where one scan lies in the frame of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.one_line import one_line
from appliance.registration.patches import Array


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
