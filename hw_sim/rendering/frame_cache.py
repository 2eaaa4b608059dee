"""A cache of the frames of a scene at rest, so that two full-size cameras run in real time.

The key of an image is its light and exposure, and its index in the sequence: the same frame of the same scene has the
same image, including its noise. It is not used where the noise must differ between sequences.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.projector import LightSlice

MOST = 96
"""Largest number of images: a sequence of both cameras and their live images, twice. The least recently used go."""
Image = NDArray[np.uint8]


class FrameCache:
    """The latest ``MOST`` frames by light and exposure. May be used by several threads at once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._images: OrderedDict[Hashable, Image] = OrderedDict()

    @staticmethod
    def key(
        camera: str,
        scene: str,
        slices: Sequence[LightSlice],
        exposure_s: float,
        gain_db: float,
        lasers: tuple[bool, bool],
        frame: int | None,
    ) -> Hashable:
        """Return a key that is equal for equal images.

        ``frame``: index in the sequence; no camera gives two frames the same noise.
        """
        light = tuple(part.key() for part in slices)
        return camera, scene, light, round(exposure_s, 6), gain_db, lasers, frame

    def get(self, key: Hashable, make: Callable[[], Image]) -> Image:
        """Return the image (h, w) uint8 of that key, read-only; rendered if it is not cached."""
        with self._lock:
            cached = self._images.get(key)
            if cached is not None:
                self._images.move_to_end(key)
                return cached
        image = make()
        image.flags.writeable = False
        with self._lock:
            self._images[key] = image
            while len(self._images) > MOST:
                self._images.popitem(last=False)
        return image
