"""Owns which part of each row the projector illuminates: from the first illuminated pixel to the last. Nothing else is worked on.

Parts begin and end at whole blocks, so that vector instructions have no rest to do pixel by pixel.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_BLOCK = 64
_NAN = np.float32(np.nan)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _any_illuminated(mask: NDArray[np.uint8]) -> bool:
    """Tell whether any place of ``mask`` is 0."""
    least = np.uint8(255)
    for x in range(mask.size):
        least = min(least, mask[x])
    return bool(least == np.uint8(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ends(mask: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the first column of the first block of a row that is not all masked, and the one behind the last such block."""
    first, stop = 0, mask.size
    while first < stop and not _any_illuminated(mask[first : first + _BLOCK]):
        first += _BLOCK
    while stop > first and not _any_illuminated(mask[(stop - 1) // _BLOCK * _BLOCK : stop]):
        stop = (stop - 1) // _BLOCK * _BLOCK
    return min(first, stop), stop


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _count(mask: NDArray[np.uint8]) -> int:
    """Return the number of pixels of a row that are not in the shadow; 16 bits hold a row and keep the loop short."""
    shadow = np.uint16(0)
    for x in range(mask.size):
        shadow = np.uint16(shadow + mask[x])
    return int(mask.size) - int(shadow)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def find_illuminated_columns(
    mask: NDArray[np.uint8], illuminated: NDArray[np.int32], p_px: NDArray[np.float32], q_px: NDArray[np.float32]
) -> int:
    """Enter the first column of each row's illuminated part, and the one behind it, in ``illuminated`` (h, 2).

    Returns how many pixels are illuminated. ``mask`` (h, w): 1 in the shadow, else 0. Coordinates (h, w) that the scan before
    left outside become NaN: those outside of its own part are NaN already.
    """
    pixels = 0
    for y in range(mask.shape[0]):
        was_first, was_stop = illuminated[y]
        first, stop = _ends(mask[y])
        pixels += _count(mask[y])
        for coordinate in (p_px[y], q_px[y]):
            coordinate[was_first : min(first, was_stop)] = _NAN
            coordinate[max(stop, was_first) : was_stop] = _NAN
        illuminated[y, 0], illuminated[y, 1] = first, stop
    return pixels
