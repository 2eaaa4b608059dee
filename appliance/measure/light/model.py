"""The camera model: a lens behind its port at its pose in the rig, and the stereo rig of two of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.correction import SUBSTITUTIONS, TOLERANCE_PX, ImageCorrection
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port, air_directions, water_rays
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.volume import STANDARD, WorkingVolume

Array = NDArray[np.float64]
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

IDENTITY: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class HousedCamera:
    """A camera in its housing. ``rotation`` and ``translation_mm`` map its frame into the left camera frame."""

    width_px: int
    height_px: int
    lens: Lens
    port: Port
    rotation: Matrix3 = IDENTITY
    translation_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    correction: ImageCorrection | None = None
    """Image correction for lens and port beyond their models; ``None``: not calibrated."""
    ray_shift: RayShift | None = None
    """Displacement of each ray, for the part that depends on depth; ``None``: not calibrated."""
    lens_in_water: bool = False
    """True if the lens was calibrated in water, as a pinhole: rays are straight from the projection centre, the port is
    ignored, and in other water the calibration is wrong."""

    def at_origin(self) -> HousedCamera:
        """Return the camera in its own frame."""
        return replace(self, rotation=IDENTITY, translation_mm=(0.0, 0.0, 0.0))

    def rays(self, uv_px: Array, water_index: float) -> tuple[Array, Array]:
        """Return the water rays of pixels (..., 2): origins on the outer glass face, mm, and unit directions.

        Both are in the left camera frame.
        """
        ideal = uv_px if self.correction is None else self.correction.to_ideal(uv_px)
        direction = self.lens.to_directions(ideal)
        if self.lens_in_water:
            origin = np.zeros_like(direction)
        else:
            origin, direction = water_rays(self.port, water_index, direction)
        if self.ray_shift is not None:
            # At the real pixel, not the ideal one, since the shift was fitted over the image.
            origin[..., :2] += self.ray_shift.at_mm(uv_px)
        R = np.asarray(self.rotation)
        return origin @ R.T + np.asarray(self.translation_mm), direction @ R.T

    def project(self, points_mm: Array, water_index: float) -> Array:
        """Return the pixels (..., 2) of water points (..., 3) in the left camera frame.

        They are NaN for points that are not in the water before the camera, and are not limited to the image.
        """
        R = np.asarray(self.rotation)
        local = (np.asarray(points_mm, np.float64) - np.asarray(self.translation_mm)) @ R
        uv = self._seen_at(local, water_index)
        if self.ray_shift is None:
            return uv
        # The shift depends on the pixel, and the pixel on the shift: repeated substitution.
        for _ in range(SUBSTITUTIONS):
            shift = np.zeros_like(local)
            # NaN (a point behind the camera) cannot be an index of the spline's nodes; the result stays NaN.
            shift[..., :2] = self.ray_shift.at_mm(np.nan_to_num(uv))
            before, uv = uv, self._seen_at(local - shift, water_index)
            if not np.any(np.abs(uv - before) > TOLERANCE_PX):
                break
        return uv

    def ideal_pixels(self, local_mm: Array, water_index: float) -> Array:
        """Return the pixels (..., 2) of points (..., 3) in the camera frame, before correction and ray shift."""
        if self.lens_in_water:
            # A point behind the camera would be projected, too, but mirrored.
            direction = np.where(local_mm[..., 2:] > 0.0, local_mm, np.nan)
        else:
            direction = air_directions(self.port, water_index, local_mm)
        with np.errstate(invalid="ignore", divide="ignore"):
            xy = direction[..., :2] / np.where(direction[..., 2:] > 0.0, direction[..., 2:], np.nan)
        return self.lens.to_pixels(xy)

    def _seen_at(self, local_mm: Array, water_index: float) -> Array:
        ideal = self.ideal_pixels(local_mm, water_index)
        return ideal if self.correction is None else self.correction.to_real(ideal)


@dataclass(frozen=True, slots=True)
class StereoRig:
    """Both cameras; the left one's frame is that of all measurements."""

    left: HousedCamera
    right: HousedCamera
    volume: WorkingVolume = STANDARD
    """Working volume, as the rig file states it."""

    def volume_centre_mm(self, water_index: float) -> Array:
        """Return the point (3,), mm, where the two central rays are nearest: the middle of the working volume.

        It is in the left camera frame. Raises ValueError if the rays are parallel.
        """
        centres = []
        for camera in (self.left, self.right):
            uv = np.array([(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0])
            centres.append(camera.rays(uv, water_index))
        (p1, d1), (p2, d2) = centres
        # Shortest connection of p1 + s d1 and p2 + t d2: both partial derivatives of its squared length are zero.
        w = p1 - p2
        b, d, e = float(d1 @ d2), float(d1 @ w), float(d2 @ w)
        det = 1.0 - b * b
        # The squared sine of the angle between the axes: 0.06°.
        if det < 1e-6:
            raise ValueError("the axes of the two cameras are parallel; check the calibration's relative orientation")
        return np.asarray(0.5 * (p1 + (b * e - d) / det * d1 + p2 + (e - b * d) / det * d2))
