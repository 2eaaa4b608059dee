"""Owns a compensation of nothing, which runs every kernel once: at installation to compile them, at start to load them."""

from __future__ import annotations

import numpy as np

from appliance.compensation.compensate import drop_edges
from appliance.compensation.grays import Stripes, accumulate_gray
from appliance.compensation.paint import Asked, Gathered, gather
from appliance.compensation.residuals import FRAMES, PARAMETERS, SMOOTH_TERMS, Samples, accumulate
from appliance.compensation.solve import FIRST_GRAY, Solved, Sources, Terms, depth_rows, solve_rows
from appliance.compensation.ways import FIRST_WAY, PER_FRAME, Ways

_SIZE = (8, 8)


def run_every_kernel() -> None:
    """On arrays of the kinds that a scan has."""
    samples = Samples(
        np.zeros((0, 2)), np.zeros((0, 2, 3)), np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 3)), np.zeros((0, 3)),
        np.zeros((0, SMOOTH_TERMS)),
    )  # fmt: skip
    accumulate(
        samples, np.zeros((FRAMES, *_SIZE), np.float32), np.zeros(PARAMETERS), 0, np.ones(3), 0,
        np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)),
    )  # fmt: skip
    stripes = Stripes(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    accumulate_gray(
        samples, np.zeros((0, 2)), np.zeros((0, *_SIZE), np.float32), stripes, 16.0, 1.0, np.zeros((0, 6)), np.zeros(0), 1.0,
        np.zeros((0, 0)), np.zeros(0), np.zeros(0),
    )  # fmt: skip
    p_px = np.full(_SIZE, np.nan, np.float32)
    solved = Solved(
        p_px.copy(), p_px.copy(), np.zeros(_SIZE, np.uint8), p_px.copy(), p_px.copy(),
        np.zeros(_SIZE, np.uint8), np.zeros(_SIZE, np.uint8), np.zeros((_SIZE[0], 2), np.int32),
    )  # fmt: skip
    one = np.float32(1.0)
    terms = Terms(one, one, one, one, one, one, one, 0, 0, one, one, one)
    ways = Ways(np.ones((2, 2, FIRST_WAY + PER_FRAME * FIRST_GRAY), np.float32), _SIZE[0])
    followed = np.zeros(FIRST_GRAY, np.int64)
    frames = np.zeros((1, *_SIZE), np.uint8)
    frames.flags.writeable = False  # as they are always handed on
    sources = Sources(frames, followed, *(p_px,) * 5)
    solve_rows(sources, ways, np.ones(FRAMES, np.float32), terms, 0, _SIZE[0], 1, solved, np.zeros((2, 2)))
    depth_rows(p_px, ways, 0, 0, _SIZE[0], p_px.copy())
    asked = Asked(stripes, np.zeros(0, np.int64), 0)
    gather(frames, asked, ways, p_px, one, 0, _SIZE[0], 1, Gathered(*(p_px.copy() for _ in range(4))))
    drop_edges(solved.p_px, solved.q_px, one, one)
