"""The first reason of a poor scan is what ails it, and a poor scan has one; numbers are those of rendered scans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest

from appliance.reconstruct.quality import CloudSummary
from appliance.scan.exposure import Exposure, Span, ladder
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Judgement, Verdict
from appliance.verdict.causes import find_causes, with_causes

STEPS = ladder(60.0, 500, 0.0, Span())
USUAL = Exposure(12_000)
GOOD = CloudSummary(44_597, 81.7, 530.7, 0.022, 0.001)
NO_POINTS = CloudSummary(0, 0.0, None, None, None)
NOTHING_LIT = CloudSummary(0, None, None, None, None)
FRINGES = {"light_dn": 40.0, "top_dn": 190.0, "fringe_cells_percent": 43.0, "fringe_dn": 87.0, "object_percent": 110.0}
NO_FRINGES = {"light_dn": 2.6, "top_dn": 3.7, "fringe_cells_percent": 0.0, "fringe_dn": None, "object_percent": None}


def judgement(
    name: str, numbers: Mapping[str, float | None], code: FaultCode | None = None, **known: float
) -> Judgement:
    fault = None if code is None else Fault(code, "as measured", known)
    return Judgement(Verdict(name, fault is None, numbers), fault)


def sight(**numbers: float | None) -> Judgement:
    places: dict[str, float | None] = {
        "distance_mm": None,
        "near_percent": None,
        "far_percent": None,
        "glow_per_m": None,
    }
    return Judgement(Verdict("sight", None, places | numbers))


def moved(added_percent: float, code: FaultCode | None) -> Judgement:
    numbers = {"added_noise_percent": added_percent, "lost_percent": 4.0, "score": 245.0, "score_limit": 4.5}
    return judgement("motion", numbers, code, shift_px=12.5)


def still() -> Judgement:
    return judgement("motion", {"added_noise_percent": 0.0, "lost_percent": 0.5, "score": 1.8, "score_limit": 4.5})


def light(code: FaultCode | None = None, **numbers: float | None) -> Judgement:
    """LIGHT_FLICKERS and its like with the numbers of their faults."""
    return judgement("light", dict(numbers), code, **{k: v for k, v in numbers.items() if v is not None})


def codes(*judgements: Judgement, summary: CloudSummary = GOOD, exposure: Exposure = USUAL) -> list[FaultCode]:
    return [cause.fault.code for cause in find_causes(judgements, summary, exposure, STEPS)]


SPECKS_OF_MOTION = {"veil_percent": 0.7, "hidden_percent": 4.4, "masked_percent": 13.3, "speck_percent": 2.4}


def test_hands_that_move_in_clear_water_do_not_make_it_dirty() -> None:
    """20 mm/s: what moves disturbs 2.4 % of the pixels as specks would, and was headed WATER DIRTY 86 %."""
    water = judgement("water", SPECKS_OF_MOTION, FaultCode.WATER_DIRTY, coverage_percent=86.0)
    said = codes(moved(25.0, FaultCode.MOVED), water, light(), sight(**FRINGES))
    assert said == [FaultCode.MOVED]


def test_hands_too_fast_to_be_judged_are_no_flickering_light() -> None:
    """60 mm/s across: no point is left to judge the motion by, and grey values change as before a lamp."""
    unjudged = judgement(
        "motion", {"added_noise_percent": None, "lost_percent": 90.0, "score": None, "score_limit": 4.5}
    )
    numbers = {"left_flicker_over_noise": 5.6, "right_flicker_over_noise": 5.7, "harmed_percent": 100.0}
    flickers = light(FaultCode.LIGHT_FLICKERS, **numbers)
    water = judgement("water", SPECKS_OF_MOTION, FaultCode.WATER_DIRTY, coverage_percent=86.0)
    assert codes(unjudged, flickers, water, sight(**FRINGES), summary=NO_POINTS) == [FaultCode.MOVED]


GLARE = {"veil_percent": 27.4, "hidden_percent": 45.1, "masked_percent": 88.8, "speck_percent": 0.0}
"""Of printed squares in clear water at 60 mm/s: glare of the white ones lies on the black ones, and few pixels are decoded."""


def test_printed_squares_that_rush_by_in_clear_water_do_not_make_it_dirty() -> None:
    """The first reason was WATER DIRTY: of the pixels that are decoded by chance a quarter seems to be backscatter."""
    unjudged = {
        "added_noise_percent": None,
        "lost_percent": 48.8,
        "score": 2288.3,
        "score_limit": 4.5,
        "score_flow": 5.5,
    }
    water = judgement("water", GLARE, FaultCode.WATER_DIRTY, coverage_percent=11.2)
    seen = sight(**FRINGES | {"fringe_dn": 41.3, "object_percent": 84.0})
    assert codes(judgement("motion", unjudged), water, light(), seen, summary=NO_POINTS)[0] is FaultCode.MOVED
    silt = sight(**FRINGES | {"fringe_dn": 10.8, "object_percent": 17.3})
    assert codes(judgement("motion", unjudged), water, light(), silt, summary=NO_POINTS)[0] is FaultCode.WATER_DIRTY


def test_specks_are_specks_where_nothing_moves() -> None:
    water = judgement("water", SPECKS_OF_MOTION, FaultCode.WATER_DIRTY, coverage_percent=86.0)
    assert codes(still(), water, light(), sight(**FRINGES)) == [FaultCode.WATER_DIRTY]


def test_hands_that_move_slowly_do_not_make_the_light_flicker() -> None:
    """5 mm/s add 3 % of noise, which spoils nothing; they change grey values as a lamp would."""
    numbers = {"left_flicker_over_noise": 0.35, "right_flicker_over_noise": 0.34, "harmed_percent": 21.0}
    assert codes(moved(2.6, None), light(FaultCode.LIGHT_FLICKERS, **numbers), sight(**FRINGES)) == []


def test_a_lamp_flickers_before_moving_hands_as_well() -> None:
    numbers = {"left_flicker_over_noise": 3.6, "right_flicker_over_noise": 3.5, "harmed_percent": 100.0}
    said = codes(moved(8.0, FaultCode.MOVED), light(FaultCode.LIGHT_FLICKERS, **numbers), sight(**FRINGES))
    assert said == [FaultCode.LIGHT_FLICKERS, FaultCode.MOVED]


PAINT = {"left_flicker_over_noise": 2.6, "right_flicker_over_noise": 2.6, "harmed_percent": 100.0}
"""Printed squares before hands of 20 mm/s, which add 40 % of noise: each part of the picture changes by its own paint."""


@pytest.mark.parametrize(
    ("common_percent", "local_percent", "ripple", "expected"),
    [(1.3, 2.9, 2.6, [FaultCode.MOVED]), (3.5, 0.6, 3.6, [FaultCode.LIGHT_FLICKERS, FaultCode.MOVED])],
    ids=["printed squares", "a lamp"],
)
def test_printed_squares_before_moving_hands_are_no_flickering_light(
    common_percent: float, local_percent: float, ripple: float, expected: list[FaultCode]
) -> None:
    """A lamp changes the whole picture alike; the squares came as LIGHT FLICKERS, and a scan that was good was BAD by it."""
    changes = {f"{side}_flicker_percent": common_percent for side in ("left", "right")}
    changes |= {f"{side}_local_flicker_percent": local_percent for side in ("left", "right")}
    changes |= {f"{side}_flicker_over_noise": ripple for side in ("left", "right")}
    flickers = light(FaultCode.LIGHT_FLICKERS, **PAINT | changes)
    assert codes(moved(40.4, FaultCode.MOVED), flickers, sight(**FRINGES)) == expected


def test_what_moves_too_fast_or_too_far_to_be_measured_is_no_flickering_light_either() -> None:
    """Motion is known there, its harm is not."""
    numbers = {"added_noise_percent": None, "lost_percent": 40.0, "score": 119.0, "score_limit": 4.5}
    changes = {"left_flicker_percent": 0.1, "left_local_flicker_percent": 0.6}
    flickers = light(FaultCode.LIGHT_FLICKERS, **PAINT, **changes)
    places = {"distance_mm": 750.0, "near_percent": 0.0, "far_percent": 100.0}
    far = sight(**FRINGES | places)
    assert codes(judgement("motion", numbers), flickers, far, summary=NO_POINTS) == [FaultCode.SCAN_FAR]


@pytest.mark.parametrize("motion", [still(), moved(5.0, FaultCode.MOVED)], ids=["at rest", "hardly moved"])
def test_sun_through_waves_flickers_in_each_part_by_itself(motion: Judgement) -> None:
    """Far more than so little motion makes of any paint."""
    changes = {
        f"{side}_{what}_percent": value
        for side in ("left", "right")
        for what, value in (("flicker", 0.3), ("local_flicker", 2.0))
    }
    assert (
        codes(motion, light(FaultCode.LIGHT_FLICKERS, **PAINT, **changes), sight(**FRINGES))[0]
        is FaultCode.LIGHT_FLICKERS
    )


def test_a_black_picture_of_turbid_water_has_a_reason() -> None:
    """6 per metre and backscatter 0.5: no fringe anywhere, a glow that fades near the windows; there was no reason at all."""
    glow = NO_FRINGES | {"light_dn": 4.1, "top_dn": 8.0, "glow_per_m": 2.25}
    assert codes(still(), light(), sight(**glow), summary=NO_POINTS) == [FaultCode.WATER_DIRTY]


def test_open_water_is_no_dirty_water() -> None:
    clear = NO_FRINGES | {"glow_per_m": 0.25}
    assert codes(still(), light(), sight(**clear), summary=NOTHING_LIT) == [FaultCode.NOTHING_SEEN]


@pytest.mark.parametrize(
    ("fringe_dn", "exposure", "expected"),
    [
        (1.2, USUAL, FaultCode.WATER_DIRTY),  # five times the light makes 6 DN of it: too little
        (3.0, USUAL, FaultCode.TOO_DARK),  # and here 16
        (1.2, Exposure(500), FaultCode.TOO_DARK),
        (3.0, STEPS[-1], FaultCode.WATER_DIRTY),  # it is exposed as long as can be
    ],
)
def test_faint_fringes_are_the_exposures_fault_where_a_longer_one_helps(
    fringe_dn: float, exposure: Exposure, expected: FaultCode
) -> None:
    faint = FRINGES | {"fringe_dn": fringe_dn, "top_dn": 2.5 * fringe_dn, "light_dn": fringe_dn}
    assert codes(still(), light(), sight(**faint), summary=NOTHING_LIT, exposure=exposure)[0] is expected


def test_an_exposure_that_leaves_all_unused_is_to_blame_where_nothing_is_seen() -> None:
    dark = NO_FRINGES | {"light_dn": 0.1, "top_dn": 0.2}
    assert codes(still(), light(), sight(**dark), summary=NOTHING_LIT, exposure=Exposure(500)) == [FaultCode.TOO_DARK]


def test_nothing_is_there_where_an_object_would_show_fringes_at_a_third_of_the_usual_exposure() -> None:
    """A bright projector is exposed for 5 ms: open water before it was TOO DARK, for 64 ms' worth of light were left."""
    clear = NO_FRINGES | {"light_dn": 2.0, "top_dn": 3.1}
    said = codes(still(), light(), sight(**clear), summary=NOTHING_LIT, exposure=Exposure(5_170))
    assert said == [FaultCode.NOTHING_SEEN]


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ({"distance_mm": 347.0, "near_percent": 100.0, "far_percent": 0.0}, FaultCode.SCAN_NEAR),
        ({"distance_mm": 750.0, "near_percent": 0.0, "far_percent": 100.0}, FaultCode.SCAN_FAR),
    ],
)
def test_what_lies_outside_of_the_volume_is_said_to_before_it_is_too_bright(
    places: dict[str, float | None], expected: FaultCode
) -> None:
    """It came without a reason, or as TOO BRIGHT."""
    bright = light(FaultCode.TOO_BRIGHT, left_saturated_percent=74.0, saturated_percent=74.0)
    said = codes(still(), bright, sight(**FRINGES | places), summary=NO_POINTS)
    assert said == [expected, FaultCode.TOO_BRIGHT]


