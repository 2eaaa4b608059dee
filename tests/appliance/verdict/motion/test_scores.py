"""Signs of movement become scores: each statistic over its own scatter and over what it may be off at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from appliance.verdict.motion.edges import EdgeShifts
from appliance.verdict.motion.scores import (
    Scores,
    drift_trend,
    edge_course,
    edges_score,
    flow_score,
    texture_score,
)
from tests.support.moving_cells import COLUMNS, NO_COURSE, ROWS, cells, harm, texture


def test_a_trend_is_the_weighted_least_squares_of_the_cells() -> None:
    rng = np.random.default_rng(2)
    drift, sd = rng.normal(0.0, 0.02, (ROWS, COLUMNS)), rng.uniform(0.0005, 0.004, (ROWS, COLUMNS))
    weight = np.where(rng.random((ROWS, COLUMNS)) < 0.8, 1.0, 0.0)
    trend = drift_trend(harm(drift_px=drift, sd_px=sd, weight=weight))
    assert trend is not None
    down, across = np.meshgrid(np.linspace(-1.0, 1.0, ROWS), np.linspace(-1.0, 1.0, COLUMNS), indexing="ij")
    error = np.hypot(sd, 0.001)[weight > 0.0]
    basis = np.stack([np.ones_like(across), across, down], -1)[weight > 0.0] / error[:, None]
    fit = np.linalg.lstsq(basis, drift[weight > 0.0] / error, rcond=None)[0]
    scatter = np.sum((drift[weight > 0.0] / error - basis @ fit) ** 2) / (len(basis) - 3)
    assert scatter > 50.0, "the cells scatter by far more than they say"
    certain = np.sqrt(np.diag(np.linalg.inv(basis.T @ basis)) * scatter)
    assert (trend.mean, trend.across, trend.down) == pytest.approx(tuple(fit), rel=1e-6)
    assert trend.sd == pytest.approx(tuple(certain), rel=1e-6)
    assert trend.score == pytest.approx(float(np.max(np.abs(fit) / np.hypot(certain, 0.001))), rel=1e-6)


def test_edges_count_in_units_of_the_drift_where_at_least_half_of_the_cells_are_certain_of_it() -> None:
    sign = np.where(np.arange(COLUMNS) % 2 == 0, -1.0, 1.0)
    drift = 0.02 * np.broadcast_to(sign, (ROWS, COLUMNS))

    def middle(certain: np.ndarray, sd: float = 0.0066, **more: Any) -> float:
        left = edges(0.0)
        left.shift_px[:] = 10.0 * drift
        given = harm(drift_px=drift, sd_px=np.where(certain, sd, 1.0), **more)
        return float(edge_course({"left": left, "right": edges(0.0)}, given)[0][0])

    every, half = np.full((ROWS, COLUMNS), True), np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS) < 24
    assert middle(every) == pytest.approx(0.2)
    assert middle(every, sd=0.0067) == pytest.approx(0.0), "three standard deviations"
    assert middle(half) == pytest.approx(0.2)
    fewer = half.copy()
    fewer[0, 0] = False
    assert middle(fewer) != pytest.approx(0.2)
    # What has no points is asked for nothing: eight of fifteen are enough then.
    weight = np.zeros((ROWS, COLUMNS))
    weight[0], weight[5, :7] = 1.0, 1.0
    assert middle(half, weight=weight) == pytest.approx(0.2)
    weight[5, 7], weight[4, 0] = 1.0, 1.0
    assert middle(half, weight=weight) != pytest.approx(0.2)


def test_cells_that_hardly_drift_say_nothing_in_units_of_it() -> None:
    values = np.linspace(0.1, 0.3, ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    left = edges(0.0)
    for share, counted in ((0.29, 26), (0.31, 48)):
        drift = np.full(ROWS * COLUMNS, 0.02)
        drift[26:] = share * 0.02
        left.shift_px[:] = values * drift.reshape(ROWS, COLUMNS) / 0.02
        given = harm(drift_px=drift.reshape(ROWS, COLUMNS), sd_px=cells(0.0001))
        middle, sd = edge_course({"left": left, "right": edges(0.0)}, given)
        mine = values.ravel()[:counted]
        assert middle == pytest.approx([np.median(mine)] * 3)
        spread = np.median(np.abs(mine - np.median(mine)))
        assert sd == pytest.approx([1.25 * 1.4826 * spread / np.sqrt(counted)] * 3)


def test_an_even_drift_is_its_mean_and_a_turn_its_slope_with_their_uncertainty() -> None:
    trend = drift_trend(harm())
    assert trend is not None
    assert (trend.mean, trend.across, trend.down) == pytest.approx((0.02, 0.0, 0.0), abs=1e-9)
    sd = np.hypot(0.002, 0.001) / np.sqrt(ROWS * COLUMNS)
    assert trend.sd[0] == pytest.approx(sd, rel=1e-3)
    assert trend.score == pytest.approx(0.02 / np.hypot(sd, 0.001), rel=1e-3)
    y, x = np.mgrid[-1.0 : 1.0 : ROWS * 1j, -1.0 : 1.0 : COLUMNS * 1j]
    turn = drift_trend(harm(drift_px=-0.01 + 0.03 * x - 0.02 * y))
    assert turn is not None
    assert (turn.mean, turn.across, turn.down) == pytest.approx((-0.01, 0.03, -0.02), abs=1e-6)
    weight = cells(0.0)
    weight[0, :5] = 1.0
    assert drift_trend(harm(weight=weight)) is None
    weight[0, 5] = 1.0
    assert drift_trend(harm(weight=weight)) is not None


def test_uncertain_cells_and_those_without_points_have_little_say() -> None:
    drift, sd = cells(0.02), cells(0.002)
    drift[0], sd[0] = 5.0, 100.0
    trend = drift_trend(harm(drift_px=drift, sd_px=sd))
    assert trend is not None
    assert trend.mean == pytest.approx(0.02, abs=1e-4)


def edges(shift: float, frames: int = 3, holes: int = 0) -> EdgeShifts:
    maps = np.full((frames, ROWS, COLUMNS), shift)
    maps.reshape(frames, -1)[:, :holes] = np.nan
    return EdgeShifts(maps)


def test_gray_edges_count_left_less_right_by_their_median() -> None:
    middle, sd = edge_course({"left": edges(0.3), "right": edges(0.1)}, harm(drift_px=cells(0.0)))
    assert middle == pytest.approx([0.2] * 3)
    assert sd == pytest.approx([0.0] * 3)
    assert edges_score((middle, sd)) == pytest.approx(0.2 / 0.025)
    assert edges_score((np.array([0.1, -0.4, np.nan]), np.array([0.02, 0.06, np.nan]))) == pytest.approx(0.4 / 0.065)
    few = {"left": edges(0.3, holes=ROWS * COLUMNS - 5), "right": edges(0.1)}
    assert np.isnan(edge_course(few, harm(drift_px=cells(0.0)))[0]).all()
    assert edges_score(NO_COURSE) is None
    enough = {"left": edges(0.3, holes=ROWS * COLUMNS - 6), "right": edges(0.1)}
    assert np.isfinite(edge_course(enough, harm(drift_px=cells(0.0)))[0]).all()


def test_scattered_edges_have_the_uncertainty_of_a_median() -> None:
    rng = np.random.default_rng(4)
    left, right = edges(0.0, frames=400), edges(0.1, frames=400)
    left.shift_px[:] = 0.3 + rng.normal(0.0, 0.05, left.shift_px.shape)
    middle, sd = edge_course({"left": left, "right": right}, harm(drift_px=cells(0.0)))
    assert np.mean(middle) == pytest.approx(0.2, abs=0.002)
    assert np.median(sd) == pytest.approx(np.std(middle), rel=0.15), "what is said is what 400 frames scatter by"


def test_edges_of_a_turn_count_in_units_of_its_drift_so_that_they_do_not_cancel() -> None:
    sign = np.where(np.arange(COLUMNS) < COLUMNS // 2, -1.0, 1.0)
    drift = 0.02 * np.broadcast_to(sign, (ROWS, COLUMNS))
    left = edges(0.0)
    left.shift_px[:] = 10.0 * drift
    middle, _ = edge_course({"left": left, "right": edges(0.0)}, harm(drift_px=drift))
    assert np.abs(middle) == pytest.approx([0.2] * 3)
    uncertain = harm(drift_px=drift, sd_px=cells(0.02))
    assert edge_course({"left": left, "right": edges(0.0)}, uncertain)[0] == pytest.approx([0.0] * 3)


def test_the_camera_that_saw_more_of_the_paint_counts() -> None:
    textures = {"left": texture((0.3, 0.4), 0.0), "right": texture((0.6, -0.8), 0.48)}
    assert flow_score(textures) == pytest.approx(0.5 / 0.02)
    assert flow_score({"left": texture((0.6, -0.8), 0.48)}) == pytest.approx(1.0 / np.hypot(0.48, 0.02))
    assert flow_score({"left": texture()}) is None


def test_paint_that_changes_between_the_means_counts_against_what_it_does_at_rest() -> None:
    assert texture_score({"left": texture(change=1.045, early=1.10)}) == pytest.approx(0.0, abs=1e-9)
    assert texture_score({"left": texture(change=1.145, early=1.10)}) == pytest.approx(5.0)
    both = {"left": texture(change=1.0, early=1.45), "right": texture(change=1.045, early=1.1)}
    assert texture_score(both) == pytest.approx(5.0)
    assert texture_score({"left": texture(change=2.0)}) is None


def test_the_largest_of_the_known_scores_counts() -> None:
    assert Scores(None, 2.0, None, 1.0).largest == 2.0
    assert Scores(None, None, None, None).largest is None
