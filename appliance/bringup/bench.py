"""Owns what the measurements of the bring-up ask of the instrument: pictures that are played, and what both cameras saw of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
MOST_FRAMES = 64
"""Frames of one take: as many pulses as the board fires."""


@dataclass(frozen=True, slots=True)
class Shot:
    """Trigger and exposure of a take."""

    delay_us: int
    """Time from a vertical blank to the exposure, 0..15000."""
    exposure_us: int
    gain_db: float = 0.0
    blanks: int = 0
    """Number of blanks from the first picture's flip to that of the first exposure, 0..6."""


class Bench(Protocol):
    """An instrument on the bench, before something white. Implemented by ``appliance.service.light_bench``."""

    @property
    def refresh_hz(self) -> float: ...

    @property
    def size_px(self) -> tuple[int, int]:
        """The projector's raster, (width, height)."""

    def load(self, pictures: Sequence[Image], *, all_channels: bool) -> None:
        """Take pictures (height, width) uint8 into the projector's memory, numbered from 0. Raises BringupError, DeviceError."""

    def take(self, order: Sequence[int], shot: Shot) -> Mapping[str, Image]:
        """Play the pictures ``order``, one per vertical blank, then dark, and return what each camera saw, (n, h, w), by side.

        Raises BringupError where it cannot be recorded, DeviceError where a device is lost.
        """


def lit_part(white: Image, black: Image, share: float = 0.5, most_dn: float = 240.0) -> NDArray[np.bool_]:
    """Return which pixels (h, w) the projector lights well: from ``share`` of the brightest on, and none that is near saturation."""
    # Signed: where a reflection moves, black may be the brighter one.
    light = white.astype(np.float32) - black
    usable = white < most_dn
    # The brightest hundredth: a glint or a hot pixel must not set the scale.
    top = float(np.quantile(light[usable], 0.99)) if usable.any() else 0.0
    lit: NDArray[np.bool_] = usable & (light > max(share * top, 1.0))
    return lit


def mean_levels(frames: Image, part: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the mean grey value of each frame (n, h, w) over ``part`` (h, w), (n,)."""
    return np.array([float(frame[part].mean()) for frame in frames])
