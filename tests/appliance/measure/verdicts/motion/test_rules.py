"""The rules by which signs of movement become a kind and a verdict: each at its limit, by numbers made for it."""

from __future__ import annotations

from dataclasses import astuple, replace
from typing import Any

import numpy as np
import pytest

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.fault import FaultCode
from appliance.measure.light.patterns import RISING_STEPS, build_sequence
from appliance.measure.verdicts.motion.albedo import AlbedoShifts
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm, Place, place_of
from appliance.measure.verdicts.motion.judge import (
    MotionKind,
    _axial,
    _judgement,
    _kind,
    _lost_share,
    _shift,
    _turning_mm_s,
    mean_pair_way2,
)
from appliance.measure.verdicts.motion.scores import (
    DriftTrend,
    Scores,
    drift_trend,
    edge_course,
    texture_score,
)
from appliance.measure.verdicts.motion.texture import TextureChange
from tests.support.golden_texts import Says
from tests.support.moving_cells import COLUMNS, ROWS, cells, harm

REST = Scores(0.5, 0.5)
STILL, AXIAL, LATERAL = MotionKind.STILL, MotionKind.AXIAL, MotionKind.LATERAL
ROTATION, LOCAL = MotionKind.ROTATION, MotionKind.LOCAL


# ------------------------------------------------------------------------------------------------- verdict


def judged(added: float | None, kind: MotionKind, scores: Scores = REST, **more: Any) -> Any:
    ripple = None if added is None else float(np.sqrt((1.0 + added) ** 2 - 1.0))
    values: dict[str, Any] = {
        "axial_mm_s": 3.0,
        "lateral_mm_s": (-4.0, 2.0),
        "shift_px": 1.5,
        "place": None,
        "lost": 0.02,
    }
    return _judgement(kind, harm(ripple), scores=scores, **values | more)


@pytest.mark.parametrize(
    ("added", "kind", "passed"), [(0.069, AXIAL, True), (0.071, AXIAL, False), (0.30, STILL, True), (None, STILL, None)]
)
def test_a_scan_is_refused_for_the_noise_that_a_movement_adds_and_never_at_rest_as_in_snow(
    added: float | None, kind: MotionKind, passed: bool | None
) -> None:
    said = judged(added, kind)
    assert said.verdict.passed is passed
    assert (None if said.fault is None else said.fault.code) == (FaultCode.MOVED if passed is False else None)


def test_a_refusal_names_speed_place_and_what_is_added_and_leaves_out_what_is_not_known(says: Says) -> None:
    said = judged(0.2, AXIAL, Scores(5.0, 0.0), lateral_mm_s=None, place=Place(1.0, 2.0, "upper left"))
    assert said.fault.numbers == pytest.approx({"shift_px": 1.5, "added_noise_percent": 20.0, "speed_mm_s": 3.0})
    blind = judged(0.2, AXIAL, Scores(0.0, 9.0), lateral_mm_s=None, shift_px=None)
    assert blind.fault.numbers == pytest.approx({"added_noise_percent": 20.0})
    says(said.verdict.text, blind.verdict.text, judged(0.2, STILL).verdict.text)


@pytest.mark.parametrize(
    ("drift", "lateral_mm_s", "speed_mm_s"),
    [(4.5, None, 3.0), (4.4, (-4.0, 2.0), np.hypot(4.0, 2.0)), (4.5, (-4.0, 2.0), 29.0**0.5), (4.4, None, None)],
)
def test_what_is_certain_has_a_say_in_the_speed(
    drift: float, lateral_mm_s: tuple[float, float] | None, speed_mm_s: float | None
) -> None:
    found = judged(0.2, AXIAL, Scores(drift, 9.0), lateral_mm_s=lateral_mm_s).verdict.numbers["speed_mm_s"]
    assert found == (None if speed_mm_s is None else pytest.approx(speed_mm_s))


