"""Owns the place in shared memory where a live picture lies while the worker looks at it: one picture, behind the
points.

The parent writes it and says so by ``LookAt``; the child copies it when it reads that. Not before the answer, or a
scan, or so long that none is expected any more, another one is written: so one place is enough, and nothing is queued.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure import POINT_BYTES

LONGEST_PX = 480
"""Longest side of the picture: smaller detail tells no more, and takes twice the time at 640."""
PICTURE_BYTES = LONGEST_PX * LONGEST_PX


def behind_picture(capacity: int) -> int:
    """Return where the picture's place ends, in bytes from the beginning of the memory for ``capacity`` points."""
    return capacity * POINT_BYTES + PICTURE_BYTES


def reduced(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a camera's picture (h, w) uint8 as small as it is looked at."""
    factor = LONGEST_PX / max(picture.shape)
    if factor >= 1.0:
        return picture
    size = (round(picture.shape[1] * factor), round(picture.shape[0] * factor))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


class LivePicture:
    """The picture's place in ``memory``, which has at least ``behind_picture(capacity)`` bytes."""

    def __init__(self, memory: memoryview | None, capacity: int) -> None:
        """Raises ValueError where the memory was closed (``None``)."""
        if memory is None:
            raise ValueError("the shared memory is closed; look at live pictures while the worker runs")
        self._place = np.frombuffer(memory, np.uint8, PICTURE_BYTES, capacity * POINT_BYTES)

    def put(self, picture: NDArray[np.uint8]) -> tuple[int, int]:
        """Leave a camera's picture (h, w) uint8 there, reduced; returns its shape then."""
        small = reduced(picture)
        self._place[: small.size] = small.reshape(-1)
        return small.shape[0], small.shape[1]

    def copy(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """Return a copy of what lies there, (h, w) uint8."""
        return self._place[: shape[0] * shape[1]].reshape(shape).copy()
