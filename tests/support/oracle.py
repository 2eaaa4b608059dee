"""The oracle: the same reconstruction in plain float64 NumPy with a KD-tree, slow and obvious, written from the formulas.

It shares the product's pattern list and calibration values, but no kernel: phases by ``arctan2``, fringe order by
Gray decoding through a lookup, correspondence by nearest neighbour in (p, q) and two substitutions on a local patch of second order, rays
traced exactly per pixel, intersection by a linear solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.patterns import Direction, PatternSequence, inverse_gray

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
    for before, after in ((around[1:-1, :-2], around[1:-1, 2:]), (around[:-2, 1:-1], around[2:, 1:-1])):
        a, b = here - before, after - here
        found |= (np.abs(a) > limits.jump_px) | (np.abs(b) > limits.jump_px) | (np.abs(b - a) > limits.bend_px)
    return found


def match(left_pq: Array, right_pq: Array, right_valid: NDArray[np.bool_]) -> Array:
    """Right image points (n, 2) of left coordinates (n, 2); NaN where the patch does not hold."""
    v, u = np.nonzero(right_valid)
    _, nearest = KDTree(right_pq[v, u]).query(left_pq)
    at = np.stack([u[nearest], v[nearest]], -1)
    height, width = right_valid.shape
    result = np.full(left_pq.shape, np.nan)
    for iteration in range(8):
        x, y = at.T
        inside = (x > 0) & (y > 0) & (x < width - 1) & (y < height - 1)
        x, y = np.where(inside, x, 1), np.where(inside, y, 1)
        around = right_valid[y, x - 1] & right_valid[y, x + 1] & right_valid[y - 1, x] & right_valid[y + 1, x]
        du = 0.5 * (right_pq[y, x + 1] - right_pq[y, x - 1])
        dv = 0.5 * (right_pq[y + 1, x] - right_pq[y - 1, x])
        jacobian = np.stack([du, dv], -1)
        good = inside & around & (np.abs(np.linalg.det(jacobian)) > 1e-4)
        step = np.zeros_like(left_pq)
        away = left_pq - right_pq[y, x]
        step[good] = np.linalg.solve(jacobian[good], away[good][..., None])[..., 0]
        bend_u = right_pq[y, x + 1] + right_pq[y, x - 1] - 2 * right_pq[y, x]
        bend_v = right_pq[y + 1, x] + right_pq[y - 1, x] - 2 * right_pq[y, x]
        away -= 0.5 * (step[:, :1] ** 2 * bend_u + step[:, 1:] ** 2 * bend_v)
        step[good] = np.linalg.solve(jacobian[good], away[good][..., None])[..., 0]
        # Noise can make two neighbours point at each other for ever: the last look accepts a little more.
        home = good & (np.abs(step) <= (0.75 if iteration == 7 else 0.5)).all(-1)
        result[home] = (at + step)[home]
        at = np.where((good & ~home)[:, None], at + np.rint(np.clip(step, -3, 3)).astype(int), at)
    return result


def triangulate(calibration: Calibration, water_index: float, left_uv: Array, right_uv: Array) -> tuple[Array, Array]:
    """Points (n, 3) and gaps (n,) in mm, by solving for the nearest points of the two exactly traced rays."""
    o1, d1 = calibration.rig.left.rays(left_uv, water_index)
    o2, d2 = calibration.rig.right.rays(right_uv, water_index)
    normal = np.stack(
        [
            np.stack([np.sum(d1 * d1, -1), -np.sum(d1 * d2, -1)], -1),
            np.stack([np.sum(d1 * d2, -1), -np.sum(d2 * d2, -1)], -1),
        ],
        -2,
    )
    right_side = np.stack([np.sum(d1 * (o2 - o1), -1), np.sum(d2 * (o2 - o1), -1)], -1)
    s = np.linalg.solve(normal, right_side[..., None])[..., 0]
    a, b = o1 + s[:, :1] * d1, o2 + s[:, 1:] * d2
    return 0.5 * (a + b), np.linalg.norm(a - b, axis=-1)
