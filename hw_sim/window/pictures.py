"""Owns the memory that both processes share: one picture after the other, each as large as it can become."""

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
    """The most that a picture may need; ``channels`` is 3 (RGB) or 1."""

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
    """A view of the shared memory behind a file descriptor. Who writes and who reads when is agreed on elsewhere."""

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
        """New memory, black; gone with the last process that has it."""
        descriptor = os.memfd_create("kingfisher-windows")
        os.ftruncate(descriptor, sum(room.size_bytes for room in ROOMS.values()))
        return cls(descriptor)

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        os.close(self.descriptor)

    def view(self, name: str, width_px: int, height_px: int) -> Picture:
        """(height, width, channels) view of a picture. Raises ValueError where it does not fit its room."""
        room = ROOMS[name]
        if not (0 < width_px <= room.width_px and 0 < height_px <= room.height_px):
            raise ValueError(f"{name} {width_px}x{height_px}; allowed are 1x1 to {room.width_px}x{room.height_px}")
        count = width_px * height_px * room.channels
        flat = np.frombuffer(self._memory, np.uint8, count, self._begin[name])
        return flat.reshape(height_px, width_px, room.channels)


class Writer:
    """Puts pictures into the memory and says which have changed."""

    def __init__(self, pictures: Pictures) -> None:
        self._pictures = pictures
        self._size: dict[str, tuple[int, int]] = {}

    def write(self, new: Mapping[str, Picture]) -> dict[str, tuple[int, int]]:
        """Name → (width, height) of those that differ from what is there."""
        changed = {}
        for name, picture in new.items():
            height, width = picture.shape[:2]
            there = self._pictures.view(name, width, height)
            picture = picture.reshape(there.shape)
            if self._size.get(name) != (width, height) or not np.array_equal(there, picture):
                there[...] = picture
                self._size[name] = changed[name] = (width, height)
        return changed
