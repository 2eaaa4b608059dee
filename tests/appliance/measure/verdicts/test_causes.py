"""The first reason of a poor scan is what ails it: how much each cause takes, and from which number on it is one, from both sides."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from appliance.instrument.machine.alerts import headline_of
from appliance.instrument.machine.words import Language
from appliance.measure.cloud import CloudSummary
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure, Span, ladder
from appliance.measure.light.sides import SIDES
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.causes import Cause, find_causes, with_causes

DARK, BRIGHT, LAMP, DIRTY, MOVED = (
    FaultCode.TOO_DARK, FaultCode.TOO_BRIGHT, FaultCode.AMBIENT, FaultCode.WATER_DIRTY, FaultCode.MOVED,
)  # fmt: skip
NEAR, FAR, FLICKER, UNDONE = FaultCode.SCAN_NEAR, FaultCode.SCAN_FAR, FaultCode.LIGHT_FLICKERS, FaultCode.COMPENSATED
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
    usual["drift_over_noise"] = None if added is None else max((1.0 + 0.01 * added) ** 2 - 1.0, 0.0) ** 0.5
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
FRINGES: dict[str, Any] = {"light_dn": 40.0, "fringe_cells_percent": 43.0, "object_percent": 110.0}
IN_FRONT: dict[str, Any] = {"distance_mm": 340.0, "near_percent": 90.0, "far_percent": 2.0}
BEHIND: dict[str, Any] = {"distance_mm": 750.0, "near_percent": 0.0, "far_percent": 100.0}
SPECKS: dict[str, Any] = {"veil_percent": 0.7, "hidden_percent": 4.4, "masked_percent": 13.3, "speck_percent": 2.4}


def sight(fringe_dn: Given = 87.0, top_dn: Given = 190.0, **more: Any) -> Judgement:
    return said("sight", fringe_dn=fringe_dn, top_dn=top_dn, **FRINGES | more)


def saturated(percent: float, **more: Any) -> Judgement:
    return said("light", BRIGHT, {"saturated_percent": percent}, left_saturated_percent=percent, **more)


def flicker(left: Given = 3.5, right: Given = 3.6, common: Given = None, local: Given = None, **more: Any) -> Judgement:
    """A lamp's ripple in either camera, and what of it all parts of the picture have in common."""
    parts = {f"{side}_flicker_percent": common for side in SIDES} | {
        f"{side}_local_flicker_percent": local for side in SIDES
    }
    return said("light", FLICKER, left_flicker_over_noise=left, right_flicker_over_noise=right, **(parts | more))


FEW = replace(GOOD, points=2_000, coverage_percent=1.7)
FLOOD = said("light", LAMP, {"ambient_percent": 100.0})
SILT: dict[str, Any] = {"veil_percent": 40.0, "hidden_percent": 75.0, "masked_percent": 80.0, "object_percent": 5.3}


