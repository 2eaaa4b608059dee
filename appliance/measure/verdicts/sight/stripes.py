"""Owns how far away something lies that is saturated: by the stripes of the Gray images, which are dark however bright the
object is.

A saturated pixel has lost the fringes' phase, but not the Gray code: a white stripe saturates it, a black one does not. So both
cameras still read which half period of the fringes lights each pixel. A pixel of the left camera is laid over the right image
where each depth would put it, and lies at the depth at which the right camera reads the same number there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.sequence import Direction, PatternSequence
from appliance.measure.verdicts.sight.distance import WIDTH_PX, candidate_depths_mm, seen_at_depths

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

ASKED = 600
"""Pixels of the left camera, at most."""
LEAST_SWING_DN = 60.0
"""Least difference from the dark image to the bright one: with less, other light than the projector's saturates the pixel."""
BESIDE_MIDDLE = 0.2
"""A Gray image's grey value is neither black nor white that is so near to the middle between dark and bright, in parts of
their difference: a stripe's edge crosses the pixel, or the object moved."""
MOST_STEPS = 3
"""Most steps of depth over which the right camera may read the same number: a half period is as wide as two of them."""
LEAST_FOUND = 0.3
"""Least share of the pixels asked that must be found again. Of an object at the near end a third lies outside of the right
image; what scattered light makes of the stripes in silt is found again in one pixel of forty."""
MIN_FOUND = 40
ALIKE, LEAST_ALIKE = 0.15, 0.5
"""Half of the depths found must lie so near to their median, in parts of it: numbers that are wrong meet anywhere."""


def find_depths_by_stripes_mm(
    frames: Mapping[str, NDArray[np.uint8]], sequence: PatternSequence, rig: StereoRig, water_index: float
) -> Array:
    """Return the depth of each saturated pixel that is found again, in the left camera's frame; to 2 %. Empty where
    too few are. ``frames``: (n, h, w) uint8 of ``left`` and ``right``; 65 to 95 ms of CPU for ``ASKED`` pixels, at any size."""
    none = np.empty(0)
    factor = max(1, rig.left.width_px // WIDTH_PX)
    small = {side: frames[side][:, factor // 2 :: factor, factor // 2 :: factor] for side in ("left", "right")}
    # Only what is saturated in the bright image is asked: the rest has fringes, which say it better.
    if np.count_nonzero(small["left"][sequence.bright] == FULL_DN) < MIN_FOUND:
        return none
    left, right = (_half_periods(small[side], sequence) for side in ("left", "right"))
    v, u = np.nonzero((left >= 0) & (small["left"][sequence.bright] == FULL_DN))
    every = -(-len(v) // ASKED) or 1
    v, u = v[::every], u[::every]
    if len(v) < MIN_FOUND:
        return none
    depths_mm = candidate_depths_mm(rig, water_index)
    here_px = np.stack([u, v], -1).astype(np.float64) * factor + factor // 2
    there_px = seen_at_depths(rig, water_index, here_px, depths_mm)
    at = np.rint(np.nan_to_num((there_px - factor // 2) / factor, nan=-1e6)).astype(np.int64)
    inside = (at >= 0).all(-1) & (at[..., 0] < right.shape[1]) & (at[..., 1] < right.shape[0])
    at[~inside] = 0
    same = inside & (right[at[..., 1], at[..., 0]] == left[v, u][:, None])
    # A half period covers two or three depths: the object lies in their middle. Equal numbers far apart are chance.
    first, last = same.argmax(axis=1), same.shape[1] - 1 - same[:, ::-1].argmax(axis=1)
    found = same.any(axis=1) & (last - first <= MOST_STEPS)
    if np.count_nonzero(found) < max(MIN_FOUND, LEAST_FOUND * len(v)):
        return none
    # The candidates are equally far apart in 1/z.
    depth_mm = np.asarray(2.0 / (1.0 / depths_mm[first[found]] + 1.0 / depths_mm[last[found]]))
    alike = abs(depth_mm / np.median(depth_mm) - 1.0) < ALIKE
    return depth_mm if np.mean(alike) >= LEAST_ALIKE else none


def _half_periods(frames: NDArray[np.uint8], sequence: PatternSequence) -> NDArray[np.int64]:
    """Return (h, w) the number of the half period across the baseline that lights each pixel, by the Gray code alone;
    −1 where an image is neither black nor white."""
    dark = frames[sequence.dark].astype(np.float32)
    swing = frames[sequence.bright] - dark
    sure = swing >= LEAST_SWING_DN
    swing = np.maximum(swing, np.float32(1.0))
    number = np.zeros(dark.shape, np.int64)
    bit = np.zeros(dark.shape, np.bool_)
    for k in sequence.axis(Direction.X).gray:
        beside: Floats = (frames[k] - dark) / swing - np.float32(0.5)
        sure &= abs(beside) > BESIDE_MIDDLE
        # From Gray code to number: each bit of the number is that of the code xor the bit before.
        bit = bit ^ (beside > 0.0)
        number = 2 * number + bit
    return np.where(sure, number, -1)
