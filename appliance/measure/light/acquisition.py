"""Owns how a sequence is taken: exposure, frame period, the cameras' noise, and what could be chosen instead."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure.light.exposure import NOMINAL, Exposure
from appliance.measure.light.noise import TYPICAL_PAIR, StereoNoise


@dataclass(frozen=True, slots=True)
class AcquisitionSettings:
    """Settings that a sequence is taken with."""

    exposure: Exposure = NOMINAL
    frame_s: float = 1.0 / 60.0
    """The time from one frame to the next."""
    noise: StereoNoise = TYPICAL_PAIR
    """The temporal noise of both cameras at this gain."""
    steps: tuple[Exposure, ...] = (NOMINAL,)
    """The exposures that may be proposed for the next scan, from dark to bright."""
