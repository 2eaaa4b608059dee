"""Warmth as the diver lives it: what is told, what goes dark, what is refused, and what comes back by itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.capture.exposure import NOMINAL
from appliance.capture.fault import FaultCode
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.alerts import alerts
from appliance.machine.states import Machine, State
from appliance.machine.step import step
from appliance.machine.thermal import RATION_S, remaining_s
from drivers.api import Key
from tests.appliance.machine.walks import SECOND_NS, after, aim, heartbeat, reviewing, run

DARK, LIT = do.GoLive(False, True, NOMINAL), do.GoLive(True, True, NOMINAL)


def later(machine: Machine, seconds: float) -> on.Tick:
    return on.Tick(machine.now_ns + int(seconds * SECOND_NS))


def warmed(machine: Machine, case_c: float, projector_c: float | None = 30.0) -> Machine:
    return run(machine, heartbeat(temperature_case_c=case_c, temperature_projector_c=projector_c))


def codes(machine: Machine) -> list[FaultCode]:
    return [alert.code for alert in alerts(machine)]


def test_hot_is_dark_until_it_has_cooled_down_and_then_goes_on_by_itself() -> None:
    hot = warmed(aim(), 60.0)
    assert hot.state is State.COOLING
    assert run(hot, on.KeyPressed(Key.SCAN)).state is State.COOLING
    assert warmed(hot, 57.5).state is State.COOLING, "three degrees below the limit, not one"
    machine, effects = after(hot, heartbeat(temperature_case_c=56.9, temperature_projector_c=30.0))
    assert (machine.state, effects) == (State.AIM, [LIT])


def test_who_leaves_cooling_sees_dark_pictures_and_is_led_back_by_scan() -> None:
    machine, effects = after(warmed(aim(), 61.0), on.KeyPressed(Key.BACK))
    assert (machine.state, effects) == (State.AIM, [do.GoLive(False, False, NOMINAL)])
    assert warmed(machine, 61.5).state is State.AIM, "once is enough"
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.COOLING
    assert codes(machine)[0] is FaultCode.HOT


def test_a_scan_in_hand_is_decided_on_before_it_cools() -> None:
    machine = warmed(reviewing(), 61.0)
    assert machine.state is State.REVIEW
    machine = run(machine, on.KeyPressed(Key.SCAN), on.Saved(1, "000001"))
    assert machine.state is State.COOLING


@pytest.mark.parametrize("per_s", [0.02, 0.1])
def test_the_time_it_will_still_take_follows_from_how_it_cools(per_s: float) -> None:
    machine, case_c = warmed(aim(), 62.0), 62.0
    assert remaining_s(machine) is None, "nobody knows at first"
    for _ in range(40):
        case_c -= per_s / 2.0
        machine = warmed(run(machine, later(machine, 0.5)), case_c)
    estimate_s = remaining_s(machine)
    assert estimate_s is not None
    assert estimate_s == pytest.approx((case_c - 57.0) / per_s, rel=0.05)


def test_what_does_not_cool_promises_nothing() -> None:
    machine = warmed(aim(), 62.0)
    for _ in range(40):
        machine = warmed(run(machine, later(machine, 0.5)), 62.0)
    assert remaining_s(machine) is None


def test_too_hot_saves_what_is_there_and_switches_off() -> None:
    machine, effects = after(aim(), heartbeat(temperature_case_c=68.0))
    assert machine.state is State.SHUTDOWN
    assert effects[-1] == do.Quit(power_off=True)
    machine, effects = after(reviewing(), heartbeat(temperature_case_c=68.0))
    assert effects == [do.LightsOff(), do.Publish(1)], "the diver was not asked; so it is kept"
    _, effects = after(machine, on.Saved(1, "000001"))
    assert effects == [do.Quit(power_off=True)]


def test_light_rests_when_nobody_presses_a_key_and_comes_back_with_the_next_one() -> None:
    machine, effects = after(aim(), later(aim(), 179.0))
    assert effects == []
    machine, effects = after(machine, later(machine, 2.0))
    assert effects == [DARK]
    menu, _ = after(machine, on.KeyPressed(Key.UP))
    assert menu.state is State.MENU, "the key means what its label says all the same"
    machine, effects = after(machine, on.KeyPressed(Key.BACK))
    assert effects == [LIT]


def test_where_it_is_warm_light_rests_sooner() -> None:
    warm = warmed(aim(), 51.0)
    assert after(warm, later(warm, 29.0))[1] == []
    assert after(warm, later(warm, 31.0))[1] == [DARK]


def test_without_a_sensor_it_says_so_and_is_never_taken_for_cold() -> None:
    machine = run(warmed(aim(), 61.0, 30.0), heartbeat())
    assert machine.state is State.COOLING
    machine = run(machine, later(machine, 6.0), heartbeat())
    assert FaultCode.TEMPERATURE_UNKNOWN in codes(machine)
    assert machine.state is State.COOLING, "it was hot, and nobody knows better"
    machine = run(machine, later(machine, 300.0), heartbeat())
    assert machine.state is State.AIM
    assert FaultCode.TEMPERATURE_UNKNOWN not in codes(warmed(machine, 40.0))


def shone(seconds: int, presses: int) -> tuple[float, int]:
    """Light in s, and scans, of a diver without temperatures who presses SCAN again and again, 0.1 s a step."""
    machine = run(aim(), heartbeat())
    machine = run(machine, later(machine, 6.0), heartbeat())
    lit, light_s, scans = True, 0.0, 0
    for tick in range(10 * seconds):
        events: list[on.Event] = [later(machine, 0.1)]
        if presses and tick % (10 * seconds // presses) == 0:
            events += [on.KeyPressed(Key.SCAN)]
        if machine.state is State.ARMED:
            events += [on.Armed(machine.captures), on.CaptureFinished(machine.captures)]
        if machine.state is State.CHECK:
            events += [on.KeyPressed(Key.BACK), on.KeyHeld(Key.BACK)]
        for event in events:
            machine, effects = step(machine, event)
            for effect in effects:
                match effect:
                    case do.GoLive(light):
                        lit = light
                    case do.StopLive() | do.LightsOff():
                        lit = False
                    case do.Capture():
                        light_s, scans = light_s + 24 / 60, scans + 1
                    case _:
                        pass
        light_s += 0.1 if lit else 0.0
    return light_s, scans


@pytest.mark.parametrize(("seconds", "presses"), [(170, 0), (240, 60), (120, 240)])
def test_without_a_sensor_light_is_rationed_whatever_the_diver_does(seconds: int, presses: int) -> None:
    light_s, scans = shone(seconds, presses)
    assert light_s <= RATION_S * (1.0 + seconds / 60.0) + 1.0
    assert light_s > 0.6 * RATION_S * seconds / 60.0, "rationed, not forbidden"
    if presses:
        assert scans > presses // 3, "aiming leaves light for scans"


def test_a_scan_without_light_left_is_refused_with_that_reason() -> None:
    machine = run(aim(), heartbeat())
    machine = run(machine, later(machine, 6.0), heartbeat())
    machine = replace(machine, thermal=replace(machine.thermal, ration_s=0.1))
    machine = run(machine, on.KeyPressed(Key.SCAN))
    assert machine.state is State.AIM
    assert [(a.headline, a.action) for a in alerts(machine)] == [("TEMP ?", "SCAN REFUSED")]
    for _ in range(90):
        machine = run(machine, later(machine, 0.1))
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.ARMED
