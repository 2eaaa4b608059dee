"""The product's end of the graphics card: system calls on an opened node, waiting in world time."""

from __future__ import annotations

from hw_sim.devices.card import Card
from hw_sim.devices.card_file import CardFile
from hw_sim.timing.world_time import WorldTime


class SimCardNode:
    """An opened DRM node: ``ioctl``, ``map``, ``read``, ``wait_readable``, ``close``."""

    def __init__(self, card: Card, time: WorldTime) -> None:
        self._time = time
        with time.condition:
            self._file = CardFile(card)

    def ioctl(self, request: int, buffer: bytearray) -> None:
        """``fcntl.ioctl(fd, request, buffer, True)``; pointers are addresses of this process. Raises OSError."""
        with self._time.condition:
            self._file.ioctl(request, buffer)

    def map(self, length: int, offset: int) -> memoryview:
        """Map a dumb buffer like ``mmap``; return its memory, writable and shared. Raises OSError."""
        with self._time.condition:
            return self._file.map(length, offset)

    def read(self, size: int) -> bytes:
        """Read like ``os.read`` on a non-blocking descriptor. Raises BlockingIOError without data."""
        with self._time.condition:
            return self._file.read(size)

    def wait_readable(self, timeout_s: float) -> bool:
        """Wait as ``select`` does; return whether an event can be read."""
        with self._time.condition:
            self._time.wait_for(lambda: self._file.readable or self._file.closed or self._time.closed, timeout_s)
            return self._file.readable

    def close(self) -> None:
        """Close the node; may be called again."""
        with self._time.condition:
            self._file.close()