@pytest.mark.parametrize(
    ("fringe_dn", "expected"), [(3.6, [FaultCode.TOO_DARK, FaultCode.SCAN_NEAR]), (60.0, [FaultCode.SCAN_NEAR])]
)
def test_what_is_near_and_still_too_dark_is_too_dark_first(fringe_dn: float, expected: list[FaultCode]) -> None:
    """The diver was sent back, where it is darker still."""
    near = FRINGES | {
        "fringe_dn": fringe_dn,
        "top_dn": 11.0,
        "distance_mm": 338.0,
        "near_percent": 88.0,
        "far_percent": 2.0,
    }
    assert codes(still(), light(), sight(**near), summary=NOTHING_LIT, exposure=Exposure(200)) == expected


def test_what_is_near_and_saturated_is_too_near_first_however_faint_its_clear_fringes_are() -> None:
    """A plane at 339 mm before a flickering lamp: 99 % were saturated, the clear rest had fringes of 5 grey values, and it came as
    TOO BRIGHT, as if a shorter exposure could mend what is outside of the volume."""
    clear = {"fringe_dn": 4.8, "top_dn": 34.0, "distance_mm": 339.0, "near_percent": 100.0, "far_percent": 0.0}
    bright = light(FaultCode.TOO_BRIGHT, left_saturated_percent=99.3, saturated_percent=99.3)
    said = codes(still(), bright, sight(**FRINGES | clear), summary=NO_POINTS)
    assert said == [FaultCode.SCAN_NEAR, FaultCode.TOO_BRIGHT]


