"""Calibrations in water as the diver lives them, key by key."""

from __future__ import annotations

import pytest

from appliance.calibration.guide import RecordingCheck, Refusal, Session, Step, Verified
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.failure import Failure, FailureKind
from appliance.machine.leading import alerts
from appliance.machine.permissions import may_light
from appliance.machine.states import Device, Machine, State, Task
from appliance.machine.words import STEP_NAMES
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    IN_USE,
    RECORDED,
    SECOND_NS,
    SOLVED,
    VERIFIED,
    after,
    calibrating,
    calibrating_at,
    good,
    heartbeat,
    run,
    trial_in_work,
)

NOT_CONVERGED = Failure(FailureKind.NO_SOLUTION, "did not converge")


def at(machine: Machine) -> tuple[Step, Task | None]:
    assert machine.calibrating is not None
    return machine.calibrating.step, machine.calibrating.task


def test_the_menu_leads_to_the_first_step_that_is_not_done() -> None:
    machine = calibrating_at(Session((good(Step.M1), good(Step.M2))))
    assert machine.state is State.CALIBRATE
    assert at(machine) == (Step.M3, None)


def test_a_recording_that_will_do_is_stored_examined_entered_and_the_next_step_follows() -> None:
    machine, effects = after(calibrating(), on.KeyPressed(Key.SCAN))
    assert any(isinstance(e, do.Arm) for e in effects)
    machine = run(machine, on.Armed(1))
    assert machine.state is State.CAPTURE
    machine, effects = after(machine, on.CaptureFinished(1))
    assert do.StoreRaw(1) in effects
    assert not any(isinstance(e, do.StartReconstruction) for e in effects), "its cloud would be empty: ports unknown"
    machine, effects = after(machine, on.RawStored(1))
    assert effects == [do.CheckRecording(1, Step.M1)], "not before the frames are safe"
    check = good(Step.M1)
    machine, effects = after(machine, on.TrialExamined(1, check))
    assert effects == [do.AcceptRecording(1, check)]
    machine = run(machine, on.Saved(1, "000001"), on.SessionChanged(Session((check,))))
    assert at(machine) == (Step.M2, None)
    assert machine.calibrating is not None
    assert machine.calibrating.latest == check, "what was reached stays on the screen until the next key"


def test_a_recording_that_will_not_do_is_rejected_with_its_reason_and_the_step_stays() -> None:
    refused = RecordingCheck(Step.M1, Refusal.TILT_MORE, 12.0, 900, "bar 150.0 mm, 12.0° in depth")
    machine, effects = after(trial_in_work(), on.TrialExamined(1, refused))
    assert effects == [do.Reject(1, "calibration M1: TILT_MORE: bar 150.0 mm, 12.0° in depth")]
    assert at(machine) == (Step.M1, None)
    assert machine.calibrating is not None
    assert machine.calibrating.latest == refused
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert machine.state is State.ARMED
    assert machine.calibrating is not None
    assert machine.calibrating.latest is None, "the message goes with the next key"


@pytest.mark.parametrize(
    ("event", "headline"),
    [
        (on.CaptureFailed(1, Fault(FaultCode.FRAME_MISSING, "", {"received": 23, "expected": 24})), "INCOMPLETE 23/24"),
        (on.DeviceDown(Device.CAMERA_LEFT, "unplugged"), "SCAN FAILED"),
        (on.KeyPressed(Key.BACK), None),
    ],
)
def test_a_capture_that_fails_or_is_stopped_leads_back_to_its_step(event: on.Event, headline: str | None) -> None:
    machine = run(calibrating(), on.KeyPressed(Key.SCAN), event)
    assert machine.state is State.CALIBRATE
    assert at(machine) == (Step.M1, None)
    shown = alerts(machine)
    assert (shown[0].headline if shown else None) == headline


def test_a_scan_is_refused_at_a_step_for_the_same_reasons_as_while_aiming() -> None:
    machine, effects = after(calibrating(), on.DeviceDown(Device.BOARD, "silent"), on.KeyPressed(Key.SCAN))
    assert machine.state is State.CALIBRATE
    assert alerts(machine)[0].action == "SCAN REFUSED"
    assert not any(isinstance(e, do.Arm) for e in effects)


def test_up_and_down_lead_where_their_labels_say_and_no_farther_than_what_is_done() -> None:
    machine = calibrating()
    assert Key.UP not in labels(machine)
    for step in (Step.M2, Step.M3, Step.M4):
        assert labels(machine)[Key.DOWN] == STEP_NAMES[step].english
        machine = run(machine, on.KeyPressed(Key.DOWN))
        assert at(machine) == (step, None)
    assert labels(machine)[Key.DOWN] == Step.VERIFY.value, "nothing can be solved yet, but checked"
    machine = run(machine, on.KeyPressed(Key.DOWN))
    assert at(machine) == (Step.VERIFY, None)
    assert Key.DOWN not in labels(machine), "there is no result yet"
    machine = calibrating_at(VERIFIED)
    steps = []
    while Key.UP in labels(machine):
        machine = run(machine, on.KeyPressed(Key.UP))
        steps.append(at(machine)[0])
    assert steps == [Step.VERIFY, Step.SOLVE, Step.M4, Step.M3, Step.M2, Step.M1]
    assert labels(machine)[Key.SCAN] == "REDO"


