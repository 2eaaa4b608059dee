"""The diver is told what is wrong with how the artefact is held, and never refused for what does not matter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.calibrate.guide import HELD, AdjustmentSummary, LengthCheck, RecordingCheck, Refusal, Session, Step
from appliance.calibrate.recordings import ArtefactKind
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.method import Method
from appliance.calibrate.water.start import start_from_air
from appliance.calibrate.water_steps import MeasuredBar, MeasuredPlane, judge_bar, judge_plane, rig_axes
from appliance.measure.calibration.design import design_calibration
from appliance.measure.light.volume import WorkingVolume
from tests.support import calibrating
from tests.support.calibrating import DESIGN, Pose, evaluate, hidden_rig
from tests.support.truth import WATER

RIG = design_calibration(DESIGN, "KF-TEST", 1600, 1200, WATER).rig
LENGTH_MM, RADIUS_MM = 150.0, 15.0


def in_left(points_rig: np.ndarray) -> np.ndarray:
    axes, origin = rig_axes(RIG)
    return points_rig @ axes.T + origin


def bar(tilt_deg: float, roll_deg: float, length_mm: float = LENGTH_MM, **more: Any) -> MeasuredBar:
    pose = Pose((5.0, -10.0, 515.0), (0.0, tilt_deg, roll_deg))
    ends = np.array([[-0.5, 0, 0], [0.5, 0, 0]]) * length_mm @ pose.rotation.T + pose.at_mm
    return replace(MeasuredBar(in_left(ends), (RADIUS_MM, RADIUS_MM), 0.03, 4000), **more)


def plane(distance_mm: float, tilt_deg: float = 8.0, fill_percent: float = 85.0, rms_mm: float = 0.05) -> MeasuredPlane:
    pose = Pose((0.0, 0.0, distance_mm), (tilt_deg, 0.0, 0.0))
    axes, _ = rig_axes(RIG)
    centre = in_left(np.array([pose.at_mm]))[0]
    return MeasuredPlane(centre, axes @ pose.rotation[:, 2], rms_mm, 100_000, fill_percent)


@pytest.mark.parametrize(
    ("step", "found", "refusal", "number"),
    [
        *((step, bar(tilt, roll), None, 0.03) for tilt in (35.0, -35.0) for step, roll in ((Step.M1, 0.0), (Step.M1, -30.0), (Step.M2, 70.0), (Step.M2, 90.0))),
        (Step.M1, bar(12.0, 0.0), Refusal.TILT_MORE, 12.0),
        (Step.M1, bar(57.0, 0.0), Refusal.TILT_LESS, 57.0),
        (Step.M1, bar(0.0, 80.0), Refusal.LAY_DOWN, 80.0),
        (Step.M2, bar(0.0, 20.0), Refusal.STAND_UP, 20.0),
        (Step.VERIFY, bar(35.0, 20.0), Refusal.TILT_LESS, 35.0),
        (Step.M1, bar(35.0, 0.0, length_mm=200.0), Refusal.WRONG_SIZE, 200.0),
        (Step.M1, bar(35.0, 0.0, radii_mm=(12.0, RADIUS_MM)), Refusal.WRONG_SIZE, 12.0),
        (Step.M1, bar(35.0, 0.0, rms_mm=0.8), Refusal.BAD_FIT, 0.8),
        *((step, plane(mm, tilt), None, 0.05) for tilt in (0.0, 15.0, -15.0) for step, mm in ((Step.M3, 470.0), (Step.M4, 570.0))),
        (Step.M3, plane(545.0), Refusal.TOO_FAR, 545.0),
        (Step.M3, plane(400.0), Refusal.TOO_NEAR, 400.0),
        (Step.M4, plane(500.0), Refusal.TOO_NEAR, 500.0),
        (Step.M4, plane(650.0), Refusal.TOO_FAR, 650.0),
        (Step.M3, plane(470.0, 50.0), Refusal.TILT_LESS, 50.0),
        (Step.M3, plane(470.0, fill_percent=20.0), Refusal.NOT_FILLED, 20.0),
        (Step.M3, plane(470.0, rms_mm=2.0), Refusal.BAD_FIT, 2.0),
    ],
)  # fmt: skip
def test_how_an_artefact_is_held_is_right_or_named_with_its_number(
    step: Step, found: MeasuredBar | MeasuredPlane, refusal: Refusal | None, number: float
) -> None:
    if isinstance(found, MeasuredBar):
        check = judge_bar(step, found, RIG, LENGTH_MM, RADIUS_MM)
    else:
        check = judge_plane(step, found, RIG)
    assert check.refusal is refusal
    assert check.number == pytest.approx(number, abs=0.01)


def test_planes_before_a_smaller_housing_belong_nearer() -> None:
    small = replace(RIG, volume=WorkingVolume(264.0, 300.0, 336.0))
    for step, near_mm, far_mm in ((Step.M3, 282.0, 470.0), (Step.M4, 310.0, 342.0)):
        found = [judge_plane(step, plane(mm), small).refusal for mm in (near_mm, far_mm)]
        assert found == ([None, Refusal.TOO_FAR] if step is Step.M3 else [Refusal.TOO_NEAR, None])


def test_no_pose_will_do_for_two_steps() -> None:
    bars = [s for s, kind in HELD.items() if kind is ArtefactKind.BALL_BAR]
    for tilt_deg in range(-60, 61, 10):
        for roll_deg in range(-90, 91, 15):
            found = bar(float(tilt_deg), float(roll_deg))
            fits = [s for s in bars if judge_bar(s, found, RIG, LENGTH_MM, RADIUS_MM).refusal is None]
            assert len(fits) <= 1
    for distance_mm in range(400, 700, 10):
        found_plane = plane(float(distance_mm))
        assert [judge_plane(s, found_plane, RIG).refusal for s in (Step.M3, Step.M4)].count(None) <= 1


def done(*steps: Step) -> Session:
    return Session(tuple(RecordingCheck(step, None, 0.03) for step in steps))


def test_recordings_may_come_in_any_order_but_nothing_is_solved_before_the_fourth() -> None:
    session = done(Step.M3)
    assert session.next_step is Step.M1
    assert all(session.open(step) for step in (Step.M1, Step.M2, Step.M3, Step.M4))
    assert not session.open(Step.SOLVE)
    assert done(Step.M4, Step.M1, Step.M3, Step.M2).next_step is Step.SOLVE


def test_a_recording_made_anew_undoes_what_was_solved_from_the_old_one() -> None:
    session = Session(
        done(Step.M1, Step.M2, Step.M3, Step.M4, Step.VERIFY).trials,
        AdjustmentSummary("bundle", 0.03, (), "abc"),
        LengthCheck(0.003, 0.0001, 0.00005),
        in_use=True,
        kept="0001.json",
    )
    again = session.with_check(RecordingCheck(Step.M2, None, 0.02, scan_id="000009"))
    assert again.next_step is Step.SOLVE
    assert again.solved is None
    assert again.verified == LengthCheck(0.0001, None, 0.00005, "abc"), "what is in use was checked"
    assert again.kept == "0001.json", "the way back stays"
    assert [check.scan_id for check in again.trials if check.step is Step.M2] == ["000009"]
    verified_again = session.with_check(RecordingCheck(Step.VERIFY, None, 0.02))
    assert verified_again.solved == session.solved


def test_a_bar_checks_the_calibration_in_use_before_anything_is_solved() -> None:
    fresh = Session()
    assert fresh.open(Step.VERIFY)
    assert not fresh.open(Step.RESULT)
    checked = replace(
        fresh.with_check(RecordingCheck(Step.VERIFY, None, 0.02)), verified=LengthCheck(0.006, None, 0.0002, "abc")
    )
    assert checked.open(Step.RESULT)
    assert checked.wrong
    assert not replace(checked, verified=LengthCheck(0.0013, None, 0.0002, "abc")).wrong, "it may be chance"
    begun = checked.with_check(RecordingCheck(Step.M1, None, 0.02))
    assert begun.wrong, "a recording changes nothing about what is in use"
    assert begun.check(Step.VERIFY) is None, "and the check was recorded for another purpose"
    assert begun.next_step is Step.M2


LYING, UPRIGHT = (-15.0, -20.0, 505.0), (15.0, 20.0, 540.0)
PLANES = {"as usual": calibrating.CALIBRATION_PLANES, "level": (Pose((0.0, 0.0, 478.0), (0.0, 0.0, 0.0)), Pose((0.0, 0.0, 570.0), (0.0, 0.0, 0.0)))}  # fmt: skip
BARS = {
    "35° both ways": ((LYING, (0.0, 35.0, 20.0)), (UPRIGHT, (0.0, -35.0, 70.0))),
    "35° the same way": ((LYING, (0.0, 35.0, 20.0)), (UPRIGHT, (0.0, 35.0, 70.0))),
    "20°": ((LYING, (0.0, 20.0, 20.0)), (UPRIGHT, (0.0, -20.0, 70.0))),
    "level": ((LYING, (0.0, 0.0, 20.0)), (UPRIGHT, (0.0, 0.0, 70.0))),
    "both lying": ((LYING, (0.0, 35.0, 20.0)), (UPRIGHT, (0.0, -35.0, 20.0))),
}


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_how_bars_and_planes_lean_changes_no_result(seed: int) -> None:
    truth = hidden_rig("realistic", seed)
    air = calibrating.air_of(truth)
    start = start_from_air(air, design_calibration(DESIGN, "KF-TEST", 1600, 1200, WATER))
    errors = {}
    for bars, (first, second) in BARS.items():
        for planes, placed in PLANES.items():
            recordings = calibrating.calibration_recordings(truth, [Pose(*first), Pose(*second)], placed)
            found = calibrate(Method.SPLINE, recordings, start)
            errors[bars, planes] = evaluate(truth, found.calibration.rig).length
    print(f"\nrig {seed}, E_L in percent: " + "; ".join(f"{b}, planes {p}: {e:.3f}" for (b, p), e in errors.items()))
    assert max(errors.values()) < 0.05
    before = evaluate(truth, start.rig).length
    assert max(errors.values()) < before / 3.0
