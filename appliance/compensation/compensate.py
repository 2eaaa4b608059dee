"""Owns the corrected maps: what both cameras would have decoded had nothing moved since the reference time."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.beside import choose_shares, with_depth, with_paint
from appliance.compensation.estimate import MotionEstimate, Scanned, noise_dn
from appliance.compensation.paint import known_smooth
from appliance.compensation.solve import Solved, Sources, Terms, solve_rows
from appliance.compensation.ways import Ways, ways
from appliance.optics.water import Water
from appliance.patterns.sequence import Direction
from appliance.reconstruct.decode import MIN_MODULATION_DN, edge_limits_px
from appliance.reconstruct.edges import keep_smooth
from appliance.reconstruct.pipeline import SIDES
from appliance.reconstruct.rows import LeftMaps

FILL_SHARE = 0.03
"""Of the image's width: so far is a depth carried over pixels that motion left without coordinates."""
PROBE_ROWS = 16
"""Every so many rows are asked for the fringes' second harmonic."""
MAX_HARMONIC = 0.3
PASSES = (3, 3, 1)
"""Every so many rows are solved, each time with the depth that the time before found, where points are followed in part."""
MISFIT_PX = 9
"""Window, in px of pictures 800 px wide, over which what contradicts is averaged."""
MOST_MISFIT = 100.0
MISFIT_SHARE = 0.5
"""Of what contradicts beyond noise, that is in the phase: wrong steps make half of their contradiction, wrong paint as much."""
_NAN = np.float32(np.nan)


@dataclass(frozen=True, slots=True)
class Compensated:
    """What ``Pipeline.find_replaced`` needs."""

    maps: Mapping[str, LeftMaps]
    """By side. Modulation is that which four steps of 90° would need for as much noise: sigma is then made of it as ever."""
    modulation_half_dn: NDArray[np.uint8]
    """(h, w): what the left camera truly saw."""


@dataclass(frozen=True, slots=True)
class _Side:
    maps: LeftMaps
    modulation_half_dn: NDArray[np.uint8]


def compensate(scanned: Scanned, calibration: Calibration, water: Water, motion: MotionEstimate) -> Compensated:
    """Follow the scanned points through all frames and decode them anew."""
    sequence = scanned.sequence
    x, y = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    followed = (*motion.frames, sequence.bright, *x.gray, *y.gray)
    axes = (0,) * 4 + (1,) * 4 + (0,) + (0,) * len(x.gray) + (1,) * len(y.gray)
    moved_mm = motion.course_mm[list(followed)]
    rig = calibration.rig

    def solve(side: str) -> _Side:
        camera = rig.left if side == "left" else rig.right
        way = ways(
            camera, motion.projector.eye, water.index, moved_mm, motion.centre_mm, axes, float(sequence.period_px)
        )
        return _solve(scanned, side, motion, followed, way)

    with ThreadPoolExecutor(len(SIDES), "kf-compensate") as pool:
        both = dict(zip(SIDES, pool.map(solve, SIDES), strict=True))
    return Compensated({side: one.maps for side, one in both.items()}, both["left"].modulation_half_dn)


def _solve(scanned: Scanned, side: str, motion: MotionEstimate, followed: tuple[int, ...], way: Ways) -> _Side:
    sequence, decoder = scanned.sequence, scanned.decoded[side]
    noise = scanned.noise.left if side == "left" else scanned.noise.right
    height, width = decoder.p_px.shape
    # One kind of array, whether it may be written or not: each kind would be compiled for itself.
    frames = scanned.frames[side].view()
    frames.flags.writeable = False
    sources = Sources(
        frames, np.asarray(followed, np.int64), decoder.p_px, *(np.zeros((0, 0), np.float32) for _ in range(6))
    )
    solved = Solved(
        np.full((height, width), np.nan, np.float32), np.full((height, width), np.nan, np.float32),
        np.empty((height, width), np.uint8), np.empty((height, width), np.uint8), np.empty((height, width), np.float32),
        np.empty((height, width), np.uint8), np.empty((height, width), np.uint8), np.zeros((height, 2), np.int32),
    )  # fmt: skip
    follow_x, follow_y = choose_shares(way)
    terms = Terms(
        np.float32(sequence.period_px), np.float32(sequence.width_px), np.float32(sequence.height_px),
        np.float32(MIN_MODULATION_DN), np.float32(noise_dn(scanned, side)),
        np.float32(noise.read_dn**2 - noise.dn_per_e * noise.black_dn), np.float32(noise.dn_per_e),
        np.float32(0.0), np.float32(0.0), len(sequence.axis(Direction.X).gray), len(sequence.axis(Direction.Y).gray),
        round(FILL_SHARE * width), np.float32(follow_x), np.float32(follow_y),
    )  # fmt: skip
    gains = (1.0 / (1.0 + motion.gains)).astype(np.float32)
    partly = min(follow_x, follow_y) < 1.0
    if partly:
        sources = with_paint(sequence, sources, terms, way)
    for stride in PASSES if partly else PASSES[-1:]:
        if partly:
            sources = with_depth(sources, terms, way)
        harmonics = np.zeros((2, 2))
        straight = terms._replace(harmonic_x=np.float32(0.0), harmonic_y=np.float32(0.0))
        solve_rows(sources, way, gains, straight, PROBE_ROWS // 2, height, PROBE_ROWS, solved, harmonics)
        share = np.clip(harmonics[:, 0] / np.maximum(harmonics[:, 1], 1e-9), -MAX_HARMONIC, MAX_HARMONIC)
        terms = terms._replace(harmonic_x=np.float32(share[0]), harmonic_y=np.float32(share[1]))
        solve_rows(sources, way, gains, terms, 0, height, stride, solved, harmonics)
        sources = sources._replace(p_px=solved.p_px.copy())
    jump_px, bend_px = edge_limits_px(sequence.period_px, width)
    drop_edges(solved.p_px, solved.q_px, jump_px, bend_px)
    worth = _less_misfit(solved.worth_half_dn, solved.misfit, motion.ripple_after, width)
    maps = LeftMaps(solved.p_px, solved.q_px, worth, solved.bright, solved.light, solved.lit_columns)
    return _Side(maps, solved.modulation_half_dn)


def _less_misfit(
    worth_half_dn: NDArray[np.uint8], misfit: NDArray[np.float32], ripple: float, width: int
) -> NDArray[np.uint8]:
    """The modulation that noise of 90° steps would need to scatter as this does: also by what the frames contradict.

    The median of that is the fringes' harmonics, which depth does not see, and ``ripple``, which is known of its own.
    """
    window = 2 * round(0.5 * MISFIT_PX * width / 800.0) + 1
    around = known_smooth(np.minimum(misfit, np.float32(MOST_MISFIT)), window)
    known = around[np.isfinite(around)]
    usual = float(np.median(known)) if known.size else 1.0
    beyond = np.maximum(np.nan_to_num(around, nan=usual) - max(usual, 1.0), 0.0)
    worse = np.sqrt(1.0 + ripple**2 + MISFIT_SHARE * beyond)
    return np.asarray(worth_half_dn / worse + 0.5, np.uint8)


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
