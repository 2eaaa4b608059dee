"""A key has a label exactly where it does something, and what stands beside it is what the diver's manual says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from appliance.machine import events as on
from appliance.machine.start import waits_for_ok
from appliance.machine.states import Machine, State
from appliance.machine.step import step
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    STARTS,
    SUMMARY,
    WAYS,
    calibrating,
    heartbeat,
    in_menu,
    kept_before_the_cloud,
    reconstructing,
    refused_by_the_disk,
    run,
    self_test_without_a_camera,
)

UP, DOWN, SCAN, BACK = Key.UP, Key.DOWN, Key.SCAN, Key.BACK


def forgetful(machine: Machine) -> Machine:
    """Without what every press leaves behind or takes away, whatever it means."""
    plain = replace(machine, last_key_ns=None, back_from=None, back_spent=False)
    return replace(plain, notice=None, just_saved=None, insists_until_ns=None)


def does(machine: Machine, *events: on.Event) -> bool:
    """Whether these events change anything that the diver could see."""
    start = forgetful(machine)
    for event in events:
        machine, effects = step(machine, event)
        if effects:
            return True
    return forgetful(machine) != start


@pytest.mark.parametrize("start", [way() for way in STARTS], ids=lambda m: m.state.value)
def test_a_key_has_a_label_where_it_does_something_and_nowhere_else(start: Machine) -> None:
    said = labels(start)
    for key in Key:
        pressed, held = (on.KeyPressed(key),), (on.KeyPressed(key), on.KeyHeld(key))
        label = said.get(key)
        if label is None:
            assert not does(start, *held), f"{key} does something and says nothing"
        elif label.startswith("HOLD: "):
            goes_on = waits_for_ok(start)  # whoever is asked to go on goes on with BACK as well
            assert does(start, *pressed) == goes_on, f"{key} must be held"
            assert does(start, *held), f"{key} says {label} and does nothing"
        else:
            assert does(start, *pressed), f"{key} says {label} and does nothing"


def refused_in_safe() -> Machine:
    return run(
        refused_by_the_disk(), heartbeat(leak=True), heartbeat(leak=True), on.SaveFailed(1, Fault(FaultCode.NOT_SAVED))
    )


@pytest.mark.parametrize(
    ("way", "expected"),
    [
        (WAYS[State.BOOT], {BACK: "HOLD: OFF"}),
        (WAYS[State.SELF_TEST], {BACK: "HOLD: OFF"}),
        (self_test_without_a_camera, {SCAN: "GO ON", BACK: "HOLD: OFF"}),
        (WAYS[State.AIM], {SCAN: "SCAN", BACK: "HOLD: OFF", UP: "MENU", DOWN: "GALLERY"}),
        (WAYS[State.ARMED], {BACK: "STOP"}),
        (WAYS[State.CAPTURE], {BACK: "STOP"}),
        (WAYS[State.CHECK], {BACK: "HOLD: REDO"}),
        (WAYS[State.RECONSTRUCT], {BACK: "HOLD: REDO"}),
        (WAYS[State.REVIEW], {SCAN: "KEEP", BACK: "HOLD: REDO", UP: "TURN"}),
        (WAYS[State.SAVING], {}),
        (kept_before_the_cloud, {}),
        (WAYS[State.COOLING], {BACK: "BACK"}),
        (WAYS[State.SAFE], {BACK: "HOLD: OFF"}),
        (refused_in_safe, {SCAN: "RETRY", BACK: "HOLD: OFF"}),
        (WAYS[State.SHUTDOWN], {}),
        (calibrating, {SCAN: "SCAN", BACK: "BACK", DOWN: "BAR UPRIGHT"}),
        (in_menu, {SCAN: "CHANGE", BACK: "BACK", DOWN: "▼"}),
        (lambda: in_menu(DOWN, DOWN), {SCAN: "OPEN", BACK: "BACK", UP: "▲", DOWN: "▼"}),
        (lambda: in_menu(*(DOWN,) * 9), {SCAN: "OPEN", BACK: "BACK", UP: "▲"}),
        (lambda: in_menu(DOWN, SCAN), {SCAN: "OK", BACK: "CANCEL", UP: "▲"}),
        (lambda: in_menu(*(DOWN,) * 8, SCAN), {BACK: "BACK", DOWN: "▼"}),
    ],
)
def test_what_stands_beside_the_keys(way: Callable[[], Machine], expected: dict[Key, str]) -> None:
    assert dict(labels(way())) == expected


def test_while_a_save_in_safe_is_under_way_there_is_nothing_to_try_again() -> None:
    machine = run(reconstructing(), heartbeat(leak=True), heartbeat(leak=True))
    assert SCAN not in labels(machine), "its cloud is still awaited"
    machine = run(machine, on.FullReady(1, SUMMARY))
    assert SCAN not in labels(machine), "it is being published"


def test_after_the_end_no_key_has_a_label_whatever_lasts() -> None:
    uncalibrated = on.ConditionRaised(Fault(FaultCode.UNCALIBRATED))
    machine = run(WAYS[State.AIM](), uncalibrated, on.KeyPressed(BACK), on.StopRequested("SIGTERM"))
    assert dict(labels(run(WAYS[State.AIM](), uncalibrated, on.StopRequested("SIGTERM")))) == {}
    assert dict(labels(machine)) == {}
