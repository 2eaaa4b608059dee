"""The system calls on a real DRM node."""

from __future__ import annotations

import fcntl
import mmap
import os
import select

from drivers.api import DeviceGone, DeviceRefused


class DrmNode:
    """An opened ``/dev/dri/cardN``: the five calls of ``drivers.api.CardNode``.

    The first opener of a card is its master and may set modes. Raises DeviceGone when the node does not exist,
    DeviceRefused when it may not be opened.
    """

    def __init__(self, path: str) -> None:
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError as error:
            raise DeviceRefused(
                path, f"cannot be opened without permission ({error.strerror})", "Join the group video"
            ) from error
        except OSError as error:
            raise DeviceGone(
                path, f"cannot be opened ({error.strerror})", "Check the graphics driver and the key card of the output"
            ) from error

    def ioctl(self, request: int, buffer: bytearray) -> None:
        fcntl.ioctl(self._fd, request, buffer, True)

    def map(self, length: int, offset: int) -> memoryview:
        return memoryview(mmap.mmap(self._fd, length, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE, offset=offset))

    def read(self, size: int) -> bytes:
        return os.read(self._fd, size)

    def wait_readable(self, timeout_s: float) -> bool:
        poll = select.poll()  # select() itself cannot watch descriptors above 1023
        poll.register(self._fd, select.POLLIN)
        return bool(poll.poll(max(0.0, timeout_s) * 1000.0))

    def close(self) -> None:
        os.close(self._fd)
