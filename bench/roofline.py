"""Owns the least time a scan can take on this machine: the bytes it must move, at the speed at which memory moves them."""

from __future__ import annotations

import time

import numba
import numpy as np
from numpy.typing import NDArray

BUFFER_BYTES = 128_000_000
"""More than fits into the second-level cache; as much as a scan's frames."""


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


def bandwidth_gb_s(repeats: int = 5) -> tuple[float, float]:
    """Reading and writing, one thread, best of ``repeats``."""
    memory = np.zeros(BUFFER_BYTES // 8, np.int64)
    _read(memory[:8])
    _write(memory[:8], 0)
    read_s, write_s = [], []
    for k in range(repeats):
        begun_s = time.thread_time()
        _read(memory)
        middle_s = time.thread_time()
        _write(memory, k)
        read_s.append(middle_s - begun_s)
        write_s.append(time.thread_time() - middle_s)
    return BUFFER_BYTES / min(read_s) / 1e9, BUFFER_BYTES / min(write_s) / 1e9


def scan_ms(pixels: int, frames: int, points: int, read_gb_s: float, write_gb_s: float) -> float:
    """Both cameras' frames read once, both coordinate maps written and read once, each point of 26 bytes written once."""
    maps_bytes = 2 * pixels * 8
    read_bytes = 2 * pixels * frames + maps_bytes
    return (read_bytes / read_gb_s + (maps_bytes + 26 * points) / write_gb_s) / 1e6
