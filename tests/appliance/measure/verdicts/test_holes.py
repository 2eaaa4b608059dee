"""A hole where a surface was seen is told from shadow, dark paint, edges and what one camera alone sees; and who made it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.decode.decoder import Mask
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.causes import find_causes
from appliance.measure.verdicts.holes import grid_step_px, judge_distance, judge_holes

SHAPE = (300, 400)
OBJECT = np.s_[50:250, 100:300]
"""200 × 200 places: a hole of 35 × 35 of them is 3.06 %, one of 34 × 34 2.89 %."""
MADE_BY = {
    Mask.SATURATED: FaultCode.TOO_BRIGHT,
    Mask.CONTRADICTION: FaultCode.PART_MISSING,
    Mask.EDGE: FaultCode.PART_MISSING,
}


def scene(size: int, reason: Mask) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]:
    """Mask, dark image and points of an object before shadow, with a square of ``size`` places that has no points."""
    mask = np.full(SHAPE, Mask.SHADOW, np.uint8)
    mask[OBJECT] = Mask.VALID
    mask[120 : 120 + size, 180 : 180 + size] = reason
    return mask, np.full(SHAPE, 9, np.uint8), mask == Mask.VALID


@pytest.mark.parametrize("reason", list(MADE_BY))
def test_a_scan_with_a_hole_in_its_middle_is_not_good(reason: Mask) -> None:
    found, percent = judge_holes(*scene(35, reason)), 100.0 * 35**2 / 200**2
    assert found.verdict.passed is False
    assert found.verdict.numbers["hole_percent"] == found.verdict.numbers["largest_percent"] == pytest.approx(percent)
    assert found.fault is not None
    assert found.fault.code is MADE_BY[reason]
    assert found.fault.numbers == pytest.approx({"hole_percent": percent})
    small = judge_holes(*scene(34, reason))
    assert (small.verdict.passed, small.fault) == (True, None)


@pytest.mark.parametrize(
    ("reason", "saturated_rows", "dark_dn", "lit_rows", "percent", "code"),
    [
        # What a torch burns away is the torch's: saturated in the dark it counts as shadow.
        (Mask.SHADOW, 0, 255, 60, 100.0, FaultCode.AMBIENT),
        (Mask.SATURATED, 60, 127, 60, 100.0, FaultCode.AMBIENT),
        # Where the projector alone saturates, a shorter exposure helps.
        (Mask.SATURATED, 60, 126, 60, 100.0, FaultCode.TOO_BRIGHT),
        # Light made holes of which half is saturated.
        (Mask.CONTRADICTION, 29, 200, 29, 100.0 * 29 / 60, FaultCode.PART_MISSING),
        (Mask.CONTRADICTION, 30, 200, 29, 50.0, FaultCode.TOO_BRIGHT),
        (Mask.CONTRADICTION, 60, 200, 30, 100.0, FaultCode.AMBIENT),
    ],
)
def test_a_hole_that_light_made_is_the_lights(
    reason: Mask, saturated_rows: int, dark_dn: int, lit_rows: int, percent: float, code: FaultCode
) -> None:
    mask, dark, there = scene(60, reason)
    mask[120 : 120 + saturated_rows, 180:240] = Mask.SATURATED
    dark[120 : 120 + lit_rows, 180:240] = dark_dn
    found = judge_holes(mask, dark, there)
    assert found.fault is not None
    assert found.fault.code is code
    assert found.verdict.numbers["saturated_percent"] == pytest.approx(percent)


@pytest.mark.parametrize("reason", [Mask.SHADOW, Mask.WEAK, Mask.VALID])
def test_shadow_dark_paint_and_what_one_camera_sees_are_no_holes(reason: Mask) -> None:
    mask, dark, _ = scene(60, reason)
    there = mask == Mask.VALID
    there[120:180, 180:240] = False
    numbers = judge_holes(mask, dark, there).verdict.numbers
    assert numbers == {"hole_percent": 0.0, "largest_percent": 0.0, "saturated_percent": None}


def test_a_hole_is_three_places_wide_and_high_and_the_largest_is_told() -> None:
    mask, dark, _ = scene(0, Mask.VALID)
    for part in (np.s_[60:62, 110:150], np.s_[70:110, 110:112], np.s_[60:63, 200:203], np.s_[80:84, 200:203]):
        mask[part] = Mask.EDGE
    numbers = judge_holes(mask, dark, mask == Mask.VALID).verdict.numbers
    assert numbers["hole_percent"] == pytest.approx(100.0 * (9 + 12) / 200**2)
    assert numbers["largest_percent"] == pytest.approx(100.0 * 12 / 200**2)


def test_a_flange_that_was_lost_when_the_motion_was_undone_is_missing() -> None:
    mask, dark, there = scene(0, Mask.VALID)
    before = there.copy()
    there[100:140, 100:300] = False
    assert judge_holes(mask, dark, there).fault is None, "it is not known whether anything was there"
    found = judge_holes(mask, dark, there, before)
    assert found.fault is not None
    assert found.fault.code is FaultCode.PART_MISSING
    assert found.verdict.numbers["hole_percent"] == pytest.approx(20.0)


def test_nothing_seen_is_nothing_to_judge() -> None:
    empty = judge_holes(np.full(SHAPE, Mask.SHADOW, np.uint8), np.zeros(SHAPE, np.uint8), np.zeros(SHAPE, bool))
    far = judge_distance(CloudSummary(0, 0.0, None, None, None), STANDARD)
    for found in (empty, far):
        assert (found.verdict.passed, found.verdict.numbers, found.fault) == (None, {}, None)


@pytest.mark.parametrize(("width_px", "step_px"), [(1600, 4), (600, 2), (599, 1), (240, 1), (100, 1)])
def test_a_hole_is_as_wide_on_the_surface_whatever_the_camera(width_px: int, step_px: int) -> None:
    assert grid_step_px(width_px) == step_px


FAR, NEAR, LARGER = FaultCode.SCAN_FAR, FaultCode.SCAN_NEAR, WorkingVolume(500.0, 600.0, 700.0)


@pytest.mark.parametrize(
    ("distance_mm", "volume", "code"),
    [
        (561.0, STANDARD, FAR), (560.0, STANDARD, None), (440.0, STANDARD, None), (439.0, STANDARD, NEAR), (578.0, LARGER, None),
    ],
)  # fmt: skip
def test_a_scan_outside_of_its_volume_says_so(
    distance_mm: float, volume: WorkingVolume, code: FaultCode | None
) -> None:
    found = judge_distance(CloudSummary(9, 90.0, distance_mm, 0.02, 0.01), volume)
    assert (None if found.fault is None else found.fault.code) is code
    assert (found.verdict.passed, found.verdict.numbers) == (code is None, {"distance_mm": distance_mm})
    assert found.fault is None or found.fault.numbers == found.verdict.numbers


def test_what_is_missing_is_told_once_and_only_where_nothing_else_explains_it() -> None:
    summary = CloudSummary(9, 90.0, 578.0, 0.02, 0.01)
    missing = Judgement(Verdict("holes", False), Fault(FaultCode.PART_MISSING, "", {"hole_percent": 7.0}))
    numbers = {"added_noise_percent": 1.0, "score": 2.0, "score_limit": 1.0}
    moved = Judgement(Verdict("motion", False, numbers), Fault(FaultCode.COMPENSATED))
    for judgements, codes in (
        ((missing,), [FaultCode.PART_MISSING]),
        ((moved, missing), [FaultCode.COMPENSATED, FaultCode.PART_MISSING]),
        ((missing, judge_distance(summary, STANDARD)), [FaultCode.SCAN_FAR]),
    ):
        assert [cause.fault.code for cause in find_causes(judgements, summary, Exposure(12_000), ())] == codes
