"""Owns the memory of the worker process and of its parent.

    CloudMemory, SharedPoints                  blocks for points: a cloud passes through them from worker to service
    LivePicture                                the place of one live image, behind the points
    ParentMemory                               the shared memory itself, made by the parent
    limit_memory, give_back_memory, …          what the worker may take, and what it gives back

The parent writes a live image and says so by ``LookAt``; the child copies it when it reads that. No other one is written
before the answer, or a scan, or until none is expected any more: so one place is enough, and nothing is queued.
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

from appliance.measure import CLOUD_BYTES, POINT_BYTES, Cloud, Found, PointTable, coarse_stride_px

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


MOST_BLOCKS = 2
"""A scan that is still being published has one while the next one's cloud comes; so have both exposures of one scan."""
_POOL_ALONE = 2
"""References to a block that nobody has: the list's, and that of who asks how many there are."""


class CloudMemory:
    """Blocks for up to ``capacity`` points each, the first of them touched at once.

    Used by one thread; clouds may be dropped by any.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._blocks: list[NDArray[np.uint8]] = []
        self._add()

    def copied(self, table: PointTable, found: Found) -> Cloud:
        """Return a copy of the points found.

        It stays as it is as long as anybody has one of its arrays, or a part of one.
        """
        return table.cloud(found, self._free())

    def _free(self) -> NDArray[np.uint8] | None:
        """Return a block of which nobody has a part; ``None``: there is none, and no more are kept."""
        for k in range(len(self._blocks)):
            # Each array that lies in a block refers to it, however it was cut out of another one. Where nobody has one,
            # nobody can get one.
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
    """Both places, for a left camera of ``width_px`` × ``height_px``."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self.capacity = width_px * height_px
        """Number of points that there is room for: one in every left pixel, so that no cloud can be too large."""
        stride_px = coarse_stride_px(width_px, height_px)
        self._coarse_capacity = -(-width_px // stride_px) * -(-height_px // stride_px)
        # Columns of four bytes follow: they must begin where such numbers may lie.
        self._coarse_first = -(-behind_picture(self.capacity) // ALIGNED_BYTES) * ALIGNED_BYTES

    @property
    def size_bytes(self) -> int:
        """Size of the memory for both, and for the live picture between them."""
        return self._coarse_first + self._coarse_capacity * POINT_BYTES

    def full(self, memory: memoryview | None) -> PointTable:
        """Return the full cloud's table.

        While it lives, ``memory`` cannot be closed. Raises ValueError where it is (``None``).
        """
        return PointTable(self.capacity, _open(memory))

    def coarse(self, memory: memoryview | None) -> PointTable:
        """Return the coarse cloud's table.

        While it lives, ``memory`` cannot be closed. Raises ValueError where it is (``None``).
        """
        return PointTable(self._coarse_capacity, _open(memory)[self._coarse_first :])


def _open(memory: memoryview | None) -> memoryview:
    if memory is None:
        raise ValueError("the shared memory is closed; take points from it while the worker runs")
    return memory


M_ARENA_MAX = -8
"""glibc's number of that option (malloc.h)."""
MADV_DONTNEED = 4
"""Linux's number of that advice (madvise(2)): of a private mapping of a file, what was not written to is read from the
file again."""
COMPILER = "libllvmlite.so"
_PART = re.compile(r"(?P<first>[0-9a-f]+)-(?P<stop>[0-9a-f]+) (?P<may>\S{4}) \S+ \S+ \d+ *(?P<file>/.*)?$")


def share_freed_memory() -> None:
    """Let all threads of this process take memory from one heap, so that what one of them has freed serves the other.

    glibc gives each thread a heap of its own, which keeps 10 MB and more of what judges needed in passing. Elsewhere
    than with glibc nothing happens.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def give_back_memory() -> None:
    """Give pages that were needed to make tables and to load kernels, and that nothing lies in any more, back to the
    machine.

    glibc keeps what was freed between two things that stay: 40 MB after the start. Of the compiler's library 65 MB were
    read to load kernels that were compiled before; nobody reads them again. Elsewhere than with glibc and Linux nothing
    happens.
    """
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(AttributeError, OSError):
        _forget_pages(COMPILER)


def _forget_pages(library: str) -> None:
    """Take the pages of a library out of this process that nobody has written to.

    Whoever reads one gets it again from the file.
    """
    advise = ctypes.CDLL(None, use_errno=True).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    for first, stop in unwritten(Path("/proc/self/smaps").read_text(encoding="utf-8", errors="replace"), library):
        advise(first, stop - first, MADV_DONTNEED)


def unwritten(smaps: str, library: str) -> Iterator[tuple[int, int]]:
    """Yield first and last address of each part of a file of that name, as proc(5) lists them, that is as the file has
    it."""
    # A page that the loader has written an address into would come back without it.
    part: re.Match[str] | None = None
    for line in smaps.splitlines():
        part = _PART.match(line) or part
        if part is None or (part["file"] or "").rpartition("/")[2] != library or "w" in part["may"]:
            continue
        if line.split() == ["Anonymous:", "0", "kB"]:
            yield int(part["first"], 16), int(part["stop"], 16)


def limit_memory(headroom_mb: float) -> None:
    """Let the kernel refuse private memory beyond what this process has now; what it shares with others does not count.

    Faster than the parent's own measure: an allocation out of proportion fails here, before the machine runs out.
    """
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    held = next((int(line.split()[1]) * 1024 for line in status.splitlines() if line.startswith("VmData:")), None)
    if held is None:
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = held + int(headroom_mb * 1e6)
    if hard == resource.RLIM_INFINITY or wanted < hard:
        resource.setrlimit(resource.RLIMIT_DATA, (wanted, hard))


class ParentMemory:
    """Shared memory for a left camera of ``width_px`` × ``height_px``, made here.

    No view of it outlives a call: it could not be closed.
    """

    def __init__(self, width_px: int, height_px: int) -> None:
        self._places = SharedPoints(width_px, height_px)
        self._memory = SharedMemory(create=True, size=self._places.size_bytes)
        self._copies = CloudMemory(self._places.capacity)

    @property
    def name(self) -> str:
        """Name by which another process opens it."""
        return self._memory.name

    def coarse(self, found: Found) -> Cloud:
        """Return a copy of the coarse cloud. Raises ValueError where the memory is closed, as all here."""
        return self._places.coarse(self._memory.buf).cloud(found)

    def full(self, found: Found) -> Cloud:
        """Return a copy of the full cloud, in memory that is used again once nobody has the copy any more."""
        return self._copies.copied(self._places.full(self._memory.buf), found)

    def put(self, picture: NDArray[np.uint8]) -> tuple[int, int]:
        """Put a live ``picture`` (h, w) into its place, reduced as far as it must be; returns its shape there."""
        return LivePicture(self._memory.buf, self._places.capacity).put(picture)

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        self._memory.unlink()
