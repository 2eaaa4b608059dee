"""The oracle: the same decoding in plain float64 NumPy, slow and obvious, written from the formulas.

It shares the product's pattern list, but no kernel: phases by ``arctan2``, fringe order by Gray decoding through a lookup.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.gray import inverse_gray
from appliance.patterns.sequence import Direction, PatternSequence

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MaskLimits:
    min_contrast_dn: float
    min_modulation_dn: float
    max_offset: float
    jump_px: float
    bend_px: float


@dataclass(frozen=True)
class Decoded:
    pq: Array
    """(h, w, 2) float64."""
    modulation: Array
    offset: Array
    """(h, w, 2): phase minus the middle of its Gray half period, in periods."""


def decode(sequence: PatternSequence, frames: NDArray[np.uint8]) -> Decoded:
    stack = frames.astype(np.float64)
    threshold = np.floor((stack[sequence.bright] + stack[sequence.dark] + 1) / 2)
    pq, modulation, offset = [], [], []
    for direction in (Direction.X, Direction.Y):
        axis = sequence.axis(direction)
        code = np.zeros(stack.shape[1:], np.int64)
        for k in axis.gray:
            code = 2 * code + (stack[k] >= threshold)
        middle = 0.5 * inverse_gray(len(axis.gray))[code] + 0.25
        i0, i1, i2, i3 = (stack[k] for k in axis.sine)
        turn = np.arctan2(i3 - i1, i0 - i2) / (2 * np.pi)
        delta = turn - middle
        delta -= np.floor(delta + 0.5)
        pq.append(sequence.period_px * (middle + delta) - 0.5)
        modulation.append(0.5 * np.hypot(i3 - i1, i0 - i2))
        offset.append(delta)
    return Decoded(np.stack(pq, -1), np.min(modulation, 0), np.stack(offset, -1))


def masks(sequence: PatternSequence, frames: NDArray[np.uint8], limits: MaskLimits) -> NDArray[np.uint8]:
    """Why each pixel has no coordinates, in the numbers of the product's ``Mask``; by whole images, one after the other.

    The direction that is complete first is judged first, edges included; what it lost, the other does not judge.
    """
    stack = frames.astype(np.float64)
    decoded = decode(sequence, frames)
    mask = np.where(stack[sequence.bright] - stack[sequence.dark] < limits.min_contrast_dn, 1, 0)
    for k, direction in enumerate((Direction.X, Direction.Y)):
        axis = sequence.axis(direction)
        i0, i1, i2, i3 = (stack[n] for n in axis.sine)
        coordinate = decoded.pq[..., k]
        wrong = (np.abs(decoded.offset[..., k]) > limits.max_offset) | (coordinate < -1) | (coordinate > axis.size_px)
        reason = np.where(wrong, 4, 0)
        reason = np.where(0.5 * np.hypot(i3 - i1, i0 - i2) < limits.min_modulation_dn, 3, reason)
        reason = np.where(np.max([i0, i1, i2, i3], 0) >= 255, 2, reason)
        mask = np.where(mask == 0, reason, mask)
        mask = np.where((mask == 0) & _edges(np.where(mask == 0, coordinate, np.nan), limits), 5, mask)
    return mask.astype(np.uint8)


def _edges(m: Array, limits: MaskLimits) -> NDArray[np.bool_]:
    """Whether a pixel differs too much from a neighbour, or bends too much between two; NaN says nothing."""
    around = np.pad(m, 1, constant_values=np.nan)
    here = around[1:-1, 1:-1]
    found = np.zeros(m.shape, bool)
    for before, after in (
        (around[1:-1, :-2], around[1:-1, 2:]),
        (around[:-2, 1:-1], around[2:, 1:-1]),
    ):
        a, b = here - before, after - here
        found |= (np.abs(a) > limits.jump_px) | (np.abs(b) > limits.jump_px) | (np.abs(b - a) > limits.bend_px)
    return found