@pytest.mark.parametrize(
    ("fringe_dn", "expected"),
    [(0.9, [FaultCode.WATER_DIRTY, FaultCode.AMBIENT]), (2.0, [FaultCode.AMBIENT, FaultCode.TOO_DARK])],
    ids=["thick water", "clear enough"],
)
def test_a_flood_light_is_not_to_blame_for_fringes_that_no_exposure_would_show(
    fringe_dn: float, expected: list[FaultCode]
) -> None:
    """In water of 5.5 per m the lamp came first, and without it there was not a point more."""
    faint = FRINGES | {"fringe_dn": fringe_dn, "top_dn": 2.0 * fringe_dn, "light_dn": 1.0}
    flood = light(FaultCode.AMBIENT, ambient_percent=100.0)
    assert codes(still(), flood, sight(**faint), summary=NO_POINTS) == expected


FOLLOWED = {"added_noise_percent": None, "lost_percent": 32.0, "score": 40.5, "score_flow": 40.5, "score_limit": 4.5}


@pytest.mark.parametrize(
    ("fringe_dn", "motion", "expected"),
    [
        (5.9, FOLLOWED, [FaultCode.MOVED, FaultCode.TOO_DARK]),
        (4.9, FOLLOWED, [FaultCode.TOO_DARK]),
        (5.9, FOLLOWED | {"score": None, "score_flow": None}, [FaultCode.TOO_DARK]),
        (5.9, FOLLOWED | {"score_flow": 4.4}, [FaultCode.TOO_DARK]),
    ],
    ids=["followed", "too faint at rest, too", "nothing to follow", "followed, and hardly moved"],
)
def test_printed_squares_that_rush_by_in_milk_are_not_too_dark_first(
    fringe_dn: float, motion: dict[str, float | None], expected: list[FaultCode]
) -> None:
    """60 mm/s in water of 3.5 per m, where a scan at rest is usable: the squares are followed, and fringes of 5 grey values and
    more are decoded unless something moves."""
    few = replace(GOOD, points=2_000, coverage_percent=1.7)
    faint = FRINGES | {"fringe_dn": fringe_dn, "top_dn": 12.0, "light_dn": 8.5}
    assert codes(judgement("motion", motion), light(), sight(**faint), summary=few) == expected


