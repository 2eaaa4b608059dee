"""The rules by which signs of movement become a kind and a verdict: each at its limit, by numbers made for it."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.scan.fault import FaultCode
from appliance.scan.noise import CameraNoise
from appliance.verdict.motion.albedo import AlbedoShifts
from appliance.verdict.motion.drift import DriftMap
from appliance.verdict.motion.harm import Place, place_of
from appliance.verdict.motion.judge import (
    MotionKind,
    _axial,
    _double_step2,
    _judgement,
    _kind,
    _lateral,
    _lost_share,
    _shift,
    _to_and_fro,
    _turning_mm_s,
    _variance,
)
from appliance.verdict.motion.scores import (
    MOVED,
    DriftTrend,
    Scores,
)
from tests.support import synthetic
from tests.support.moving_cells import COLUMNS, NO_COURSE, ROWS, cells, harm, texture

REST = Scores(0.5, 0.5, 0.5, 0.5)


# ------------------------------------------------------------------------------------------------- verdict


def judged(added: float | None, kind: MotionKind, scores: Scores = REST, **more: Any) -> Any:
    ripple = None if added is None else float(np.sqrt((1.0 + added) ** 2 - 1.0))
    values: dict[str, Any] = {
        "axial_mm_s": 3.0,
        "lateral_mm_s": (-4.0, 2.0),
        "shift_px": 1.5,
        "place": None,
        "lost": 0.02,
    } | more
    return _judgement(kind, harm(ripple), scores=scores, **values)


@pytest.mark.parametrize(
    ("added", "kind", "passed"),
    [
        (0.069, MotionKind.AXIAL, True),
        (0.071, MotionKind.AXIAL, False),
        (0.30, MotionKind.AXIAL, False),
        (0.30, MotionKind.STILL, True),
        (0.0, MotionKind.STILL, True),
        (None, MotionKind.STILL, None),
    ],
)
def test_a_scan_is_refused_for_the_noise_that_a_movement_adds_and_never_at_rest_as_in_snow(
    added: float | None, kind: MotionKind, passed: bool | None
) -> None:
    said = judged(added, kind)
    assert said.verdict.passed is passed
    assert (said.fault is not None) == (passed is False)
    if said.fault is not None:
        assert said.fault.code is FaultCode.MOVED
        assert said.fault.numbers["added_noise_percent"] == pytest.approx(100.0 * (added or 0.0))


def test_the_numbers_of_a_verdict_are_those_that_were_measured_with_their_signs() -> None:
    numbers = judged(0.2, MotionKind.AXIAL, Scores(5.0, 1.0, 6.0, 2.0)).verdict.numbers
    assert (numbers["axial_mm_s"], numbers["right_mm_s"], numbers["down_mm_s"]) == (3.0, -4.0, 2.0)
    assert numbers["speed_mm_s"] == pytest.approx(np.sqrt(9.0 + 16.0 + 4.0))
    assert numbers["added_noise_percent"] == pytest.approx(20.0)
    assert numbers["limit_percent"] == pytest.approx(7.0)
    assert numbers["lost_percent"] == pytest.approx(2.0)
    assert (numbers["score"], numbers["score_limit"]) == (6.0, 4.5)


def test_a_verdict_carries_every_number_it_was_made_from() -> None:
    place = Place(120.0, 80.0, "upper left")
    scores = Scores(5.0, 1.0, 6.0, 2.0)
    numbers = judged(0.2, MotionKind.AXIAL, scores, place=place).verdict.numbers
    assert (numbers["ripple_mm"], numbers["noise_mm"], numbers["shift_px"]) == (0.004, 0.02, 1.5)
    assert (numbers["place_u_px"], numbers["place_v_px"]) == (120.0, 80.0)
    known = [numbers[f"score_{name}"] for name in ("drift", "edges", "flow", "texture")]
    assert known == [5.0, 1.0, 6.0, 2.0]
    still = judged(0.2, MotionKind.STILL, scores, place=place, lateral_mm_s=None).verdict
    assert (still.numbers["place_u_px"], still.numbers["place_v_px"]) == (None, None)
    assert (still.numbers["right_mm_s"], still.numbers["down_mm_s"]) == (None, None)
    assert still.text == "still"
    nowhere = judged(0.2, MotionKind.AXIAL, scores).verdict.numbers
    assert (nowhere["place_u_px"], nowhere["place_v_px"]) == (None, None)


def test_a_refusal_names_speed_place_and_what_is_added_and_leaves_out_what_is_not_known() -> None:
    said = judged(0.2, MotionKind.AXIAL, Scores(5.0, 0.0, 0.0, 0.0), place=Place(1.0, 2.0, "upper left"))
    assert said.verdict.text == "axial 3.0 mm/s, upper left; adds 20 % noise"
    assert said.fault.numbers == pytest.approx({"shift_px": 1.5, "added_noise_percent": 20.0, "speed_mm_s": 3.0})
    blind = judged(0.2, MotionKind.AXIAL, Scores(0.0, 9.0, 0.0, 0.0), shift_px=None)
    assert blind.verdict.text == "axial; adds 20 % noise"
    assert blind.fault.numbers == pytest.approx({"added_noise_percent": 20.0})


def test_only_what_is_certain_has_a_say_in_the_speed() -> None:
    def speed(scores: Scores, kind: MotionKind = MotionKind.AXIAL) -> float | None:
        found = judged(0.2, kind, scores).verdict.numbers["speed_mm_s"]
        return None if found is None else float(found)

    assert speed(Scores(4.5, 0.0, 4.4, 0.0)) == pytest.approx(3.0)
    assert speed(Scores(4.4, 0.0, 4.5, 0.0)) == pytest.approx(np.hypot(4.0, 2.0))
    assert speed(Scores(4.4, 9.0, None, 9.0)) is None


def test_a_turn_has_the_speed_of_its_cells_whose_median_says_nothing() -> None:
    rates = cells(0.0)
    rates[:, : COLUMNS // 2], rates[:, COLUMNS // 2 :] = -6.0, 6.0
    turning = harm(0.6, depth_rate_mm_s=rates)
    assert _axial(turning) == pytest.approx(0.0)
    assert _turning_mm_s(turning) == pytest.approx(6.0)
    said = _judgement(MotionKind.ROTATION, turning, 0.0, None, 1.0, None, Scores(9.0, None, None, None), 0.0)
    assert said.verdict.numbers["speed_mm_s"] == pytest.approx(6.0)


def test_cells_without_points_say_nothing_of_the_speed() -> None:
    rates, weight = cells(3.0), cells(1.0)
    rates[0], weight[0] = 99.0, 0.0
    rates[1, 0] = np.nan
    assert _axial(harm(depth_rate_mm_s=rates, weight=weight)) == pytest.approx(3.0)
    assert _turning_mm_s(harm(depth_rate_mm_s=rates, weight=weight)) == pytest.approx(3.0)
    assert _axial(harm(weight=cells(0.0))) is None


# ---------------------------------------------------------------------------------------------------- kind

EVEN = DriftTrend(0.02, 0.001, 0.001, (0.001, 0.001, 0.001), 20.0)


def kind(scores: Scores, trend: DriftTrend | None = EVEN, course: Any = NO_COURSE, **more: Any) -> MotionKind:
    values: dict[str, Any] = {"axial_mm_s": 3.0, "lateral_mm_s": None} | more
    given = values.pop("harm", harm())
    return _kind(scores, trend, given, course, values["axial_mm_s"], values["lateral_mm_s"])


@pytest.mark.parametrize("sign", ["drift", "edges", "flow", "texture"])
def test_whatever_exceeds_the_score_is_a_movement(sign: str) -> None:
    for score, still in ((4.4, True), (4.6, False), (8.0, False)):
        assert (kind(replace(REST, **{sign: score})) is MotionKind.STILL) == still
    assert kind(Scores(None, None, None, None)) is MotionKind.STILL


def test_sideways_is_what_is_faster_across_than_along_and_does_not_turn() -> None:
    both = Scores(9.0, 0.0, 9.0, 0.0)
    assert kind(both, lateral_mm_s=(4.0, 3.0)) is MotionKind.LATERAL
    assert kind(both, lateral_mm_s=(-3.0, 3.0)) is MotionKind.AXIAL
    assert kind(both, lateral_mm_s=(4.0, 3.0), axial_mm_s=-3.5) is MotionKind.AXIAL
    assert kind(replace(both, flow=4.0), lateral_mm_s=(40.0, 30.0)) is MotionKind.AXIAL, "not certain"
    turning = replace(EVEN, across=0.04)
    assert kind(both, turning, lateral_mm_s=(4.0, 3.0)) is MotionKind.ROTATION
    assert kind(replace(REST, flow=9.0), None) is MotionKind.LATERAL
    assert kind(replace(REST, texture=9.0), None) is MotionKind.LATERAL
    assert kind(replace(REST, edges=9.0), None) is MotionKind.AXIAL


def test_a_turn_is_a_slope_of_the_drift_that_is_steep_and_certain() -> None:
    moved = replace(REST, drift=9.0)
    assert kind(moved, replace(EVEN, across=0.013)) is MotionKind.AXIAL
    assert kind(moved, replace(EVEN, across=0.015)) is MotionKind.ROTATION
    assert kind(moved, replace(EVEN, down=-0.015)) is MotionKind.ROTATION
    assert kind(moved, replace(EVEN, across=0.015, sd=(0.001, 0.003, 0.003))) is MotionKind.AXIAL
    assert kind(moved, replace(EVEN, mean=-0.03, across=0.015)) is MotionKind.AXIAL


def test_kinds_at_their_limits() -> None:
    both = Scores(9.0, 0.0, 9.0, 0.0)
    assert kind(both, replace(EVEN, across=0.029), lateral_mm_s=(4.0, 3.0)) is MotionKind.LATERAL
    assert kind(both, replace(EVEN, across=0.031), lateral_mm_s=(4.0, 3.0)) is MotionKind.ROTATION
    assert kind(both, lateral_mm_s=(4.6, 0.0)) is MotionKind.LATERAL
    assert kind(both, lateral_mm_s=(4.4, 0.0)) is MotionKind.AXIAL
    assert kind(both, None, lateral_mm_s=(0.1, 0.0), axial_mm_s=None) is MotionKind.LATERAL
    assert kind(replace(REST, edges=9.0), None, axial_mm_s=None) is MotionKind.AXIAL, (
        "what does not slide is not lateral"
    )
    # A score of 4.5 is the first that counts.
    for sign, found in (("drift", MotionKind.AXIAL), ("flow", MotionKind.LATERAL), ("texture", MotionKind.LATERAL)):
        assert kind(replace(REST, **{sign: 4.5}), None) is found
    assert kind(replace(both, flow=4.5), lateral_mm_s=(40.0, 30.0)) is MotionKind.LATERAL
    assert kind(Scores(4.4, 9.0, 4.4, None), None) is MotionKind.AXIAL
    moved = replace(REST, drift=9.0)
    assert kind(moved, replace(EVEN, across=0.015, sd=(9.0, 0.0023, 0.0023))) is MotionKind.ROTATION
    for sd in ((0.0, 0.0034, 0.0), (0.0, 0.0, 0.0034)):
        assert kind(moved, replace(EVEN, down=0.015, sd=sd)) is MotionKind.AXIAL


def test_a_quarter_of_the_way_back_is_shaking() -> None:
    sd = np.full(8, 0.01)
    for way in (1.0, -1.0):
        for back, shaking in ((0.26, True), (0.24, False)):
            course = way * np.array([1.0, 0.8, 0.6, 0.4, 0.4 + back, 0.3, 0.2, 0.1])
            assert _to_and_fro((course, sd)) == shaking
        for least, shaking in ((0.11, True), (0.105, False)):  # four times 0.0269
            assert _to_and_fro((way * np.array([0.0, least] + [0.0] * 6), sd)) == shaking
    for uncertain, shaking in ((0.0249, True), (0.0251, False)):
        sd[1] = uncertain
        assert _to_and_fro((np.array([0.0, 9.0] + [0.0] * 6), sd)) == shaking, "beyond 2.5 times the usual"
    sd[1] = np.nan
    assert not _to_and_fro((np.array([0.0, 9.0] + [0.0] * 6), sd))
    assert _to_and_fro((np.array([0.0, 0.9, 0.0, 0.0] + [np.nan] * 4), np.full(8, 0.01))), "four frames do"


def somewhere(harmed: dict[tuple[int, int], float], drift: float = 0.1, **more: Any) -> MotionKind:
    """Kind of a scan at rest with a harm of so many times the noise, in squares, in some cells."""
    ripple = cells(0.0)
    for at, square in harmed.items():
        ripple[at] = 0.02 * np.sqrt(square)
    return kind(REST, harm=harm(ripple_mm=ripple, drift_px=cells(drift), **more))


GROUP = [(row, column) for row in (1, 2) for column in (4, 5, 6)]


def test_what_is_local_is_so_at_its_limits() -> None:
    assert somewhere(dict.fromkeys(GROUP, 4.0)) is MotionKind.LOCAL
    # Of nine cells in all that have most of the harm, three lie elsewhere.
    far = [(5, 0), (5, 1), (4, 0)]
    for square, found in ((4.0 * 0.80, MotionKind.LOCAL), (4.0 * 0.90, MotionKind.STILL)):
        assert somewhere(dict.fromkeys(GROUP, 4.0) | dict.fromkeys(far, square)) is found
    twelve = [(row, column) for row in (1, 2, 3) for column in (3, 4, 5, 6)]
    assert somewhere(dict.fromkeys(twelve, 4.0)) is MotionKind.LOCAL
    assert somewhere(dict.fromkeys([*twelve, (2, 2)], 4.0)) is MotionKind.STILL
    assert somewhere({(2, 1): 4.0, (2, 5): 3.9}) is MotionKind.LOCAL
    assert somewhere({(2, 1): 4.0, (2, 6): 3.9}) is MotionKind.STILL
    assert somewhere({(1, 2): 4.0, (5, 2): 3.9}) is MotionKind.LOCAL
    assert somewhere({(0, 2): 4.0, (5, 2): 3.9}) is MotionKind.STILL
    # A hundredth of what noise does to the whole scan is the least: 0.08 in six of 48 cells.
    assert somewhere(dict.fromkeys(GROUP, 0.082)) is MotionKind.LOCAL
    assert somewhere(dict.fromkeys(GROUP, 0.078)) is MotionKind.STILL
    assert somewhere(dict.fromkeys(GROUP, 4.0), drift=-0.0125) is MotionKind.LOCAL
    assert somewhere(dict.fromkeys(GROUP, 4.0), drift=0.0115) is MotionKind.STILL


def test_a_local_movement_needs_twenty_cells_and_that_nothing_else_moves() -> None:
    for many, found in ((20, MotionKind.LOCAL), (19, MotionKind.STILL)):
        weight = np.where(np.arange(ROWS * COLUMNS) < many, 1.0, 0.0).reshape(ROWS, COLUMNS)
        assert somewhere({(0, 0): 4.0, (0, 1): 4.0}, weight=weight) is found
        noise = np.where(weight > 0.0, 0.02, np.nan)
        assert somewhere({(0, 0): 4.0, (0, 1): 4.0}, noise_mm=noise) is found
    ripple = cells(0.0)
    ripple[1:3, 4:7] = 0.04
    there = harm(ripple_mm=ripple, drift_px=cells(0.1))
    for sign in ("flow", "edges"):
        assert kind(replace(REST, **{sign: 4.5}), harm=there) is not MotionKind.LOCAL
        assert kind(replace(REST, **{sign: 4.4}), harm=there) is MotionKind.LOCAL
    assert kind(Scores(0.5, None, None, 0.5), harm=there) is MotionKind.LOCAL


def test_shaking_goes_to_and_fro_by_more_than_its_uncertainty() -> None:
    sd = np.full(8, 0.01)

    def course(*values: float) -> Any:
        return np.array(values), sd

    assert _to_and_fro(course(0.0, 0.3, 0.6, 0.3, 0.0, -0.3, 0.0, 0.2))
    assert not _to_and_fro(course(0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)), "steadily towards the sine images"
    assert not _to_and_fro(course(0.7, 0.6, 0.5, 0.62, 0.3, 0.2, 0.1, 0.0)), "a fifth of the way back is none"
    assert not _to_and_fro(course(0.0, 0.05, 0.0, 0.05, 0.0, 0.05, 0.0, 0.05)), "less than its uncertainty"
    assert not _to_and_fro((np.array([0.0, 0.9, 0.0] + [np.nan] * 5), sd)), "three frames tell nothing"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not _to_and_fro(NO_COURSE), "nor does it warn of means of nothing"
    uncertain = sd.copy()
    uncertain[[1, 2]] = 1.0
    assert not _to_and_fro((np.array([0.1, 9.0, -9.0, 0.1, 0.1, 0.1, 0.05, 0.0]), uncertain)), "coarse bits"
    assert kind(replace(REST, drift=9.0), course=course(0.0, 0.3, 0.6, 0.3, 0.0, -0.3, 0.0, 0.2)) is MotionKind.TREMOR


def test_something_else_moves_where_few_cells_close_together_have_the_harm() -> None:
    ripple, drift = cells(0.0005), cells(0.0)
    ripple[1:3, 5:8] = 0.05
    drift[1:3, 5:8] = 0.1
    there = harm(ripple_mm=ripple, drift_px=drift)
    assert kind(REST, harm=there) is MotionKind.LOCAL
    assert kind(replace(REST, flow=4.6), harm=there) is not MotionKind.LOCAL, "all of it slides"
    assert kind(replace(REST, edges=4.6), harm=there) is not MotionKind.LOCAL
    assert kind(REST, harm=harm(ripple_mm=ripple, drift_px=drift / 10.0)) is MotionKind.STILL, "not certain"
    scattered = cells(0.0005)
    scattered[[0, 0, 5, 5, 2, 3], [0, 7, 0, 7, 3, 5]] = 0.05
    assert kind(REST, harm=harm(ripple_mm=scattered, drift_px=cells(0.1))) is MotionKind.STILL
    weight = cells(0.0)
    weight[1:3, 5:8] = 1.0
    assert kind(REST, harm=harm(ripple_mm=ripple, drift_px=drift, weight=weight)) is MotionKind.STILL, "too few cells"
    place = place_of(there, (400, 300))
    assert place is not None
    assert place.word == "upper right"
    assert place.u_px == pytest.approx(325.0, abs=5.0)
    assert place.v_px == pytest.approx(100.0, abs=5.0)


def test_a_harm_that_is_everywhere_has_its_middle_but_no_side() -> None:
    place = place_of(harm(), (400, 300))
    assert place is not None
    assert place.word == "everywhere"
    assert (place.u_px, place.v_px) == pytest.approx((200.0, 150.0))
    assert place_of(harm(ripple_mm=cells(0.0)), (400, 300)) is None


def test_a_side_is_named_from_what_is_seen_and_not_from_the_middle_of_the_image() -> None:
    def word(row: int, column: int, weight: np.ndarray | None = None) -> str:
        ripple = cells(0.0)
        ripple[row : row + 2, column : column + 2] = 0.05
        place = place_of(harm(ripple_mm=ripple, weight=cells(1.0) if weight is None else weight), (400, 300))
        assert place is not None
        return place.word

    assert word(2, 3) == "middle"
    assert word(0, 3) == "upper"
    assert word(4, 3) == "lower"
    assert word(2, 0) == "left"
    assert word(2, 6) == "right"
    right_half = cells(0.0)
    right_half[:, COLUMNS // 2 :] = 1.0
    assert word(2, 5, right_half) == "middle"


def test_harm_in_more_than_four_tenths_of_what_is_seen_is_everywhere() -> None:
    def word(strong: int, weaker: int = 0, square: float = 0.0) -> str:
        ripple2 = np.zeros(ROWS * COLUMNS)
        ripple2[:strong], ripple2[strong : strong + weaker] = 1.0, square
        place = place_of(harm(ripple_mm=0.05 * np.sqrt(ripple2).reshape(ROWS, COLUMNS)), (400, 300))
        assert place is not None
        return place.word

    assert word(20) == "everywhere"
    assert word(19) == "upper"
    # A cell is harmed from a quarter of the mean square on: 0.065 here.
    assert word(12, 8, 0.070) == "everywhere"
    assert word(12, 8, 0.060) != "everywhere"


def test_a_side_begins_an_eighth_of_the_image_away_from_what_is_seen() -> None:
    def word(right_px: float, down_px: float) -> str:
        ripple, u, v = cells(0.0), cells(180.0), cells(140.0)
        ripple[2, 3] = 0.05
        u[2, 3], u[3, 3] = 180.0 + right_px, 180.0 - right_px
        v[2, 3], v[3, 3] = 140.0 + down_px, 140.0 - down_px
        place = place_of(harm(ripple_mm=ripple, u_px=u, v_px=v), (400, 300))
        assert place is not None
        assert (place.u_px, place.v_px) == pytest.approx((180.0 + right_px, 140.0 + down_px))
        return place.word

    assert word(47.5, 35.5) == word(-47.5, -35.5) == "middle"
    assert word(48.5, 0.0) == "right"
    assert word(-48.5, 0.0) == "left"
    assert word(0.0, 36.5) == "lower"
    assert word(0.0, -36.5) == "upper"
    assert word(-48.5, 36.5) == "lower left"


def test_cells_without_a_place_or_points_have_no_say_in_where_it_is() -> None:
    ripple, weight, u = cells(0.0), cells(1.0), 25.0 + 50.0 * np.mgrid[0:ROWS, 0:COLUMNS][1].astype(float)
    ripple[0, 0], ripple[5, 7] = 0.05, np.nan
    weight[5, 7] = 0.0
    u[5, 7] = np.nan
    place = place_of(harm(ripple_mm=ripple, weight=weight, u_px=u, v_px=u), (400, 300))
    assert place is not None
    assert (place.u_px, place.v_px) == (25.0, 25.0)


def test_fringes_and_paint_make_one_way_over_the_whole_sequence() -> None:
    known = DriftMap(drift_px=cells(0.02), sd_px=cells(0.001), slope_per_px=cells(0.5), **_rest_of_drift_map())
    assert _shift(known, harm(), texture(), 24) == pytest.approx(0.02 / 0.5 * 24)
    assert _shift(known, harm(), texture((0.3, -0.4)), 24) == pytest.approx(np.hypot(0.96, 0.5 * 24 / 12))
    assert _shift(known, harm(weight=cells(0.0)), texture((0.3, 0.4)), 24) is None


def _rest_of_drift_map() -> dict[str, Any]:
    taken = {"drift_px", "sd_px", "slope_per_px"}
    return {name: cells(0.0) for name in DriftMap.__dataclass_fields__ if name not in taken}


def test_only_cells_with_points_and_a_slope_have_a_say_in_the_way() -> None:
    drift, slope, weight = cells(0.02), cells(0.5), cells(1.0)
    drift[:3], weight[:3] = 0.5, 0.0
    drift[3], slope[3] = 0.5, np.nan
    known = DriftMap(drift_px=drift, sd_px=cells(0.001), slope_per_px=slope, **_rest_of_drift_map())
    assert _shift(known, harm(weight=weight), texture(), 24) == pytest.approx(0.02 / 0.5 * 24)
    backwards = replace(known, drift_px=-drift)
    assert _shift(backwards, harm(weight=weight), texture(), 24) == pytest.approx(0.02 / 0.5 * 24)


def test_what_is_shadow_or_saturated_or_veiled_was_not_lost_to_a_movement() -> None:
    decoder = CameraDecoder(build_sequence(16), 10, 10)
    masks = {
        Mask.SHADOW: 40, Mask.SATURATED: 10, Mask.VALID: 30, Mask.WEAK: 5, Mask.CONTRADICTION: 9, Mask.EDGE: 6,
    }  # fmt: skip
    decoder.mask[:] = np.repeat(list(masks), list(masks.values())).reshape(10, 10)
    decoder.backscatter_pixels = 3
    assert _lost_share(decoder) == pytest.approx((9 + 6 - 3) / (100 - 40 - 10 - 3))
    decoder.mask[:] = Mask.SHADOW
    decoder.backscatter_pixels = 0
    assert _lost_share(decoder) == 0.0
    decoder.mask[0, 0] = Mask.EDGE
    assert _lost_share(decoder) == 1.0


def test_noise_is_that_of_grey_value_0_and_per_grey_value() -> None:
    assert _variance(CameraNoise(1.2, 0.05, 8.0)) == pytest.approx((1.44 - 0.05 * 8.0, 0.05))


def test_the_way_of_the_paint_is_the_mean_of_the_cameras_that_see_any() -> None:
    def seen(step_px: float) -> AlbedoShifts:
        return AlbedoShifts(np.array([[0.0, 0.0], [0.0, 0.0], [step_px, 0.0]]), np.zeros(3))

    blind = AlbedoShifts(np.full((3, 2), np.nan), np.full(3, np.nan))
    assert _double_step2({"left": seen(1.0), "right": seen(3.0)}, None, 5.0) == pytest.approx(5.0)
    assert _double_step2({"left": blind, "right": seen(3.0)}, 5.0, 0.0) == pytest.approx(9.0)
    assert _double_step2({"left": blind, "right": blind}, 5.0, 5.0) is None


def test_stripes_of_light_in_turbid_water_are_no_paint_that_moves() -> None:
    ways = {
        side: AlbedoShifts(np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0]]), np.zeros(3)) for side in ("left", "right")
    }
    assert _double_step2(ways, None, -2.0) is None
    assert _double_step2(ways, MOVED - 0.1, None) is None
    assert _double_step2(ways, MOVED, None) == pytest.approx(1.0)


@pytest.mark.parametrize("velocity_mm_s", [(4.0, 0.0), (-3.0, 2.0), (0.0, -5.0)])
def test_a_flow_is_a_speed_in_the_middle_of_the_volume(velocity_mm_s: tuple[float, float]) -> None:
    calibration = synthetic.calibration()
    index = synthetic.WATER.index
    middle = calibration.rig.volume_centre_mm(index)
    frame_s = 1.0 / 60.0
    after = middle + np.array([*velocity_mm_s, 0.0]) * 12.0 * frame_s
    was, there = calibration.rig.left.project(np.stack([middle, after]), index)
    flow = float(there[0] - was[0]), float(there[1] - was[1])
    found = _lateral(texture(flow), harm(), calibration.rig, index, frame_s)
    assert found == pytest.approx(velocity_mm_s, rel=0.002, abs=0.002)
    assert _lateral(texture(), harm(), calibration.rig, index, frame_s) is None
