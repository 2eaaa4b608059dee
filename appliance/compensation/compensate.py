"""Owns the corrected maps: what both cameras would have decoded had nothing moved since the reference time."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.compensation.estimate import MotionEstimate, noise_dn
from appliance.compensation.paint import known_smooth, with_paint
from appliance.compensation.solve import MAX_T, SINES, Solved, Sources, Terms, depth_rows, solve_rows
from appliance.compensation.surface import rough_depth
from appliance.compensation.ways import FIRST_WAY, PER_FRAME, Ways, ways
from appliance.optics.water import Water
from appliance.patterns.sequence import Direction
from appliance.reconstruct.decode.decoder import MIN_MODULATION_DN, edge_limits_px
from appliance.reconstruct.decode.edges import keep_smooth
from appliance.reconstruct.images import ScanImages
from appliance.reconstruct.rows import LeftMaps
from appliance.scan.sides import SIDES, of_side

FILL_SHARE = 0.03
"""Of the image's width: so far is a depth carried over pixels that motion left without coordinates."""
PROBE_ROWS = 16
"""Every so many rows are asked for the fringes' second harmonic."""
MAX_HARMONIC = 0.3
ROUGH_ROWS = 4
"""Every so many rows are solved to know where paint lies."""
GOOD_VARIANCE = 1.15
"""Of a phase, of that by steps of 90°: more, and paint is asked."""
EXACT_PX, EXACT_TURNS = 0.02, 0.001
MAX_SETTLED_T = 0.02
"""2 mm: what is looked up for other things, too, is right to that."""
MISFIT_PX = 9
"""Window, in px of pictures 800 px wide, over which what contradicts is averaged."""
MOST_MISFIT = 100.0
WORTH_SHARE = 0.25
"""Of it the maps carry: reading between pixels leaves so little noise that the whole would not go into a byte."""
BY_CHANCE = 1.3
"""Times the usual: so far such a mean strays by noise alone, which neighbours share."""
MISFIT_SHARE = 0.5
"""Of what contradicts beyond noise, that is in the phase: wrong steps make half of their contradiction, wrong paint as much."""
_NAN = np.float32(np.nan)


@dataclass(frozen=True, slots=True)
class Compensated:
    """What ``Pipeline.find_replaced`` needs."""

    maps: Mapping[str, LeftMaps]
    """By side. Modulation is ``WORTH_SHARE`` of that which four steps of 90° would need for as much noise."""
    modulation_half_dn: NDArray[np.uint8]
    """(h, w): what the left camera truly saw."""


@dataclass(frozen=True, slots=True)
class _Side:
    maps: LeftMaps
    modulation_half_dn: NDArray[np.uint8]


def compensate(scanned: ScanImages, calibration: Calibration, water: Water, motion: MotionEstimate) -> Compensated:
    """Follow the scanned points through the frames and decode them anew."""
    sequence = scanned.sequence
    x, y = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    followed = (*x.sine, sequence.bright, *x.gray, *y.gray)
    axes = (0,) * (SINES + 1 + len(x.gray)) + (1,) * len(y.gray)
    moved_mm = motion.course_mm[list(followed)]
    rig = calibration.rig

    def solve(side: str) -> _Side:
        camera = of_side(rig, side)
        way = ways(
            camera, motion.projector.eye, water.index, moved_mm, motion.centre_mm, axes, float(sequence.period_px)
        )
        px_per_mm = camera.lens.f_px[0] * water.index / float(motion.centre_mm[2])
        return _solve(scanned, side, motion, followed, way, motion.gray_place_mm * px_per_mm)

    with ThreadPoolExecutor(len(SIDES), "kf-compensate") as pool:
        both = dict(zip(SIDES, pool.map(solve, SIDES), strict=True))
    return Compensated({side: one.maps for side, one in both.items()}, both["left"].modulation_half_dn)


def _solve(
    scanned: ScanImages, side: str, motion: MotionEstimate, followed: tuple[int, ...], way: Ways, place_px: float
) -> _Side:
    sequence, decoder = scanned.sequence, scanned.decoded[side]
    noise = of_side(scanned.noise, side)
    height, width = decoder.p_px.shape
    # One kind of array, whether it may be written or not: each kind would be compiled for itself.
    frames = scanned.frames[side].view()
    frames.flags.writeable = False
    nothing = np.zeros((0, 0), np.float32)
    sources = Sources(
        frames, np.asarray(followed, np.int64), decoder.p_px, rough_depth(decoder.p_px, way), nothing, nothing, nothing
    )
    terms = Terms(
        np.float32(sequence.period_px), np.float32(sequence.width_px), np.float32(sequence.height_px),
        np.float32(MIN_MODULATION_DN), np.float32(noise_dn(scanned, side)),
        np.float32(noise.dark_variance_dn2), np.float32(noise.dn_per_e),
        len(sequence.axis(Direction.X).gray), round(FILL_SHARE * width), np.float32(settled_t(way)),
        np.float32(0.0), np.float32(0.0),
    )  # fmt: skip
    if phase_variance(way) > GOOD_VARIANCE:
        sources = with_paint(sequence, sources, terms, way, place_px, ROUGH_ROWS)
    solved = Solved(
        np.full((height, width), np.nan, np.float32), np.full((height, width), np.nan, np.float32),
        np.empty((height, width), np.uint8), np.empty((height, width), np.float32), np.empty((height, width), np.float32),
        np.empty((height, width), np.uint8), np.empty((height, width), np.uint8), np.zeros((height, 2), np.int32),
    )  # fmt: skip
    gains = (1.0 / (1.0 + motion.gains)).astype(np.float32)
    terms = _probed(sources, way, gains, terms, solved)
    if sources.paint.size:
        # Once more, with paint from the depth that the first one leads to.
        solve_rows(sources, way, gains, terms, 0, height, ROUGH_ROWS, solved, np.zeros((2, 2)))
        nearer = sources._replace(rough=_nearest_rows(solved.p_px, sources.rough, way))
        sources = with_paint(sequence, nearer, terms, way, place_px)
        terms = _probed(sources, way, gains, terms, solved)
    solve_rows(sources, way, gains, terms, 0, height, 1, solved, np.zeros((2, 2)))
    jump_px, bend_px = edge_limits_px(sequence.period_px, width)
    drop_edges(solved.p_px, solved.q_px, jump_px, bend_px)
    drop_new_borders(solved.p_px, solved.q_px, decoder.p_px)
    worth = _less_misfit(solved.worth_dn, solved.misfit, motion.ripple_after, width)
    maps = LeftMaps(solved.p_px, solved.q_px, worth, solved.bright, solved.light, solved.lit_columns)
    return _Side(maps, solved.modulation_half_dn)


