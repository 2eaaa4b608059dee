"""The settings of a sequence: exposure, frame period, the cameras' noise, and the possible exposures."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure.light.exposure import NOMINAL, Exposure
from appliance.measure.light.noise import TYPICAL_PAIR, StereoNoise


@dataclass(frozen=True, slots=True)
class AcquisitionSettings:
    """Settings with which a sequence is captured."""

    exposure: Exposure = NOMINAL
    frame_s: float = 1.0 / 60.0
    """Frame period."""
    noise: StereoNoise = TYPICAL_PAIR
    """Temporal noise of both cameras at this gain."""
    steps: tuple[Exposure, ...] = (NOMINAL,)
    """Exposures that may be proposed for the next scan, from dark to bright."""
