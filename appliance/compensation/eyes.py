"""Owns how a picture moves when its points move: per point and eye, the pixel, its derivative and its perspective.

u(X + d) = u(X) + J d / (1 + e·d): exact for a pinhole, and for an eye behind a port within some hundredths of a pixel over
the 20 mm that a scan can move.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appliance.optics.model import HousedCamera

Array = NDArray[np.float64]

_STEP_MM = 0.5


class Seen(NamedTuple):
    """n points as one eye sees them."""

    px: Array
    """(n, 2); NaN for points it cannot see."""
    jacobian: Array
    """(n, 2, 3) px/mm."""
    nearing: Array
    """(n, 3) 1/mm: e, the eye's axis divided by the point's distance along it."""


def bare(eye: HousedCamera) -> HousedCamera:
    """Without what shifts its pixels smoothly beyond every formula: that moves a way or a derivative by a thousandth, and
    costs more than all the rest."""
    return replace(eye, correction=None, ray_shift=None)


def see(eye: HousedCamera, water_index: float, points_mm: Array) -> Seen:
    """Points (n, 3) in the left camera frame."""
    steps = np.concatenate([_STEP_MM * np.eye(3), -_STEP_MM * np.eye(3)])
    px = bare(eye).project(points_mm[None] + steps[:, None], water_index)
    jacobian = np.moveaxis(px[:3] - px[3:], 0, -1) / (2.0 * _STEP_MM)
    axis = np.asarray(eye.rotation)[:, 2]
    distance_mm = (points_mm - np.asarray(eye.translation_mm)) @ axis
    return Seen(eye.project(points_mm, water_index), np.ascontiguousarray(jacobian), axis / distance_mm[:, None])