def _nearest_rows(p_px: NDArray[np.float32], rough: NDArray[np.float32], way: Ways) -> NDArray[np.float32]:
    """t by every ``ROUGH_ROWS``-th row of columns; ``rough`` where they say nothing."""
    height, width = p_px.shape
    depth = np.empty_like(rough)
    depth_rows(
        np.repeat(p_px[::ROUGH_ROWS], ROUGH_ROWS, axis=0)[:height], way, round(FILL_SHARE * width), 0, height, depth
    )
    return np.asarray(np.where(np.abs(depth) < MAX_T, depth, rough), np.float32)


def phase_variance(way: Ways) -> float:
    """Of the x-sines' phases where points are followed, of that by steps of 90°; in the middle of the volume, median over
    the image, mean over all phases."""
    first = FIRST_WAY + 6
    moved = way.nodes[..., first : first + SINES * PER_FRAME : PER_FRAME].astype(np.float64)
    steps = 2.0 * np.pi * (moved + 0.25 * np.arange(SINES))
    A = np.stack([np.ones_like(steps), np.cos(steps), -np.sin(steps)], -1)
    inverse = np.linalg.inv(np.einsum("...ki,...kj->...ij", A, A) + 1e-9 * np.eye(3))
    return float(np.median(inverse[..., 1, 1] + inverse[..., 2, 2]))


def settled_t(way: Ways) -> float:
    """By how much a depth may be wrong and nothing is read elsewhere for it: no sine by more than ``EXACT_PX``, no step by
    more than ``EXACT_TURNS``."""
    by_t = (
        np.abs(way.nodes[..., FIRST_WAY : FIRST_WAY + SINES * PER_FRAME]).reshape(-1, SINES, 3, 3)[..., 1].max((0, 1))
    )
    return float(min(MAX_SETTLED_T, EXACT_PX / max(by_t[:2].max(), 1e-9), EXACT_TURNS / max(by_t[2], 1e-9)))


def _probed(sources: Sources, way: Ways, gains: NDArray[np.float32], terms: Terms, solved: Solved) -> Terms:
    """``terms`` with what every so many rows tell of fringes and light: first of the light, then, with that, of harmonics."""
    height = sources.p_px.shape[0]
    for _ in range(2 if sources.paint.size else 1):
        told = np.zeros((2, 2))
        solve_rows(sources, way, gains, terms, PROBE_ROWS // 2, height, PROBE_ROWS, solved, told)
        harmonic, mean = told[:, 0] / np.maximum(told[:, 1], 1e-9)
        terms = terms._replace(
            harmonic=np.float32(np.clip(harmonic, -MAX_HARMONIC, MAX_HARMONIC)),
            mean_share=np.float32(np.clip(mean, 0.0, 1.0)),
        )
    return terms


def drop_new_borders(p_px: NDArray[np.float32], q_px: NDArray[np.float32], plain_px: NDArray[np.float32]) -> None:
    """NaN for what the plain decoding does not confirm beside what neither knows: a spot between pixels reaches over an edge
    by one pixel more than a pixel does."""
    beside = cv2.dilate(np.isnan(p_px).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    dropped = beside & np.isnan(plain_px)
    p_px[dropped] = np.nan
    q_px[dropped] = np.nan


def _less_misfit(
    worth_dn: NDArray[np.float32], misfit: NDArray[np.float32], ripple: float, width: int
) -> NDArray[np.uint8]:
    """``WORTH_SHARE`` of the modulation that noise of 90° steps would need to scatter as this does, in half grey values: also
    by what the frames contradict.

    The median of that is the fringes' harmonics, which depth does not see, and ``ripple``, which is known of its own.
    """
    window = 2 * round(0.5 * MISFIT_PX * width / 800.0) + 1
    around = known_smooth(np.minimum(misfit, np.float32(MOST_MISFIT)), window)
    known = around[np.isfinite(around)]
    usual = float(np.median(known)) if known.size else 1.0
    beyond = np.maximum(np.nan_to_num(around, nan=usual) - BY_CHANCE * max(usual, 1.0), 0.0)
    worse = np.sqrt(1.0 + ripple**2 + MISFIT_SHARE * beyond)
    return np.asarray(np.minimum(2.0 * WORTH_SHARE * worth_dn / worse + 0.5, 255.0), np.uint8)


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
            for x in range(width):  # a slice would bring the text of its error, which takes the compiler 3 s
                rows[k, y % 3, 1 + x] = source[y, x] if y < height else _NAN
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
