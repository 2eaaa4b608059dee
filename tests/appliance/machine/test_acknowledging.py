"""A warning that lasts is taken for known with one key, which does nothing else; what is new or worse is shown in full again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings

from appliance.machine import events as on
from appliance.machine.acknowledge import pending
from appliance.machine.alerts import RULES, Severity, lasting
from appliance.machine.leading import alerts, in_full
from appliance.machine.states import Device, Machine, State
from appliance.machine.step import step
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    EVENTS,
    HOLD_BACK,
    START,
    WALKS,
    after,
    aim,
    calibrating,
    capturing,
    heartbeat,
    in_gallery,
    in_menu,
    reviewing,
    run,
    saving,
    walk,
)

BACK = on.KeyPressed(Key.BACK)
UNCALIBRATED = on.ConditionRaised(Fault(FaultCode.UNCALIBRATED, "no file calibration/current.json"))


def warm(celsius: float) -> on.TelemetryArrived:
    return heartbeat(temperature_case_c=celsius)


def full(machine: Machine) -> str | None:
    """The headline that is shown in full."""
    alert = in_full(alerts(machine))
    return None if alert is None else alert.headline


def marks(machine: Machine) -> list[str]:
    return [alert.headline for alert in alerts(machine) if alert.seen]


@pytest.mark.parametrize("way", [aim, in_menu, in_gallery, reviewing, saving])
def test_back_takes_a_lasting_warning_for_known_and_does_nothing_else(way: Callable[[], Machine]) -> None:
    machine = run(way(), UNCALIBRATED)
    assert labels(machine)[Key.BACK] == "SEEN"
    assert full(machine) == "UNCALIBRATED"
    known, effects = after(machine, BACK)
    assert (full(known), marks(known), effects) == (None, ["UNCALIBRATED"], [])
    assert labels(known) == labels(way()), "its key means again what it always means"
    # But for what is known, and when a key was pressed, it is the machine that it was.
    fields = {"seen", "last_key_ns", "back_from", "back_spent"}
    as_it_was = {name: getattr(machine, name) for name in fields}
    assert replace(known, **as_it_was) == machine


@pytest.mark.parametrize("way", [aim, reviewing])
def test_held_on_the_same_press_neither_rejects_a_scan_nor_asks_for_switching_off(way: Callable[[], Machine]) -> None:
    machine, effects = after(run(way(), UNCALIBRATED), *HOLD_BACK)
    assert (machine.state, machine.scan, machine.off_question, effects) == (way().state, way().scan, None, [])


def test_the_mark_stays_on_every_screen_from_then_on() -> None:
    machine = run(aim(), UNCALIBRATED, BACK)
    for events in (
        (on.KeyPressed(Key.UP),), (BACK,), (on.KeyPressed(Key.DOWN),), (BACK,),
        (on.KeyPressed(Key.SCAN), on.Armed(1)), (on.CaptureFinished(1),),
    ):  # fmt: skip
        machine = run(machine, *events)
        assert (full(machine), marks(machine)) == (None, ["UNCALIBRATED"]), machine.state


def test_another_reason_is_shown_in_full_again() -> None:
    machine = run(aim(), UNCALIBRATED, BACK, UNCALIBRATED)
    assert full(machine) is None, "told again it is no news"
    machine = run(machine, on.ConditionRaised(Fault(FaultCode.UNCALIBRATED, "of another instrument: KF-0002")))
    assert full(machine) == "UNCALIBRATED"


def test_what_ended_and_comes_again_is_news() -> None:
    machine = run(aim(), on.DeviceDown(Device.KEYS, "gone"), BACK, on.DeviceUp(Device.KEYS))
    assert (full(machine), machine.seen) == (None, ())
    assert full(run(machine, on.DeviceDown(Device.KEYS, "gone"))) == "KEYS LOST"


@pytest.mark.parametrize(("first", "same", "worse"), [(51.0, 52.4, 53.0), (55.0, 53.5, 57.5)])
def test_a_temperature_that_trembles_stays_a_mark_and_one_that_rises_does_not(
    first: float, same: float, worse: float
) -> None:
    machine = run(aim(), warm(first), BACK, warm(same))
    assert (full(machine), marks(machine)) == (None, [f"WARM {same:.0f} °C"])
    assert full(run(machine, warm(worse))) == f"WARM {worse:.0f} °C"


def test_a_supply_that_sags_further_is_shown_in_full_again() -> None:
    def low(volts: float) -> on.ConditionRaised:
        return on.ConditionRaised(Fault(FaultCode.SUPPLY_LOW, f"{volts} V", {"supply_v": volts}))

    machine = run(aim(), low(10.4), BACK, low(10.2))
    assert full(machine) is None
    assert full(run(machine, low(10.1))) == "SUPPLY LOW 10.1V"


def test_each_is_read_before_it_is_known() -> None:
    machine = run(aim(), UNCALIBRATED, on.StorageCounted(3, "000003", 0))
    assert full(machine) == "STORAGE FULL"
    machine = run(machine, BACK)
    assert (full(machine), marks(machine)) == ("UNCALIBRATED", ["STORAGE FULL"])
    assert full(run(machine, BACK)) is None
    assert run(machine, BACK, on.KeyPressed(Key.SCAN)).state is State.AIM, "it still forbids what it forbids"


def test_what_is_critical_stays_in_full() -> None:
    machine = run(aim(), on.ConditionRaised(Fault(FaultCode.LASER_ON)), UNCALIBRATED)
    assert labels(machine)[Key.BACK] == "HOLD: OFF"
    assert full(run(machine, BACK)) == "LASER ON"


def test_back_ends_a_recording_whatever_is_wrong_besides() -> None:
    machine = run(capturing(), UNCALIBRATED)
    assert labels(machine)[Key.BACK] == "STOP"
    assert run(machine, BACK).state is State.AIM


def test_what_calibrating_is_the_remedy_for_need_not_be_acknowledged_there() -> None:
    machine = run(calibrating(), UNCALIBRATED)
    assert labels(machine)[Key.BACK] == "BACK"
    assert full(run(machine, BACK)) == "UNCALIBRATED"


@pytest.mark.parametrize("code", [code for code, rule in RULES.items() if rule.passing])
def test_what_comes_and_goes_with_the_live_picture_is_never_in_full_and_needs_no_key(code: FaultCode) -> None:
    machine = run(aim(), on.ConditionRaised(Fault(code, "", {}, "live view")))
    assert [alert.code for alert in alerts(machine)] == [code]
    assert full(machine) is None
    assert labels(machine) == labels(aim())
    assert full(run(machine, UNCALIBRATED)) == "UNCALIBRATED"


@given(START, WALKS, EVENTS)
@settings(deadline=None)
def test_nothing_becomes_known_but_by_its_key(start: Machine, events: list[on.Event], event: on.Event) -> None:
    before = walk(start, events)
    machine, _ = step(before, event)
    gained = set(machine.seen) - set(before.seen)
    if gained:
        assert gained == {pending(before)} or isinstance(event, on.KeyPressed)
        assert isinstance(event, on.KeyPressed)
        loose = replace(before, stuck=before.stuck - {event.key})
        assert labels(loose)[event.key] == "SEEN"
    there = {(fault.code, fault.device) for fault in lasting(machine)}
    assert all((was.code, was.device) in there for was in machine.seen)
    assert not any(alert.seen and RULES[alert.code].severity is Severity.CRITICAL for alert in alerts(machine))
