"""Corrected maps: what both cameras would have decoded had nothing moved since the reference time.

Every pixel of both cameras is followed through the x-sines and the Gray images (``displacement``) and solved for its
true phase steps (``phase_solver``). Then edges, and points beside a hole that the plain decoding does not confirm, are
dropped. What the frames contradict counts as noise: the maps carry the variance of each coordinate.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.decode.decoder import MIN_MODULATION_DN, edge_limits_px
from appliance.measure.decode.edges import keep_smooth
from appliance.measure.light.patterns import RISING_STEPS, Direction
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.sine import PHASE_STEPS
from appliance.measure.light.water import Water
from appliance.measure.motion.displacement import (
    FIRST_FRAME,
    FRAME_COEFFICIENTS,
    DisplacementField,
    displacement_field,
)
from appliance.measure.motion.estimate import WORKING_WIDTH_PX, MotionEstimate, noise_dn
from appliance.measure.motion.phase_solver import RedecodedMaps, Sources, Terms, depth_rows, solve_rows
from appliance.measure.points.rows import LeftMaps
from appliance.measure.scan_images import ScanImages

Map = NDArray[np.float32]

FILL_SHARE = 0.03
"""Distance, as a share of the image's width, over which a depth is carried to pixels that motion left without
coordinates."""
PROBE_ROWS = 16
"""Every so many rows of pictures 800 px wide tell the fringes' second harmonic and the sines' mean light."""
MAX_HARMONIC = 0.3
"""The largest second harmonic that is believed, as a share of the first."""
WIDE_PX = 8
"""Size of a wide window in the smaller image that its mean is taken in."""
EXACT_PX, EXACT_TURNS = 0.02, 0.001
"""Errors of a displacement and a phase step that are not worth reading again."""
MAX_SETTLED_T = 0.02
"""Depths are right to this in any case (2 mm), for what else is read there."""
MISFIT_PX = 9
"""Window, in px of pictures 800 px wide, over which the misfit is averaged."""
MOST_MISFIT = 100.0
"""A pixel's misfit counts up to here."""
BY_CHANCE = 1.3
"""Mean misfits up to so many times the usual are noise, which neighbours share."""
MISFIT_SHARE = 0.5
"""Share of the misfit beyond noise that is in the phase: half of what wrong steps contradict."""
BLOCKS_ACROSS = 100
"""Blocks across the image whose depths make the rough surface."""
FEWEST = 3
"""Pixels with a column that make a block's depth."""
MEDIAN_BLOCKS = 5
"""Window of the median filter over the blocks."""
BESIDE_PX = 2
"""A spot between pixels reaches so far."""
_NAN = np.float32(np.nan)


def compensate(
    images: ScanImages, calibration: Calibration, water: Water, motion: MotionEstimate
) -> dict[str, LeftMaps]:
    """Follow the points of a scan through its frames by the estimated ``motion``, and decode them anew.

    Returns, by side, the maps that ``Pipeline.find_replaced`` needs, each with the variance of its coordinates.
    """
    sequence = images.sequence
    x, y = sequence.axis(Direction.X), sequence.axis(Direction.Y)
    followed = (*x.sine, sequence.bright, *x.gray, *y.gray)
    axes = (0,) * (PHASE_STEPS + 1 + len(x.gray)) + (1,) * len(y.gray)
    moved_mm = motion.trajectory_mm[list(followed)]
    rig = calibration.rig

    def solve(side: str) -> LeftMaps:
        camera = of_side(rig, side)
        field = displacement_field(
            camera,
            motion.projector.camera,
            water.index,
            moved_mm,
            motion.centre_mm,
            axes,
            float(sequence.period_px),
            rig.volume,
        )
        return _redecode(images, side, motion, followed, field)

    with ThreadPoolExecutor(len(SIDES), "kf-compensate") as pool:
        return dict(zip(SIDES, pool.map(solve, SIDES), strict=True))


