"""Owns the second camera's testimony on a dot that only one camera sees: that it sees nothing like it anywhere on that ray.

What is bright and no dot is seen by both cameras: a lit corner, a print, a speck in the water near the cameras. Then the
other one has it somewhere on the image of the first one's ray. Where that image is not in its picture it cannot tell.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.dots import COARSE_PX, EDGE_PX, contrast_of, dot_range_mm
from appliance.instrument.ranging.rig_frame import RigFrame
from appliance.measure import StereoRig

Array = NDArray[np.float64]

_BEGIN_MM = 150.0
"""Depth, of the standard housing, in the rig frame from which the ray is searched; what is nearer is out of focus and before one camera alone."""
_NEAR_MM, _FAR_MM = 330.0, 620.0
"""Depths, of the standard housing, between which the other camera must see the ray; nearer and farther, as far as its picture goes."""
_STEP_MM = 4.0
HALF_PX = 3
"""Half width of the band that is looked at along the ray's image, coarse px: a calibration's error, and the size of what is looked for."""
LIKE = 0.25
"""Share of the contrast from which a spot is like the dot."""


class OtherCamera:
    """Asks one camera of a rig about what the other one sees."""

    def __init__(self, rig: StereoRig, frame: RigFrame, water_index: float) -> None:
        self._cameras, self._frame, self._index = (rig.left, rig.right), frame, water_index
        volume = rig.volume
        farthest_mm = dot_range_mm(volume)[1]
        self._depths_mm = np.arange(volume.scaled(_BEGIN_MM), farthest_mm, volume.scaled(_STEP_MM))
        self._in_volume = (self._depths_mm >= volume.scaled(_NEAR_MM)) & (self._depths_mm <= volume.scaled(_FAR_MM))

    def sees_nothing_like(
        self, side: int, start_mm: Array, ahead: Array, images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
        contrast_dn: float,
    ) -> bool:  # fmt: skip
        """Tell whether the camera that is not ``side`` (0 left, 1 right) looks all along the ray from ``start_mm`` in
        the direction ``ahead`` (3,), rig frame, as far as the volume goes, and sees nothing of ``LIKE`` times the
        contrast."""
        camera, image = self._cameras[1 - side], images[1 - side]
        z_mm = self._depths_mm
        way = start_mm + ((z_mm - start_mm[2]) / ahead[2])[:, None] * ahead
        step = max(1, camera.width_px // COARSE_PX)
        seen = (camera.project(self._frame.to_left(way), self._index) + 0.5) / step - 0.5
        h, w = camera.height_px // step, camera.width_px // step
        inside = np.asarray(np.isfinite(seen).all(axis=1))
        inside &= ((seen >= EDGE_PX) & (seen <= (w - 1 - EDGE_PX, h - 1 - EDGE_PX))).all(axis=1)
        if not inside[self._in_volume].all():
            return False
        seen = seen[inside]
        x0, y0 = (int(v) for v in np.floor(seen.min(axis=0)) - EDGE_PX)
        x1, y1 = (int(v) for v in np.ceil(seen.max(axis=0)) + EDGE_PX + 1)
        part = image[y0 * step : y1 * step, x0 * step : x1 * step]
        coarse = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA) if step > 1 else part
        along = np.zeros(coarse.shape, np.uint8)
        line = np.rint(seen - (x0, y0)).astype(np.int32)
        cv2.polylines(along, [line], False, (1,), 2 * HALF_PX + 1)
        return not bool((contrast_of(coarse)[along > 0] > LIKE * contrast_dn).any())
