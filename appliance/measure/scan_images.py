"""The images of one scan for judges and compensation, and a grid of their pixels.

``ScanImages`` has the complete sequence of both cameras, decoded; it exists after the last frame. ``PixelGrid`` keeps
every n-th pixel of some frames of one camera. It is filled as the frames arrive, so that the judges of water and ports
need not read whole frames afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.noise import StereoNoise
from appliance.measure.light.patterns import PatternSequence


class PixelGrid:
    """An even grid of one camera's pixels in the frames ``indices``.

    ``steps`` returns the distance of rows and that of columns, for an image of so many rows and columns.
    """

    def __init__(self, indices: Sequence[int], steps: Callable[[int, int], tuple[int, int]]) -> None:
        self._indices, self._steps = list(indices), steps
        self.down_px = self.across_px = 1
        """Distance of the rows, and of the columns."""
        self.grey = np.empty((len(self._indices), 0, 0), np.uint8)
        """(images, rows, columns): grey values, in the order of ``indices``."""

    @property
    def at(self) -> tuple[slice, slice]:
        """The grid as an index of an image or a map."""
        return slice(self.down_px // 2, None, self.down_px), slice(self.across_px // 2, None, self.across_px)

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the pixels of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        if index == 0:
            self.down_px, self.across_px = self._steps(*frames.shape[1:])
            self.grey = np.empty((len(self._indices), *frames[0][self.at].shape), np.uint8)
        if index in self._indices:
            self.grey[self._indices.index(index)] = frames[index][self.at]

    def take_all(self, frames: NDArray[np.uint8]) -> PixelGrid:
        """Take the pixels of complete ``frames`` (n, h, w) uint8; return itself."""
        for index in range(len(frames)):
            self.push(frames, index)
        return self


@dataclass(frozen=True, slots=True)
class ScanImages:
    """The complete sequence of both cameras after its last frame; mappings by ``left`` and ``right``."""

    sequence: PatternSequence
    frames: Mapping[str, NDArray[np.uint8]]
    """Each camera's images (n, h, w) uint8 in the order of the sequence. They are shared: do not write to them."""
    decoded: Mapping[str, CameraDecoder]
    """Coordinates, modulation and masks. They have no meaning if a frame shows a wrong pattern."""
    settings: AcquisitionSettings = AcquisitionSettings()  # noqa: RUF009
    """Settings of the capture."""

    @property
    def noise(self) -> StereoNoise:
        """Temporal noise of both cameras with these settings."""
        return self.settings.noise

    @property
    def frame_s(self) -> float:
        """Frame period in seconds."""
        return self.settings.frame_s

    @property
    def exposure_s(self) -> float:
        """Exposure time of each frame in seconds."""
        return 1e-6 * self.settings.exposure.time_us
