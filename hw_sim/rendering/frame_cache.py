"""Owns the cache of frames of a scene at rest: made once and shown again, two full-size cameras run in real time.

An image is known by all that lights and exposes it, and by its place in a sequence: the same frame of the same scene gives
the same image, to its noise. Where the noise of one sequence and the next matters, this is not used.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.projector import LightSlice

MOST = 96
"""Images kept: a sequence of both cameras and their live images, twice. The one that was not asked for longest goes."""
Image = NDArray[np.uint8]


class FrameCache:
    """The latest ``MOST`` frames by what lit and exposed them. May be used by several threads at once."""

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
        """Return a key that is equal for equal images. ``frame``: of the sequence; no camera gives two frames the same noise."""
        light = tuple(part.key() for part in slices)
        return camera, scene, light, round(exposure_s, 6), gain_db, lasers, frame

    def get(self, key: Hashable, make: Callable[[], Image]) -> Image:
        """Return the image (h, w) uint8 of that key, read-only; made if there is none yet."""
        with self._lock:
            known = self._images.get(key)
            if known is not None:
                self._images.move_to_end(key)
                return known
        made = make()
        made.flags.writeable = False
        with self._lock:
            self._images[key] = made
            while len(self._images) > MOST:
                self._images.popitem(last=False)
        return made
