"""How long each thing is waited for, with the settings of a new instrument: not a moment less, and not a moment more."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.leading import alerts
from appliance.machine.states import Device, Machine, Part, Settings, State, boot
from appliance.ranging.reach import Range
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    PARTS,
    RECORDED,
    SECOND_NS,
    UPS,
    VERIFIED,
    after,
    aim,
    armed,
    calibrating_at,
    capturing,
    checking,
    heartbeat,
    reconstructing,
    refused_by_the_disk,
    run,
    saving,
    trial_in_work,
)

SCAN = on.KeyPressed(Key.SCAN)


def later(machine: Machine, seconds: float) -> on.Tick:
    return on.Tick(machine.now_ns + round(seconds * SECOND_NS))


def self_testing_without_a_worker() -> Machine:
    return run(boot(0), *UPS, on.BootFinished(), *PARTS[:-1])


def solving() -> Machine:
    return run(calibrating_at(RECORDED), SCAN)


def putting_in_use() -> Machine:
    return run(calibrating_at(VERIFIED), SCAN)


@pytest.mark.parametrize(
    ("way", "limit_s"),
    [
        (lambda: boot(0), 60.0),
        (self_testing_without_a_worker, 45.0),
        (armed, 45.0),
        (capturing, 24 / 60 + 5.0),
        (checking, 60.0),
        (reconstructing, 60.0),
        (saving, 60.0),
        (trial_in_work, 60.0),
        (solving, 300.0),
        (putting_in_use, 60.0),
    ],
)
def test_what_does_not_answer_is_given_up_at_its_limit(way: Callable[[], Machine], limit_s: float) -> None:
    machine = way()
    waits = run(machine, later(machine, limit_s - 0.001))
    assert (waits.state, waits.calibrating) == (machine.state, machine.calibrating)
    assert waits.deadline_ns is not None
    over = run(machine, later(machine, limit_s))
    assert (over.state, over.calibrating, over.parts) != (machine.state, machine.calibrating, machine.parts)


def test_a_self_test_after_a_start_in_which_nothing_answered_has_its_own_time() -> None:
    machine = run(boot(0), *UPS, *PARTS[:-1], on.Tick(60 * SECOND_NS))
    assert machine.state is State.SELF_TEST
    assert Part.WORKER not in run(machine, on.Tick(104 * SECOND_NS)).parts
    assert not run(machine, on.Tick(105 * SECOND_NS)).parts[Part.WORKER].passed


@pytest.mark.parametrize(("way", "said"), [(armed, "no ready after 45.0 s"), (capturing, "no end after 5.4 s")])
def test_a_scan_that_timed_out_says_what_was_waited_for_and_how_long(way: Callable[[], Machine], said: str) -> None:
    machine = way()
    machine = run(machine, later(machine, 45.0 if machine.state is State.ARMED else 5.4))
    assert (alerts(machine)[0].code, alerts(machine)[0].detail) == (FaultCode.CAPTURE_TIMEOUT, said)


def test_a_part_that_was_busy_early_does_not_shorten_the_self_test_and_one_that_is_done_does_not_prolong_it() -> None:
    machine = run(self_testing_without_a_worker(), on.Tick(2 * SECOND_NS), on.PartBusy(Part.WORKER))
    done = run(machine, on.Tick(44 * SECOND_NS), on.PartBusy(Part.STORAGE))
    assert Part.WORKER not in done.parts
    assert Part.WORKER in run(done, on.Tick(45 * SECOND_NS)).parts


def test_a_part_that_was_busy_late_is_given_ten_seconds_more() -> None:
    machine = run(self_testing_without_a_worker(), on.Tick(44 * SECOND_NS), on.PartBusy(Part.WORKER))
    assert Part.WORKER not in run(machine, on.Tick(54 * SECOND_NS - 1)).parts
    assert not run(machine, on.Tick(54 * SECOND_NS)).parts[Part.WORKER].passed


def test_a_sequence_shines_for_its_frames_at_sixty_a_second() -> None:
    settings = Settings()
    for period_px, frames in ((16, 24), (32, 22), (64, 20)):
        assert settings.light_s(period_px) == pytest.approx(frames / 60)
        assert settings.capture_s(period_px) == pytest.approx(frames / 60 + 5.0)
    assert settings.light_s(48) == pytest.approx(24 / 60), "of an unknown one the longest"
    assert settings.capture_s(48) == pytest.approx(24 / 60 + 5.0)


def test_a_refusal_can_be_read_for_two_seconds_although_its_reason_has_gone() -> None:
    machine = run(aim(), on.DeviceDown(Device.BOARD, "gone"), SCAN, on.DeviceUp(Device.BOARD))
    assert alerts(run(machine, later(machine, 1.9)))[0].action == "SCAN REFUSED"
    assert alerts(run(machine, later(machine, 2.0))) == ()


def test_scan_outside_the_volume_can_be_pressed_again_for_ten_seconds() -> None:
    machine = run(aim(), on.Ranged(Range(700.0, 0.0, 0.5, 2)), SCAN)
    waits = run(machine, later(machine, 9.9))
    assert labels(waits)[Key.SCAN] == "ANYWAY"
    assert run(waits, SCAN).state is State.ARMED
    assert labels(run(machine, later(machine, 10.0)))[Key.SCAN] == "SCAN"


def test_a_save_is_tried_again_after_five_seconds_three_times_and_as_often_anew_when_the_diver_asks() -> None:
    refused = on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO"))
    machine = refused_by_the_disk()
    for _ in range(2):
        for _ in range(3):
            assert after(machine, later(machine, 4.9))[1] == []
            machine, effects = after(machine, later(machine, 5.0))
            assert effects == [do.Publish(1)]
            machine = run(machine, refused)
        assert after(machine, later(machine, 3600.0))[1] == [], "not for ever"
        machine, effects = after(machine, SCAN)
        assert effects == [do.Publish(1)]
        machine = run(machine, refused)


def test_raw_frames_are_stored_again_after_five_seconds() -> None:
    machine = run(reconstructing(), on.SaveFailed(1, Fault(FaultCode.NOT_SAVED, "EIO")))
    assert after(machine, later(machine, 4.9))[1] == []
    assert after(machine, later(machine, 5.0))[1] == [do.StoreRaw(1)]


def test_a_save_that_was_under_way_when_water_came_in_keeps_the_time_it_had() -> None:
    machine = saving()
    wet = run(machine, later(machine, 20.0), heartbeat(leak=True), heartbeat(leak=True))
    assert wet.state is State.SAFE
    assert wet.scan is not None
    assert wet.scan.publishing
    waits = run(wet, later(machine, 59.9))
    assert waits.scan is not None
    assert waits.scan.publishing
    over = run(wet, later(machine, 60.0))
    assert over.scan is not None
    assert not over.scan.publishing
    assert FaultCode.NOT_SAVED in [alert.code for alert in alerts(over)]


def test_a_low_supply_that_recovered_is_borne_as_long_anew() -> None:
    low = on.ConditionRaised(Fault(FaultCode.SUPPLY_LOW, "9.8 V", {"supply_v": 9.8}))
    machine = run(aim(), low, later(aim(), 20.0))
    machine = run(machine, on.ConditionCleared(FaultCode.SUPPLY_LOW), low)
    assert run(machine, later(machine, 29.9)).state is State.AIM
    assert run(machine, later(machine, 30.0)).state is State.SHUTDOWN


def test_too_much_heat_is_not_borne_although_a_low_supply_still_is() -> None:
    low = on.ConditionRaised(Fault(FaultCode.SUPPLY_LOW, "9.8 V", {"supply_v": 9.8}))
    machine, effects = after(aim(), low, heartbeat(temperature_case_c=68.0))
    assert machine.state is State.SHUTDOWN
    assert effects[-1] == do.Quit(power_off=True)


@pytest.mark.parametrize(
    ("celsius", "codes"),
    [
        (64.9, []),
        (65.0, [FaultCode.WARM]),
        (74.9, [FaultCode.WARM]),
        (75.0, [FaultCode.HOT, FaultCode.WARM]),
    ],
)
def test_a_projector_has_limits_of_its_own(celsius: float, codes: list[FaultCode]) -> None:
    machine = run(aim(), heartbeat(temperature_projector_c=celsius, temperature_case_c=20.0))
    assert [alert.code for alert in alerts(machine)] == codes


def test_a_projector_at_its_last_limit_switches_off() -> None:
    assert run(aim(), heartbeat(temperature_projector_c=84.9)).state is State.COOLING
    assert run(aim(), heartbeat(temperature_projector_c=85.0)).state is State.SHUTDOWN
