"""What becomes of a scan step by step: which answers count, which come too late, and what is told, tidied up and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.conditions import has
from appliance.machine.leading import alerts
from appliance.machine.permissions import other_exposure, second_exposure
from appliance.machine.saving import late
from appliance.machine.states import Device, Machine, State, boot
from appliance.machine.step import step
from appliance.ranging.reach import Range
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    HOLD_BACK,
    RECORDED,
    SECOND_NS,
    SUMMARY,
    after,
    aim,
    armed,
    asked,
    calibrating,
    calibrating_at,
    capturing,
    checking,
    heartbeat,
    kept_before_the_cloud,
    reconstructing,
    reviewing,
    run,
    safe_with_a_scan,
    saving,
    trial_in_work,
)

EIO = Fault(FaultCode.NOT_SAVED, "EIO")
DIED = Fault(FaultCode.RECONSTRUCTION_FAILED, "worker exited with 9")
SPOILT = Fault(FaultCode.PATTERN_WRONG)
LEAK = (heartbeat(leak=True), heartbeat(leak=True))
STOP = on.StopRequested("SIGTERM")
ADD = (on.KeyPressed(Key.DOWN), on.KeyHeld(Key.DOWN))
SCAN, DOWN, BACK = (on.KeyPressed(key) for key in (Key.SCAN, Key.DOWN, Key.BACK))
SECOND = Exposure(3_200)


def later(machine: Machine, seconds: float) -> on.Tick:
    return on.Tick(machine.now_ns + round(seconds * SECOND_NS))


def offered() -> Machine:
    """In review, and a second exposure would add to it."""
    return run(reviewing(), on.Judged(1, (), None, SECOND))


def adding() -> Machine:
    """The second sequence is being worked out."""
    return run(offered(), *ADD, on.Armed(2), on.CaptureFinished(2))


# ------------------------------------------------------------------------------------- to the review


@pytest.mark.parametrize(
    ("way", "reason"),
    [
        (checking, "rejected before the cloud was ready"),
        (reconstructing, "rejected before the cloud was ready"),
        (lambda: run(reconstructing(), on.CoarseReady(1, SUMMARY)), "rejected by the diver"),
    ],
)
def test_a_scan_that_is_rejected_before_its_cloud_is_whole_ends_its_worker(
    way: Callable[[], Machine], reason: str
) -> None:
    machine, effects = after(way(), *HOLD_BACK)
    assert machine.state is State.AIM
    assert [e for e in effects if not isinstance(e, do.GoLive)] == [do.CancelReconstruction(1), do.Reject(1, reason)]


def test_a_scan_that_is_rejected_with_its_cloud_has_no_worker_to_end() -> None:
    _, effects = after(reviewing(), *HOLD_BACK)
    assert [e for e in effects if not isinstance(e, do.GoLive)] == [do.Reject(1, "rejected by the diver")]


def test_patterns_that_are_found_right_after_the_cloud_change_nothing() -> None:
    machine = run(checking(), on.CoarseReady(1, SUMMARY))
    assert machine.state is State.REVIEW
    assert step(machine, on.PatternsRight(1)) == (machine, ())


def test_a_worker_that_failed_by_itself_is_not_ended_once_more_and_a_late_cloud_is_welcome() -> None:
    machine, effects = after(reconstructing(), on.ReconstructionFailed(1, DIED))
    assert (machine.state, effects) == (State.REVIEW, [])
    machine = run(machine, on.FullReady(1, SUMMARY))
    assert machine.scan is not None
    assert (machine.scan.full, machine.scan.failed) == (SUMMARY, None)
    assert alerts(machine) == ()


def test_a_spoilt_scan_without_a_sentence_is_rejected_by_the_name_of_its_fault() -> None:
    _, effects = after(reconstructing(), on.ReconstructionFailed(1, SPOILT))
    assert do.Reject(1, SPOILT.code.value) in effects


def test_what_is_told_of_a_scan_that_is_being_published_comes_too_late() -> None:
    machine = saving()
    for event in (on.FullReady(1, SUMMARY), on.ReconstructionFailed(1, SPOILT), on.ReconstructionFailed(1, DIED)):
        said, effects = after(machine, event)
        assert (said.state, effects) == (State.SAVING, [])
        assert said.scan is not None
        assert said.scan.publishing


def test_a_far_object_is_no_reason_to_ask_at_a_step_of_the_calibration() -> None:
    machine = run(calibrating(), on.Ranged(Range(700.0, 0.0, 0.5, 2)), SCAN)
    assert machine.state is State.ARMED


def test_heat_refuses_a_scan_at_a_step_of_the_calibration_where_the_diver_is() -> None:
    machine = run(calibrating(), heartbeat(temperature_case_c=61.0), SCAN)
    assert machine.state is State.CALIBRATE
    assert alerts(machine)[0].action == "SCAN REFUSED"


def test_exactly_enough_light_is_enough_and_a_sequence_takes_its_share() -> None:
    machine = run(aim(), heartbeat())
    machine = run(machine, later(machine, 6.0), heartbeat())
    for left_s, begun in ((0.39, False), (0.4, True), (12.0, True)):
        rationed = replace(machine, thermal=replace(machine.thermal, ration_s=left_s))
        scanned = run(rationed, SCAN, on.Armed(1))
        assert (scanned.state is State.CAPTURE) == begun, left_s
        if begun:
            assert scanned.thermal.ration_s == pytest.approx(left_s - 0.4)


@pytest.mark.parametrize(("device", "clears"), [("board", True), (None, True), ("camera.left", False)])
def test_a_laser_that_images_showed_is_not_taken_back_by_what_the_board_reads(device: str | None, clears: bool) -> None:
    machine = run(capturing(), on.CaptureFailed(1, Fault(FaultCode.LASER_ON, "seen", device=device)))
    witness = device if device != "board" else None
    assert has(machine, FaultCode.LASER_ON, witness)
    machine = run(machine, later(machine, 5.0), heartbeat())
    assert has(machine, FaultCode.LASER_ON, witness) == (not clears)


@pytest.mark.parametrize(
    ("named", "reopened"),
    [("camera.right", Device.CAMERA_RIGHT), ("camera.left", Device.CAMERA_LEFT), (None, None), ("cameras", None)],
)
def test_the_camera_that_is_stuck_is_opened_again_and_both_where_nobody_knows_which(
    named: str | None, reopened: Device | None
) -> None:
    _, effects = after(capturing(), on.CaptureFailed(1, Fault(FaultCode.CAMERA_STUCK, "same image", device=named)))
    assert do.ReopenDevice(reopened) in effects


# ------------------------------------------------------------------------------------- a second exposure


def test_a_second_exposure_is_offered_in_the_review_of_a_whole_cloud_only() -> None:
    assert second_exposure(offered()) == SECOND
    coarse = run(reconstructing(), on.CoarseReady(1, SUMMARY), on.Judged(1, (), None, SECOND))
    assert second_exposure(coarse) is None
    assert Key.DOWN not in labels(coarse)
    for machine in (run(offered(), SCAN), run(checking(), on.Judged(1, (), None, SECOND)), aim()):
        assert second_exposure(machine) is None


def test_another_exposure_is_proposed_in_the_review_only() -> None:
    proposal = on.Judged(1, (), Exposure(8_000))
    assert other_exposure(run(reviewing(), proposal)) == Exposure(8_000)
    for machine in (run(checking(), proposal), run(reviewing(), proposal, SCAN), aim(), reviewing()):
        assert other_exposure(machine) is None


def test_a_second_exposure_that_cannot_be_recorded_is_refused_and_the_review_goes_on() -> None:
    machine, effects = after(offered(), on.DeviceDown(Device.BOARD, "gone"), *ADD)
    assert (machine.state, effects) == (State.REVIEW, [])
    assert alerts(machine)[0].action == "SCAN REFUSED"
    assert machine.scan == offered().scan


def test_whatever_lasts_back_gives_up_the_second_exposure_first() -> None:
    machine = run(adding(), on.ConditionRaised(Fault(FaultCode.UNCALIBRATED)))
    assert labels(machine)[Key.BACK] == "STOP"
    machine = run(machine, BACK)
    assert (machine.state, machine.seen) == (State.REVIEW, ())


def test_while_a_second_exposure_is_worked_out_the_first_can_not_be_rejected() -> None:
    machine, effects = after(adding(), on.KeyHeld(Key.BACK))
    assert machine.scan is not None
    assert not any(isinstance(effect, do.Reject) for effect in effects)


def test_answers_about_another_pair_and_after_it_was_given_up_change_nothing() -> None:
    for event in (on.PairMerged(2, SUMMARY), on.PairFailed(2, DIED)):
        assert step(adding(), event) == (adding(), ())
    for machine in (offered(), reconstructing(), run(adding(), BACK)):
        for event in (on.PairMerged(1, SUMMARY), on.PairFailed(1, DIED)):
            assert step(machine, event) == (machine, ())


def test_frames_of_a_pair_that_the_disk_refuses_are_stored_again() -> None:
    machine = run(adding(), on.PairMerged(1, SUMMARY))
    assert machine.scan is not None
    assert machine.scan.added == SECOND
    machine = run(machine, on.SaveFailed(1, EIO))
    assert after(machine, later(machine, 5.0))[1] == [do.StoreRaw(1)]


# ------------------------------------------------------------------------------------- to the disk


def test_what_the_disk_refused_of_another_scan_does_not_touch_the_one_in_hand() -> None:
    machine = run(reconstructing(), on.SaveFailed(7, EIO))
    assert machine.scan == reconstructing().scan
    assert alerts(machine)[0].code is FaultCode.NOT_SAVED


def test_a_scan_whose_raw_frames_were_refused_is_published_when_that_is_tried_again_not_before() -> None:
    machine, effects = after(kept_before_the_cloud(), on.SaveFailed(1, EIO), on.FullReady(1, SUMMARY))
    assert (machine.state, effects) == (State.SAVING, [])
    machine, effects = after(machine, later(machine, 5.0))
    assert effects == [do.Publish(1)]


def test_a_save_that_succeeded_ends_the_message_and_says_so_until_the_next_key() -> None:
    machine = run(saving(), on.SaveFailed(1, EIO), SCAN, on.Saved(1, "000001"))
    assert (alerts(machine), machine.just_saved) == ((), "000001")
    assert run(machine, DOWN).just_saved is None


def test_a_disk_that_is_silent_about_no_scan_leads_back_to_aim() -> None:
    machine, effects = late(replace(saving(), scan=None))
    assert (machine.state, effects) == (State.AIM, ())
    assert has(machine, FaultCode.NOT_SAVED)


@pytest.mark.parametrize(
    ("left", "full"),
    [(0, True), (1, False), (100, False), (None, False)],
)
def test_the_disk_is_full_when_not_one_more_scan_fits(left: int | None, full: bool) -> None:
    assert has(run(aim(), on.StorageCounted(3, "000003", left)), FaultCode.STORAGE_FULL) == full


def test_a_disk_that_does_not_tell_how_much_fits_is_as_full_as_it_was() -> None:
    machine = run(aim(), on.StorageCounted(3, "000003", 0), on.StorageCounted(3, "000003", None))
    assert has(machine, FaultCode.STORAGE_FULL)
    assert not has(run(machine, on.StorageCounted(2, "000002", 1)), FaultCode.STORAGE_FULL)


# ------------------------------------------------------------------------------------- the end


@pytest.mark.parametrize(
    ("way", "expected"),
    [
        (aim, [do.StopLive()]),
        (armed, [do.AbortCapture(1)]),
        (checking, [do.CancelReconstruction(1)]),
        (reconstructing, [do.CancelReconstruction(1)]),
        (reviewing, []),
        (
            trial_in_work,
            [do.StopLive(), do.CancelCalibration(), do.Reject(1, "calibration M1: switched off")],
        ),
        (lambda: run(calibrating_at(RECORDED), SCAN), [do.CancelCalibration()]),
    ],
)
def test_what_is_under_way_is_ended_before_the_service_is(
    way: Callable[[], Machine], expected: list[do.Effect]
) -> None:
    machine, effects = after(way(), STOP)
    assert (machine.state, effects) == (State.SHUTDOWN, [*expected, do.Quit(power_off=False)])


def test_a_scan_that_was_kept_before_its_cloud_is_saved_with_it_before_the_end() -> None:
    machine, effects = after(kept_before_the_cloud(), STOP)
    assert (machine.state, effects) == (State.SAVING, [])
    machine, effects = after(machine, on.FullReady(1, SUMMARY))
    assert effects == [do.Publish(1)]
    machine, effects = after(machine, on.Saved(1, "000001"))
    assert (machine.state, effects) == (State.SHUTDOWN, [do.Quit(power_off=False)])


def test_a_kept_scan_that_turns_out_worthless_does_not_keep_the_service_from_ending() -> None:
    machine, effects = after(kept_before_the_cloud(), STOP, on.ReconstructionFailed(1, SPOILT))
    assert machine.state is State.SHUTDOWN
    assert [effect for effect in effects if isinstance(effect, do.Reject | do.Quit)] == [
        do.Reject(1, SPOILT.code.value),
        do.Quit(power_off=False),
    ]


def test_in_safe_a_worthless_scan_is_put_away_and_the_instrument_stays_dark() -> None:
    machine, effects = after(safe_with_a_scan(), on.ReconstructionFailed(1, SPOILT))
    assert (machine.state, machine.scan, machine.deadline_ns) == (State.SAFE, None, None)
    assert do.Reject(1, SPOILT.code.value) in effects


@pytest.mark.parametrize("detail", ["2 heartbeats in a row report water", ""])
def test_water_ends_what_a_calibration_was_waiting_for_and_says_why(detail: str) -> None:
    machine, effects = after(trial_in_work(), on.ConditionRaised(Fault(FaultCode.LEAK, detail)))
    assert machine.state is State.SAFE
    assert do.CancelCalibration() in effects
    assert do.Reject(1, f"calibration M1: {detail or FaultCode.LEAK.value}") in effects


def test_water_takes_the_question_of_switching_off_away_also_while_the_instrument_starts() -> None:
    assert run(asked(boot(0)), *LEAK).off_question is None


def test_while_the_question_of_switching_off_is_there_back_answers_that_one() -> None:
    machine = run(asked(aim()), on.ConditionRaised(Fault(FaultCode.UNCALIBRATED)))
    assert labels(machine)[Key.BACK] == "BACK"
    machine = run(machine, BACK)
    assert (machine.off_question, machine.seen) == (None, ())