def test_a_turn_has_the_speed_of_its_cells_whose_median_says_nothing() -> None:
    rates = np.where(np.arange(COLUMNS) < COLUMNS // 2, -6.0, 6.0) + cells(0.0)
    turning = harm(0.6, depth_rate_mm_s=rates)
    assert (_axial(turning), _turning_mm_s(turning)) == pytest.approx((0.0, 6.0))
    said = _judgement(ROTATION, turning, 0.0, None, 1.0, None, Scores(9.0, None), 0.0)
    assert said.verdict.numbers["speed_mm_s"] == pytest.approx(6.0)
    # Cells without points say nothing.
    weight = np.where(rates > 0.0, 1.0, 0.0)
    rates[1, -1] = np.nan
    given = harm(depth_rate_mm_s=rates, weight=weight)
    assert (_axial(given), _turning_mm_s(given)) == pytest.approx((6.0, 6.0))
    assert _axial(harm(weight=cells(0.0))) is None


# ---------------------------------------------------------------------------------------------------- kind

EVEN = DriftTrend(0.02, 0.001, 0.001, (0.001, 0.001, 0.001), 20.0)


def kind(scores: Scores, trend: DriftTrend | None = EVEN, given: Harm | None = None, **more: Any) -> MotionKind:
    speed: dict[str, Any] = {"axial_mm_s": 3.0, "lateral_mm_s": None} | more
    return _kind(scores, trend, given or harm(), **speed)


@pytest.mark.parametrize("sign", ["drift", "texture"])
def test_whatever_exceeds_the_score_is_a_movement(sign: str) -> None:
    for score, still in ((4.4, True), (4.5, False)):
        assert (kind(replace(REST, **{sign: score})) is STILL) == still
    assert kind(Scores(None, None)) is STILL


BOTH, DRIFT = Scores(9.0, 9.0), replace(REST, drift=9.0)


@pytest.mark.parametrize(
    ("scores", "trend", "lateral_mm_s", "axial_mm_s", "expected"),
    [
        # Sideways is what is faster across than along by half and does not turn.
        (BOTH, EVEN, (4.6, 0.0), 3.0, LATERAL),
        (BOTH, EVEN, (4.4, 0.0), 3.0, AXIAL),
        (BOTH, EVEN, (4.0, 3.0), -3.5, AXIAL),
        (BOTH, replace(EVEN, across=0.029), (4.0, 3.0), 3.0, LATERAL),
        (BOTH, replace(EVEN, across=0.031), (4.0, 3.0), 3.0, ROTATION),
        (BOTH, None, (0.1, 0.0), None, LATERAL),
        # A score of 4.5 is the first that is certain.
        (replace(REST, drift=4.5), None, None, 3.0, AXIAL),
        (replace(REST, texture=4.5), None, None, 3.0, LATERAL),
        # A turn is a slope of the drift that is steep and certain.
        (DRIFT, replace(EVEN, across=0.013), None, 3.0, AXIAL),
        (DRIFT, replace(EVEN, across=0.015), None, 3.0, ROTATION),
        (DRIFT, replace(EVEN, down=-0.015), None, 3.0, ROTATION),
        (DRIFT, replace(EVEN, mean=-0.03, across=0.015), None, 3.0, AXIAL),
        (DRIFT, replace(EVEN, across=0.015, sd=(9.0, 0.0023, 0.0023)), None, 3.0, ROTATION),
        (DRIFT, replace(EVEN, across=0.015, sd=(0.001, 0.003, 0.003)), None, 3.0, AXIAL),
        (DRIFT, replace(EVEN, down=0.015, sd=(0.0, 0.0034, 0.0)), None, 3.0, AXIAL),
        (DRIFT, replace(EVEN, down=0.015, sd=(0.0, 0.0, 0.0034)), None, 3.0, AXIAL),
    ],
)
def test_kinds_at_their_limits(
    scores: Scores,
    trend: DriftTrend | None,
    lateral_mm_s: tuple[float, float] | None,
    axial_mm_s: float | None,
    expected: MotionKind,
) -> None:
    assert kind(scores, trend, lateral_mm_s=lateral_mm_s, axial_mm_s=axial_mm_s) is expected


NAN = float("nan")
GROUP = [(row, column) for row in (1, 2) for column in (4, 5, 6)]
TWELVE = [(row, column) for row in (1, 2, 3) for column in (3, 4, 5, 6)]
FAR = [(5, 0), (5, 1), (4, 0)]


@pytest.mark.parametrize(
    ("harmed", "drift", "expected"),
    [
        # Of nine cells in all that have most of the harm, three lie elsewhere.
        (dict.fromkeys(GROUP, 4.0) | dict.fromkeys(FAR, 3.2), 0.1, LOCAL),
        (dict.fromkeys(GROUP, 4.0) | dict.fromkeys(FAR, 3.6), 0.1, STILL),
        (dict.fromkeys(TWELVE, 4.0), 0.1, LOCAL),
        (dict.fromkeys([*TWELVE, (2, 2)], 4.0), 0.1, STILL),
        ({(2, 1): 4.0, (2, 5): 3.9}, 0.1, LOCAL),
        ({(2, 1): 4.0, (2, 6): 3.9}, 0.1, STILL),
        ({(1, 2): 4.0, (5, 2): 3.9}, 0.1, LOCAL),
        ({(0, 2): 4.0, (5, 2): 3.9}, 0.1, STILL),
        # A hundredth of what noise does to the whole scan is the least: 0.08 in six of 48 cells.
        (dict.fromkeys(GROUP, 0.082), 0.1, LOCAL),
        (dict.fromkeys(GROUP, 0.078), 0.1, STILL),
        (dict.fromkeys(GROUP, 4.0), -0.0125, LOCAL),
        (dict.fromkeys(GROUP, 4.0), 0.0115, STILL),
    ],
)
def test_local_movements_at_their_limits(
    harmed: dict[tuple[int, int], float], drift: float, expected: MotionKind
) -> None:
    assert kind(REST, given=harm(ripple_mm=rippled(harmed), drift_px=cells(drift))) is expected


def rippled(harmed: dict[tuple[int, int], float]) -> np.ndarray:
    """A harm of so many times the noise, in squares, in some cells."""
    ripple = cells(0.0)
    for at, square in harmed.items():
        ripple[at] = 0.02 * np.sqrt(square)
    return ripple


def test_a_local_movement_needs_twenty_cells_and_that_nothing_else_moves() -> None:
    for many, found in ((20, LOCAL), (19, STILL)):
        weight = np.where(np.arange(ROWS * COLUMNS) < many, 1.0, 0.0).reshape(ROWS, COLUMNS)
        corner: dict[str, Any] = {"ripple_mm": rippled({(0, 0): 4.0, (0, 1): 4.0}), "drift_px": cells(0.1)}
        assert kind(REST, given=harm(**corner, weight=weight)) is found
        assert kind(REST, given=harm(**corner, noise_mm=np.where(weight > 0.0, 0.02, np.nan))) is found
    there = harm(ripple_mm=rippled(dict.fromkeys(GROUP, 4.0)), drift_px=cells(0.1))
    for lateral_mm_s, local in (((4.0, 3.0), False), (None, True)):
        assert (kind(REST, given=there, lateral_mm_s=lateral_mm_s) is LOCAL) is local


# --------------------------------------------------------------------------------------------------- place


def test_a_harm_that_is_everywhere_has_its_middle_but_no_side() -> None:
    place = place_of(harm(), (400, 300))
    assert place is not None
    assert astuple(place) == (pytest.approx(200.0), pytest.approx(150.0), "everywhere")
    assert place_of(harm(ripple_mm=cells(0.0)), (400, 300)) is None
    # Four tenths of the cells are 20 of 48; one is harmed from a quarter of the mean square on, 0.065 here.
    for strong, weaker, square, everywhere in ((20, 0, 0.0, True), (19, 0, 0.0, False), (12, 8, 0.070, True), (12, 8, 0.060, False)):  # fmt: skip
        ripple2 = np.repeat([1.0, square, 0.0], [strong, weaker, ROWS * COLUMNS - strong - weaker])
        found = place_of(harm(ripple_mm=0.05 * np.sqrt(ripple2).reshape(ROWS, COLUMNS)), (400, 300))
        assert found is not None
        assert (found.word == "everywhere") == everywhere


@pytest.mark.parametrize(
    ("right_px", "down_px", "side"),
    [
        (47.5, 35.5, "middle"), (-47.5, -35.5, "middle"), (48.5, 0.0, "right"), (-48.5, 0.0, "left"), (0.0, 36.5, "lower"),
        (0.0, -36.5, "upper"), (-48.5, 36.5, "lower left"),
    ],
)  # fmt: skip
def test_a_side_begins_an_eighth_of_the_image_from_what_is_seen(right_px: float, down_px: float, side: str) -> None:
    ripple, u, v = cells(0.0), cells(180.0), cells(140.0)
    ripple[2, 3] = 0.05
    u[2, 3], u[3, 3] = 180.0 + right_px, 180.0 - right_px
    v[2, 3], v[3, 3] = 140.0 + down_px, 140.0 - down_px
    place = place_of(harm(ripple_mm=ripple, u_px=u, v_px=v), (400, 300))
    assert place is not None
    assert astuple(place) == (pytest.approx(180.0 + right_px), pytest.approx(140.0 + down_px), side)


# --------------------------------------------------------------------------------------------- ways and noise


def test_fringes_and_paint_make_one_way_of_the_cells_with_points_and_a_slope() -> None:
    drift, slope, weight = cells(0.02), cells(0.5), cells(1.0)
    drift[:3], weight[:3] = 0.5, 0.0
    drift[3], slope[3] = 0.5, np.nan
    rest = {name: cells(0.0) for name in DriftMap.__dataclass_fields__}
    known = DriftMap(**(rest | {"drift_px": drift, "slope_per_px": slope}))
    backwards = replace(known, drift_px=-drift)
    for one in (known, backwards):
        assert _shift(one, harm(weight=weight), None, 24) == pytest.approx(0.02 / 0.5 * 24)
    both = _shift(known, harm(weight=weight), np.array([0.3, -0.4]) / 12.0, 24)
    assert both == pytest.approx(np.hypot(0.96, 0.5 * 24 / 12))
    assert _shift(known, harm(weight=cells(0.0)), np.array([0.3, 0.4]), 24) is None


def test_what_is_shadow_or_saturated_or_veiled_was_not_lost_to_a_movement() -> None:
    decoder = CameraDecoder(build_sequence(16), 10, 10)
    kinds = (Mask.SHADOW, Mask.SATURATED, Mask.VALID, Mask.WEAK, Mask.CONTRADICTION, Mask.EDGE)
    decoder.mask[:] = np.repeat(kinds, (40, 10, 30, 5, 9, 6)).reshape(10, 10)
    decoder.backscatter_pixels = 3
    assert _lost_share(decoder) == pytest.approx((9 + 6 - 3) / (100 - 40 - 10 - 3))
    decoder.mask[:] = Mask.SHADOW
    decoder.backscatter_pixels = 0
    assert _lost_share(decoder) == 0.0


def test_the_way_of_the_paint_is_the_mean_of_the_cameras_that_see_any() -> None:
    def pair_way2(left_px: float, right_px: float) -> float | None:
        ways = (np.array([[0.0, 0.0], [0.0, 0.0], [px, 0.0]]) for px in (left_px, right_px))
        return mean_pair_way2([AlbedoShifts(way, np.zeros(3)) for way in ways], build_sequence(16, steps=RISING_STEPS))

    assert pair_way2(1.0, 3.0) == pytest.approx(5.0)
    assert pair_way2(NAN, 3.0) == pytest.approx(9.0)
    assert pair_way2(NAN, NAN) is None
    # In our order the ways of a pair are three frames and one.
    way = AlbedoShifts(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [2.0, 0.0]]), np.zeros(4))
    assert mean_pair_way2([way, way], build_sequence(16)) == pytest.approx(0.5 * (4.0 + 4.0 / 3.0))