def test_what_is_far_and_too_dark_is_too_far_first() -> None:
    """Coming closer makes it brighter as well."""
    far = FRINGES | {"fringe_dn": 3.6, "top_dn": 56.0, "distance_mm": 757.0, "near_percent": 2.0, "far_percent": 90.0}
    dark = light(FaultCode.TOO_DARK, coverage_percent=0.0)
    assert codes(still(), dark, sight(**far), summary=NO_POINTS)[0] is FaultCode.SCAN_FAR


def test_a_motion_that_was_undone_takes_only_what_it_lost() -> None:
    """16 ms and 12 dB before hands of 20 mm/s: the noise was undone, a third was saturated, and it came as MOVED."""
    bright = light(FaultCode.TOO_BRIGHT, left_saturated_percent=33.0, saturated_percent=33.0)
    poor = replace(GOOD, points=900, coverage_percent=0.9)
    said = codes(moved(85.0, FaultCode.COMPENSATED), bright, sight(**FRINGES), summary=poor)
    assert said[0] is FaultCode.TOO_BRIGHT


def test_a_few_points_outside_are_no_reason() -> None:
    places: dict[str, float | None] = {"distance_mm": 660.0, "near_percent": 0.0, "far_percent": 30.0}
    assert codes(still(), light(), sight(**FRINGES | places)) == []


