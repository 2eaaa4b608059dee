"""Owns the images of a scan, as every judge and the motion compensation are given them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.noise import StereoNoise
from appliance.measure.light.sequence import PatternSequence


@dataclass(frozen=True, slots=True)
class ScanImages:
    """The whole sequence of both cameras after its last frame. Mappings are keyed ``left`` and ``right``."""

    sequence: PatternSequence
    frames: Mapping[str, NDArray[np.uint8]]
    """Each camera's images (n, h, w) uint8 in the order of the sequence. They are shared, and not to be written to."""
    decoded: Mapping[str, CameraDecoder]
    """Coordinates, modulation and masks. They mean nothing where a frame shows another pattern than it should."""
    settings: AcquisitionSettings = AcquisitionSettings()  # noqa: RUF009
    """Settings with which the sequence was taken."""

    @property
    def noise(self) -> StereoNoise:
        """The temporal noise of both cameras as they were set."""
        return self.settings.noise

    @property
    def frame_s(self) -> float:
        """The time from one frame to the next, in seconds."""
        return self.settings.frame_s

    @property
    def exposure_s(self) -> float:
        """Exposure time of each frame in seconds."""
        return 1e-6 * self.settings.exposure.time_us
