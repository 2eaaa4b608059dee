"""Owns motion blur: at how many instants an exposure is looked at, so that their mean is what a moving picture leaves."""

from __future__ import annotations

import math

import numpy as np

from hw_sim.geometry import Pose
from hw_sim.objects.shapes import RADIUS

SMEAR_PX = 1.0
"""Motion of the picture between two instants, at most (as long as MOST_INSTANTS suffice)."""
MOST_INSTANTS = 4


def instants(begin: Pose, end: Pose, pixel_mm: float) -> int:
    """Of an exposure that begins and ends with the object at these poses: 1..MOST_INSTANTS.

    Measured where the object is widest, across the line of sight: along it the picture hardly moves. ``pixel_mm`` is the
    size of a camera pixel on the object.
    """
    reach_mm = 0.7 * float(RADIUS[begin.kind])
    places = reach_mm * np.array([[0.0, 0.0, 0.0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    moved_mm = np.linalg.norm((places @ begin.R.T + begin.t - places @ end.R.T - end.t)[:, :2], axis=1).max()
    return min(MOST_INSTANTS, max(1, math.ceil(float(moved_mm) / pixel_mm / SMEAR_PX)))
