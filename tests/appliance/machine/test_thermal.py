"""Warmth as the diver lives it: what is told, what goes dark, what is refused, and what comes back by itself."""

from __future__ import annotations

from dataclasses import replace

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.conditions import has
from appliance.machine.leading import alerts
from appliance.machine.states import Machine, State
from appliance.machine.step import step
from appliance.machine.thermal import RATION_S, may_aim_lit, passed, remaining_s, slope_c_per_s, spend
from appliance.scan.exposure import NOMINAL
from appliance.scan.fault import Fault, FaultCode
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


def unsensed() -> Machine:
    """AIM without a temperature sensor: light is rationed."""
    machine = run(aim(), heartbeat())
    return run(machine, later(machine, 6.0), heartbeat())


def rested(machine: Machine, seconds: float) -> Machine:
    """The same in the dark, so much later."""
    dark = replace(machine, thermal=replace(machine.thermal, lit=False))
    after_ns = dark.now_ns + int(seconds * SECOND_NS)
    return passed(replace(dark, now_ns=after_ns), dark.now_ns)


def test_an_hour_of_rest_gathers_no_more_than_a_minutes_light() -> None:
    machine = rested(unsensed(), 3600.0)
    assert machine.thermal.ration_s == 20.0
    shining = replace(machine, thermal=replace(machine.thermal, lit=True), now_ns=machine.now_ns + 30 * SECOND_NS)
    assert passed(shining, machine.now_ns).thermal.ration_s == pytest.approx(20.0 - 30.0 + 10.0)


def test_light_gathers_by_a_third_of_the_time_and_is_spent_by_two_thirds_more_but_never_below_nothing() -> None:
    empty = replace(unsensed(), thermal=replace(unsensed().thermal, ration_s=0.0))
    assert rested(empty, 15.0).thermal.ration_s == pytest.approx(5.0)
    lit = replace(empty, thermal=replace(empty.thermal, ration_s=9.0, lit=True), now_ns=empty.now_ns + 6 * SECOND_NS)
    assert passed(lit, empty.now_ns).thermal.ration_s == pytest.approx(9.0 - 6.0 * 2.0 / 3.0)
    assert passed(replace(lit, now_ns=lit.now_ns + 60 * SECOND_NS), lit.now_ns).thermal.ration_s == 0.0
    assert passed(lit, lit.now_ns + SECOND_NS).thermal.ration_s == 9.0, "time does not run backwards"
    assert spend(lit, 2.5).thermal.ration_s == pytest.approx(6.5)
    assert spend(lit, 30.0).thermal.ration_s == 0.0


def test_aiming_goes_dark_at_the_reserve_and_is_lit_again_only_with_something_in_hand() -> None:
    def with_ration(ration_s: float, spent: bool) -> bool:
        machine = unsensed()
        machine = replace(machine, thermal=replace(machine.thermal, ration_s=ration_s, spent=spent, lit=False))
        return may_aim_lit(passed(machine, machine.now_ns))

    assert [with_ration(s, spent=False) for s in (5.0, 5.1, 7.9)] == [False, True, True]
    assert [with_ration(s, spent=True) for s in (5.1, 7.9, 8.0)] == [False, False, True]


def test_a_sensor_may_be_silent_for_five_seconds_and_what_was_hot_cools_in_five_minutes() -> None:
    warm = warmed(aim(), 51.0)
    for silent_s, told in ((4.9, False), (5.0, True)):
        assert (FaultCode.TEMPERATURE_UNKNOWN in codes(run(warm, later(warm, silent_s), heartbeat()))) == told
    for silent_s, believed in ((299.0, True), (300.0, False)):
        machine = run(warm, later(warm, silent_s), heartbeat())
        assert has(machine, FaultCode.WARM, "case") == believed


@pytest.mark.parametrize(("code", "limit_c"), [(FaultCode.WARM, 50.0), (FaultCode.HOT, 60.0)])
def test_a_band_begins_at_its_limit_and_ends_three_degrees_below(code: FaultCode, limit_c: float) -> None:
    assert not has(warmed(aim(), limit_c - 0.01), code, "case")
    hot = warmed(aim(), limit_c)
    assert has(hot, code, "case")
    assert has(warmed(hot, limit_c - 2.99), code, "case")
    assert not has(warmed(hot, limit_c - 3.0), code, "case")
    assert not has(warmed(warmed(hot, limit_c - 3.0), limit_c - 0.01), code, "case"), "and begins at its limit again"


def test_a_straight_line_is_fitted_to_what_was_measured() -> None:
    def line(slope: float, seconds: tuple[float, ...]) -> tuple[tuple[int, float], ...]:
        return tuple((int(7e9 + s * 1e9), 40.0 + slope * s) for s in seconds)

    assert slope_c_per_s(line(-0.05, (0.0, 5.0, 12.0, 30.0))) == pytest.approx(-0.05)
    assert slope_c_per_s(((0, 1.0), (SECOND_NS, 2.0), (2 * SECOND_NS, 6.0))) == pytest.approx(2.5)
    assert slope_c_per_s(line(1.0, (0.0, 5.0))) is None, "two points make any line"
    assert slope_c_per_s(((5, 1.0), (5, 2.0), (5, 3.0))) is None


def test_the_estimate_is_the_slowest_places_and_never_more_than_an_hour() -> None:
    def cooling(place: str, per_s: float) -> tuple[tuple[int, float], ...]:
        return tuple((int(5e9 * k), 65.0 - per_s * 5 * k) for k in range(8))

    def hot(place: str) -> Fault:
        return Fault(FaultCode.HOT, "hot", {"temperature_c": 63.0, "below_c": 57.0}, place)

    machine = replace(aim(), conditions=(hot("case"), hot("projector")))
    trend = {"case": cooling("case", 0.1), "projector": cooling("projector", 0.02)}
    assert remaining_s(replace(machine, thermal=replace(machine.thermal, trend=trend))) == pytest.approx(300.0)
    for hardly in (0.001, 0.0019):
        trend["projector"] = cooling("projector", hardly)
        assert remaining_s(replace(machine, thermal=replace(machine.thermal, trend=trend))) is None
    trend["projector"] = cooling("projector", 0.0021)
    far = Fault(FaultCode.HOT, "hot", {"temperature_c": 66.0, "below_c": 57.0}, "projector")
    slow = replace(machine, conditions=(far,), thermal=replace(machine.thermal, trend=trend))
    assert remaining_s(slow) == 3600.0
    assert remaining_s(aim()) is None
