"""Memory of the worker process and of its parent.

    CloudMemory, SharedPoints                  blocks for points, by which clouds pass from worker to service
    LivePicture                                the place of one live image, behind the points
    ParentMemory                               the shared memory itself, made by the parent
    limit_memory, give_back_memory, …          limit of the worker's memory, and its return to the system

The parent writes a live image and announces it by ``LookAt``; the child copies it when it reads the message. The next
image is written only after the answer, after a new scan, or when no answer is expected any more: one place is enough,
and there is no queue.
"""

from __future__ import annotations

import ctypes
import re
import resource
import sys
from collections.abc import Iterator
from contextlib import suppress
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure import CLOUD_BYTES, POINT_BYTES, Cloud, CloudLocation, PointTable, coarse_stride_px

LONGEST_PX = 480
"""Longest side of the image: smaller detail gives no better guidance, and 640 takes twice the time."""
PICTURE_BYTES = LONGEST_PX * LONGEST_PX


def behind_picture(capacity: int) -> int:
    """Return the end of the image's place, in bytes from the beginning of memory for ``capacity`` points."""
    return capacity * POINT_BYTES + PICTURE_BYTES


def reduced(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a camera's image (h, w) uint8 at the size in which it is evaluated."""
    factor = LONGEST_PX / max(picture.shape)
    if factor >= 1.0:
        return picture
    size = (round(picture.shape[1] * factor), round(picture.shape[0] * factor))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


class LivePicture:
    """The image's place in ``memory``, which has at least ``behind_picture(capacity)`` bytes."""

    def __init__(self, memory: memoryview | None, capacity: int) -> None:
        """Open the place. Raises ValueError if the memory was closed (``None``)."""
        if memory is None:
            raise ValueError("the shared memory is closed; use live images while the worker runs")
        self._place = np.frombuffer(memory, np.uint8, PICTURE_BYTES, capacity * POINT_BYTES)

    def put(self, picture: NDArray[np.uint8]) -> tuple[int, int]:
        """Store a camera's image (h, w) uint8, reduced; return its new shape."""
        small = reduced(picture)
        self._place[: small.size] = small.reshape(-1)
        return small.shape[0], small.shape[1]

    def copy(self, shape: tuple[int, int]) -> NDArray[np.uint8]:
        """Return a copy of the image, (h, w) uint8."""
        return self._place[: shape[0] * shape[1]].reshape(shape).copy()


MOST_BLOCKS = 2
"""Most blocks: for a scan that is being published and the next one, or for both exposures of a bracket."""
_POOL_ALONE = 2
"""Reference count of an unused block: the list's reference, and that of the call that counts."""


class CloudMemory:
    """Blocks for up to ``capacity`` points each, the first of them touched at once.

    Used by one thread; clouds may be dropped by any.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._blocks: list[NDArray[np.uint8]] = []
        self._add()

    def copied(self, table: PointTable, points: CloudLocation) -> Cloud:
        """Return a copy of the points, which stays valid while one of its arrays, or a part of one, is in use."""
        return table.cloud(points, self._free())

    def _free(self) -> NDArray[np.uint8] | None:
        """Return an unused block; ``None``: there is none, and the number of blocks is at its limit."""
        for k in range(len(self._blocks)):
            # Each array in a block refers to it, even one cut out of another array. Without a reference there is no way
            # to get one.
            if sys.getrefcount(self._blocks[k]) <= _POOL_ALONE:
                return self._blocks[k]
        return self._add() if len(self._blocks) < MOST_BLOCKS else None

    def _add(self) -> NDArray[np.uint8]:
        block = np.empty(self._capacity * CLOUD_BYTES, np.uint8)
        block.fill(0)  # touch every page now
        self._blocks.append(block)
        return block


ALIGNED_BYTES = 64


class SharedPoints:
    """Layout of the shared memory, for a left camera of ``width_px`` × ``height_px``."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self.capacity = width_px * height_px
        """Largest number of points: one in every left pixel, so that no cloud can be too large."""
        stride_px = coarse_stride_px(width_px, height_px)
        self._coarse_capacity = -(-width_px // stride_px) * -(-height_px // stride_px)
        # Aligned, since columns of four bytes follow.
        self._coarse_first = -(-behind_picture(self.capacity) // ALIGNED_BYTES) * ALIGNED_BYTES

    @property
    def size_bytes(self) -> int:
        """Size of the memory for both clouds and the live image between them."""
        return self._coarse_first + self._coarse_capacity * POINT_BYTES

    def full(self, memory: memoryview | None) -> PointTable:
        """Return the full cloud's table.

        While it lives, ``memory`` cannot be closed. Raises ValueError if it is closed (``None``).
        """
        return PointTable(self.capacity, _open(memory))

    def coarse(self, memory: memoryview | None) -> PointTable:
        """Return the coarse cloud's table.

        While it lives, ``memory`` cannot be closed. Raises ValueError if it is closed (``None``).
        """
        return PointTable(self._coarse_capacity, _open(memory)[self._coarse_first :])


def _open(memory: memoryview | None) -> memoryview:
    if memory is None:
        raise ValueError("the shared memory is closed; take points from it while the worker runs")
    return memory


M_ARENA_MAX = -8
"""Option number of glibc's mallopt (malloc.h)."""
MADV_DONTNEED = 4
"""Advice number of Linux (madvise(2)).

Pages of a private mapping that were not written to are read from the file again.
"""
COMPILER = "libllvmlite.so"
_PART = re.compile(r"(?P<first>[0-9a-f]+)-(?P<stop>[0-9a-f]+) (?P<may>\S{4}) \S+ \S+ \d+ *(?P<file>/.*)?$")


def share_freed_memory() -> None:
    """Let all threads of this process allocate from one heap, so that they share freed memory.

    glibc gives each thread a heap of its own, which keeps 10 MB and more of the judges' temporary memory. Has no effect
    without glibc.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def give_back_memory() -> None:
    """Return unused pages to the system, from building tables and loading kernels.

    glibc keeps freed memory between two live blocks: 40 MB after the start. Loading compiled kernels reads 65 MB of the
    compiler's library, which are not needed again. Has no effect without glibc and Linux.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(AttributeError, OSError):
        _forget_pages(COMPILER)


def _forget_pages(library: str) -> None:
    """Release the unmodified pages of a library in this process.

    A later access reads them from the file again.
    """
    advise = ctypes.CDLL(None, use_errno=True).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for first, stop in unwritten(Path("/proc/self/smaps").read_text(encoding="utf-8", errors="replace"), library):
        advise(first, stop - first, MADV_DONTNEED)


def unwritten(smaps: str, library: str) -> Iterator[tuple[int, int]]:
    """Yield first and last address of each part of a file without modified pages, from proc(5)'s list."""
    # A page in which the loader has written an address would lose it.
    part: re.Match[str] | None = None
    for line in smaps.splitlines():
        part = _PART.match(line) or part
        if part is None or (part["file"] or "").rpartition("/")[2] != library or "w" in part["may"]:
            continue
        if line.split() == ["Anonymous:", "0", "kB"]:
            yield int(part["first"], 16), int(part["stop"], 16)


def limit_memory(headroom_mb: float) -> None:
    """Let the kernel refuse private memory beyond the present amount plus ``headroom_mb``.

    Faster than the parent's check: an excessive allocation fails here, before the system runs out of memory.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    used_bytes = next((int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData:")), None)
    if used_bytes is None:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit_bytes = used_bytes + int(headroom_mb * 1e6)
    if hard == resource.RLIM_INFINITY or limit_bytes < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (limit_bytes, hard))


class ParentMemory:
    """Shared memory for a left camera of ``width_px`` × ``height_px``, made here.

    No view of it outlives a call: otherwise it could not be closed.
    """

    def __init__(self, width_px: int, height_px: int) -> None:
        self._places = SharedPoints(width_px, height_px)
        self._memory = SharedMemory(create=True, size=self._places.size_bytes)
        self._copies = CloudMemory(self._places.capacity)

    @property
    def name(self) -> str:
        """Name by which another process opens it."""
        return self._memory.name

    def coarse(self, points: CloudLocation) -> Cloud:
        """Return a copy of the coarse cloud. Raises ValueError if the memory is closed, as all methods."""
        return self._places.coarse(self._memory.buf).cloud(points)

    def full(self, points: CloudLocation) -> Cloud:
        """Return a copy of the full cloud, in memory that is used again when the copy is no longer in use."""
        return self._copies.copied(self._places.full(self._memory.buf), points)

    def put(self, picture: NDArray[np.uint8]) -> tuple[int, int]:
        """Store a live ``picture`` (h, w), reduced to fit; return its new shape."""
        return LivePicture(self._memory.buf, self._places.capacity).put(picture)

    def close(self) -> None:
        """Free the memory."""
        self._memory.close()
        self._memory.unlink()
