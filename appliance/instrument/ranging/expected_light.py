"""Owns the light of the live views: white, but dark where the laser dots can fall, so that they are seen at any
exposure.

Bright light can saturate a surface, and on what is saturated no dot is brighter. The projector needs no calibration for
this: where a beam passes before it follows from the drawing, with room for how beams and projector may lean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.beams import Pointers, RigFrame
from appliance.instrument.ranging.dots import dot_depths_mm
from appliance.measure import BRIGHT_CODE, DARK_CODE, STANDARD, HousedCamera, StereoRig, WorkingVolume

LEAN_SIGMAS = 3.0
AROUND_MM = 5.0
"""Around a dot's middle: what it is compared with."""
SHADE_DEPTHS, SHADE_STEP_PX, SHADE_RIM_PX = 9, 2, 1
"""Depths, and pixels of the reduced picture, at which the shade is looked up; and how far it is kept from its border,
for a projector that leans."""
SHADE_BEYOND_MM = 60.0
"""Length by which these depths go on beyond both ends of the standard housing's volume: what is too near is lit, too.
"""
LEAST_SHADE_PX = 100
"""A shade of fewer pixels of the reduced picture tells nothing."""


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


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLight:
    """Light of the live views as the projector, as drawn, throws it: codes (h, w) uint8, its frame the rig's."""

    projector: HousedCamera
    codes: NDArray[np.uint8]
    volume: WorkingVolume = STANDARD

    def shade(self, rig: StereoRig, water_index: float, width_px: int) -> NDArray[np.bool_] | None:
        """Return the pixels (h, ``width_px``) of the left camera's reduced picture that this light reaches at no
        distance of the volume and somewhat beyond; ``None``: too few.

        Whatever is bright there is the water's, or another lamp's.
        """
        camera, frame = rig.left, RigFrame.of(rig)
        height_px, scale = max(1, round(width_px * camera.height_px / camera.width_px)), camera.width_px / width_px
        u, v = (np.arange(0, size, SHADE_STEP_PX) for size in (width_px, height_px))
        places = np.asarray((np.stack(np.meshgrid(u, v), axis=-1) + 0.5) * scale - 0.5, np.float64)
        origins, along = camera.rays(places, water_index)
        start, towards = frame.from_left(origins), frame.turn_from_left(along)
        dark = np.ones(places.shape[:2], np.bool_)
        beyond_mm = self.volume.scaled(SHADE_BEYOND_MM)
        for z_mm in np.linspace(self.volume.nearest_mm - beyond_mm, self.volume.farthest_mm + beyond_mm, SHADE_DEPTHS):
            points = start + towards * ((z_mm - start[..., 2]) / towards[..., 2])[..., None]
            dark &= self._dark_at(self.projector.project(points, water_index))
        whole = cv2.resize(dark.astype(np.uint8), (width_px, height_px), interpolation=cv2.INTER_NEAREST)
        inner = cv2.erode(whole, np.ones((2 * SHADE_RIM_PX + 1, 2 * SHADE_RIM_PX + 1), np.uint8)).astype(np.bool_)
        return inner if np.count_nonzero(inner) >= LEAST_SHADE_PX else None

    def _dark_at(self, uv_px: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell of each place (..., 2) of the projector's picture whether it is there and dark."""
        height_px, width_px = self.codes.shape
        known = np.isfinite(uv_px).all(axis=-1)
        column, row = (np.rint(np.where(known, uv_px[..., axis], -1.0)).astype(np.int64) for axis in (0, 1))
        inside = (column >= 0) & (row >= 0) & (column < width_px) & (row < height_px)
        codes = self.codes[np.clip(row, 0, height_px - 1), np.clip(column, 0, width_px - 1)]
        return np.asarray(inside & (codes == DARK_CODE))