def test_floodlight_is_not_the_waters_fault() -> None:
    """All is saturated: the fringes that are missing say nothing of the water."""
    water = judgement(
        "water", {"veil_percent": None, "hidden_percent": 35.0, "masked_percent": 100.0}, FaultCode.WATER_DIRTY
    )
    flood = light(FaultCode.TOO_BRIGHT, left_saturated_percent=99.6, saturated_percent=99.6)
    assert codes(still(), water, flood, sight(**NO_FRINGES), summary=NO_POINTS) == [FaultCode.TOO_BRIGHT]


def test_a_flood_light_in_silt_is_not_the_waters_fault_either() -> None:
    """The object is saturated; illuminated water beside it made the saturated share small, and WATER DIRTY 75 % was said."""
    numbers = {"veil_percent": 40.0, "hidden_percent": 75.0, "masked_percent": 80.0, "object_percent": 5.3}
    flood = light(FaultCode.TOO_BRIGHT, left_saturated_percent=17.6, left_lit_percent=91.4, saturated_percent=17.6)
    said = codes(
        still(), judgement("water", numbers, FaultCode.WATER_DIRTY), flood, sight(**FRINGES), summary=NO_POINTS
    )
    assert said == [FaultCode.TOO_BRIGHT, FaultCode.WATER_DIRTY]


def test_the_waters_backscatter_counts_before_what_it_hides() -> None:
    water = judgement(
        "water", {"veil_percent": 48.0, "hidden_percent": 25.0, "masked_percent": 27.0}, FaultCode.WATER_DIRTY
    )
    assert codes(still(), water, light(), sight(**FRINGES)) == [FaultCode.WATER_DIRTY]


def test_a_poor_scan_that_nothing_explains_says_so() -> None:
    few = replace(GOOD, points=2_000, coverage_percent=11.0)
    assert codes(still(), light(), sight(**FRINGES), summary=few) == [FaultCode.SCAN_POOR]


