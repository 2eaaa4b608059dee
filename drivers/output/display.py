"""Presenting pictures to the diver: two buffers that take turns."""

from __future__ import annotations

from typing import Generic

import numpy as np
from numpy.typing import NDArray

from drivers.api import Flip, Health
from drivers.output.projector import surface_health
from drivers.output.surface import P, Surface

PRESENTED = -1
"""Value of ``Flip.index`` for a picture that was not loaded beforehand."""


class PictureDisplay(Generic[P]):
    """``drivers.api.Display`` on any surface."""

    def __init__(self, surface: Surface[P]) -> None:
        self._surface = surface
        self._back = surface.create_picture()
        self._front = surface.create_picture()
        width, height = surface.size_px
        self._staged = np.zeros((height, width, 4), np.uint8)

    @property
    def size_px(self) -> tuple[int, int]:
        return self._surface.size_px

    def present(self, image: NDArray[np.uint8], timeout_s: float) -> Flip:
        """Show ``image`` (height, width, 3) RGB uint8 at the next vertical blank and wait for it.

        ``Flip.index`` is -1. Raises ValueError on another shape or type, DeviceGone.
        """
        height, width, _ = self._staged.shape
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(f"picture is {image.shape} {image.dtype}; the display takes ({height}, {width}, 3) uint8")
        # Swap channels in cached memory, then copy whole words: scan-out memory is slow to write out of order.
        self._staged[:, :, 0] = image[:, :, 2]
        self._staged[:, :, 1] = image[:, :, 1]
        self._staged[:, :, 2] = image[:, :, 0]
        self._back.write(self._staged)
        shown = self._surface.flip(self._back, timeout_s)
        self._back, self._front = self._front, self._back
        return Flip(PRESENTED, shown.sequence, shown.time_ns)

    def health(self) -> Health:
        """Return the display's entry in ``kingfisher check``."""
        return surface_health(self._surface)

    def close(self) -> None:
        """Switch the output off. Idempotent."""
        self._surface.close()
