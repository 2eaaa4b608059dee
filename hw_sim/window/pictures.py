"""The memory that both processes share: the images in sequence, with room for the largest of each."""

from __future__ import annotations

import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Room:
    """The largest size of an image; ``channels`` is 3 (RGB) or 1."""

    width_px: int
    height_px: int
    channels: int

    @property
    def size_bytes(self) -> int:
        return self.width_px * self.height_px * self.channels


ROOMS = {
    "display": Room(800, 480, 3),
    "projector": Room(1280, 768, 1),
    "left": Room(400, 300, 1),
    "right": Room(400, 300, 1),
}


class Pictures:
    """A view of the shared memory behind a file descriptor. Turns of writing and reading are agreed elsewhere."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, sum(room.size_bytes for room in ROOMS.values()))
        self._begin = {}
        begin = 0
        for name, room in ROOMS.items():
            self._begin[name] = begin
            begin += room.size_bytes

    @classmethod
    def create(cls) -> Self:
        """New memory, black; freed with the last process that has it."""
        descriptor = os.memfd_create("kingfisher-windows")
        os.ftruncate(descriptor, sum(room.size_bytes for room in ROOMS.values()))
        return cls(descriptor)

    def close(self) -> None:
        """Unmap the memory."""
        self._memory.close()
        os.close(self.descriptor)

    def view(self, name: str, width_px: int, height_px: int) -> Picture:
        """(height, width, channels) view of an image. Raises ValueError if it does not fit its room."""
        room = ROOMS[name]
        if not (0 < width_px <= room.width_px and 0 < height_px <= room.height_px):
            raise ValueError(f"{name} {width_px}x{height_px}; allowed are 1x1 to {room.width_px}x{room.height_px}")
        count = width_px * height_px * room.channels
        flat = np.frombuffer(self._memory, np.uint8, count, self._begin[name])
        return flat.reshape(height_px, width_px, room.channels)


class Writer:
    """Writes images into the memory and reports the changed ones."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._size: dict[str, tuple[int, int]] = {}

    def write(self, new: Mapping[str, Picture]) -> dict[str, tuple[int, int]]:
        """Write ``new``; return name → (width, height) of the changed ones."""
        changed = {}
        for name, picture in new.items():
            height, width = picture.shape[:2]
            stored = self._pictures.view(name, width, height)
            picture = picture.reshape(stored.shape)
            if self._size.get(name) != (width, height) or not np.array_equal(stored, picture):
                stored[...] = picture
                self._size[name] = changed[name] = (width, height)
        return changed
