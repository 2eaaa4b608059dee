"""Owns the true surface as a tape measure: how far a point is from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw_sim.geometry import Pose
from hw_sim.objects.shapes import distances


class Surface:
    """The true surface at a moment."""

    def __init__(self, pose: Pose) -> None:
        self._pose = pose

    def distance_mm(self, points_rig_mm: ArrayLike) -> NDArray[np.float64]:
        """Signed distances (n,) float64 of points (n, 3) in the rig frame, outside positive; exact near the surface."""
        points = np.reshape(np.asarray(points_rig_mm, np.float64), (-1, 3))
        out = np.empty(len(points))
        pose = self._pose
        distances(pose.kind, pose.sizes, np.ascontiguousarray((points - pose.t) @ pose.R), out)
        return out
