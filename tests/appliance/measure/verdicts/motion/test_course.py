"""What part of a movement makes the ripple follows from the way that the fringes went before the sines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion.course import pair_offset
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm, PairOffset

OURS = build_sequence(16)
GRAYS = len(OURS.axis(Direction.X).gray)
FRAMES = np.arange(float(GRAYS + 4))
"""Frames of the Gray images and of the sines, in the order of projection."""
MIDDLE = FRAMES - FRAMES[-4:].mean()
FRAME_S = 1.0 / 60.0
CELLS = (6, 8)


def found(way_px: np.ndarray, edge_sd_px: float = 0.005, seed: int = 1) -> PairOffset | None:
    """The offset for a way of the fringes (frames,), left less right, that cells share up to a factor between −1.3 and 1.3."""
    rng = np.random.default_rng(seed)
    factors = rng.choice([-1.0, 1.0], CELLS) * rng.uniform(0.7, 1.3, CELLS)
    axis = OURS.axis(Direction.X)
    m, n = axis.pair_frames
    x = way_px[np.array(axis.sine) - axis.gray[0]]
    nothing = {name: np.zeros(CELLS) for name in DriftMap.__dataclass_fields__}
    cosine, sine = (x[2] - x[0]) / m, (x[3] - x[1]) / n
    mean = (m * m * cosine + n * n * sine) / (m * m + n * n)
    left = DriftMap(**(nothing | {"drift_px": factors * mean}))
    right = DriftMap(**nothing)
    drift = mean * factors
    values: dict[str, Any] = dict.fromkeys(Harm.__dataclass_fields__)
    harm = Harm(**(values | {"drift_px": drift, "sd_px": np.full(CELLS, 1e-3), "weight": np.ones(CELLS)}))
    # Of the typical cell, as the course of the edges is given: left less right in the direction of its drift.
    typical = np.median(np.abs(drift)) / mean if abs(mean) > 3e-3 else 1.0
    shift = typical * (way_px[:GRAYS] - x.mean()) + edge_sd_px * rng.standard_normal(GRAYS)
    return pair_offset(shift, np.full(len(shift), edge_sd_px), left, right, harm, OURS, FRAME_S)


def of_drift2(way_px: np.ndarray, edge_sd_px: float = 0.005) -> float:
    offset = found(way_px, edge_sd_px)
    assert offset is not None
    assert offset.px2 == 0.0
    return offset.of_drift2


IS_GRAY = np.arange(len(FRAMES)) < GRAYS
STEADY_WAYS = pytest.mark.parametrize(
    ("way", "within"),
    [
        (0.2 * MIDDLE, 0.04),
        (0.2 * MIDDLE * np.where(IS_GRAY, 0.8, 1.0), 0.06),
    ],
    ids=["steady", "edges whose shifts are a fifth too small"],
)
NO_EDGE = np.where(IS_GRAY, np.nan, 0.2 * MIDDLE)


@STEADY_WAYS
def test_a_steady_movement_makes_no_ripple(way: np.ndarray, within: float) -> None:
    assert of_drift2(way) == pytest.approx(0.0, abs=within)
    assert found(NO_EDGE) is None, "nothing says that it is not steady"
    # Edges that are hardly known are no reason to fear a shake.
    assert of_drift2(0.2 * MIDDLE, edge_sd_px=0.2) == pytest.approx(0.0, abs=0.04)


def test_a_shake_that_hardly_drifts_is_not_measured_by_its_drift() -> None:
    way = 0.02 * MIDDLE + 0.3 * np.cos(2.0 * np.pi * 6.0 * FRAME_S * MIDDLE)
    x = way[-4:]
    offset2 = ((x[0] + x[3] - x[1] - x[2]) / 2.0) ** 2
    assert of_drift2(way) * 0.02**2 == pytest.approx(offset2, rel=0.35)


@pytest.mark.parametrize("per_frame_px", [0.03, 0.06])
def test_what_gathers_speed_is_offset_by_what_it_gains_per_frame(per_frame_px: float) -> None:
    way = 0.2 * MIDDLE - 0.5 * per_frame_px * MIDDLE**2
    assert of_drift2(way) == pytest.approx((per_frame_px / 0.2) ** 2, abs=0.03)


@pytest.mark.parametrize(("hz", "size_px"), [(6.0, 0.3), (10.0, 0.2)])
def test_a_shake_harms_where_it_turns_round_and_does_not_drift(hz: float, size_px: float) -> None:
    way = size_px * np.cos(2.0 * np.pi * hz * FRAME_S * MIDDLE)
    x = way[-4:]
    offset = found(way)
    assert offset is not None
    assert offset.of_drift2 == 0.0
    assert offset.px2 == pytest.approx(((x[0] + x[3] - x[1] - x[2]) / 2.0) ** 2, rel=0.25)


def test_a_drift_that_no_cell_is_certain_of_is_not_followed() -> None:
    assert found(np.where(IS_GRAY, np.nan, 1e-4 * MIDDLE)) is None, "nor without an edge"
    still = found(1e-4 * MIDDLE)
    assert still is not None
    assert still.px2 < 1e-4, "a hundredth of what a hand makes"