def test_solving_shows_how_far_it_is_and_can_be_left_at_any_time() -> None:
    machine, effects = after(calibrating_at(RECORDED), on.KeyPressed(Key.SCAN))
    assert effects == [do.SolveCalibration()]
    assert at(machine) == (Step.SOLVE, Task.SOLVE)
    machine = run(machine, on.CalibrationProgressed(0.4))
    assert machine.calibrating is not None
    assert machine.calibrating.progress == 0.4
    left, effects = after(machine, on.KeyPressed(Key.BACK))
    assert left.state is State.AIM
    assert do.CancelCalibration() in effects
    assert left.session == RECORDED, "progress is kept"
    assert run(left, on.KeyHeld(Key.BACK)).state is State.AIM, "the same press does not switch off"
    assert at(run(machine, on.SessionChanged(SOLVED))) == (Step.VERIFY, None)


def test_what_fails_says_why_and_may_be_tried_again() -> None:
    machine = run(calibrating_at(RECORDED), on.KeyPressed(Key.SCAN), on.CalibrationFailed(NOT_CONVERGED))
    assert at(machine) == (Step.SOLVE, None)
    assert machine.calibrating is not None
    assert machine.calibrating.failed == NOT_CONVERGED
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.SolveCalibration()]


def test_the_result_is_kept_and_the_old_one_restored_with_the_same_key() -> None:
    machine, effects = after(calibrating_at(VERIFIED), on.KeyPressed(Key.SCAN))
    assert effects == [do.UseSolved()]
    machine = run(machine, on.SessionChanged(IN_USE))
    assert at(machine) == (Step.RESULT, None)
    assert labels(machine)[Key.SCAN] == "RESTORE"
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.RestoreKeptCalibration()]
    assert labels(run(machine, on.SessionChanged(VERIFIED)))[Key.SCAN] == "KEEP"


def test_the_bar_alone_checks_the_calibration_in_use_and_a_wrong_length_is_told_until_it_is_right() -> None:
    machine = run(calibrating(), *[on.KeyPressed(Key.DOWN)] * 4)
    assert at(machine) == (Step.VERIFY, None), "past SOLVE, for which there is nothing"
    bar = good(Step.VERIFY)
    machine = run(machine, on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1), on.RawStored(1))
    machine = run(
        machine, on.TrialExamined(1, bar), on.SessionChanged(Session((bar,), None, Verified(-0.006, None, 0.0001)))
    )
    assert at(machine) == (Step.RESULT, None)
    assert Key.SCAN not in labels(machine), "there is nothing to keep"
    (told,) = [alert for alert in alerts(machine) if alert.code is FaultCode.LENGTH_ERROR]
    assert told.headline == "LENGTH ERR 0.6 %"
    assert run(machine, on.KeyPressed(Key.BACK)).state is State.AIM
    right = run(machine, on.SessionChanged(Session((bar,), None, Verified(0.0004, None, 0.0001))))
    assert not [alert for alert in alerts(right) if alert.code is FaultCode.LENGTH_ERROR]
    used = Session(VERIFIED.trials, SOLVED.solved, Verified(0.006, 0.0002, 0.0001), True, "0001.json")
    better = run(machine, on.SessionChanged(used))
    assert not [alert for alert in alerts(better) if alert.code is FaultCode.LENGTH_ERROR], "another one is in use"


def test_a_new_session_needs_a_long_press() -> None:
    machine, effects = after(calibrating_at(IN_USE), on.KeyPressed(Key.DOWN))
    assert effects == []
    machine, effects = after(machine, on.KeyHeld(Key.DOWN))
    assert effects == [do.BeginSession()]
    assert at(run(machine, on.SessionChanged(Session()))) == (Step.M1, None)
    for session in (Session(), RECORDED, SOLVED):
        _, effects = after(calibrating_at(session), on.KeyPressed(Key.DOWN), on.KeyHeld(Key.DOWN))
        assert do.BeginSession() not in effects


@pytest.mark.parametrize(
    ("events", "task_s"),
    [
        ((on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1)), "saving_s"),
        ((on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1), on.RawStored(1)), "examine_s"),
    ],
)
def test_who_does_not_answer_is_not_awaited_for_ever(events: tuple[on.Event, ...], task_s: str) -> None:
    machine = run(calibrating(), *events)
    limit_ns = machine.now_ns + int(getattr(machine.settings, task_s) * SECOND_NS)
    assert at(run(machine, on.Tick(limit_ns - 1)))[1] is not None
    machine, effects = after(machine, on.Tick(limit_ns))
    assert at(machine) == (Step.M1, None)
    assert do.CancelCalibration() in effects
    assert any(isinstance(e, do.Reject) for e in effects)


def test_an_answer_that_comes_too_late_changes_nothing() -> None:
    machine = run(trial_in_work(), on.KeyPressed(Key.BACK))
    late, effects = after(machine, on.TrialExamined(1, good(Step.M1)), on.CalibrationProgressed(0.5))
    assert (late, effects) == (machine, [])


def test_water_in_the_housing_puts_the_light_out_at_every_step() -> None:
    for session in (Session(), RECORDED, SOLVED, VERIFIED, IN_USE):
        machine, effects = after(calibrating_at(session), heartbeat(leak=True), heartbeat(leak=True))
        assert not may_light(machine)
        assert do.LightsOff() in effects
        assert alerts(machine)[0].code is FaultCode.LEAK
        assert machine.state is State.SAFE
        machine, effects = after(machine, on.KeyPressed(Key.BACK))
        assert not any(isinstance(e, do.GoLive) and (e.light or e.lasers) for e in effects)


def test_a_disk_that_refuses_the_frames_costs_the_recording_and_not_the_session() -> None:
    machine = run(calibrating(), on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1))
    machine = run(machine, on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")))
    assert at(machine) == (Step.M1, None)
    assert any(alert.code is FaultCode.NOT_SAVED for alert in alerts(machine))
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert any(isinstance(e, do.Arm) for e in effects)
