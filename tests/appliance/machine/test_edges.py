"""States that events cannot bring about are left again, questions nobody asked have no answer, and a new machine is at rest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.calibration.guide import AdjustmentSummary, Session, Step, Verified
from appliance.machine import acknowledge, asking, calibrate, gallery, menu, safety, scanning
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.failure import Failure, FailureKind
from appliance.machine.states import Ending, Machine, State, Task, Thermal, boot
from appliance.machine.step import step
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    IN_USE,
    RECORDED,
    SECOND_NS,
    VERIFIED,
    after,
    aim,
    calibrating,
    calibrating_at,
    good,
    heartbeat,
    in_gallery,
    in_menu,
    refused_by_the_disk,
    reviewing,
    run,
    safe,
    safe_with_a_scan,
    saving,
    trial_in_work,
)

EIO = Fault(FaultCode.NOT_SAVED, "EIO")


def later(machine: Machine, seconds: float) -> on.Tick:
    return on.Tick(machine.now_ns + round(seconds * SECOND_NS))


# ------------------------------------------------------------------------------------- what cannot be


@pytest.mark.parametrize(
    "broken",
    [
        lambda: replace(in_menu(), menu=None),
        lambda: replace(in_gallery(), gallery=None),
        lambda: replace(reviewing(), scan=None),
        lambda: replace(calibrating(), calibrating=None),
    ],
)
@pytest.mark.parametrize("key", list(Key))
def test_a_state_without_what_belongs_to_it_leads_to_aim_with_any_key(broken: Callable[[], Machine], key: Key) -> None:
    machine = broken()
    labels(machine)
    assert run(machine, on.KeyPressed(key)).state is State.AIM


def test_where_nothing_is_asked_there_is_nothing_to_answer() -> None:
    for key in Key:
        assert asking.pressed(aim(), key) == (aim(), ())
        assert asking.other_answer(aim(), key) is None
        assert not menu.may_move(aim(), key)
        assert not gallery.may_move(aim(), key)
        assert calibrate.neighbour(aim(), key) is None
    assert asking.unanswered(aim()) == aim()
    assert acknowledge.forgotten(aim()) == aim()
    assert calibrate.decision(aim()) is None
    assert not menu.may_choose(aim())
    assert not calibrate.records(aim())
    assert calibrate.late(aim()) == (aim(), ())
    assert scanning.stopped_adding(reviewing()) == (reviewing(), ())
    assert scanning.rejected(aim()) == (aim(), ())
    assert scanning.no_cloud(aim(), EIO)[0].state is State.AIM


def test_after_the_end_nothing_is_forced() -> None:
    ended, _ = safety.stop(safe(), Ending.POWER_OFF)
    assert ended.state is State.SHUTDOWN
    assert safety.forced(ended) == (ended, ())
    assert run(safe(), on.StopRequested("SIGTERM")).state is State.SHUTDOWN
    assert step(ended, on.KeyPressed(Key.SCAN)) == (ended, ())


def test_a_safe_whose_cause_has_gone_is_left_with_the_scan_still_to_be_decided_on() -> None:
    assert run(replace(safe(), conditions=()), later(safe(), 0.1)).state is State.AIM
    waits = replace(safe_with_a_scan(), conditions=())
    assert run(waits, later(waits, 0.1)).state is State.SAFE, "its cloud is awaited"
    wet = run(saving(), heartbeat(leak=True), heartbeat(leak=True))
    dried = replace(wet, conditions=())
    assert run(dried, later(dried, 0.1)).state is State.SAFE, "it is being published"
    refused = run(wet, on.SaveFailed(1, EIO))
    refused = replace(refused, conditions=())
    review = run(refused, later(refused, 0.1))
    assert (review.state, review.scan is not None) == (State.REVIEW, True)
    ending = replace(refused, stopping=Ending.STOP)
    assert run(ending, later(ending, 0.1)).state is State.SAFE, "it ends as soon as that is saved"


def test_a_new_machine_is_dark_and_has_a_whole_ration_of_light() -> None:
    machine = boot(5)
    assert machine.thermal == Thermal({}, {}, False, 20.0, False)
    assert (machine.now_ns, machine.since_ns, machine.lasers_off_since_ns) == (5, 5, 5)
    assert (machine.captures, machine.retries, machine.leak_votes, machine.session) == (0, 0, 0, Session())


def test_a_device_that_is_told_to_have_booted_again_starts_no_second_self_test() -> None:
    for machine in (aim(), reviewing(), safe()):
        assert step(machine, on.BootFinished()) == (machine, ())


# ------------------------------------------------------------------------------------- calibration


def task(machine: Machine) -> tuple[Step, Task | None, int | None]:
    at = machine.calibrating
    assert at is not None
    return at.step, at.task, at.number


def test_a_recording_that_is_entered_is_not_taken_back_by_leaving() -> None:
    machine = run(trial_in_work(), on.TrialExamined(1, good(Step.M1)))
    assert task(machine) == (Step.M1, Task.ACCEPT, 1)
    left, effects = after(machine, on.KeyPressed(Key.BACK))
    assert left.state is State.AIM
    assert not any(isinstance(effect, do.CancelCalibration | do.Reject) for effect in effects)


def test_leaving_while_a_recording_is_looked_at_puts_it_away_with_the_reason() -> None:
    _, effects = after(trial_in_work(), on.KeyPressed(Key.BACK))
    assert do.CancelCalibration() in effects
    assert do.Reject(1, "calibration M1: left by the diver") in effects


def test_answers_about_another_recording_or_step_change_nothing() -> None:
    machine = trial_in_work()
    for event in (
        on.TrialExamined(2, good(Step.M1)),
        on.TrialExamined(1, good(Step.M2)),
        on.RawStored(2),
        on.CalibrationProgressed(0.5),
    ):
        assert step(machine, event) == (machine, ())
    storing = run(calibrating(), on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1))
    assert task(storing) == (Step.M1, Task.STORE, 1)
    assert step(storing, on.TrialExamined(1, good(Step.M1))) == (storing, ())
    assert task(run(storing, on.SaveFailed(2, EIO))) == (Step.M1, Task.STORE, 1)
    refused = run(storing, on.SaveFailed(1, EIO))
    assert task(refused) == (Step.M1, None, None)
    assert refused.calibrating is not None
    assert refused.calibrating.failed == Failure(FailureKind.DISK, "EIO")


def test_a_task_that_came_to_nothing_says_why_and_its_recording_is_put_away() -> None:
    why = Failure(FailureKind.RECORDING, "no bar", "M1")
    machine, effects = after(trial_in_work(), on.CalibrationFailed(why))
    assert task(machine) == (Step.M1, None, None)
    assert machine.calibrating is not None
    assert machine.calibrating.failed == why
    assert [e for e in effects if not isinstance(e, do.GoLive)] == [do.Reject(1, "calibration M1: no bar")]
    for idle in (calibrating(), aim()):
        assert step(idle, on.CalibrationFailed(why)) == (idle, ())
    solving = run(calibrating_at(RECORDED), on.KeyPressed(Key.SCAN))
    machine, effects = after(solving, on.CalibrationFailed(why))
    assert (task(machine), effects) == ((Step.SOLVE, None, None), [])


def test_another_session_leads_on_from_what_can_not_be_done_any_more() -> None:
    at_result = calibrating_at(IN_USE)
    assert task(at_result)[0] is Step.RESULT
    assert task(run(at_result, on.SessionChanged(Session())))[0] is Step.M1
    assert task(run(at_result, on.SessionChanged(VERIFIED)))[0] is Step.RESULT, "it can be decided on again"
    unverified = Session(RECORDED.trials, AdjustmentSummary("bundle", 0.03, (), "abc"))
    assert task(run(at_result, on.SessionChanged(unverified)))[0] is Step.VERIFY
    assert run(aim(), on.SessionChanged(IN_USE)).state is State.AIM


def test_a_bar_that_checks_what_was_solved_leads_to_the_decision() -> None:
    machine = calibrating_at(Session(RECORDED.trials, AdjustmentSummary("bundle", 0.03, (), "abc")))
    assert task(machine)[0] is Step.VERIFY
    recorded = (on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1), on.RawStored(1))
    machine = run(machine, *recorded, on.TrialExamined(1, good(Step.VERIFY)))
    assert task(machine) == (Step.VERIFY, Task.ACCEPT, 1)
    assert task(run(machine, on.SessionChanged(VERIFIED))) == (Step.RESULT, None, None)


@pytest.mark.parametrize(("error", "told"), [(0.0009, False), (0.0013, True), (-0.0013, True), (-0.0009, False)])
def test_a_length_is_told_as_wrong_from_a_thousandth_on_in_either_direction(error: float, told: bool) -> None:
    machine = run(aim(), on.SessionChanged(Session((good(Step.VERIFY),), None, Verified(error, None, 0.0001))))
    found = [fault for fault in machine.conditions if fault.code is FaultCode.LENGTH_ERROR]
    assert bool(found) == told
    if told:
        assert found[0].numbers == {"error_percent": pytest.approx(0.13)}
        assert f"{100 * error:+.3f} %" in found[0].detail


# ------------------------------------------------------------------------------------- light and keys


@pytest.mark.parametrize(("celsius", "rests_s"), [(20.0, 180.0), (51.0, 30.0)])
def test_light_rests_three_minutes_after_the_latest_key_and_half_a_minute_where_it_is_warm(
    celsius: float, rests_s: float
) -> None:
    machine = run(aim(), heartbeat(temperature_case_c=celsius, temperature_projector_c=20.0))
    for start in (machine, run(machine, later(machine, 20.0), on.KeyPressed(Key.BACK))):
        beat = heartbeat(temperature_case_c=celsius, temperature_projector_c=20.0)
        assert after(start, later(start, rests_s - 0.001), beat)[1] == []
        assert [e.light for e in after(start, later(start, rests_s))[1] if isinstance(e, do.GoLive)] == [False]


def test_the_press_that_woke_a_jammed_key_means_what_it_says() -> None:
    machine = run(aim(), on.KeyJammed(Key.SCAN))
    assert run(machine, on.KeyPressed(Key.UP)).state is State.ARMED
    assert run(machine, on.KeyPressed(Key.SCAN)).stuck == frozenset()
    assert run(run(machine, on.KeyFreed(Key.SCAN)), on.KeyPressed(Key.UP)).state is State.MENU
    back = run(aim(), on.KeyJammed(Key.BACK))
    assert run(back, on.KeyPressed(Key.UP)).state is State.MENU


def test_a_save_that_the_disk_refused_can_be_given_up() -> None:
    machine, effects = after(refused_by_the_disk(), on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))
    assert (machine.state, machine.scan) == (State.AIM, None)
    assert do.Reject(1, "rejected by the diver") in effects