def _redecode(
    images: ScanImages,
    side: str,
    motion: MotionEstimate,
    followed: tuple[int, ...],
    field: DisplacementField,
) -> LeftMaps:
    """Decode one camera's frames along its displacement field."""
    sequence, decoder = images.sequence, images.decoded[side]
    noise = of_side(images.noise, side)
    height, width = decoder.p_px.shape
    # One kind of array, whether it may be written or not: each kind would be compiled for itself.
    frames = images.frames[side].view()
    frames.flags.writeable = False
    rough_t = rough_depth(decoder.p_px, field)
    rough_t[~sees_fringes(frames[list(sequence.axis(Direction.X).sine)], field)] = np.nan
    gains = (1.0 / (1.0 + motion.gains)).astype(np.float32)
    sources = Sources(frames, np.asarray(followed, np.int64), gains, decoder.p_px, rough_t)
    terms = Terms(
        period_px=np.float32(sequence.period_px),
        width_px=np.float32(sequence.width_px),
        height_px=np.float32(sequence.height_px),
        noise_dn=np.float32(noise_dn(images, side)),
        dark_dn2=np.float32(noise.dark_variance_dn2),
        shot_dn=np.float32(noise.dn_per_e),
        gray=len(sequence.axis(Direction.X).gray),
        fill_px=round(FILL_SHARE * width),
        settled_t=np.float32(settled_t(field)),
        harmonic=np.float32(0.0),
    )
    solved = empty_maps(height, width)
    terms = _probed(sources, field, terms, solved)
    solve_rows(sources, field, terms, 0, 1, solved, np.zeros(2))
    jump_px, bend_px = edge_limits_px(sequence.period_px, width, sequence.width_px)
    drop_edges(solved.p_px, solved.q_px, jump_px, bend_px)
    drop_new_borders(solved.p_px, solved.q_px, decoder.p_px)
    return LeftMaps(
        solved.p_px,
        solved.q_px,
        solved.modulation_half_dn,
        solved.bright,
        solved.offset_dn,
        solved.illuminated_columns,
        # What is left of a contradiction makes a ripple where the steps rise, and next to none in the other order.
        variance_px2=solved.variance_px2
        * misfit_factor(solved.misfit, motion.ripple_after if sequence.steps == RISING_STEPS else 0.0, width),
    )


def empty_maps(height: int, width: int) -> RedecodedMaps:
    """Return maps (height, width) without any coordinate."""
    shape = (height, width)
    return RedecodedMaps(
        p_px=np.full(shape, np.nan, np.float32),
        q_px=np.full(shape, np.nan, np.float32),
        modulation_half_dn=np.empty(shape, np.uint8),
        variance_px2=np.empty(shape, np.float32),
        misfit=np.empty(shape, np.float32),
        bright=np.empty(shape, np.uint8),
        offset_dn=np.empty(shape, np.uint8),
        illuminated_columns=np.zeros((height, 2), np.int32),
    )


def sees_fringes(sines: NDArray[np.uint8], field: DisplacementField) -> NDArray[np.bool_]:
    """Return which pixels (h, w) any point with fringes may be followed from, by the x-sines (4, h, w) of one camera.

    A pixel that is lit by a sine of modulation m swings by at least √2 m over four steps of 90°. Where none does by
    ``MIN_MODULATION_DN`` within reach of a point's way, the solver would find too little modulation.
    """
    swing = cv2.subtract(np.asarray(sines.max(0)), np.asarray(sines.min(0)))
    ways = np.abs(
        field.nodes[..., FIRST_FRAME : FIRST_FRAME + PHASE_STEPS * FRAME_COEFFICIENTS].reshape(-1, PHASE_STEPS, 3, 3)
    )
    # Of the parabola's coefficients, for any depth between t = −1 and 1.
    reach = 2 * (BESIDE_PX + math.ceil(float(ways[:, :, :2].sum(-1).max()))) + 1
    lit = (swing >= MIN_MODULATION_DN).astype(np.uint8)
    return np.asarray(cv2.dilate(lit, np.ones((reach, reach), np.uint8)), np.bool_)


