"""Owns the light of the live views: white, but dark where the laser dots can fall, so that they are seen at any exposure.

Bright light can saturate a surface, and on what is saturated no dot is brighter. The projector needs no calibration for
this: where a beam passes before it follows from the drawing, with room for how beams and projector may lean.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.optics.model import HousedCamera
from appliance.optics.volume import STANDARD, WorkingVolume
from appliance.patterns.sequence import BRIGHT_CODE, DARK_CODE
from appliance.ranging.beams import Pointers
from appliance.ranging.dots import dot_depths_mm

LEAN_SIGMAS = 3.0
AROUND_MM = 5.0
"""Around a dot's middle: what it is compared with."""


def live_light(
    projector: HousedCamera, pointers: Pointers | None, water_index: float, volume: WorkingVolume = STANDARD
) -> NDArray[np.uint8]:
    """Return the codes (h, w) uint8 of the live views' light. ``projector`` as drawn, its frame the rig's."""
    picture = np.full((projector.height_px, projector.width_px), BRIGHT_CODE, np.uint8)
    if pointers is None:
        return picture
    z = dot_depths_mm(volume)
    for beam in pointers.beams():
        at = projector.project(beam.at(z), water_index)
        aside = projector.project(beam.at(z) + np.array([1.0, 0.0, 0.0]), water_index)
        free_mm = AROUND_MM + LEAN_SIGMAS * math.radians(pointers.tolerance_deg) * (z - beam.z0_mm)
        radius_px = free_mm * np.linalg.norm(aside - at, axis=1)
        for (u, v), radius in zip(at, radius_px, strict=True):
            cv2.circle(picture, (round(float(u)), round(float(v))), math.ceil(float(radius)), DARK_CODE, -1)
    return picture
