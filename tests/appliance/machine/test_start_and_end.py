"""From power-on to AIM, and what ends a dive: leaks, low supply, disks that refuse."""

from __future__ import annotations

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.leading import alerts
from appliance.machine.saving import RETRIES
from appliance.machine.states import Device, Machine, Part, State, boot
from appliance.ranging.reach import Range
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    PARTS,
    SECOND_NS,
    SUMMARY,
    UPS,
    about_to_switch_off,
    after,
    aim,
    capturing,
    heartbeat,
    kept_before_the_cloud,
    reconstructing,
    refused_by_the_disk,
    reviewing,
    run,
    saving,
    self_test_without_a_camera,
)

EIO = Fault(FaultCode.NOT_SAVED, "EIO")
LEAK = (heartbeat(leak=True), heartbeat(leak=True))
LOW = on.ConditionRaised(Fault(FaultCode.SUPPLY_LOW, "9.8 V", {"supply_v": 9.8}))


def later(machine: Machine, seconds: float) -> on.Tick:
    return on.Tick(machine.now_ns + int(seconds * SECOND_NS))


# ---------------------------------------------------------------------------------------- the start


def test_a_self_test_that_finds_nothing_wrong_passes_by_itself() -> None:
    machine = run(boot(0), *UPS, on.BootFinished(), *PARTS)
    assert machine.state is State.SELF_TEST
    assert run(machine, on.Tick(SECOND_NS - 1)).state is State.SELF_TEST, "long enough to be seen"
    assert run(machine, on.Tick(SECOND_NS)).state is State.AIM


def test_it_waits_for_every_result_and_counts_silence_as_failed() -> None:
    machine = run(boot(0), *UPS, on.BootFinished(), *PARTS[:-1], on.Tick(44 * SECOND_NS))
    assert machine.state is State.SELF_TEST
    machine = run(machine, on.Tick(45 * SECOND_NS), on.Tick(49 * SECOND_NS))
    assert machine.state is State.AIM, "without a worker scans can still be recorded"
    assert not machine.parts[Part.WORKER].passed


def test_a_worker_that_gets_on_is_waited_for_and_one_that_falls_silent_is_not() -> None:
    machine = run(boot(0), *UPS, on.BootFinished(), *PARTS[:-1])
    for second in range(2, 120, 2):
        machine = run(machine, on.Tick(second * SECOND_NS), on.PartBusy(Part.WORKER))
    assert machine.state is State.SELF_TEST
    assert Part.WORKER not in machine.parts, "a slow processor has not failed"
    ready = run(machine, PARTS[-1], on.Tick(120 * SECOND_NS))
    assert ready.state is State.AIM
    assert ready.parts[Part.WORKER].passed
    silent = run(machine, on.Tick(129 * SECOND_NS), on.Tick(133 * SECOND_NS))
    assert silent.state is State.AIM
    assert not silent.parts[Part.WORKER].passed


def test_what_forbids_scans_stays_on_the_screen_until_ok_or_until_it_works() -> None:
    machine = run(self_test_without_a_camera(), on.Tick(500 * SECOND_NS))
    assert machine.state is State.SELF_TEST
    assert labels(machine)[Key.SCAN] == "GO ON"
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM
    assert run(machine, on.DeviceUp(Device.CAMERA_LEFT), later(machine, 1.0)).state is State.AIM


def test_what_only_limits_is_shown_for_a_while() -> None:
    parts = [on.PartTested(part, part is not Part.CALIBRATION) for part in Part]
    machine = run(boot(0), *UPS, on.BootFinished(), *parts)
    assert run(machine, on.Tick(2 * SECOND_NS)).state is State.SELF_TEST
    assert run(machine, on.Tick(3 * SECOND_NS)).state is State.AIM


def test_without_keys_nobody_is_asked() -> None:
    ups = [on.DeviceUp(device) for device in Device if device not in (Device.KEYS, Device.BOARD)]
    lost = [on.DeviceDown(device, "not found") for device in (Device.KEYS, Device.BOARD)]
    machine = run(boot(0), *ups, *lost, on.BootFinished(), *PARTS)
    assert run(machine, on.Tick(9 * SECOND_NS)).state is State.SELF_TEST
    assert run(machine, on.Tick(10 * SECOND_NS)).state is State.AIM


# ---------------------------------------------------------------------------------------- the place


@pytest.mark.parametrize(("distance_mm", "headline"), [(612.0, "FAR 612 mm"), (401.0, "NEAR 401 mm")])
def test_outside_the_volume_scan_asks_once_more(distance_mm: float, headline: str) -> None:
    machine = run(aim(), on.Ranged(Range(distance_mm, 2.0, 0.4, 2)))
    asked, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert (asked.state, effects) == (State.AIM, [])
    assert alerts(asked)[0].headline == headline
    assert labels(asked)[Key.SCAN] == "ANYWAY"
    assert run(asked, on.KeyPressed(Key.SCAN)).state is State.ARMED
    forgotten = run(asked, later(asked, 10.0))
    assert alerts(forgotten) == ()
    assert run(forgotten, on.KeyPressed(Key.SCAN)).state is State.AIM, "asked anew"


def test_hands_that_tremble_at_the_limit_are_not_asked() -> None:
    machine = run(aim(), *(on.Ranged(Range(d, 0.0, 0.3, 2)) for d in (558.0, 562.0)))
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.ARMED
    machine = run(machine, *(on.Ranged(Range(d, 0.0, 0.3, 2)) for d in (566.0, 558.0)))
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM, "once outside, a little inside is not enough"


