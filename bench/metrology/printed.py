"""The ray model exactly as printed in 2015, with its misprints, to show their effect.

Bräuer-Burchardt et al. 2015, Eqs. 1–4. Eq. 1 has arctan where Snell's law has arcsin, and r/c where the glass term
needs c'/r; its d is the distance to the outer face. ``HousedCamera`` with a perpendicular port is the intended model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.paper import STEPS_MM, search_distances
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import HousedCamera

Array = NDArray[np.float64]

NEWTON_STEPS = 20
SMALL = 1e-6
REACH_MM, STEP_MM = 15.0, 3.0
"""Range and step of the distances of a wider search: distances far from the true ones compensate the misprints in part.
"""


def calibrate_as_printed(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Search for the distances with which the printed equations fit best. Raises RecordingError without a bar or a plane."""
    rig = replace(start.rig, left=_printed(start.rig.left), right=_printed(start.rig.right))
    steps_mm = (STEP_MM, *STEPS_MM)
    return search_distances(recordings, replace(start, rig=rig), reach_mm=REACH_MM, steps_mm=steps_mm).calibration


def _printed(camera: HousedCamera) -> PrintedCamera:
    return PrintedCamera(
        camera.width_px, camera.height_px, camera.lens, camera.port, camera.rotation, camera.translation_mm
    )


@dataclass(frozen=True, slots=True)
class PrintedCamera(HousedCamera):
    """Camera with the rays of the printed equations; no file can store it, and the port's normal serves as axis."""

    def rays(self, uv_px: Array, water_index: float) -> tuple[Array, Array]:
        """Return the water rays of pixels (..., 2) as ``HousedCamera.rays`` does."""
        xy = self.lens.to_normalised(uv_px)
        slope, shift = self._printed(np.linalg.norm(xy, axis=-1), water_index)
        origin = np.concatenate([np.zeros_like(xy), -shift[..., None]], -1)
        direction = np.concatenate([xy * slope[..., None], np.ones_like(xy[..., :1])], -1)
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        R = np.asarray(self.rotation)
        return origin @ R.T + np.asarray(self.translation_mm), direction @ R.T

    def ideal_pixels(self, local_mm: Array, water_index: float) -> Array:
        """Return the pixels (..., 2) of points (..., 3) as ``HousedCamera.ideal_pixels`` does, by Newton's method on the distance
        from the axis."""
        z, h = local_mm[..., 2], np.linalg.norm(local_mm[..., :2], axis=-1)

        def miss(r: Array) -> Array:
            slope, shift = self._printed(r, water_index)
            return np.asarray((z + shift) * slope * r - h)

        # Where a ray of small angle would be without a window: refraction spreads the air side by the index.
        r = water_index * h / z
        for _ in range(NEWTON_STEPS):
            now = miss(r)
            # The derivative by a difference: this model is only ever compared with, so that its speed does not count.
            r = r - now * SMALL / (miss(r + SMALL) - now)
        with np.errstate(invalid="ignore", divide="ignore"):
            outward = np.where(h[..., None] > 0.0, local_mm[..., :2] / h[..., None], 0.0)
        return self.lens.to_pixels(np.where(z[..., None] > 0.0, r[..., None] * outward, np.nan))

    def _printed(self, r: Array, water_index: float) -> tuple[Array, Array]:
        """Return 1/c' and l for distances r from the axis, in units of c, or their limits where r is 0."""
        # Both quotients have a limit on the axis, where the formula itself is 0/0.
        r = np.maximum(r, SMALL)
        sine = np.sin(np.arctan(r))
        outer_mm = self.port.distance_mm + self.port.thickness_mm
        glass = np.tan(np.arcsin(sine / self.port.glass_index))
        shift = (
            outer_mm * r / np.tan(np.arctan(sine / water_index)) - outer_mm - self.port.thickness_mm * r * (r - glass)
        )
        return np.tan(np.arcsin(sine / water_index)) / r, shift