def rough_depth(p_px: Map, field: DisplacementField) -> Map:
    """Return where the surface roughly is, t (h, w), everywhere in a picture, by decoded columns ``p_px`` (h, w).

    Medians of blocks, where a block has none those of larger ones, and linear between. Zero, the middle of the volume,
    where no column is known at all.
    """
    height, width = p_px.shape
    depth = np.empty((height, width), np.float32)
    depth_rows(p_px, field, 0, depth)
    step = max(2, width // BLOCKS_ACROSS)
    rows, columns = height // step, width // step
    # Up: blocks of blocks, until one is left. Down: each fills what the finer one does not know.
    levels = [_medians(depth[: rows * step, : columns * step], step, FEWEST)]
    while max(levels[-1].shape) > 1:
        below = levels[-1]
        even = np.pad(below, [(0, n % 2) for n in below.shape], constant_values=np.nan)
        levels.append(_medians(even, 2, 1))
    full: Map = np.nan_to_num(levels[-1]).astype(np.float32)
    for below in levels[-2::-1]:
        around = cv2.resize(full, below.shape[::-1], interpolation=cv2.INTER_LINEAR)
        full = np.asarray(np.where(np.isfinite(below), below, around), np.float32)
    full = np.asarray(cv2.medianBlur(full, MEDIAN_BLOCKS), np.float32)
    whole = cv2.resize(full, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
    return np.asarray(
        cv2.copyMakeBorder(whole, 0, height - rows * step, 0, width - columns * step, cv2.BORDER_REPLICATE), np.float32
    )


def _medians(values: Map, step: int, fewest: int) -> Map:
    """Return the medians of blocks of ``step`` px; NaN where fewer than ``fewest`` values are known."""
    rows, columns = values.shape[0] // step, values.shape[1] // step
    blocks = values.reshape(rows, step, columns, step).transpose(0, 2, 1, 3).reshape(rows, columns, step * step)
    known = np.isfinite(blocks).sum(-1)
    ordered = np.sort(blocks, axis=-1)
    # NaN come last.
    middle = np.take_along_axis(ordered, np.maximum(known - 1, 0)[..., None] // 2, -1)[..., 0]
    return np.where(known >= fewest, middle, np.float32(np.nan))


def settled_t(field: DisplacementField) -> float:
    """Return by how much a depth t may be wrong without anything being read elsewhere for it.

    No sine moves by more than ``EXACT_PX``, no step by more than ``EXACT_TURNS``.
    """
    sines = np.abs(field.nodes[..., FIRST_FRAME : FIRST_FRAME + PHASE_STEPS * FRAME_COEFFICIENTS])
    by_t = sines.reshape(-1, PHASE_STEPS, 3, 3)[..., 1].max((0, 1))
    return float(min(MAX_SETTLED_T, EXACT_PX / max(by_t[:2].max(), 1e-9), EXACT_TURNS / max(by_t[2], 1e-9)))


def _probed(sources: Sources, field: DisplacementField, terms: Terms, solved: RedecodedMaps) -> Terms:
    """Return ``terms`` with the fringes' second harmonic, fitted to some rows."""
    _, width = sources.p_px.shape
    every = PROBE_ROWS * max(1, width // WORKING_WIDTH_PX)
    sums = np.zeros(2)
    solve_rows(sources, field, terms, every // 2, every, solved, sums)
    harmonic = sums[0] / max(sums[1], 1e-9)
    return terms._replace(harmonic=np.float32(np.clip(harmonic, -MAX_HARMONIC, MAX_HARMONIC)))


def drop_new_borders(p_px: Map, q_px: Map, plain_px: Map) -> None:
    """Drop (NaN) what the plain decoding ``plain_px`` does not confirm beside what has no coordinate; all (h, w).

    A spot between pixels reaches over an edge by one pixel more than a pixel does: without this rule, holes are filled
    with bad points.
    """
    beside = cv2.dilate(np.isnan(p_px).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    dropped = beside & np.isnan(plain_px)
    p_px[dropped] = np.nan
    q_px[dropped] = np.nan


def misfit_factor(misfit: Map, ripple: float, width: int) -> Map:
    """Return by how many times (h, w) a coordinate's variance is that of noise, where the frames contradict each other.

    It grows by ``MISFIT_SHARE`` of the misfit (h, w; NaN: no column) beyond the usual, averaged around each pixel. The
    median misfit is the fringes' harmonics, which depth does not see; ``ripple``, in units of noise, is what the motion
    leaves of its own.
    """
    around = known_mean(np.minimum(misfit, np.float32(MOST_MISFIT)), scaled_window(MISFIT_PX, width))
    known = around[np.isfinite(around)]
    usual = float(np.median(known)) if known.size else 1.0
    beyond = np.maximum(np.nan_to_num(around, nan=usual) - BY_CHANCE * max(usual, 1.0), 0.0)
    return np.asarray(1.0 + ripple**2 + MISFIT_SHARE * beyond, np.float32)


def scaled_window(px: int, width: int) -> int:
    """Return a window of ``px`` of 800 in px of a picture ``width`` px wide; odd."""
    return 2 * round(0.5 * px * width / 800.0) + 1


def known_mean(values: Map, window_px: int) -> Map:
    """Return the mean (h, w) of the finite ``values`` within ``window_px`` around each pixel; NaN where there is none.

    It is taken in a smaller image, of which the window covers about ``WIDE_PX``.
    """
    height, width = values.shape
    times = max(1, window_px // WIDE_PX)
    known = np.isfinite(values)
    size = (-(-width // times), -(-height // times))
    share = cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    total = cv2.resize(np.where(known, values, np.float32(0.0)), size, interpolation=cv2.INTER_AREA)
    window = (window_px // times | 1, window_px // times | 1)
    share, total = cv2.boxFilter(share, -1, window), cv2.boxFilter(total, -1, window)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(share > 1e-6, total / share, _NAN).astype(np.float32)
    return np.asarray(cv2.resize(mean, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def drop_edges(p_px: Map, q_px: Map, jump_px: np.float32, bend_px: np.float32) -> None:
    """Drop (NaN) what is an edge in either map (h, w), each pixel judged by its neighbours as they were.

    ``rows`` (2, 3, w + 2) keeps three rows of both maps in turns, with a NaN at either end.
    """
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
            # Row y − 1 has both neighbours now.
            if y > 0:
                keep_smooth(
                    rows[k, (y - 2) % 3, 1 : width + 1],
                    rows[k, (y - 1) % 3],
                    rows[k, y % 3, 1 : width + 1],
                    jump_px,
                    bend_px,
                    smooth,
                    edge,
                )
                for x in range(width):
                    edges[x] |= edge[x]
        if y > 0:
            for x in range(width):
                if edges[x]:
                    p_px[y - 1, x] = _NAN
                    q_px[y - 1, x] = _NAN
