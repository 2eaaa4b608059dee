"""Owns the Gray code of half fringe periods: which bit is lit where, and back.

The code has one bit more than counting the fringes needs. It numbers *half* periods, so that the fringe order
stays right where the phase jumps: every phase jump lies in the middle between two code edges' tolerance, a quarter
of a period away from the nearest decision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def bit_count(size_px: int, period_px: int) -> int:
    """Return the number of Gray-code images that number all half periods over ``size_px``: 7, 6, 5 for 16, 32, 64 on 1024,
    and one more of each on 1280."""
    # Rounded up: a rest of a period at the far edge has its own number.
    half_periods = -(-2 * size_px // period_px)
    return max(1, (half_periods - 1).bit_length())


def gray_bit(size_px: int, period_px: int, bit: int) -> NDArray[np.bool_]:
    """Return which places of ``size_px`` are illuminated in the image of bit ``bit`` (0 = most significant) of the reflected
    binary code: shape (size_px,) bool."""
    # By the pixels' left edges, while `sine.fringe` takes their centres: for even periods both change between the same
    # pixels.
    half_period = 2 * np.arange(size_px, dtype=np.int64) // period_px
    # Reflected binary code: n xor n/2.
    code = half_period ^ (half_period >> 1)
    shift = bit_count(size_px, period_px) - 1 - bit
    return (code >> shift & 1).astype(np.bool_)


def inverse_gray(bits: int) -> NDArray[np.int16]:
    """Return the table from Gray code to half-period number: shape (2**bits,) int16."""
    number = np.arange(1 << bits, dtype=np.int64)
    table = np.empty(1 << bits, dtype=np.int16)
    table[number ^ (number >> 1)] = number.astype(np.int16)
    return table
