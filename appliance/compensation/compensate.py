"""Owns the corrected maps: what both cameras would have decoded had nothing moved since the reference time."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.estimate import MotionEstimate, Scanned, noise_dn
from appliance.compensation.hand import SHIFT, TURN, between_mm
from appliance.compensation.solve import Solved, Sources, Terms, solve_rows
from appliance.compensation.ways import Ways, ways
from appliance.optics.water import Water
from appliance.patterns.sequence import Direction
from appliance.reconstruct.decode import MIN_MODULATION_DN, edge_limits_px
from appliance.reconstruct.edges import keep_smooth
from appliance.reconstruct.pipeline import SIDES
from appliance.reconstruct.rows import LeftMaps

Array = NDArray[np.float64]

FILL_SHARE = 0.03
"""Of the image's width: so far is a depth carried over pixels that motion left without coordinates."""
PROBE_ROWS = 16
"""Every so many rows are asked for the fringes' second harmonic."""
MAX_HARMONIC = 0.3
_NAN = np.float32(np.nan)


@dataclass(frozen=True, slots=True)
class Compensated:
    """What ``Pipeline.find_replaced`` needs."""

    maps: Mapping[str, LeftMaps]
    """By side."""
    sigma_factor: float
    """Noise of the new phases against that of four steps of 90°, the motion's own uncertainty included."""


def compensate(scanned: Scanned, calibration: Calibration, water: Water, motion: MotionEstimate) -> Compensated:
    """Follow the scanned points through all frames and decode them anew."""
    sequence = scanned.sequence
    x, y = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    followed = (*motion.frames, sequence.bright, *x.gray, *y.gray)
    axes = (0,) * 4 + (1,) * 4 + (0,) + (0,) * len(x.gray) + (1,) * len(y.gray)
    moved_mm = _motion_at(motion, scanned.frame_s, followed)
    rig = calibration.rig

    def solve(side: str) -> LeftMaps:
        camera = rig.left if side == "left" else rig.right
        way = ways(
            camera, motion.projector.eye, water.index, moved_mm, motion.centre_mm, axes, float(sequence.period_px)
        )
        return _solve(scanned, side, motion, followed, way)

    with ThreadPoolExecutor(len(SIDES), "kf-compensate") as pool:
        return Compensated(dict(zip(SIDES, pool.map(solve, SIDES), strict=True)), motion.error_after)


def _motion_at(motion: MotionEstimate, frame_s: float, followed: tuple[int, ...]) -> Array:
    known_s, wanted_s = frame_s * np.asarray(motion.frames), frame_s * np.asarray(followed[len(motion.frames) :])
    others = [
        between_mm(hand, known_s, motion.motion_mm[:, part], wanted_s, motion.reference_s)
        for hand, part in ((SHIFT, slice(0, 3)), (TURN, slice(3, 6)))
    ]
    return np.concatenate([motion.motion_mm, np.concatenate(others, -1)])


def _solve(scanned: Scanned, side: str, motion: MotionEstimate, followed: tuple[int, ...], way: Ways) -> LeftMaps:
    sequence, decoder = scanned.sequence, scanned.decoded[side]
    height, width = decoder.p_px.shape
    # One kind of array, whether it may be written or not: each kind would be compiled for itself.
    frames = scanned.frames[side].view()
    frames.flags.writeable = False
    sources = Sources(frames, np.asarray(followed, np.int64), decoder.p_px)
    solved = Solved(
        np.empty((height, width), np.float32), np.empty((height, width), np.float32),
        np.empty((height, width), np.uint8), np.empty((height, width), np.uint8), np.empty((height, width), np.uint8),
        np.zeros((height, 2), np.int32),
    )  # fmt: skip
    terms = Terms(
        np.float32(sequence.period_px), np.float32(sequence.width_px), np.float32(sequence.height_px),
        np.float32(MIN_MODULATION_DN), np.float32(noise_dn(scanned, side)), np.float32(0.0), np.float32(0.0),
        len(sequence.axis(Direction.X).gray), len(sequence.axis(Direction.Y).gray), round(FILL_SHARE * width),
    )  # fmt: skip
    gains = (1.0 / (1.0 + motion.gains)).astype(np.float32)
    harmonics = np.zeros((2, 2))
    solve_rows(sources, way, gains, terms, PROBE_ROWS // 2, height, PROBE_ROWS, solved, harmonics)
    share = np.clip(harmonics[:, 0] / np.maximum(harmonics[:, 1], 1e-9), -MAX_HARMONIC, MAX_HARMONIC)
    terms = terms._replace(harmonic_x=np.float32(share[0]), harmonic_y=np.float32(share[1]))
    solve_rows(sources, way, gains, terms, 0, height, 1, solved, harmonics)
    jump_px, bend_px = edge_limits_px(sequence.period_px, width)
    drop_edges(solved.p_px, solved.q_px, jump_px, bend_px)
    return LeftMaps(
        solved.p_px, solved.q_px, solved.modulation_half_dn, solved.bright, solved.light, solved.lit_columns
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def drop_edges(p_px: NDArray[np.float32], q_px: NDArray[np.float32], jump_px: np.float32, bend_px: np.float32) -> None:
    """NaN for what is an edge in either map (h, w), each pixel judged by its neighbours as they were."""
    height, width = p_px.shape
    rows = np.full((2, 3, width + 2), _NAN, np.float32)
    smooth = np.empty(width, np.float32)
    edge, edges = np.empty(width, np.uint8), np.empty(width, np.uint8)
    for y in range(height + 1):
        edges[:] = 0
        for k in range(2):
            source = p_px if k == 0 else q_px
            if y < height:
                rows[k, y % 3, 1 : width + 1] = source[y]
            else:
                rows[k, y % 3, :] = _NAN
            if y > 0:
                keep_smooth(
                    rows[k, (y - 2) % 3, 1 : width + 1], rows[k, (y - 1) % 3], rows[k, y % 3, 1 : width + 1], jump_px,
                    bend_px, smooth, edge,
                )  # fmt: skip
                for x in range(width):
                    edges[x] |= edge[x]
        if y > 0:
            for x in range(width):
                if edges[x]:
                    p_px[y - 1, x] = _NAN
                    q_px[y - 1, x] = _NAN
