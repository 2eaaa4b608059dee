"""What the diver sees and what the instrument does, event by event, for the faults of a dive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.alerts import RULES, headline_of
from appliance.machine.leading import alerts
from appliance.machine.states import Device, Machine, Settings, State, boot
from appliance.machine.step import step
from appliance.ranging.reach import Range
from appliance.scan.exposure import NOMINAL, Exposure
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    MISSING,
    PARTS,
    SECOND_NS,
    SUMMARY,
    TO_CALIBRATION,
    UPS,
    about_to_switch_off,
    after,
    aim,
    asked,
    capturing,
    checking,
    heartbeat,
    reconstructing,
    reviewing,
    run,
    saving,
)


def shown(machine: Machine) -> list[tuple[str, str]]:
    return [(alert.headline, alert.action) for alert in alerts(machine)]


def test_a_good_scan_from_key_to_saved() -> None:
    machine, effects = after(aim(), on.KeyPressed(Key.SCAN))
    assert (machine.state, effects) == (State.ARMED, [do.StopLive(), do.Arm(1, 16, NOMINAL)])
    machine, effects = after(machine, on.Armed(1))
    assert (machine.state, effects) == (State.CAPTURE, [do.Capture(1)])
    machine, effects = after(machine, on.CaptureFinished(1))
    assert (machine.state, effects) == (State.CHECK, [do.StoreRaw(1), do.StartReconstruction(1)])
    machine = run(machine, on.RawStored(1), on.PatternsRight(1))
    assert machine.state is State.RECONSTRUCT
    machine = run(machine, on.CoarseReady(1, SUMMARY))
    assert machine.state is State.REVIEW
    machine, effects = after(machine, on.FullReady(1, SUMMARY), on.KeyPressed(Key.SCAN))
    assert effects == [do.Publish(1)]
    assert machine.just_saved is None
    machine, effects = after(machine, on.Saved(1, "000001"))
    assert (machine.state, machine.just_saved, machine.last_scan) == (State.AIM, "000001", "000001")
    assert effects == [do.GoLive(light=True, lasers=True, exposure=NOMINAL)]


def test_keep_before_the_full_cloud_waits_for_it() -> None:
    machine = run(reconstructing(), on.CoarseReady(1, SUMMARY))
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert machine.state is State.SAVING
    assert effects == []
    machine, effects = after(machine, on.FullReady(1, SUMMARY))
    assert effects == [do.Publish(1)]


@pytest.mark.parametrize("way", [checking, reconstructing, reviewing])
def test_a_glove_that_brushes_back_costs_no_scan(way: Callable[[], Machine]) -> None:
    machine, effects = after(way(), on.KeyPressed(Key.BACK))
    assert (machine.state, machine.scan, effects) == (way().state, way().scan, [])
    assert labels(machine)[Key.BACK] == "HOLD: REDO"


def test_back_held_that_began_before_there_was_a_scan_rejects_nothing() -> None:
    machine = run(aim(), on.KeyPressed(Key.BACK), on.KeyPressed(Key.SCAN), on.Armed(1), on.CaptureFinished(1))
    machine, effects = after(machine, on.KeyHeld(Key.BACK))
    assert (machine.state, effects) == (State.CHECK, [])


@pytest.mark.parametrize("way", [checking, reconstructing, reviewing])
def test_back_held_rejects_and_aims_again_without_switching_off(way: Callable[[], Machine]) -> None:
    machine, effects = after(way(), on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))
    assert machine.state is State.AIM
    (reject,) = (effect for effect in effects if isinstance(effect, do.Reject))
    assert reject.reason.startswith("rejected")
    assert run(machine, on.KeyHeld(Key.BACK)).state is State.AIM, "the same press does not switch off"
    assert machine.off_question is None
    assert asked(machine).off_question is not None


def test_holding_back_in_aim_asks_even_over_a_message() -> None:
    machine = about_to_switch_off(run(capturing(), on.CaptureFailed(1, MISSING)))
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.StopLive(), do.Quit(power_off=True)]
    assert machine.state is State.SHUTDOWN


def test_a_missing_frame_is_named_over_aim_and_ok_repeats() -> None:
    machine = run(capturing(), on.CaptureFailed(1, MISSING))
    assert machine.state is State.AIM
    assert shown(machine) == [("INCOMPLETE 23/24", "REPEAT")]
    assert labels(machine)[Key.SCAN] == "REPEAT"
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert do.Arm(2, 16, NOMINAL) in effects
    assert shown(machine) == []


def test_what_forbids_a_scan_is_shown_before_what_only_warns() -> None:
    uncalibrated = on.ConditionRaised(Fault(FaultCode.UNCALIBRATED, "no file"))
    for events in (
        (uncalibrated, on.StorageCounted(3, "000003", 0)),
        (on.StorageCounted(3, "000003", 0), uncalibrated),
    ):
        assert shown(run(aim(), *events)) == [
            ("STORAGE FULL", "END DIVE, COPY SCANS ASHORE"),
            ("UNCALIBRATED", "LENGTHS NOT TRUSTED"),
        ]


def test_scan_with_a_camera_unplugged_is_refused_with_that_reason_and_clears_itself() -> None:
    machine, effects = after(aim(), on.DeviceDown(Device.CAMERA_RIGHT, "gone from the bus"))
    assert shown(machine) == [("RIGHT CAM LOST", "OFF AND ON, OR END DIVE")]
    assert effects == [do.GoLive(light=True, lasers=True, exposure=NOMINAL)]
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert (machine.state, effects) == (State.AIM, [])
    assert shown(machine) == [("RIGHT CAM LOST", "SCAN REFUSED")]
    machine = run(machine, on.DeviceUp(Device.CAMERA_RIGHT))
    assert shown(machine) == [("RIGHT CAM LOST", "SCAN REFUSED")], "the answer can be read even so"
    machine = run(machine, on.Tick(machine.now_ns + 2 * SECOND_NS))
    assert shown(machine) == []
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.ARMED


def test_a_camera_unplugged_mid_sequence_ends_the_scan_at_once() -> None:
    machine, effects = after(capturing(), on.DeviceDown(Device.CAMERA_LEFT, "gone"))
    assert machine.state is State.AIM
    assert effects[0] == do.AbortCapture(1)
    assert shown(machine) == [
        ("SCAN FAILED", "LEFT CAM LOST: REPEAT"),
        ("LEFT CAM LOST", "OFF AND ON, OR END DIVE"),
    ]
    # its own report, late, changes nothing
    assert step(machine, on.CaptureFailed(1, MISSING)) == (machine, ())


def test_a_camera_on_a_slow_link_is_refused_by_name() -> None:
    machine = run(aim(), on.DeviceDown(Device.CAMERA_LEFT, "480 Mbit/s", FaultCode.CAMERA_SLOW_LINK))
    assert shown(machine) == [("CAMERA LINK SLOW", "OFF AND ON, OR END DIVE")]
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM


def test_losing_keys_or_display_does_not_forbid_a_scan() -> None:
    machine = run(aim(), on.DeviceDown(Device.DISPLAY, "gone"), on.DeviceDown(Device.KEYS, "gone"))
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.ARMED


def test_a_late_flip_is_repeated_once_in_silence_then_named() -> None:
    late = Fault(FaultCode.LATE_FLIP, "frame 9", {"frame": 9})
    machine, effects = after(capturing(), on.CaptureFailed(1, late))
    assert (machine.state, effects) == (State.ARMED, [do.Arm(2, 16, NOMINAL)])
    assert shown(machine) == []
    machine = run(machine, on.Armed(2), on.CaptureFailed(2, late))
    assert machine.state is State.AIM
    assert shown(machine) == [("PROJECTOR LATE", "REPEAT")]
    # the next press has its own silent repetition
    machine = run(machine, on.KeyPressed(Key.SCAN), on.Armed(3), on.CaptureFailed(3, late))
    assert machine.state is State.ARMED


def test_other_faults_are_never_repeated_in_silence() -> None:
    for code in FaultCode:
        machine = run(capturing(), on.CaptureFailed(1, Fault(code)))
        assert (machine.state is State.ARMED) == (code is FaultCode.LATE_FLIP)


def test_a_frozen_camera_is_reopened_once() -> None:
    stuck = Fault(FaultCode.CAMERA_STUCK, "same image", device="camera.left")
    machine, effects = after(capturing(), on.CaptureFailed(1, stuck))
    assert effects[0] == do.ReopenDevice(Device.CAMERA_LEFT)
    assert shown(machine) == [("LEFT CAM STUCK", "REPEAT")]


def test_a_laser_that_stays_on_blocks_scans_until_it_is_seen_off() -> None:
    machine = run(capturing(), on.CaptureFailed(1, Fault(FaultCode.LASER_ON, "left")))
    assert ("LASER ON", "SCAN BLOCKED") in shown(machine)
    machine = run(machine, on.KeyPressed(Key.SCAN), on.Tick(5 * SECOND_NS), heartbeat(left_on=True))
    assert machine.state is State.AIM
    assert shown(machine)[0] == ("LASER ON", "SCAN REFUSED")
    machine = run(machine, on.Tick(6 * SECOND_NS), heartbeat(left_on=False))
    assert shown(machine) == []


def test_a_laser_found_on_by_telemetry_ends_a_capture_but_a_fresh_switch_is_given_time() -> None:
    machine = run(capturing(), heartbeat(right_on=True))
    assert machine.state is State.CAPTURE
    machine, effects = after(machine, on.Tick(2 * SECOND_NS), heartbeat(right_on=True))
    assert do.AbortCapture(1) in effects
    assert effects[-1] == do.GoLive(light=True, lasers=False, exposure=NOMINAL)


def test_one_heartbeat_with_a_leak_is_debounced_two_are_latched() -> None:
    machine = run(reviewing(), heartbeat(leak=True), heartbeat(leak=False), heartbeat(leak=True))
    assert shown(machine) == []
    machine, effects = after(machine, heartbeat(leak=True))
    assert effects == [do.LightsOff(), do.Publish(1)], "nobody will be asked whether to keep it"
    assert machine.state is State.SAFE
    assert shown(machine)[0][0] == "LEAK: ASCEND"
    machine = run(machine, heartbeat(leak=False), heartbeat(leak=False), on.ConditionCleared(FaultCode.LEAK))
    assert shown(machine)[0][0] == "LEAK: ASCEND"
    machine, effects = after(machine, on.KeyPressed(Key.BACK), on.Saved(1, "000001"))
    assert (machine.state, machine.just_saved, effects) == (State.SAFE, "000001", [])
    _, effects = after(about_to_switch_off(machine), on.KeyPressed(Key.SCAN))
    assert effects == [do.Quit(power_off=True)], "it can still be switched off"


def test_heat_warns_then_blocks_with_hysteresis_and_a_missing_sensor_changes_nothing() -> None:
    machine = run(aim(), heartbeat(temperature_case_c=51.0))
    assert shown(machine) == [("WARM 51 °C", "LET IT COOL SOON")]
    machine, effects = after(machine, heartbeat(temperature_case_c=60.0))
    assert (machine.state, effects) == (State.COOLING, [do.LightsOff(), do.StopLive()])
    assert shown(machine)[0][0] == "HOT 60 °C"
    machine = run(machine, heartbeat(temperature_case_c=None), heartbeat(temperature_case_c=58.0))
    assert shown(machine)[0][0] == "HOT 58 °C"
    machine, effects = after(machine, heartbeat(temperature_case_c=56.5))
    assert effects == [do.GoLive(light=True, lasers=True, exposure=NOMINAL)]


def test_a_low_supply_refuses_scans_where_its_limit_is_known() -> None:
    machine = run(aim(), heartbeat(supply_v=3.0))
    assert shown(machine) == []
    strict = boot(0, Settings(supply_low_v=10.0))
    machine = run(strict, *UPS, on.BootFinished(), *PARTS, on.Tick(SECOND_NS), heartbeat(supply_v=9.5))
    assert shown(machine) == [("SUPPLY LOW 9.5V", "END DIVE")]
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM


def test_a_full_disk_refuses_before_the_capture_and_does_not_end_a_running_one() -> None:
    machine = run(aim(), on.StorageCounted(3, "000003", 0))
    assert shown(machine) == [("STORAGE FULL", "END DIVE, COPY SCANS ASHORE")]
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM
    assert run(capturing(), on.StorageCounted(3, "000003", 0)).state is State.CAPTURE


def test_a_disk_that_refuses_brings_the_scan_back_and_ok_tries_again() -> None:
    machine = run(saving(), on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")))
    assert machine.state is State.REVIEW
    assert shown(machine)[0][0] == "NOT SAVED"
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.Publish(1)]
    machine = run(machine, on.Saved(1, "000001"))
    assert shown(machine) == []
    assert machine.just_saved == "000001"


def test_a_disk_that_never_answers_is_not_saved_and_a_late_answer_is_believed() -> None:
    machine = run(saving(), on.Tick(61 * SECOND_NS))
    assert machine.state is State.REVIEW
    assert shown(machine)[0][0] == "NOT SAVED"
    assert run(machine, on.Saved(1, "000001")).just_saved == "000001"


def test_a_dead_worker_leaves_the_raw_frames_to_be_kept() -> None:
    died = Fault(FaultCode.RECONSTRUCTION_FAILED, "worker exited with 9")
    machine = run(reconstructing(), on.ReconstructionFailed(1, died))
    assert machine.state is State.REVIEW
    assert shown(machine) == [("PROCESS LATER", "KEEP RAW FRAMES OR REPEAT")]
    _, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert effects == [do.Publish(1)]


def test_a_hanging_worker_is_given_up_also_while_the_save_waits_for_it() -> None:
    machine, effects = after(reconstructing(), on.Tick(61 * SECOND_NS))
    assert machine.state is State.REVIEW
    assert effects == [do.CancelReconstruction(1)]
    waiting = run(reconstructing(), on.CoarseReady(1, SUMMARY), on.KeyPressed(Key.SCAN))
    machine, effects = after(waiting, on.Tick(61 * SECOND_NS))
    assert effects == [do.CancelReconstruction(1), do.Publish(1)]


def test_a_wrong_pattern_found_by_the_worker_never_becomes_a_cloud() -> None:
    shifted = Fault(FaultCode.PROJECTOR_TIMING, "one frame late", {"shift_frames": 1})
    machine, effects = after(reconstructing(), on.ReconstructionFailed(1, shifted))
    assert machine.state is State.AIM
    assert do.Reject(1, "one frame late") in effects
    assert shown(machine)[0][0] == "PROJECTOR TIMING"


def test_a_moved_scan_says_so_in_the_review_and_can_be_kept() -> None:
    moved = Fault(FaultCode.MOVED, "", {"shift_px": 1.84})
    machine = run(reconstructing(), on.CoarseReady(1, SUMMARY), on.Judged(1, (moved,)), on.FullReady(1, SUMMARY))
    assert shown(machine) == [("MOVED 1.8 px", "REPEAT")]
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.SAVING


def test_what_the_judges_said_last_counts() -> None:
    moved = Fault(FaultCode.MOVED, "", {"shift_px": 1.84})
    machine = run(reconstructing(), on.CoarseReady(1, SUMMARY), on.Judged(1, (moved,)), on.Judged(1))
    assert shown(machine) == []
    assert shown(run(machine, on.Judged(2, (moved,)))) == [], "it is of another scan"


def test_a_board_reset_sets_the_live_views_up_again() -> None:
    machine, effects = after(aim(), on.BoardReset("BROWNOUT"))
    assert effects == [do.GoLive(light=True, lasers=True, exposure=NOMINAL)]
    assert shown(machine)[0][0] == "BOARD RESET"
    machine, effects = after(capturing(), on.BoardReset("BROWNOUT"))
    assert effects == [do.AbortCapture(1), do.GoLive(light=True, lasers=True, exposure=NOMINAL)]
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.ARMED, "it can be repeated at once"


@pytest.mark.parametrize(("jammed", "stand_in"), [(Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)])
def test_another_key_takes_over_a_stuck_one_with_its_label(jammed: Key, stand_in: Key) -> None:
    machine = run(reviewing(), on.KeyJammed(jammed))
    assert shown(machine)[0][0] == "KEY STUCK"
    machine = run(machine, on.KeyPressed(Key.DOWN if jammed is Key.BACK else Key.BACK))  # seen
    assert labels(machine)[stand_in] == labels(reviewing())[jammed]
    assert jammed not in labels(machine)
    assert run(machine, on.KeyPressed(stand_in)).state is run(reviewing(), on.KeyPressed(jammed)).state
    freed = run(machine, on.KeyPressed(jammed), on.KeyPressed(stand_in))
    assert stand_in not in freed.stuck
    assert jammed not in freed.stuck


def test_stopping_waits_for_the_save_and_for_nothing_else() -> None:
    machine, effects = after(saving(), on.StopRequested("SIGTERM"))
    assert (machine.state, effects) == (State.SAVING, [])
    _, effects = after(machine, on.Saved(1, "000001"))
    assert effects == [do.Quit(power_off=False)]
    _, effects = after(capturing(), on.StopRequested("SIGTERM"))
    assert effects == [do.AbortCapture(1), do.Quit(power_off=False)]


def test_devices_not_heard_of_refuse_a_scan() -> None:
    machine = run(boot(0), on.DeviceUp(Device.KEYS), *(on.Tick(minute * 60 * SECOND_NS) for minute in (1, 2, 9)))
    assert machine.state is State.SELF_TEST, "what failed stays on the screen until the diver has seen it"
    machine = run(machine, on.KeyPressed(Key.SCAN), on.KeyPressed(Key.SCAN))
    assert machine.state is State.AIM
    assert shown(machine)[0] == ("LEFT CAM LOST", "SCAN REFUSED")


def test_headlines_fit_sixteen_characters_with_any_numbers() -> None:
    assert set(RULES) == set(FaultCode)
    names = ("received", "expected", "frame", "skew_ms", "shift_px", "temperature_c", "supply_v", "link_mbps")
    for code in FaultCode:
        for value in (0.0, 23.4567, -40.0, 123456.789, float("nan")):
            for device in (None, "camera.left", "camera.right"):
                headline = headline_of(Fault(code, "", dict.fromkeys(names, value), device))
                assert 0 < len(headline) <= 16, headline
                assert "{" not in headline
    for rule in RULES.values():
        assert len(rule.action.english) <= 32


def test_answers_to_an_earlier_scan_change_nothing() -> None:
    again = run(capturing(), on.KeyPressed(Key.BACK), on.KeyPressed(Key.SCAN))
    assert step(again, on.Armed(1)) == (again, ())
    again = run(again, on.Armed(2))
    assert again.captures == 2
    assert step(again, on.CaptureFailed(1, MISSING)) == (again, ())
    assert step(again, on.CaptureFinished(1)) == (again, ())
    second = run(again, on.CaptureFinished(2))
    for late in (
        on.CoarseReady(1, SUMMARY),
        on.FullReady(1, SUMMARY),
        on.ReconstructionFailed(1, MISSING),
        on.PatternsRight(1),
    ):
        assert step(second, late) == (second, ())
    assert run(second, on.Saved(1, "000001")).state is State.CHECK
    assert run(second, on.RawStored(1)).scan == second.scan


def test_a_late_tick_does_not_push_a_deadline_away() -> None:
    late = run(aim(), on.Tick(100 * SECOND_NS), on.Tick(SECOND_NS), on.KeyPressed(Key.SCAN), on.Armed(1))
    limit_ns = 100 * SECOND_NS + int(late.settings.capture_s(16) * SECOND_NS)
    assert run(late, on.Tick(limit_ns - 1)).state is State.CAPTURE
    assert run(late, on.Tick(limit_ns)).state is State.AIM


# ---------------------------------------------------------------------------------------- exposure

SHORTER = Exposure(8_000)
REJECT = (on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK))


def proposed(*events: on.Event) -> Machine:
    return run(reviewing(), on.Judged(1, (Fault(FaultCode.TOO_BRIGHT),), SHORTER), *events)


def test_one_key_takes_the_proposed_exposure_and_the_next_scan_has_it() -> None:
    machine = proposed()
    assert labels(machine)[Key.DOWN] == "EXPOSE 8 ms"
    machine, effects = after(machine, on.KeyPressed(Key.DOWN), *REJECT)
    assert do.GoLive(light=True, lasers=True, exposure=SHORTER) in effects, "the live views show it before the scan"
    _, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert do.Arm(2, 16, SHORTER) in effects


def test_the_same_key_takes_it_back_and_the_scan_is_kept_either_way() -> None:
    machine = proposed(on.KeyPressed(Key.DOWN))
    assert labels(machine)[Key.DOWN] == "EXPOSE 12 ms"
    machine = run(machine, on.KeyPressed(Key.DOWN))
    assert machine.exposure == NOMINAL
    assert labels(machine)[Key.DOWN] == "EXPOSE 8 ms"
    for decided in (machine, run(machine, on.KeyPressed(Key.DOWN))):
        assert run(decided, on.KeyPressed(Key.SCAN)).state is State.SAVING


def test_an_exposure_stays_until_the_diver_changes_it() -> None:
    machine = proposed(on.KeyPressed(Key.DOWN), *REJECT, on.KeyPressed(Key.SCAN))
    machine = run(machine, on.Armed(2), on.CaptureFinished(2), on.FullReady(2, SUMMARY), on.Judged(2))
    assert Key.DOWN not in labels(machine), "nothing is proposed for a scan whose light was right"
    machine = run(machine, on.KeyPressed(Key.DOWN), *REJECT)
    assert machine.exposure == SHORTER
    calibrate = run(machine, *(on.KeyPressed(key) for key in (Key.UP, *TO_CALIBRATION)))
    assert do.Arm(3, 16, SHORTER) in after(calibrate, on.KeyPressed(Key.SCAN))[1]


def test_without_a_proposal_and_while_back_is_stuck_no_key_changes_the_exposure() -> None:
    for machine in (
        run(reviewing(), on.KeyPressed(Key.DOWN)),
        proposed(on.KeyJammed(Key.BACK), on.KeyPressed(Key.DOWN)),
    ):
        assert machine.exposure == NOMINAL


def test_more_gain_is_named_as_such() -> None:
    machine = run(proposed(), on.Judged(1, (), Exposure(12_000, 4.0)))
    assert labels(machine)[Key.DOWN] == "GAIN 4 dB"


# ------------------------------------------------------------------------------------ two exposures


ADD = (on.KeyPressed(Key.DOWN), on.KeyHeld(Key.DOWN))


def offered(*events: on.Event) -> Machine:
    return run(reviewing(), on.FullReady(1, SUMMARY), on.Judged(1, (), None, Exposure(3_200)), *events)


def added() -> Machine:
    return offered(*ADD, on.Armed(2), on.CaptureFinished(2))


def test_one_key_records_a_second_exposure_and_the_scan_becomes_one_of_both() -> None:
    machine = offered()
    assert labels(machine)[Key.DOWN] == "HOLD: ADD 3.2 ms"
    machine, effects = after(machine, *ADD)
    assert do.Arm(2, 16, Exposure(3_200), second=True) in effects
    machine, effects = after(machine, on.Armed(2), on.CaptureFinished(2))
    assert effects[-1] == do.StartReconstruction(2)
    assert not any(isinstance(effect, do.StoreRaw | do.Reject) for effect in effects)
    more = replace(SUMMARY, points=1500)
    machine, effects = after(machine, on.PairMerged(1, more))
    assert machine.state is State.REVIEW
    assert effects == [do.StoreRaw(1)], "its frames are made durable, too"
    assert machine.scan is not None
    assert machine.scan.full == more
    assert Key.DOWN not in labels(machine), "two are enough"
    assert machine.exposure == NOMINAL, "the next scan is taken as before"
    assert do.Publish(1) in after(machine, on.KeyPressed(Key.SCAN))[1]


@pytest.mark.parametrize(
    "lost",
    [
        (*ADD, on.KeyPressed(Key.BACK)),
        (*ADD, on.Armed(2), on.KeyPressed(Key.BACK)),
        (*ADD, on.CaptureFailed(2, MISSING)),
        (*ADD, on.Armed(2), on.DeviceDown(Device.BOARD, "unplugged")),
        (*ADD, on.Armed(2), on.BoardReset("WATCHDOG")),
        (*ADD, on.Armed(2), on.Tick(10_000 * SECOND_NS)),
        (*ADD, on.Armed(2), on.CaptureFinished(2), on.KeyPressed(Key.BACK)),
        (*ADD, on.Armed(2), on.CaptureFinished(2), on.PairFailed(1, Fault(FaultCode.MOVED))),
        (*ADD, on.Armed(2), on.CaptureFinished(2), on.Tick(10_000 * SECOND_NS)),
    ],
)
def test_whatever_ends_the_second_exposure_the_first_scan_is_reviewed_as_before(lost: tuple[on.Event, ...]) -> None:
    machine, effects = after(offered(), *lost)
    assert machine.state is State.REVIEW
    assert machine.scan == offered().scan
    assert not any(isinstance(effect, do.Reject | do.CancelReconstruction) for effect in effects)
    for alert in alerts(machine)[:1]:  # who pressed BACK is told nothing
        assert alert.headline == "NOT ADDED"
        assert alert.action.endswith("FIRST KEPT")
        assert not isinstance(lost[-1], on.KeyPressed)
    assert do.Publish(1) in after(machine, on.KeyPressed(Key.SCAN))[1]


def test_the_press_that_stops_the_second_exposure_does_not_reject_the_first_when_it_is_held_on() -> None:
    for machine in (offered(*ADD), offered(*ADD, on.Armed(2)), added()):
        assert labels(machine)[Key.BACK] == "STOP"
        machine, effects = after(machine, *REJECT)
        assert machine.state is State.REVIEW
        assert not any(isinstance(effect, do.Reject) for effect in effects)
        machine, effects = after(machine, *REJECT)
        assert (machine.state, do.Reject(1, "rejected by the diver") in effects) == (State.AIM, True)


def test_a_leak_during_the_second_exposure_saves_the_first() -> None:
    for machine in (offered(*ADD, on.Armed(2)), added()):
        machine, effects = after(machine, heartbeat(leak=True), heartbeat(leak=True), heartbeat(leak=True))
        assert machine.state is State.SAFE
        assert do.Publish(1) in effects
        assert run(machine, on.PairMerged(1, SUMMARY)).scan == machine.scan, "too late"


def test_points_that_are_wrong_are_not_added_to() -> None:
    machine = offered(on.Judged(1, (Fault(FaultCode.MOVED),), None, Exposure(3_200)))
    assert Key.DOWN not in labels(machine)


def test_a_glove_that_brushes_down_records_nothing_and_one_that_lay_on_it_before_the_offer_neither() -> None:
    pressed = run(offered(), on.KeyPressed(Key.DOWN))
    assert (pressed.state, pressed.exposure, pressed.scan) == (State.REVIEW, NOMINAL, offered().scan)
    early = run(reviewing(), on.KeyPressed(Key.DOWN), on.FullReady(1, SUMMARY), on.Judged(1, (), None, Exposure(3_200)))
    assert labels(early)[Key.DOWN] == "HOLD: ADD 3.2 ms"
    assert run(early, on.KeyHeld(Key.DOWN)).state is State.REVIEW


def test_a_distance_is_forgotten_when_the_lasers_go_off() -> None:
    machine, _ = after(aim(), on.Ranged(Range(500.0, 1.0, 0.3, 2)))
    assert machine.range == Range(500.0, 1.0, 0.3, 2)
    machine, _ = after(machine, on.KeyPressed(Key.SCAN))
    assert machine.state is State.ARMED
    assert machine.range is None
    machine, _ = after(machine, on.Ranged(Range(480.0, 1.0, 0.3, 2)))
    assert machine.range is None, "measured before the lasers went off, told after"