@pytest.mark.parametrize(
    ("judgements", "summary", "exposure", "expected"),
    [
        # Hands of 60 mm/s, too fast to be judged, change grey values as a lamp would.
        ((motion(None, lost_percent=90.0, score=None), flicker(5.6), said("water", DIRTY, **SPECKS), sight()), NO_POINTS, USUAL, [MOVED]),
        ((motion(8.0, MOVED), flicker(), sight()), GOOD, USUAL, [FLICKER, MOVED]),
        ((motion(None, score=119.0), flicker(2.6, common=0.1, local=0.6), sight(**BEHIND)), NO_POINTS, USUAL, [FAR]),
        # What lies outside is told before all else, however bright or dark it is.
        ((STILL, saturated(74.0), sight(**IN_FRONT)), NO_POINTS, USUAL, [NEAR, BRIGHT]),
        ((STILL, saturated(99.3), sight(4.8, 34.0, **IN_FRONT)), NO_POINTS, USUAL, [NEAR, BRIGHT]),
        ((STILL, saturated(74.0), sight(**BEHIND)), NO_POINTS, USUAL, [FAR, BRIGHT]),
        ((STILL, said("light"), sight(3.6, 11.0, **IN_FRONT)), NO_POINTS, Exposure(200), [NEAR]),
        ((STILL, said("light", DARK, {"coverage_percent": 0.0}), sight(3.6, 56.0, **BEHIND)), NO_POINTS, USUAL, [FAR, DARK]),
        ((STILL, said("light"), sight(3.6, 6.0, **BEHIND)), NO_POINTS, USUAL, [FAR]),
        # A flood light is not to blame for fringes that no exposure would show, nor water for what light saturates.
        ((STILL, FLOOD, sight(0.9, 1.8, light_dn=1.0)), NO_POINTS, USUAL, [DIRTY, LAMP]),
        ((STILL, FLOOD, sight(2.0, 4.0, light_dn=1.0)), NO_POINTS, USUAL, [LAMP, DARK]),
        ((STILL, said("water", DIRTY, veil_percent=None, hidden_percent=35.0, masked_percent=100.0), saturated(99.6), sight(None, 3.7)), NO_POINTS, USUAL, [BRIGHT]),
        ((STILL, said("water", DIRTY, **SILT), saturated(17.6, left_lit_percent=91.4), sight()), NO_POINTS, USUAL, [BRIGHT, DIRTY]),
        # 16 ms and 12 dB before hands: the noise was undone, and a third is saturated.
        ((motion(85.0, UNDONE), saturated(33.0), sight()), replace(GOOD, coverage_percent=0.9), USUAL, [BRIGHT, UNDONE]),
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


# -------------------------------------------------------------------------------------------------- shares

M2 = 1.08**2 - 1.0
"""Square of the ripple that 8 % of added noise are."""


def over(own: float) -> float:
    """What a ripple takes, whose square is ``own`` times that of the noise."""
    return own / (1.0 + own)


def place(distance_mm: Given, near: Given, far: Given, **more: Any) -> Judgement:
    return said("sight", distance_mm=distance_mm, near_percent=near, far_percent=far, **more)


def water(veil: Given = None, hidden: Given = None, masked: Given = None, speck: Given = None) -> Judgement:
    return said("water", DIRTY, veil_percent=veil, hidden_percent=hidden, masked_percent=masked, speck_percent=speck)


HANDS = motion(5.0)


@pytest.mark.parametrize(
    ("judgements", "code", "share"),
    [
        # Noise that a movement adds takes what noise is worth, lost points all of theirs.
        ((motion(25.0, MOVED),), MOVED, 1.0 - 0.96 / 1.25**2),
        ((motion(25.0, MOVED, lost_percent=150.0),), MOVED, 1.0),
        ((motion(-9.0, MOVED),), MOVED, 0.04),
        ((motion(25.0, MOVED, lost_percent=None),), MOVED, 0.36),
        ((motion(25.0, MOVED, score=4.5),), MOVED, 1.0 - 0.96 / 1.25**2),
        *[((motion(25.0, MOVED, **unknown),), MOVED, None) for unknown in ({"score": 4.4}, {"score": None}, {"score_limit": None})],
        # Light takes what its ripple adds to the noise of the better camera.
        ((flicker(),), FLICKER, over(12.25)),
        ((flicker(left=None),), FLICKER, over(12.96)),
        ((flicker(left=None, right=None),), FLICKER, None),
        # Before what moves, it is what exceeds 2.4 times the drift over the noise, in common or in parts.
        ((motion(8.0), flicker(common=3.0, local=1.0)), FLICKER, over(0.9 * 12.25 - 2.4**2 * M2)),
        ((motion(8.0), flicker()), FLICKER, over(12.25 - 2.4**2 * M2)),
        ((motion(8.0), flicker(common=3.0, local=4.0, left_local_flicker_percent=None)), FLICKER, over(0.64 * 12.25 - 2.4**2 * M2)),
        # A drift that makes no ripple is seen by the judge of light as one that does.
        ((motion(0.0, drift_over_noise=1.3), flicker()), FLICKER, over(12.25 - 2.4**2 * 1.3**2)),
        # Before a movement of unknown harm a lamp has half of the change in common.
        ((motion(None), flicker(common=2.0, local=2.0)), FLICKER, over(12.25)),
        ((motion(None), flicker(common=2.0, local=2.01)), FLICKER, None),
        ((motion(None), flicker(common=0.0, local=0.0)), FLICKER, None),
        # What mostly lies outside takes all.
        ((place(700.0, 10.0, 50.1),), FAR, 1.0),
        ((place(700.0, None, 50.0),), FAR, None),
        ((place(None, 90.0, None),), NEAR, None),
        ((place(300.0, 90.0, None),), NEAR, 1.0),
        # Light takes the pixels that it costs.
        ((said("light", DARK, {"weak_percent": 3.0, "coverage_percent": 70.0}),), DARK, 0.3),
        ((said("light", DARK, {}),), DARK, 1.0),
        ((said("light", LAMP, {"ambient_percent": 40.0}),), LAMP, 0.4),
        ((said("light", LAMP, {}),), LAMP, 0.0),
        ((said("light", BRIGHT, {"saturated_percent": 20.0}),), BRIGHT, 0.2),
        # Water takes what its backscatter hides from an eighth of the light on; what moves looks like specks.
        ((STILL, water(12.0, 20.0, 20.0)), DIRTY, 0.2),
        ((STILL, water(11.9, 20.0, 25.0)), DIRTY, None),
        ((STILL, water(30.0, 20.0, 20.0)), DIRTY, 0.2),
        ((STILL, water(speck=3.0)), DIRTY, 0.03),
        ((HANDS, water(25.1, 7.7, 25.1, 3.1)), DIRTY, 0.251),
    ],
)  # fmt: skip
def test_of_a_usable_scan_each_cause_takes_its_share_beyond_its_judges_limit(
    judgements: tuple[Judgement, ...], code: FaultCode, share: float | None
) -> None:
    found = causes(*judgements)
    assert (found[code].share if code in found else None) == (None if share is None else pytest.approx(share))
    assert all(one.certain for one in found.values())


# ----------------------------------------------------------------------------------------------- poor scans


def test_a_movement_that_its_judge_let_pass_is_named_for_a_poor_scan_with_what_is_known_of_it() -> None:
    cause = causes(motion(25.0, shift_px=2.0), summary=POOR)[MOVED]
    assert not cause.certain
    assert cause.fault.numbers == {"added_noise_percent": 25.0, "shift_px": 2.0}
    assert cause.fault.detail == "as seen"


def test_a_movement_that_was_undone_takes_of_a_poor_scan_what_it_took() -> None:
    poor = causes(motion(25.0, UNDONE), SEEN, summary=POOR)
    assert set(poor) == {MOVED, UNDONE}
    assert poor[MOVED].share == pytest.approx(0.04)
    assert not poor[MOVED].certain
    harmless = causes(motion(0.0, UNDONE, lost_percent=0.0), SEEN, summary=POOR)
    assert set(harmless) == {UNDONE, FaultCode.SCAN_POOR}, "what was undone explains no poor scan"


def rushing(
    fringe: Given = 30.0, veil: Given = None, saturated: Given = None, score: Given = None, **more: Any
) -> dict[FaultCode, Cause]:
    judgements = (
        motion(None, score=score), said("sight", fringe_dn=fringe, **more), water(veil, speck=9.0), said("light", left_saturated_percent=saturated),
    )  # fmt: skip
    return causes(*judgements, summary=replace(GOOD, coverage_percent=10.0))


@pytest.mark.parametrize(
    ("seen", "told"),
    [
        ({"fringe": 8.0}, True), ({"fringe": 7.9}, False), ({"fringe": None}, False),
        ({"veil": 12.0}, False),
        ({"saturated": 25.0}, True), ({"saturated": 25.1}, False),
    ],
)  # fmt: skip
def test_strong_fringes_that_give_no_points_are_a_fast_movement(seen: dict[str, Any], told: bool) -> None:
    assert (MOVED in rushing(**seen)) is told


def test_a_fast_movement_takes_the_points_that_are_missing_of_a_scan_that_is_poor_and_unjudged() -> None:
    fast, fringes = motion(None, score=None), said("sight", fringe_dn=30.0)
    found = rushing()
    assert found[MOVED].share == pytest.approx(0.9)
    assert found[MOVED].certain
    assert DIRTY not in found, "specks of what moves are none"
    assert MOVED not in causes(STILL, fringes, summary=POOR)
    assert causes(fast, fringes) == {}
    for summary, share in (({"coverage_percent": 120.0, "noise_mm": 0.3}, 0.0), ({"coverage_percent": None}, 1.0)):
        assert causes(fast, fringes, summary=replace(GOOD, **summary))[MOVED].share == share


def test_saturation_that_its_judge_let_pass_is_named_for_a_poor_scan() -> None:
    cause = causes(said("light", left_saturated_percent=3.0, right_saturated_percent=9.0), summary=POOR)[BRIGHT]
    assert cause.share == pytest.approx(0.09)
    assert not cause.certain
    assert cause.fault.numbers == {"saturated_percent": pytest.approx(9.0)}
    dark = said("light", DARK, {"coverage_percent": 40.0}, left_saturated_percent=9.0)
    assert set(causes(dark, SEEN, STILL, summary=POOR)) == {DARK, BRIGHT}
    assert set(causes(said("light", left_saturated_percent=0.0), summary=POOR)) == {FaultCode.NOTHING_SEEN}


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
    for others, percent, named in (
        ((motion(25.0),), 5.0, {MOVED, BRIGHT}), ((motion(25.0),), 4.9, {MOVED}), ((STILL,), 1.0, {BRIGHT}),
    ):  # fmt: skip
        assert set(causes(*others, said("light", left_saturated_percent=percent), SEEN, summary=POOR)) == named


# --------------------------------------------------------------------------------------------------- faint


def faint(fringe: float, top: Given = 10.0, noise_mm: Given = 0.02, room: float = 5.0, **light: Any) -> Cause | None:
    """Why the fringes are faint of a scan that could be exposed for ``room`` times as long."""
    summary = CloudSummary(100, 20.0, 500.0, noise_mm, 0.001)
    judgements = (said("sight", fringe_dn=fringe, top_dn=top), said("light", **light), STILL)
    steps = (Exposure(1_000), Exposure(int(10_000 * room)))
    found = causes(*judgements, summary=summary, present=Exposure(10_000), steps=steps)
    return next((one for code, one in found.items() if code in (DARK, DIRTY)), None)


@pytest.mark.parametrize(
    ("seen", "code"),
    [
        # White may not exceed 255: of fringes of 3 and a white of 95, 8.05 can be made, of 96 7.97.
        ({"fringe": 3.0, "top": 95.0}, DARK), ({"fringe": 3.0, "top": 96.0}, DIRTY),
        ({"fringe": 2.0, "top": None, "room": 4.0}, DARK),
        ({"fringe": 0.03, "top": 0.0, "room": 300.0}, DIRTY),
        ({"fringe": 8.0}, None),
        ({"fringe": 7.9, "left_saturated_percent": 25.0}, DARK),
        # Strong fringes, and yet a poor scan: points are too noisy.
        ({"fringe": 9.0, "noise_mm": 0.25}, None), ({"fringe": 9.0, "noise_mm": None}, None),
        ({"fringe": 9.0, "noise_mm": 0.26, "room": 1.26}, DARK), ({"fringe": 9.0, "noise_mm": 0.26, "room": 1.25}, None),
    ],
)  # fmt: skip
def test_faint_fringes_are_dark_where_exposing_makes_eight_dn(seen: dict[str, Any], code: FaultCode | None) -> None:
    found = faint(**seen)
    assert (None if found is None else found.fault.code) is code


@pytest.mark.parametrize(
    ("fringe", "present", "top", "code"),
    [
        (1.0, Exposure(7_300), 15.5, DIRTY),
        (7.9, Exposure(16_000, 12.0), 15.5, DIRTY),  # worth 4, and nothing is left to expose for
        # White of 14.7 may be made 16 times as bright: 4 by time alone, 4 by gain, over whose noise only 2 of these count.
        (0.62, Exposure(4_000), 14.68, DIRTY),
        # As far as white leaves room without gain, every grey value counts.
        (2.01, Exposure(4_000), 58.0, DARK),
    ],
)
def test_gain_makes_grey_values_but_no_photons(fringe: float, present: Exposure, top: float, code: FaultCode) -> None:
    """A plane in water of 5.5 per m: fringes of 1 grey value, of which 16 ms and 12 dB make 8.7, and not a point."""
    steps = (Exposure(2_000), Exposure(16_000), Exposure(16_000, 12.0))
    judgements = (said("sight", fringe_dn=fringe, top_dn=top), said("light"))
    found = causes(*judgements, summary=NO_POINTS, present=present, steps=steps)
    assert [one for one in found if one in (DARK, DIRTY)] == [code]


def test_what_faint_fringes_take_is_what_is_lost_as_far_as_they_are_too_faint() -> None:
    for fringe, room, share in ((4.0, 5.0, 0.8), (1.0, 2.0, 0.8), (8.0, 5.0, 0.8), (16.0, 5.0, 0.4)):
        cause = faint(fringe, room=room, noise_mm=0.3)
        assert cause is not None
        assert cause.share == pytest.approx(share)
        assert not cause.certain
        assert cause.fault.numbers == {"fringe_dn": fringe, "coverage_percent": pytest.approx(20.0)}
    noisy = CloudSummary(100, 120.0, 500.0, 0.3, 0.001)
    assert DARK not in causes(said("sight", fringe_dn=4.0, top_dn=9.0), summary=noisy), "nothing is lost"


@pytest.mark.parametrize(
    ("glow_per_m", "time_us", "steps", "code"),
    [
        (1.6, 12_000, (USUAL,), DIRTY), (1.5, 12_000, (USUAL,), FaultCode.NOTHING_SEEN),
        (None, 750, (USUAL,), DARK), (None, 751, (USUAL,), FaultCode.NOTHING_SEEN), (None, 500, (), FaultCode.NOTHING_SEEN),
    ],
)  # fmt: skip
def test_where_no_fringes_are_seen_it_is_the_water_or_the_exposure_or_that_there_is_nothing(
    glow_per_m: Given, time_us: int, steps: tuple[Exposure, ...], code: FaultCode
) -> None:
    seen = said("sight", light_dn=2.5, glow_per_m=glow_per_m)
    (cause,) = find_causes((seen,), replace(NO_POINTS, coverage_percent=None), Exposure(time_us), steps)
    assert (cause.fault.code, cause.share, cause.certain) == (code, 1.0, False)
    assert cause.fault.numbers == {"light_dn": 2.5} | ({"coverage_percent": 0.0} if code is DIRTY else {})


@pytest.mark.parametrize(
    ("coverage", "noise_mm", "word"),
    [(None, None, "few"), (25.0, 0.26, "noisy")],
)
def test_a_poor_scan_without_a_cause_has_few_or_noisy_points(coverage: Given, noise_mm: Given, word: str) -> None:
    summary = CloudSummary(10, coverage, None, noise_mm, None)
    (cause,) = find_causes((said("light", left_saturated_percent=0.0), SEEN, STILL), summary, USUAL, (USUAL,))
    assert (cause.fault.code, cause.share, cause.certain) == (FaultCode.SCAN_POOR, 0.0, False)
    assert word in cause.fault.detail
    assert cause.fault.numbers == ({} if coverage is None else {"coverage_percent": coverage})


# -------------------------------------------------------------------------------------------- all together


def test_a_cause_that_two_judges_see_is_named_once_with_the_larger_share_and_as_certain_as_either() -> None:
    dark = said("light", DARK, {"coverage_percent": 90.0})
    (cause,) = find_causes((dark, said("sight", fringe_dn=3.0, top_dn=6.0), STILL), POOR, USUAL, LONGER)
    assert (cause.fault.code, cause.certain) == (DARK, True)
    assert cause.share == pytest.approx(0.8)
    assert cause.fault.numbers["fringe_dn"] == 3.0


def test_verdicts_come_with_identity_first_then_causes_by_what_they_take_then_the_others() -> None:
    who = said("identity", MOVED)
    light = said("light", LAMP, {"ambient_percent": 30.0}, left_saturated_percent=40.0)
    old = said("causes", FaultCode.SCAN_POOR)
    found = with_causes((light, said("window"), old, motion(90.0, MOVED), SEEN, who), POOR, USUAL, LONGER)
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
    assert found[0].verdict.text == "no cause of poor points"


def test_a_movement_that_was_undone_leaves_its_verdict_as_it_is() -> None:
    undone = replace(motion(25.0, UNDONE), verdict=Verdict("motion", True, motion().verdict.numbers, "axial"))
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
    dirty = water(40.0, 30.0, 30.0)
    dirty = replace(
        dirty, verdict=replace(dirty.verdict, numbers={**dirty.verdict.numbers, "attenuation_per_m": attenuation_per_m})
    )
    faults = [one.fault for one in with_causes((dirty, SEEN), GOOD, USUAL, LONGER) if one.fault is not None]
    assert [headline_of(fault) for fault in faults] == [headline]
    assert headline_of(faults[0], Language.GERMAN) == german
    assert ("/m" in faults[0].detail) == headline.startswith("SIGHT"), "the desk counts in attenuation"