def test_a_distance_that_is_not_known_is_not_outside() -> None:
    assert run(aim(), on.Ranged(None), on.KeyPressed(Key.SCAN)).state is State.ARMED
    assert run(aim(), on.Ranged(Range(500.0, None, 1.0, 1)), on.KeyPressed(Key.SCAN)).state is State.ARMED


# ---------------------------------------------------------------------------------------- the disk


def test_a_refused_scan_is_tried_again_unasked_and_not_for_ever() -> None:
    machine, tries = refused_by_the_disk(), 0
    for _ in range(40):
        machine, effects = after(machine, later(machine, 1.0))
        if do.Publish(1) in effects:
            tries += 1
            machine = run(machine, on.SaveFailed(1, EIO))
    assert tries == 3
    assert machine.state is State.REVIEW
    assert alerts(machine)[0].code is FaultCode.NOT_SAVED
    assert after(machine, on.KeyPressed(Key.SCAN))[1] == [do.Publish(1)], "the diver may still try"


def test_a_retry_that_works_ends_as_any_save() -> None:
    machine, effects = after(refused_by_the_disk(), later(saving(), 6.0))
    assert effects == [do.Publish(1)]
    machine = run(machine, on.Saved(1, "000001"))
    assert (machine.state, machine.just_saved, alerts(machine)) == (State.AIM, "000001", ())


def test_raw_frames_that_were_refused_are_stored_again() -> None:
    machine = run(reconstructing(), on.SaveFailed(1, EIO))
    assert alerts(machine)[0].code is FaultCode.NOT_SAVED
    machine, effects = after(machine, later(machine, 5.0))
    assert effects == [do.StoreRaw(1)]
    machine = run(machine, on.RawStored(1))
    assert alerts(machine) == ()
    assert machine.scan is not None
    assert machine.scan.raw_durable


# ---------------------------------------------------------------------------------------- the end


def test_a_leak_ends_a_capture_and_saves_what_was_recorded_before_the_cloud_is_there() -> None:
    machine, effects = after(capturing(), *LEAK)
    assert (machine.state, effects) == (State.SAFE, [do.LightsOff(), do.AbortCapture(1)])
    machine, effects = after(reconstructing(), *LEAK)
    assert (machine.state, effects) == (State.SAFE, [do.LightsOff()])
    machine, effects = after(machine, on.CoarseReady(1, SUMMARY), on.FullReady(1, SUMMARY))
    assert (machine.state, effects) == (State.SAFE, [do.Publish(1)])
    machine = run(machine, on.Saved(1, "000001"))
    assert (machine.state, machine.scan, machine.last_scan) == (State.SAFE, None, "000001")


def test_a_leak_does_not_wait_for_a_worker_for_ever() -> None:
    machine = run(reconstructing(), *LEAK)
    _, effects = after(machine, later(machine, machine.settings.reconstruct_s))
    assert effects == [do.CancelReconstruction(1), do.Publish(1)]


def test_a_scan_kept_before_its_cloud_that_the_disk_refuses_is_tried_again_and_does_not_wait_for_ever() -> None:
    machine = run(kept_before_the_cloud(), on.SaveFailed(1, EIO))
    machine = run(machine, later(machine, machine.settings.reconstruct_s))
    machine, effects = after(machine, later(machine, 1.0))
    assert (machine.state, effects) == (State.SAVING, [do.Publish(1)])
    assert run(machine, on.Saved(1, "000001")).state is State.AIM


def test_switching_off_in_safe_finishes_the_save_first() -> None:
    machine = about_to_switch_off(run(reviewing(), *LEAK))
    machine, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert (machine.state, effects) == (State.SAFE, [])
    assert after(machine, on.Saved(1, "000001"))[1] == [do.Quit(power_off=True)]


def test_a_low_supply_refuses_scans_at_once_and_switches_off_in_good_order() -> None:
    machine = run(aim(), LOW)
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.AIM
    assert after(machine, later(machine, 29.0))[1] == []
    _, effects = after(machine, later(machine, 30.0))
    assert effects == [do.StopLive(), do.Quit(power_off=True)]
    recovered = run(machine, on.ConditionCleared(FaultCode.SUPPLY_LOW), later(machine, 300.0))
    assert recovered.state is State.AIM


@pytest.mark.parametrize("way", [saving, reviewing])
def test_a_low_supply_saves_what_is_in_hand_before(way: object) -> None:
    assert callable(way)
    before: Machine = way()
    machine, effects = after(before, LOW, later(before, 30.0))
    assert machine.state is State.SAVING
    assert effects == ([] if before.state is State.SAVING else [do.Publish(1)])
    assert after(machine, on.Saved(1, "000001"))[1] == [do.Quit(power_off=True)]


def test_a_disk_that_refuses_at_the_end_is_tried_again_and_does_not_keep_it_on() -> None:
    machine = run(saving(), on.StopRequested("SIGTERM"))
    ended = None
    for _ in range(RETRIES + 1):
        machine, effects = after(machine, on.SaveFailed(1, EIO))
        ended = next((effect for effect in effects if isinstance(effect, do.Quit)), ended)
        machine = run(machine, later(machine, 6.0)) if ended is None else machine
    assert ended == do.Quit(power_off=False)


def test_a_stuck_key_is_told_as_long_as_it_lasts() -> None:
    machine = run(aim(), on.KeyJammed(Key.SCAN), on.KeyPressed(Key.DOWN))
    assert alerts(machine)[0].code is FaultCode.KEY_STUCK
    assert alerts(run(machine, on.KeyFreed(Key.SCAN))) == ()
