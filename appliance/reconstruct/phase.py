"""Owns the phase of a pixel: four sine images and a Gray code become a pattern coordinate, a modulation and a mask.

Written for the machine that has to do it: row by row, each row in short loops of one output and few inputs, which is
what LLVM turns into vector instructions; what passes between the loops stays in the first-level cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

ATAN_TURNS = tuple(
    np.float32(c)
    for c in (
        0.15915432572364807,
        -0.0530262365937233,
        0.03152511641383171,
        -0.021061517298221588,
        0.01267249882221222,
        -0.0053482758812606335,
        0.0010841300245374441,
    )
)
"""Minimax polynomial of atan(t)/2π on 0 … 1, odd powers of t. In float32: 5.3e-8 turns, 8.5e-7 px of a 16-px period."""

_HALF, _QUARTER, _TINY, _ZERO = np.float32(0.5), np.float32(0.25), np.float32(1e-30), np.float32(0.0)
_PER_DN, _NAN = np.float32(2.0), np.float32(np.nan)
_C0, _C1, _C2, _C3, _C4, _C5, _C6 = ATAN_TURNS


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def phase(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    turn: NDArray[np.float32],
    modulation: NDArray[np.float32],
) -> None:
    """Wrapped phase atan2(i3 − i1, i0 − i2)/2π in turns, −½ … ½, within 6e-8, and modulation: half the length of that
    vector, in grey values. Without modulation the phase is 0."""
    for i in range(turn.size):
        cosine, sine = np.float32(i0[i]) - np.float32(i2[i]), np.float32(i3[i]) - np.float32(i1[i])
        a, b = abs(cosine), abs(sine)
        t = min(a, b) / max(max(a, b), _TINY)
        s = t * t
        r = t * (_C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * (_C4 + s * (_C5 + s * _C6))))))
        r = _QUARTER - r if b > a else r
        r = _HALF - r if cosine < _ZERO else r
        turn[i] = -r if sine < _ZERO else r
        modulation[i] = _HALF * np.sqrt(cosine * cosine + sine * sine)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def unwrap(
    turn: NDArray[np.float32],
    half_period: NDArray[np.uint8],
    period_px: np.float32,
    coordinate: NDArray[np.float32],
    offset: NDArray[np.float32],
) -> None:
    """The middle of the Gray half period, in periods, tells the fringe order at any phase.

    ``offset`` becomes the distance of the phase from that middle, in periods: 0 … ½.
    """
    for i in range(coordinate.size):
        middle = _HALF * np.float32(half_period[i]) + _QUARTER
        off = turn[i] - middle
        off -= np.floor(off + _HALF)
        offset[i] = abs(off)
        coordinate[i] = period_px * middle + (period_px * off - _HALF)


@numba.njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _judge(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    amplitude: NDArray[np.float32],
    offset: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    size_px: np.float32,
    min_modulation_dn: np.float32,
    max_offset: np.float32,
    mask: NDArray[np.uint8],
) -> None:
    for i in range(mask.size):
        top = max(max(i0[i], i1[i]), max(i2[i], i3[i]))
        wrong = (offset[i] > max_offset) | (coordinate[i] < np.float32(-1.0)) | (coordinate[i] > size_px)
        reason = np.uint8(4) if wrong else np.uint8(0)
        reason = np.uint8(3) if amplitude[i] < min_modulation_dn else reason
        reason = np.uint8(2) if top == np.uint8(255) else reason
        mask[i] = mask[i] if mask[i] != np.uint8(0) else reason


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _blank(mask: NDArray[np.uint8], coordinate: NDArray[np.float32]) -> None:
    for i in range(mask.size):
        coordinate[i] = coordinate[i] if mask[i] == np.uint8(0) else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _note(amplitude: NDArray[np.float32], kept: NDArray[np.uint8]) -> None:
    for i in range(kept.size):
        kept[i] = np.uint8(amplitude[i] * _PER_DN + _HALF)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _note_smaller(amplitude: NDArray[np.float32], kept: NDArray[np.uint8]) -> None:
    for i in range(kept.size):
        kept[i] = min(kept[i], np.uint8(amplitude[i] * _PER_DN + _HALF))


class Axis(NamedTuple):
    """What closing one direction needs to know."""

    period_px: np.float32
    size_px: np.float32
    min_modulation_dn: np.float32
    max_offset: np.float32
    """Distance of the phase from the middle of its half period, in periods; beyond, Gray code and phase disagree."""
    second: bool
    """The other direction has been closed: the smaller modulation counts."""


@numba.njit(nogil=True, cache=True, error_model="numpy")
def close_row(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    half_period: NDArray[np.uint8],
    axis: Axis,
    scratch: NDArray[np.float32],
    coordinate: NDArray[np.float32],
    half_dn: NDArray[np.uint8],
    mask: NDArray[np.uint8],
) -> None:
    """Coordinate in px (NaN where the mask says why), modulation in half grey values, and mask; all arrays (w,).

    ``scratch`` is (3, w) or wider.
    """
    n = mask.size
    turn, offset, amplitude = scratch[0, :n], scratch[1, :n], scratch[2, :n]
    phase(i0, i1, i2, i3, turn, amplitude)
    unwrap(turn, half_period, axis.period_px, coordinate, offset)
    _judge(
        i0, i1, i2, i3, amplitude, offset, coordinate, axis.size_px, axis.min_modulation_dn, axis.max_offset, mask
    )  # fmt: skip
    _blank(mask, coordinate)
    if axis.second:
        _note_smaller(amplitude, half_dn)
    else:
        _note(amplitude, half_dn)