def test_six_cells_with_points_make_a_trend_and_five_do_not() -> None:
    weight = cells(0.0)
    weight[0, :5] = 1.0
    assert drift_trend(harm(weight=weight)) is None
    weight[0, 5] = 1.0
    assert drift_trend(harm(weight=weight)) is not None


def test_edges_count_in_units_of_the_drift_where_at_least_half_of_the_cells_are_certain_of_it() -> None:
    drift = 0.02 * np.where(np.arange(COLUMNS) % 2 == 0, -1.0, 1.0) + cells(0.0)
    left = np.tile(10.0 * drift, (3, 1, 1))

    def middle(certain: np.ndarray, sd: float = 0.0066, **more: Any) -> float:
        given = harm(drift_px=drift, sd_px=np.where(certain, sd, 1.0), **more)
        return float(edge_course(left, edges(0.0), given)[0][0])

    every, half = np.full((ROWS, COLUMNS), True), np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS) < 24
    fewer = half.copy()
    fewer[0, 0] = False
    assert middle(every) == pytest.approx(0.2)
    assert middle(every, sd=0.0067) == pytest.approx(0.0), "three standard deviations"
    assert middle(half) == pytest.approx(0.2)
    assert middle(fewer) != pytest.approx(0.2)
    # What has no points is asked for nothing: eight of fifteen are enough then.
    weight = np.zeros((ROWS, COLUMNS))
    weight[0], weight[5, :7] = 1.0, 1.0
    assert middle(half, weight=weight) == pytest.approx(0.2)
    weight[5, 7], weight[4, 0] = 1.0, 1.0
    assert middle(half, weight=weight) != pytest.approx(0.2)


