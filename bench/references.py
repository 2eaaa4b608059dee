"""References for the product's decoding: plain NumPy, OpenCV's vector operations, and float64 with a KD-tree."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Direction, PatternSequence, inverse_gray
from bench.scan_frames import ScanFrames
from tests.support import oracle, synthetic

Frames = NDArray[np.uint8]


def numpy_decode(sequence: PatternSequence, frames: Frames) -> list[NDArray[np.float32]]:
    """Return both coordinates of one camera, float32, by NumPy."""
    middle = ((frames[sequence.bright].astype(np.uint16) + frames[sequence.dark] + 1) >> 1).astype(np.uint8)
    coordinates = []
    for direction in (Direction.X, Direction.Y):
        axis = sequence.axis(direction)
        code = np.zeros(middle.shape, np.uint8)
        for k in axis.gray:
            code = (code << 1) | (frames[k] >= middle)
        half = inverse_gray(len(axis.gray))[code].astype(np.float32)
        i0, i1, i2, i3 = (frames[k].astype(np.float32) for k in axis.sine)
        wrapped = np.arctan2(i3 - i1, i0 - i2) * np.float32(0.5 / np.pi)
        centre = np.float32(0.5) * half + np.float32(0.25)
        offset = wrapped - centre
        offset -= np.floor(offset + np.float32(0.5))
        coordinate = sequence.period_px * (centre + offset) - np.float32(0.5)
        weak = np.hypot(i3 - i1, i0 - i2) < 10.0
        coordinate[weak] = np.nan
        coordinates.append(coordinate)
    return coordinates


def opencv_decode(sequence: PatternSequence, frames: Frames) -> list[NDArray[np.float32]]:
    """Return both coordinates of one camera by OpenCV's vector operations."""
    middle = cv2.addWeighted(frames[sequence.bright], 0.5, frames[sequence.dark], 0.5, 0.0)
    coordinates = []
    for direction in (Direction.X, Direction.Y):
        axis = sequence.axis(direction)
        code, ones = np.zeros(middle.shape, np.uint8), np.ones(middle.shape, np.uint8)
        for k in axis.gray:
            bit = cv2.bitwise_and(cv2.compare(frames[k], middle, cv2.CMP_GE), ones)
            code = cv2.bitwise_or(cv2.add(code, code), bit)
        table = np.zeros(256, np.float32)
        table[: 1 << len(axis.gray)] = 0.5 * inverse_gray(len(axis.gray)) + 0.25
        centre = cv2.LUT(code, table)
        i0, i1, i2, i3 = (frames[k] for k in axis.sine)
        cosine, sine = cv2.subtract(i0, i2, dtype=cv2.CV_32F), cv2.subtract(i3, i1, dtype=cv2.CV_32F)
        length, angle = cv2.cartToPolar(cosine, sine)
        offset = cv2.addWeighted(angle, 0.5 / math.pi, centre, -1.0, 0.0)
        rounded = np.asarray(np.rint(offset), np.float32)
        offset = cv2.subtract(offset, rounded)
        coordinate = cv2.addWeighted(centre, float(sequence.period_px), offset, float(sequence.period_px), -0.5)
        weak = cv2.inRange(length, np.zeros(1), np.full(1, 10.0))
        cv2.copyTo(np.full_like(coordinate, np.nan), weak, coordinate)
        coordinates.append(np.asarray(coordinate, np.float32))
    return coordinates


def reference_scan(scan: ScanFrames) -> int:
    """Reconstruct the scan in float64 NumPy with a KD-tree; return the number of points."""
    valid, pq = {}, {}
    for side, frames in scan.frames.items():
        decoded = oracle.decode(scan.sequence, frames)
        bright, dark = (frames[k].astype(int) for k in (scan.sequence.bright, scan.sequence.dark))
        good = (bright - dark >= 8) & (decoded.modulation >= 5.0) & (np.abs(decoded.offset) <= 0.36).all(-1)
        valid[side], pq[side] = good, decoded.pq
    v, u = np.nonzero(valid["left"])
    right_uv = oracle.match(pq["left"][v, u], pq["right"], valid["right"])
    has_match = np.isfinite(right_uv).all(-1)
    left_uv = np.stack([u, v], -1)[has_match].astype(float)
    points, _ = oracle.triangulate(scan.calibration, synthetic.WATER.index, left_uv, right_uv[has_match])
    return len(points)
