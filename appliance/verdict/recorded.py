"""Owns what every judge of a scan is given: the frames of both cameras, what they were decoded to, how they were taken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import PatternSequence
from appliance.reconstruct.decode import CameraDecoder
from appliance.scan.noise import StereoNoise


@dataclass(frozen=True, slots=True)
class Recorded:
    """A whole sequence of both cameras, after its last frame. Mappings are keyed ``left`` and ``right``."""

    sequence: PatternSequence
    frames: Mapping[str, NDArray[np.uint8]]
    """(n, h, w) uint8 of each camera, in the order of the sequence. Not to be written to."""
    decoded: Mapping[str, CameraDecoder]
    """Coordinates, modulation and masks. They mean nothing where a frame shows another pattern than it should."""
    noise: StereoNoise
    """Of the cameras as they are set."""
    frame_s: float = 1.0 / 60.0
    """From one frame to the next."""
    exposure_s: float = 0.012
