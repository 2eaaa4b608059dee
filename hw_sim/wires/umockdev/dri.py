"""The DRM node of the simulated card: another process's system calls, and scan-out memory shared with it."""

from __future__ import annotations

import errno
import itertools
import mmap
import os
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from hw_sim.devices.card import Card
from hw_sim.devices.card_file import CardFile, UserMemory
from hw_sim.devices.drm_abi import OwnMemory
from hw_sim.timing.world_time import WorldTime
from hw_sim.wires.umockdev.preload import HostMemory

SLOT_BYTES = 1 << 26
"""Distance of two buffers in the node, larger than any buffer."""
SLOTS = 4096
HELD_S = 0.005
"""A regular file is always ready for ``poll``, so that reads come without events. They get EAGAIN after this delay,
lest the host spins; it is short, as the descriptor's other calls wait behind."""


class CardMemory:
    """The node as a sparse regular file, which holds the buffers that both sides map."""

    def __init__(self, node: Path) -> None:
        """The node must not exist yet."""
        node.parent.mkdir(parents=True, exist_ok=True)
        self._fd = os.open(node, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o660)
        os.ftruncate(self._fd, SLOT_BYTES * SLOTS)
        self._slots = itertools.count(1)
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._fd)

    def allocate(self, size: int) -> tuple[memoryview, int]:
        """Return zeroed memory and its offset in the node. Raises OSError(ENOMEM)."""
        with self._lock:
            offset = next(self._slots) * SLOT_BYTES
        if size > SLOT_BYTES or offset + size > SLOT_BYTES * SLOTS:
            raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        return memoryview(mmap.mmap(self._fd, size, mmap.MAP_SHARED, offset=offset)), offset


class HostClock:
    """The kernel's clock at moments of world time.

    While a sequence is recorded that waits for its host (pace ``attended`` and ``lockstep``), the display's time stops
    with the world's, so that blanks keep their distance; after it the two are aligned again.
    """

    def __init__(self, world: WorldTime, recording: Callable[[], bool]) -> None:
        """``recording`` is called with the lock held."""
        self._world, self._recording = world, recording
        self._ahead_ns: int | None = None

    def at_ns(self, world_ns: int) -> int:
        """Return a moment by CLOCK_MONOTONIC, which all processes share. The caller holds the lock."""
        if self._ahead_ns is None or not self._recording():
            self._ahead_ns = self._world.real_ns(world_ns) - world_ns
        return world_ns + self._ahead_ns


class DrmFile:
    """One opening of ``/dev/dri/card0``. Takes the world's lock itself."""

    def __init__(self, card: Card, time: WorldTime, memory: CardMemory, clock: HostClock) -> None:
        self._time, self._memory, self._clock = time, memory, clock
        with time.condition:
            self._file = CardFile(card, self)

    # -- what the card wants of its host

    @property
    def memory(self) -> UserMemory:
        """Memory of this process; unused, as every call has its caller's."""
        return OwnMemory()

    def time_ns(self, world_ns: int) -> int:
        return self._clock.at_ns(world_ns)

    def scan_out_memory(self, size: int) -> tuple[bytearray | memoryview, int]:
        return self._memory.allocate(size)

    # -- system calls

    def ioctl(self, request: int, argument: int, memory: HostMemory) -> int:
        # The size is in the request (_IOC_SIZE); the kernel, too, copies the argument in and out in one piece.
        buffer = bytearray(memory.copy_from_user(argument, request >> 16 & 0x3FFF))
        with self._time.condition:
            self._check()
            self._file.ioctl(request, buffer, memory)
        memory.copy_to_user(argument, buffer)
        return 0

    def read(self, size: int) -> bytes:
        """Return complete events. Raises OSError(EAGAIN), after HELD_S, without one."""
        with self._time.condition:
            self._check()
            if not self._file.readable:
                self._time.condition.wait_for(lambda: self._file.readable or self._time.closed, HELD_S)
            return self._file.read(size)

    def write(self, data: bytes) -> int:
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    def close(self) -> None:
        with self._time.condition:
            self._file.close()

    def _check(self) -> None:
        if self._time.closed:
            raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
