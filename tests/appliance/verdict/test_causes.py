"""The first reason of a poor scan is what ails it: how much each cause takes, and from which number on it is one, from both sides."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from appliance.machine.alerts import headline_of
from appliance.machine.words import Language
from appliance.reconstruct.quality import CloudSummary
from appliance.scan.exposure import Exposure, Span, ladder
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Judgement, Verdict
from appliance.verdict.causes import Cause, find_causes, with_causes

DARK, BRIGHT, LAMP, DIRTY, MOVED = (
    FaultCode.TOO_DARK, FaultCode.TOO_BRIGHT, FaultCode.AMBIENT, FaultCode.WATER_DIRTY, FaultCode.MOVED,
)  # fmt: skip
NEAR, FAR, FLICKER = FaultCode.SCAN_NEAR, FaultCode.SCAN_FAR, FaultCode.LIGHT_FLICKERS
GOOD = CloudSummary(44_597, 81.7, 530.7, 0.022, 0.001)
POOR = replace(GOOD, coverage_percent=20.0)
NO_POINTS = CloudSummary(0, 0.0, None, None, None)
USUAL = Exposure(12_000)
LONGER = (Exposure(6_000), Exposure(60_000))
Given = float | None
"""A number of a verdict."""


def said(name: str, code: FaultCode | None = None, known: dict[str, float] | None = None, **numbers: Any) -> Judgement:
    fault = None if code is None else Fault(code, "as measured", known or {})
    return Judgement(Verdict(name, fault is None, numbers, "as seen"), fault)


def motion(added: Given = 25.0, code: FaultCode | None = None, **more: Any) -> Judgement:
    usual: dict[str, Any] = {"added_noise_percent": added, "lost_percent": 4.0, "score": 9.0, "score_limit": 4.5}
    return said("motion", code, **(usual | more))


SEEN = said("sight", fringe_dn=9.0, top_dn=200.0)
"""An object that is seen well enough: it explains nothing."""


def causes(
    *judgements: Judgement,
    summary: CloudSummary = GOOD,
    present: Exposure = USUAL,
    steps: tuple[Exposure, ...] = LONGER,
) -> dict[FaultCode, Cause]:
    return {cause.fault.code: cause for cause in find_causes(judgements, summary, present, steps)}


# ----------------------------------------------------------------------------------------------- scenarios

STILL = motion(0.0, score=1.8)
STEPS = ladder(60.0, 500, 0.0, Span())
FRINGES: dict[str, Any] = {
    "light_dn": 40.0,
    "top_dn": 190.0,
    "fringe_cells_percent": 43.0,
    "fringe_dn": 87.0,
    "object_percent": 110.0,
}
IN_FRONT: dict[str, Any] = {"distance_mm": 340.0, "near_percent": 90.0, "far_percent": 2.0}
BEHIND: dict[str, Any] = {"distance_mm": 750.0, "near_percent": 0.0, "far_percent": 100.0}
SPECKS: dict[str, Any] = {"veil_percent": 0.7, "hidden_percent": 4.4, "masked_percent": 13.3, "speck_percent": 2.4}
RUSHES: dict[str, Any] = {"lost_percent": 32.0, "score": 40.5, "score_flow": 40.5}
"""Printed squares at 60 mm/s in water of 3.5 per m, where a scan at rest is usable."""


def sight(fringe_dn: Given = 87.0, top_dn: Given = 190.0, **more: Any) -> Judgement:
    return said("sight", **(FRINGES | {"fringe_dn": fringe_dn, "top_dn": top_dn} | more))


def saturated(percent: float, **more: Any) -> Judgement:
    return said("light", BRIGHT, {"saturated_percent": percent}, left_saturated_percent=percent, **more)


def flickering(ripple: float, **more: Any) -> Judgement:
    return said("light", FLICKER, left_flicker_over_noise=ripple, right_flicker_over_noise=ripple, **more)


FEW = replace(GOOD, points=2_000, coverage_percent=1.7)
FLOOD = said("light", LAMP, {"ambient_percent": 100.0})
SILT: dict[str, Any] = {"veil_percent": 40.0, "hidden_percent": 75.0, "masked_percent": 80.0, "object_percent": 5.3}


@pytest.mark.parametrize(
    ("judgements", "summary", "exposure", "expected"),
    [
        # Hands of 60 mm/s, too fast to be judged, change grey values as a lamp would.
        ((motion(None, lost_percent=90.0, score=None), flickering(5.6), said("water", DIRTY, **SPECKS), sight()), NO_POINTS, USUAL, [MOVED]),
        ((motion(8.0, MOVED), flickering(3.5), sight()), GOOD, USUAL, [FLICKER, MOVED]),
        ((motion(None, score=119.0), flickering(2.6, left_flicker_percent=0.1, left_local_flicker_percent=0.6), sight(**BEHIND)), NO_POINTS, USUAL, [FAR]),
        # What lies outside is told before it is too bright, however faint its clear fringes are; too dark a near thing is told first.
        ((STILL, saturated(74.0), sight(**IN_FRONT)), NO_POINTS, USUAL, [NEAR, BRIGHT]),
        ((STILL, saturated(99.3), sight(4.8, 34.0, **IN_FRONT)), NO_POINTS, USUAL, [NEAR, BRIGHT]),
        ((STILL, saturated(74.0), sight(**BEHIND)), NO_POINTS, USUAL, [FAR, BRIGHT]),
        ((STILL, said("light"), sight(3.6, 11.0, **IN_FRONT)), NO_POINTS, Exposure(200), [DARK, NEAR]),
        ((STILL, said("light"), sight(60.0, 11.0, **IN_FRONT)), NO_POINTS, Exposure(200), [NEAR]),
        ((STILL, said("light", DARK, {"coverage_percent": 0.0}), sight(3.6, 56.0, **BEHIND)), NO_POINTS, USUAL, [FAR, DARK]),
        ((STILL, said("light"), sight(3.6, 6.0, **BEHIND)), NO_POINTS, USUAL, [FAR]),
        # A flood light is not to blame for fringes that no exposure would show, nor water for what light saturates.
        ((STILL, FLOOD, sight(0.9, 1.8, light_dn=1.0)), NO_POINTS, USUAL, [DIRTY, LAMP]),
        ((STILL, FLOOD, sight(2.0, 4.0, light_dn=1.0)), NO_POINTS, USUAL, [LAMP, DARK]),
        ((STILL, said("water", DIRTY, veil_percent=None, hidden_percent=35.0, masked_percent=100.0), saturated(99.6), sight(None, 3.7)), NO_POINTS, USUAL, [BRIGHT]),
        ((STILL, said("water", DIRTY, **SILT), saturated(17.6, left_lit_percent=91.4), sight()), NO_POINTS, USUAL, [BRIGHT, DIRTY]),
        # Fringes of 5 grey values and more are decoded unless something moves.
        ((motion(None, **RUSHES), said("light"), sight(5.9, 12.0, light_dn=8.5)), FEW, USUAL, [MOVED, DARK]),
        ((motion(None, **RUSHES), said("light"), sight(4.9, 12.0, light_dn=8.5)), FEW, USUAL, [DARK]),
        ((motion(None, **RUSHES | {"score": None, "score_flow": None}), said("light"), sight(5.9, 12.0, light_dn=8.5)), FEW, USUAL, [DARK]),
        ((motion(None, **RUSHES | {"score_flow": 4.4}), said("light"), sight(5.9, 12.0, light_dn=8.5)), FEW, USUAL, [DARK]),
        # 16 ms and 12 dB before hands: the noise was undone, and a third is saturated.
        ((motion(85.0, FaultCode.COMPENSATED), saturated(33.0), sight()), replace(GOOD, coverage_percent=0.9), USUAL, [BRIGHT, FaultCode.COMPENSATED]),
        # The fault of a judge whose numbers are not weighed stands behind those that are.
        ((said("bubbles", FaultCode.LEAK), motion(60.0, MOVED)), GOOD, USUAL, [MOVED, FaultCode.LEAK]),
    ],
)  # fmt: skip
def test_the_first_reason_of_a_poor_scan_is_what_ails_it(
    judgements: tuple[Judgement, ...], summary: CloudSummary, exposure: Exposure, expected: list[FaultCode]
) -> None:
    assert [cause.fault.code for cause in find_causes(judgements, summary, exposure, STEPS)] == expected


def test_a_judge_whose_fault_something_else_explains_says_nothing_and_keeps_its_numbers() -> None:
    specks, bubbles = said("water", DIRTY, **SPECKS), said("bubbles", FaultCode.LEAK)
    found = with_causes((said("light"), specks, sight(), motion(25.0, MOVED), bubbles), GOOD, USUAL, STEPS)
    assert {one.verdict.name: one.fault.code for one in found if one.fault is not None} == {
        "motion": MOVED,
        "bubbles": FaultCode.LEAK,
    }
    (explained,) = (one.verdict for one in found if one.verdict.name == "water")
    assert explained.passed is None
    assert explained.numbers["speck_percent"] == 2.4


# -------------------------------------------------------------------------------------------------- motion


def test_noise_that_a_movement_adds_takes_what_noise_is_worth_and_lost_points_all_of_theirs() -> None:
    cause = causes(motion(25.0, MOVED))[MOVED]
    assert cause.share == pytest.approx(1.0 - 0.96 / 1.25**2)
    assert cause.certain
    assert causes(motion(25.0, MOVED, lost_percent=150.0))[MOVED].share == 1.0
    assert causes(motion(-9.0, MOVED))[MOVED].share == pytest.approx(0.04)
    assert causes(motion(25.0, MOVED, lost_percent=None))[MOVED].share == pytest.approx(0.36)
    assert MOVED in causes(motion(25.0, MOVED, score=4.5))
    assert MOVED not in causes(motion(25.0, MOVED, score=4.4))
    for unknown in ("score", "score_limit"):
        assert MOVED not in causes(motion(25.0, MOVED, **{unknown: None}))


def test_a_movement_that_its_judge_let_pass_is_named_for_a_poor_scan_with_what_is_known_of_it() -> None:
    assert causes(motion(25.0)) == {}
    cause = causes(motion(25.0, shift_px=2.0), summary=POOR)[MOVED]
    assert not cause.certain
    assert cause.fault.numbers == {"added_noise_percent": 25.0, "shift_px": 2.0}
    assert cause.fault.detail == "as seen"


def test_a_movement_that_was_undone_takes_nothing_and_of_a_poor_scan_what_it_took() -> None:
    undone = motion(25.0, FaultCode.COMPENSATED)
    good = causes(undone)
    assert set(good) == {FaultCode.COMPENSATED}
    assert (good[FaultCode.COMPENSATED].share, good[FaultCode.COMPENSATED].certain) == (0.0, True)
    poor = causes(undone, SEEN, summary=POOR)
    assert set(poor) == {MOVED, FaultCode.COMPENSATED}
    assert poor[MOVED].share == pytest.approx(0.04)
    assert not poor[MOVED].certain
    harmless = causes(motion(0.0, FaultCode.COMPENSATED, lost_percent=0.0), SEEN, summary=POOR)
    assert set(harmless) == {FaultCode.COMPENSATED, FaultCode.SCAN_POOR}, "what was undone explains no poor scan"


def rushing(
    fringe: Given = 30.0, backscatter: Given = None, saturated: Given = None, score: Given = None, **more: Any
) -> dict[FaultCode, Cause]:
    summary = replace(GOOD, coverage_percent=10.0)
    judgements = (
        motion(None, score=score),
        said("sight", fringe_dn=fringe, **more),
        said("water", DIRTY, veil_percent=backscatter, speck_percent=9.0),
        said("light", left_saturated_percent=saturated),
    )
    return causes(*judgements, summary=summary)


def test_strong_fringes_that_give_no_points_are_a_fast_movement() -> None:
    cause = rushing()[MOVED]
    assert cause.share == pytest.approx(0.9)
    assert cause.certain is True
    assert DIRTY not in rushing(), "specks of what moves are none"
    assert MOVED in rushing(10.0)
    assert MOVED not in rushing(9.9)
    assert MOVED not in rushing(None)
    assert MOVED in rushing(backscatter=11.9)
    assert MOVED not in rushing(backscatter=12.0)
    assert MOVED in rushing(saturated=25.0)
    assert MOVED not in rushing(saturated=25.1)
    assert MOVED not in rushing(distance_mm=800.0, far_percent=90.0)
    assert MOVED in rushing(backscatter=27.0, score=2288.0, object_percent=40.0)
    assert MOVED not in rushing(backscatter=27.0, score=2288.0, object_percent=39.9), "it outshines the object"
    assert MOVED not in rushing(backscatter=27.0, score=2288.0), "not known"
    assert MOVED not in rushing(backscatter=27.0, score=4.4, object_percent=84.0), "nothing was seen to move"
    judged = causes(motion(0.0, score=1.0), said("sight", fringe_dn=30.0), summary=POOR)
    assert MOVED not in judged
    usable = causes(motion(None, score=None), said("sight", fringe_dn=30.0))
    assert usable == {}
    noisy = replace(GOOD, coverage_percent=120.0, noise_mm=0.3)
    fast = causes(motion(None, score=None), said("sight", fringe_dn=30.0), summary=noisy)
    assert fast[MOVED].share == 0.0
    unknown = causes(
        motion(None, score=None), said("sight", fringe_dn=30.0), summary=replace(GOOD, coverage_percent=None)
    )
    assert unknown[MOVED].share == 1.0


# ------------------------------------------------------------------------------------------------- flicker


def flicker(*others: Judgement, left: Given = 3.5, right: Given = 3.6, **more: Any) -> float | None:
    light = said("light", FLICKER, left_flicker_over_noise=left, right_flicker_over_noise=right, **more)
    found = causes(light, *others)
    return found[FLICKER].share if FLICKER in found else None


def parts(common: float, local: float) -> dict[str, Any]:
    return {
        "left_flicker_percent": common, "right_flicker_percent": common,
        "left_local_flicker_percent": local, "right_local_flicker_percent": local,
    }  # fmt: skip


def test_light_takes_what_its_ripple_adds_to_the_noise_of_the_better_camera() -> None:
    assert flicker() == pytest.approx(12.25 / 13.25)
    assert flicker(left=None) == pytest.approx(12.96 / 13.96)
    assert flicker(left=None, right=None) is None
    assert flicker(left=0.0) is None
    assert flicker(**parts(1.0, 5.0)) == pytest.approx(12.25 / 13.25), "whoever does not move shares nothing"


def test_before_what_moves_a_lamp_is_what_exceeds_the_motions_own_ripple() -> None:
    moves = motion(8.0)
    moved = 1.08**2 - 1.0
    for common, local in ((3.0, 1.0), (3.0, 4.0)):
        lamp = common**2 / (common**2 + local**2)
        own = max(lamp * 12.25 - 2.4**2 * moved, (1.0 - lamp) * 12.25 - 4.0**2 * moved)
        assert flicker(moves, **parts(common, local)) == pytest.approx(own / (1.0 + own))
    own = 12.25 - 2.4**2 * moved
    assert flicker(moves) == pytest.approx(own / (1.0 + own)), "manifests that do not say what is in common"
    assert flicker(moves, **(parts(3.0, 4.0) | {"left_local_flicker_percent": None})) == pytest.approx(
        max(0.36 * 12.25 - 5.76 * moved, 0.64 * 12.25 - 16.0 * moved)
        / (1.0 + max(0.36 * 12.25 - 5.76 * moved, 0.64 * 12.25 - 16.0 * moved))
    ), "the camera that has less in common counts"
    assert flicker(motion(-5.0), **parts(3.0, 0.0)) == pytest.approx(12.25 / 13.25), "a negative addition is none"
    assert flicker(motion(200.0), **parts(3.0, 4.0)) is None


def test_before_a_movement_of_unknown_harm_a_lamp_has_half_of_the_change_in_common() -> None:
    unknown = motion(None)
    assert flicker(unknown, **parts(2.0, 2.0)) == pytest.approx(12.25 / 13.25)
    assert flicker(unknown, **parts(2.0, 2.01)) is None
    assert flicker(unknown, **parts(0.0, 0.0)) is None


# ------------------------------------------------------------------------------------------------- outside


def test_what_mostly_lies_outside_takes_all() -> None:
    far = said("sight", distance_mm=700.0, near_percent=10.0, far_percent=50.1)
    cause = causes(far)[FAR]
    assert (cause.share, cause.certain, cause.fault.numbers) == (1.0, True, {"distance_mm": 700.0})
    near = said("sight", distance_mm=300.0, near_percent=90.0, far_percent=None)
    assert set(causes(near, summary=POOR)) == {NEAR}
    assert "90 %" in causes(near)[NEAR].fault.detail
    assert causes(said("sight", distance_mm=700.0, near_percent=None, far_percent=50.0)) == {}
    assert causes(said("sight", near_percent=90.0)) == {}


def test_what_is_near_and_yet_too_faint_does_not_take_all() -> None:
    def share(fringe_dn: Given, **places: Any) -> float:
        (cause,) = causes(said("sight", distance_mm=300.0, fringe_dn=fringe_dn, **places)).values()
        return cause.share

    assert share(7.9, near_percent=90.0, far_percent=0.0) < 1.0
    assert share(8.0, near_percent=90.0, far_percent=0.0) == 1.0
    assert share(None, near_percent=90.0, far_percent=0.0) == 1.0
    assert share(7.9, near_percent=0.0, far_percent=90.0) == 1.0


# -------------------------------------------------------------------------------------------------- levels


@pytest.mark.parametrize(
    ("code", "known", "share"),
    [
        (DARK, {"weak_percent": 3.0, "coverage_percent": 70.0}, 0.3),
        (DARK, {}, 1.0),
        (LAMP, {"ambient_percent": 40.0}, 0.4),
        (LAMP, {}, 0.0),
        (BRIGHT, {"saturated_percent": 20.0}, 0.2),
    ],
)
def test_light_takes_the_pixels_that_it_costs(code: FaultCode, known: dict[str, float], share: float) -> None:
    cause = causes(said("light", code, known))[code]
    assert cause.share == pytest.approx(share)
    assert cause.certain is True


def test_saturation_that_its_judge_let_pass_is_named_for_a_poor_scan() -> None:
    light = said("light", left_saturated_percent=3.0, right_saturated_percent=9.0)
    assert causes(light) == {}
    cause = causes(light, summary=POOR)[BRIGHT]
    assert cause.share == pytest.approx(0.09)
    assert cause.certain is False
    assert cause.fault.numbers == {"saturated_percent": pytest.approx(9.0)}
    dark = said("light", DARK, {"coverage_percent": 40.0}, left_saturated_percent=9.0)
    assert set(causes(dark, SEEN, motion(0.0, score=1.0), summary=POOR)) == {DARK, BRIGHT}
    none = causes(said("light", left_saturated_percent=0.0), summary=POOR)
    assert set(none) == {FaultCode.NOTHING_SEEN}


def test_what_a_torch_saturates_is_not_also_too_bright() -> None:
    """Where hardly anything else of the object was seen it even led, with no exposure to offer."""
    known = {"left_lit_percent": 50.0, "left_saturated_percent": 40.0, "right_saturated_percent": 9.0}
    little = said("water", object_percent=10.0)
    for burnt, percent in (({}, 100.0 * 0.2 / 0.3), ({"left_burnt_percent": 39.0, "right_burnt_percent": 1.0}, 8.0)):
        light = said("light", LAMP, {"ambient_percent": 45.0}, **known, **burnt)
        found = causes(light, little, SEEN, summary=POOR)
        assert found[LAMP].share == pytest.approx(0.45)
        assert found[BRIGHT].fault.numbers == {"saturated_percent": pytest.approx(percent)}


def test_a_twentieth_is_the_least_that_is_named_beside_something_larger() -> None:
    moves = motion(25.0)
    for percent, named_too in ((5.0, True), (4.9, False)):
        found = causes(moves, said("light", left_saturated_percent=percent), SEEN, summary=POOR)
        assert (BRIGHT in found) == named_too
        assert MOVED in found
    alone = causes(said("light", left_saturated_percent=1.0), SEEN, motion(0.0, score=1.0), summary=POOR)
    assert set(alone) == {BRIGHT}


# --------------------------------------------------------------------------------------------------- water


def water(moves: bool = False, **numbers: Any) -> float | None:
    dirty = said("water", DIRTY, **numbers)
    found = causes(dirty, motion(5.0) if moves else motion(0.0, score=1.0))
    return found[DIRTY].share if DIRTY in found else None


def test_water_takes_what_its_backscatter_hides() -> None:
    assert water(veil_percent=12.0, hidden_percent=20.0, masked_percent=20.0) == pytest.approx(0.2)
    assert water(veil_percent=11.9, hidden_percent=20.0, masked_percent=25.0) is None
    assert water(veil_percent=30.0, hidden_percent=20.0, masked_percent=21.0) == pytest.approx(0.3)
    assert water(veil_percent=30.0, hidden_percent=20.0, masked_percent=20.0) == pytest.approx(0.2)
    assert water(veil_percent=30.0, hidden_percent=20.0) == pytest.approx(0.2)
    assert water(speck_percent=3.0) == pytest.approx(0.03)
    assert water(moves=True, speck_percent=3.0) is None, "what moves looks like specks"
    bright: dict[str, Any] = {"veil_percent": 17.3, "masked_percent": 23.0, "hidden_percent": 7.7, "speck_percent": 3.1}
    assert water(**bright) == pytest.approx(0.173)
    assert water(moves=True, **bright) is None, "the backscatter alone is no fault"
    assert water(moves=True, **bright | {"hidden_percent": 25.1}) == pytest.approx(0.251)
    assert water(moves=True, **bright | {"veil_percent": 30.1}) == pytest.approx(0.301)
    assert water(moves=True, **bright | {"veil_percent": 25.1, "masked_percent": 25.1}) == pytest.approx(0.251)
    assert water() is None
    assert causes(said("water", speck_percent=3.0), summary=GOOD) == {}


# --------------------------------------------------------------------------------------------------- faint


def faint(fringe: float, top: Given = 10.0, noise_mm: Given = 0.02, room: float = 5.0, **more: Any) -> Cause | None:
    summary = CloudSummary(100, 20.0, 500.0, noise_mm, 0.001)
    steps = (Exposure(1_000), Exposure(int(10_000 * room)))
    judgements = (said("sight", fringe_dn=fringe, top_dn=top), said("light", **more), motion(0.0, score=1.0))
    found = causes(*judgements, summary=summary, present=Exposure(10_000), steps=steps)
    return next((one for code, one in found.items() if code in (DARK, DIRTY)), None)


def named(cause: Cause | None) -> FaultCode | None:
    return None if cause is None else cause.fault.code


def test_faint_fringes_are_dark_where_an_exposure_makes_eight_grey_values_of_them() -> None:
    assert named(faint(2.0, room=4.0)) is DARK
    assert named(faint(2.0, room=3.9)) is DIRTY
    # White may not exceed 235: of fringes of 3 and a white of 88, 8.01 can be made, of 89 7.9.
    assert named(faint(3.0, top=88.0)) is DARK
    assert named(faint(3.0, top=89.0)) is DIRTY
    assert named(faint(2.0, top=None, room=4.0)) is DARK
    assert named(faint(0.03, top=0.0, room=300.0)) is DIRTY, "235 times as much is all there is"
    assert named(faint(8.0)) is None, "that is enough"
    assert named(faint(7.9)) is DARK
    assert named(faint(7.9, left_saturated_percent=25.0)) is DARK
    assert named(faint(7.9, left_saturated_percent=25.1)) is None
    # Strong fringes, and yet a poor scan: points are too noisy.
    assert named(faint(9.0, noise_mm=0.25)) is None
    assert named(faint(9.0, noise_mm=None)) is None
    assert named(faint(9.0, noise_mm=0.26, room=1.26)) is DARK
    assert named(faint(9.0, noise_mm=0.26, room=1.25)) is None


def test_gain_makes_grey_values_of_faint_fringes_but_no_photons() -> None:
    """A plane in water of 5.5 per m: fringes of 1 grey value, of which 16 ms and 12 dB make 8.7, and not a point."""
    steps = (Exposure(2_000), Exposure(16_000), Exposure(16_000, 12.0))

    def said_of(fringe: float, present: Exposure, top: float = 15.5) -> FaultCode | None:
        summary = CloudSummary(0, 0.0, None, None, None)
        found = causes(
            said("sight", fringe_dn=fringe, top_dn=top), said("light"), summary=summary, present=present, steps=steps
        )
        return next((code for code in found if code in (DARK, DIRTY)), None)

    assert said_of(1.0, Exposure(7_300)) is DIRTY
    assert said_of(7.9, Exposure(16_000, 12.0)) is DIRTY, "worth 4, and nothing is left to expose for"
    # White of 14.7 may be made 16 times as bright: 4 by time alone, 4 by gain, over whose noise only 2 of these count.
    assert said_of(0.62, Exposure(4_000), top=14.68) is DIRTY
    assert said_of(0.64, Exposure(4_000), top=14.68) is DARK
    # As far as white leaves room without gain, every grey value counts.
    assert said_of(2.01, Exposure(4_000), top=58.0) is DARK
    assert said_of(1.95, Exposure(4_000), top=58.0) is DIRTY


def test_what_faint_fringes_take_is_what_is_lost_as_far_as_they_are_too_faint() -> None:
    for fringe, room, share in ((4.0, 5.0, 0.8), (1.0, 2.0, 0.8), (8.0, 5.0, 0.8), (16.0, 5.0, 0.4)):
        cause = faint(fringe, room=room, noise_mm=0.3)
        assert cause is not None
        assert cause.share == pytest.approx(share)
        assert cause.certain is False
        assert cause.fault.numbers == {"fringe_dn": fringe, "coverage_percent": pytest.approx(20.0)}
    noisy = CloudSummary(100, 120.0, 500.0, 0.3, 0.001)
    found = causes(said("sight", fringe_dn=4.0, top_dn=9.0), summary=noisy)
    assert DARK not in found, "nothing is lost"


def unseen(glow: Given = None, present: int = 12_000, steps: tuple[Exposure, ...] = (Exposure(12_000),)) -> Cause:
    nothing = CloudSummary(0, None, None, None, None)
    seen = said("sight", light_dn=2.5, glow_per_m=glow)
    (cause,) = find_causes((seen,), nothing, Exposure(present), steps)
    return cause


def test_where_no_fringes_are_seen_it_is_the_water_or_the_exposure_or_that_there_is_nothing() -> None:
    dirty = unseen(1.6)
    assert (dirty.fault.code, dirty.share, dirty.certain) == (DIRTY, 1.0, False)
    assert dirty.fault.numbers == {"light_dn": 2.5, "coverage_percent": 0.0}
    nothing = unseen(1.5)
    assert (nothing.fault.code, nothing.share, nothing.certain) == (FaultCode.NOTHING_SEEN, 1.0, False)
    assert nothing.fault.numbers == {"light_dn": 2.5}
    dark = unseen(None, present=750)
    assert (dark.fault.code, dark.share, dark.certain) == (DARK, 1.0, False)
    assert dark.fault.numbers == {"light_dn": 2.5}
    assert unseen(None, present=751).fault.code is FaultCode.NOTHING_SEEN
    assert unseen(None, present=500, steps=()).fault.code is FaultCode.NOTHING_SEEN


@pytest.mark.parametrize(
    ("coverage", "noise_mm", "word"),
    [(None, None, "few"), (24.9, 0.02, "few"), (25.0, 0.26, "noisy"), (80.0, 0.26, "noisy")],
)
def test_a_poor_scan_without_a_cause_says_whether_points_are_few_or_noisy(
    coverage: Given, noise_mm: Given, word: str
) -> None:
    summary = CloudSummary(10, coverage, None, noise_mm, None)
    judged = said("light", left_saturated_percent=0.0)
    seen = SEEN
    (cause,) = find_causes((judged, seen, motion(0.0, score=1.0)), summary, USUAL, (USUAL,))
    assert (cause.fault.code, cause.share, cause.certain) == (FaultCode.SCAN_POOR, 0.0, False)
    assert word in cause.fault.detail
    assert cause.fault.numbers == ({} if coverage is None else {"coverage_percent": coverage})


# -------------------------------------------------------------------------------------------- all together


def test_a_cause_that_two_judges_see_is_named_once_with_the_larger_share_and_as_certain_as_either() -> None:
    dark = said("light", DARK, {"coverage_percent": 90.0})
    seen = said("sight", fringe_dn=3.0, top_dn=6.0)
    (cause,) = find_causes((dark, seen, motion(0.0, score=1.0)), POOR, USUAL, LONGER)
    assert (cause.fault.code, cause.certain) == (DARK, True)
    assert cause.share == pytest.approx(0.8)
    assert cause.fault.numbers["fringe_dn"] == 3.0


def test_verdicts_come_with_identity_first_then_causes_by_what_they_take_then_the_others() -> None:
    who = said("identity", MOVED)
    light = said("light", LAMP, {"ambient_percent": 30.0}, left_saturated_percent=40.0)
    old = said("causes", FaultCode.SCAN_POOR)
    window, seen = said("window"), SEEN
    found = with_causes((light, window, old, motion(90.0, MOVED), seen, who), POOR, USUAL, LONGER)
    # One verdict takes one cause; the next one of the same judge comes with the verdict on causes.
    assert [one.verdict.name for one in found] == ["identity", "motion", "light", "causes", "window", "sight"]
    assert found[0] is who
    codes = [None if one.fault is None else one.fault.code for one in found[1:]]
    assert codes == [MOVED, BRIGHT, LAMP, None, None]
    assert dict(found[3].verdict.numbers) == {
        "moved_percent": pytest.approx(100.0 * (1.0 - 0.96 / 1.9**2)),
        "too_bright_percent": pytest.approx(40.0),
        "ambient_percent": pytest.approx(30.0),
    }
    assert (found[2].verdict.passed, found[2].verdict.text) == (False, "as seen")


def test_a_scan_that_nothing_ails_says_so() -> None:
    found = with_causes((said("light"), said("window")), GOOD, USUAL, LONGER)
    assert [one.verdict.name for one in found] == ["causes", "light", "window"]
    assert (found[0].verdict.passed, found[0].fault, dict(found[0].verdict.numbers)) == (True, None, {})
    assert found[0].verdict.text == "nothing ails it"


def test_a_movement_that_was_undone_leaves_its_verdict_as_it_is() -> None:
    undone = replace(
        motion(25.0, FaultCode.COMPENSATED), verdict=Verdict("motion", True, motion().verdict.numbers, "axial")
    )
    (first, *_) = with_causes((undone,), GOOD, USUAL, LONGER)
    assert (first.verdict.passed, first.verdict.text) == (True, "axial")
    failed = with_causes((motion(25.0, MOVED),), GOOD, USUAL, LONGER)[0]
    assert (failed.verdict.passed, failed.verdict.text) == (False, "as seen")
    slow = with_causes((motion(60.0), SEEN), POOR, USUAL, (USUAL,))[0]
    assert (slow.verdict.passed, slow.verdict.text) == (False, "MOVED: as seen")


@pytest.mark.parametrize(
    ("attenuation_per_m", "headline", "german"),
    [
        (3.0, "SIGHT ONLY 1.6 m", "SICHT NUR 1.6 m"),
        (0.6, "SIGHT ONLY 8.0 m", "SICHT NUR 8.0 m"),
        (0.4, "WATER DIRTY", "WASSER TRÜB"),
        (0.0, "WATER DIRTY", "WASSER TRÜB"),
        (None, "WATER DIRTY", "WASSER TRÜB"),
    ],
)
def test_water_that_is_to_blame_is_told_as_the_distance_at_which_a_black_disk_vanishes(
    attenuation_per_m: float | None, headline: str, german: str
) -> None:
    """It said WATER DIRTY 93%, and nobody knew of what. Davies-Colley (1988): 4.8 / c."""
    numbers = {
        "attenuation_per_m": attenuation_per_m,
        "veil_percent": 40.0,
        "hidden_percent": 30.0,
        "masked_percent": 30.0,
    }
    dirty = said("water", DIRTY, {"coverage_percent": 70.0}, **numbers)
    faults = [one.fault for one in with_causes((dirty, SEEN), GOOD, USUAL, LONGER) if one.fault is not None]
    assert [headline_of(fault) for fault in faults] == [headline]
    assert headline_of(faults[0], Language.GERMAN) == german
    assert ("/m" in faults[0].detail) == headline.startswith("SIGHT"), "the desk counts in attenuation"
