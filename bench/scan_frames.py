"""Owns the scan that everything is measured on: 2 × 24 frames of 1600 × 1200 with noise, and its truth.

A tilted disc that fills three quarters of the left image, made from closed forms, so that each pixel's coordinates and
correspondence are known. Noise is 1.6 grey values: 0.04 px in a coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.patterns.sequence import PatternSequence, build_sequence
from tests.support import synthetic

NOISE_DN = 1.6
RADIUS_MM = 112.0
NORMAL = np.array([-0.2, 0.15, 1.0]) / np.linalg.norm([-0.2, 0.15, 1.0])
SIDES = ("left", "right")
Array = NDArray[np.float64]


@dataclass(frozen=True)
class ScanFrames:
    """Frames and truth; arrays of the left camera unless said otherwise."""

    calibration: Calibration
    sequence: PatternSequence
    frames: dict[str, NDArray[np.uint8]]
    """(24, h, w) of each side."""
    pq_px: dict[str, Array]
    """(h, w, 2) true pattern coordinates of each side; NaN off the disc."""
    right_uv_px: Array
    """(h, w, 2) true correspondence; NaN where the right camera does not see the point."""


def make_scan(width_px: int = 1600, height_px: int = 1200, period_px: int = 16, seed: int = 1) -> ScanFrames:
    """Make the scan; some twenty seconds at full resolution."""
    cal = synthetic.calibration(width_px, height_px)
    sequence = build_sequence(period_px)
    index = synthetic.WATER.index
    centre = cal.rig.volume_centre_mm(index)
    rng = np.random.default_rng(seed)
    frames, pq_px, points = {}, {}, {}
    for side, camera in (("left", cal.rig.left), ("right", cal.rig.right)):
        at = synthetic.plane_points(camera, NORMAL, float(NORMAL @ centre))
        pq = synthetic.projector(cal).project(at, index)
        pq[np.linalg.norm(at - centre, axis=-1) > RADIUS_MM] = np.nan
        stack = np.empty((len(sequence), height_px, width_px), np.uint8)
        for k, image in enumerate(synthetic.frames(sequence, pq)):
            noise = NOISE_DN * rng.standard_normal(image.shape, dtype=np.float32)
            stack[k] = np.clip(np.rint(image + noise), 0, 255)
        inside = (pq > 0.0).all(-1) & (pq[..., 0] < 1023.0) & (pq[..., 1] < 767.0)
        pq[~inside] = np.nan
        frames[side], pq_px[side], points[side] = stack, pq, at
    uv = cal.rig.right.project(points["left"], index)
    seen = np.isfinite(pq_px["left"]).all(-1) & (uv > 2.0).all(-1)
    seen &= (uv[..., 0] < width_px - 3) & (uv[..., 1] < height_px - 3)
    uv[~seen] = np.nan
    return ScanFrames(cal, sequence, frames, pq_px, uv)