def test_a_motion_that_was_undone_is_not_held_against_a_good_scan_but_against_a_poor_one() -> None:
    undone = moved(130.0, FaultCode.COMPENSATED)
    assert codes(undone, light(), sight(**FRINGES)) == [FaultCode.COMPENSATED]
    poor = replace(GOOD, coverage_percent=12.0)
    assert FaultCode.MOVED in codes(undone, light(), sight(**FRINGES), summary=poor)


def test_judgements_keep_their_own_numbers_and_lose_what_something_else_explains() -> None:
    water = judgement("water", SPECKS_OF_MOTION, FaultCode.WATER_DIRTY, coverage_percent=86.0)
    said = with_causes((light(), water, sight(**FRINGES), moved(25.0, FaultCode.MOVED)), GOOD, USUAL, STEPS)
    of = {one.verdict.name: one for one in said}
    assert [one.fault.code for one in said if one.fault is not None] == [FaultCode.MOVED]
    assert of["water"].verdict.passed is None
    assert of["water"].verdict.numbers["speck_percent"] == pytest.approx(2.4)
    assert of["causes"].verdict.passed is False
    assert of["causes"].verdict.numbers["moved_percent"] == pytest.approx(100 * (1 - 0.96 / 1.25**2))


def test_the_first_fault_among_the_judgements_is_the_first_cause() -> None:
    numbers = {"left_flicker_over_noise": 3.6, "right_flicker_over_noise": 3.5, "harmed_percent": 100.0}
    flickers = light(FaultCode.LIGHT_FLICKERS, **numbers)
    said = with_causes((moved(8.0, FaultCode.MOVED), flickers, sight(**FRINGES)), GOOD, USUAL, STEPS)
    assert [one.fault.code for one in said if one.fault is not None] == [FaultCode.LIGHT_FLICKERS, FaultCode.MOVED]


def test_a_verdict_that_passed_fails_where_the_causes_blame_it() -> None:
    faint = FRINGES | {"fringe_dn": 3.0, "top_dn": 8.0}
    said = with_causes((still(), light(), sight(**faint)), NOTHING_LIT, USUAL, STEPS)
    of = {one.verdict.name: one for one in said}
    assert of["light"].fault is not None
    assert of["light"].fault.code is FaultCode.TOO_DARK
    assert of["light"].verdict.passed is False


@pytest.mark.parametrize(("far_percent", "expected"), [(40.0, []), (60.0, [FaultCode.SCAN_FAR])])
def test_an_object_is_too_far_when_most_of_it_is(far_percent: float, expected: list[FaultCode]) -> None:
    places = {"distance_mm": 690.0, "near_percent": 0.0, "far_percent": far_percent}
    assert codes(still(), light(), sight(**FRINGES | places)) == expected


@pytest.mark.parametrize(("veil_percent", "expected"), [(8.0, []), (16.0, [FaultCode.WATER_DIRTY])])
def test_what_is_lost_behind_faint_backscatter_is_not_lost_to_the_water(
    veil_percent: float, expected: list[FaultCode]
) -> None:
    numbers = {"veil_percent": veil_percent, "hidden_percent": 20.0, "masked_percent": 25.0, "speck_percent": 0.0}
    water = judgement("water", numbers, FaultCode.WATER_DIRTY, coverage_percent=75.0)
    assert codes(still(), water, light(), sight(**FRINGES)) == expected


def test_the_fault_of_a_judge_whose_numbers_are_not_weighed_stands_as_it_says_behind_the_weighed_ones() -> None:
    leaky = judgement("bubbles", {}, FaultCode.LEAK)
    hands = moved(60.0, FaultCode.MOVED)
    causes, judged = find_causes((leaky, hands), GOOD, USUAL, STEPS), with_causes((leaky, hands), GOOD, USUAL, STEPS)
    assert [cause.fault.code for cause in causes] == [FaultCode.MOVED, FaultCode.LEAK]
    assert {one.verdict.name: one.fault.code for one in judged if one.fault is not None} == {
        "motion": FaultCode.MOVED,
        "bubbles": FaultCode.LEAK,
    }