def edges(shift: float, frames: int = 3, holes: int = 0) -> np.ndarray:
    maps = np.full((frames, ROWS, COLUMNS), shift)
    maps.reshape(frames, -1)[:, :holes] = np.nan
    return maps


def test_gray_edges_count_left_less_right_by_their_median() -> None:
    middle, sd = edge_course(edges(0.3), edges(0.1), harm(drift_px=cells(0.0)))
    assert middle == pytest.approx([0.2] * 3)
    assert sd == pytest.approx([0.0] * 3)
    for known, told in ((5, False), (6, True)):
        few = edges(0.3, holes=ROWS * COLUMNS - known)
        assert np.isfinite(edge_course(few, edges(0.1), harm(drift_px=cells(0.0)))[0]).all() == told


def test_paint_that_changes_between_the_means_counts_against_what_it_does_at_rest() -> None:
    assert texture_score({"left": TextureChange(1.045, 1.10)}) == pytest.approx(0.0, abs=1e-9)
    assert texture_score({"left": TextureChange(1.145, 1.10)}) == pytest.approx(5.0)
    assert texture_score({"left": TextureChange(1.0, 1.45), "right": TextureChange(1.045, 1.1)}) == pytest.approx(5.0)
    assert texture_score({"left": TextureChange(1.245, 1.10, locked=2.0)}) == pytest.approx(0.2 / np.hypot(0.02, 0.08))
    assert texture_score({"left": None, "right": None}) is None


def test_the_largest_of_the_known_scores_counts() -> None:
    assert (Scores(1.0, 2.0).largest, Scores(None, 2.0).largest) == (2.0, 2.0)
    assert Scores(None, None).largest is None
