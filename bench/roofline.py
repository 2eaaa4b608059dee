"""Least time of a scan on this machine: the bytes that it moves, at the speed of memory."""

from __future__ import annotations

import time

import numba
import numpy as np
from numpy.typing import NDArray

BUFFER_BYTES = 640_000_000
"""Beyond the last cache of any machine we know (260 MB)."""


@numba.njit(nogil=True, cache=True)
def _read(memory: NDArray[np.int64]) -> np.int64:
    total = np.int64(0)
    for i in range(memory.size):
        total += memory[i]
    return total


@numba.njit(nogil=True, cache=True)
def _write(memory: NDArray[np.int64], value: int) -> None:
    for i in range(memory.size):
        memory[i] = value


class Memory:
    """Memory larger than all caches, to be read and written at full speed by one thread."""

    def __init__(self, size_bytes: int = BUFFER_BYTES) -> None:
        # Filled: a page that was never written is no memory at all, and reading it comes from the cache.
        self._words = np.full(size_bytes // 8, 1, np.int64)
        _read(self._words[:8])
        _write(self._words[:8], 1)

    def bandwidth_gb_s(self) -> tuple[float, float]:
        """Return the bandwidths of reading and of writing, by CPU time."""
        begun_s = time.thread_time()
        total = _read(self._words)
        middle_s = time.thread_time()
        _write(self._words, 1)
        ended_s = time.thread_time()
        if total != self._words.size:
            raise RuntimeError(f"{self._words.size} ones sum to {total}: this memory is not to be trusted")
        return self._words.nbytes / (middle_s - begun_s) / 1e9, self._words.nbytes / (ended_s - middle_s) / 1e9


def scan_ms(pixels: int, frames: int, points: int, read_gb_s: float, write_gb_s: float) -> float:
    """Return the least time of a scan by memory traffic.

    Frames of both cameras are read once, both coordinate maps are written and read once, and each point of 26 bytes is
    written once.
    """
    maps_bytes = 2 * pixels * 8
    read_bytes = 2 * pixels * frames + maps_bytes
    return (read_bytes / read_gb_s + (maps_bytes + 26 * points) / write_gb_s) / 1e6


def full_cloud_ms(left_px: int, right_px: int, points: int, read_gb_s: float, write_gb_s: float) -> float:
    """Return the least time of the full cloud by memory traffic.

    Read once are both coordinates, modulation, Gray threshold and grey value of each illuminated left pixel, and both
    coordinates and modulation of each illuminated right pixel. Each point is written once, with gap, sigma, modulation,
    pixel and grey value.
    """
    read_bytes = (2 * 4 + 3) * left_px + (2 * 4 + 1) * right_px
    return (read_bytes / read_gb_s + 26 * points / write_gb_s) / 1e6
