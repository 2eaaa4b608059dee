"""Light of the live views: white, but dark where laser dots can be, so that they stay visible.

Bright light can saturate a surface, on which no dot is visible. This needs no calibration: the position of a beam in
front of the projector follows from the design, with a margin for the tilt of beams and projector.
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
"""Radius around a dot's centre that is needed for comparison."""
SHADE_DEPTHS, SHADE_STEP_PX, SHADE_RIM_PX = 9, 2, 1
"""Numbers for the shade: depths; step and border in pixels of the reduced image.

The border allows for a tilted projector.
"""
SHADE_BEYOND_MM = 60.0
"""Length by which the depths exceed both ends of the standard volume: objects that are too near are illuminated, too.
"""
LEAST_SHADE_PX = 100
"""Least number of pixels of the reduced image that make a usable shade."""


def live_light(
    projector: HousedCamera, pointers: Pointers | None, water_index: float, volume: WorkingVolume = STANDARD
) -> NDArray[np.uint8]:
    """Return the codes (h, w) uint8 of the live views' light.

    ``projector``: the nominal one; its frame is the rig frame.
    """
    picture = np.full((projector.height_px, projector.width_px), BRIGHT_CODE, np.uint8)
    if pointers is None:
        return picture
    z = dot_depths_mm(volume)
    for beam in pointers.beams():
        pixels = projector.project(beam.at(z), water_index)
        aside = projector.project(beam.at(z) + np.array([1.0, 0.0, 0.0]), water_index)
        free_mm = AROUND_MM + LEAN_SIGMAS * math.radians(pointers.tolerance_deg) * (z - beam.z0_mm)
        radius_px = free_mm * np.linalg.norm(aside - pixels, axis=1)
        for (u, v), radius in zip(pixels, radius_px, strict=True):
            cv2.circle(picture, (round(float(u)), round(float(v))), math.ceil(float(radius)), DARK_CODE, -1)
    return picture


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLight:
    """Light of the live views by the nominal projector: codes (h, w) uint8; its frame is the rig frame."""

    projector: HousedCamera
    codes: NDArray[np.uint8]
    volume: WorkingVolume = STANDARD

    def shade(self, rig: StereoRig, water_index: float, width_px: int) -> NDArray[np.bool_] | None:
        """Return the pixels of the left camera's reduced image that the live light never reaches.

        (h, ``width_px``) bool, for all distances of the volume and some beyond; ``None``: too few. Brightness there
        comes from the water or another lamp.
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
        full = cv2.resize(dark.astype(np.uint8), (width_px, height_px), interpolation=cv2.INTER_NEAREST)
        inner = cv2.erode(full, np.ones((2 * SHADE_RIM_PX + 1, 2 * SHADE_RIM_PX + 1), np.uint8)).astype(np.bool_)
        return inner if np.count_nonzero(inner) >= LEAST_SHADE_PX else None

    def _dark_at(self, uv_px: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return for each position (..., 2) of the projector's picture whether it is inside and dark."""
        height_px, width_px = self.codes.shape
        is_finite = np.isfinite(uv_px).all(axis=-1)
        column, row = (np.rint(np.where(is_finite, uv_px[..., axis], -1.0)).astype(np.int64) for axis in (0, 1))
        inside = (column >= 0) & (row >= 0) & (column < width_px) & (row < height_px)
        codes = self.codes[np.clip(row, 0, height_px - 1), np.clip(column, 0, width_px - 1)]
        return np.asarray(inside & (codes == DARK_CODE))
