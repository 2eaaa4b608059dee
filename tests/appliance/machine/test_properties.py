"""What holds from every state, whatever happened before and whatever comes next."""

from __future__ import annotations

import typing

import pytest
from hypothesis import given, settings

from appliance.calibration.guide import HELD
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.leading import alerts
from appliance.machine.permissions import interruption, may_lase, may_light, may_shine, refusal
from appliance.machine.states import NEEDED_FOR_A_SCAN, Machine, State, Task
from appliance.machine.step import step
from appliance.scan.fault import Fault, FaultCode
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    EVENTS,
    EVERY_EVENT,
    SECOND_NS,
    START,
    STARTS,
    WALKS,
    WAYS,
    run,
    walk,
)


def test_the_list_of_every_event_is_complete() -> None:
    assert {type(event) for event in EVERY_EVENT} == set(typing.get_args(on.Event))


@pytest.mark.parametrize("state", list(State))
def test_every_state_is_reached_by_events(state: State) -> None:
    assert WAYS[state]().state is state


@pytest.mark.parametrize("start", [way() for way in STARTS], ids=lambda m: m.state.value)
def test_every_state_answers_every_event(start: Machine) -> None:
    for event in EVERY_EVENT:
        machine, effects = step(start, event)
        assert isinstance(machine, Machine)
        assert all(isinstance(effect, typing.get_args(do.Effect)) for effect in effects)
        for alert in alerts(machine):
            assert 0 < len(alert.headline) <= 16
            assert 0 < len(alert.action) <= 32
        labels(machine)


@given(START, WALKS, EVENTS)
@settings(deadline=None)
def test_the_same_event_gives_the_same_answer_and_leaves_the_machine_as_it_was(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    machine = walk(start, events)
    before = repr(machine)
    assert step(machine, event) == step(machine, event)
    assert repr(machine) == before


@given(START, WALKS)
@settings(max_examples=60, deadline=None)
def test_back_repeated_reaches_aim_unless_what_keeps_it_dark_lasts(start: Machine, events: list[on.Event]) -> None:
    machine = walk(start, events)
    for _ in range(200):
        machine = run(machine, on.KeyPressed(Key.BACK))
        if labels(machine).get(Key.BACK) == "HOLD: REDO":
            machine = run(machine, on.KeyHeld(Key.BACK))
        machine = run(machine, on.Tick(machine.now_ns + SECOND_NS))
        if machine.state is State.AIM:
            return
    ends = machine.state is State.SHUTDOWN or machine.stopping is not None
    assert ends or (machine.state is State.SAFE and not may_light(machine))


@given(START, WALKS)
@settings(max_examples=60, deadline=None)
def test_a_capture_always_ends_even_if_nothing_answers(start: Machine, events: list[on.Event]) -> None:
    machine = walk(start, events)
    if machine.state is not State.CAPTURE:
        machine = WAYS[State.CAPTURE]()
    limit_ns = machine.since_ns + int(machine.settings.capture_s(machine.choices.period_px) * 1e9)
    machine = run(machine, on.Tick(limit_ns))
    assert machine.state not in (State.ARMED, State.CAPTURE)


PASSING = (State.BOOT, State.ARMED, State.CAPTURE, State.CHECK, State.RECONSTRUCT, State.SAVING)


@given(START, WALKS)
@settings(max_examples=60, deadline=None)
def test_without_the_diver_every_state_ends_where_the_diver_decides(start: Machine, events: list[on.Event]) -> None:
    machine = walk(start, events)
    for _ in range(12):  # each state has one deadline; a save is tried again three times
        machine = run(machine, on.Tick(machine.now_ns + 100 * SECOND_NS))
    assert machine.state not in PASSING
    assert machine.deadline_ns is None
    assert machine.calibrating is None or machine.calibrating.task is None


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_no_light_without_permission(start: Machine, events: list[on.Event], event: on.Event) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    for effect in effects:
        match effect:
            case do.GoLive(light, lasers):
                assert not light or may_shine(machine)
                assert not lasers or may_lase(machine)
            case do.Arm() | do.Capture():
                assert may_light(machine)
                assert interruption(machine) is None
            case _:
                pass
    if not may_light(machine):
        assert machine.state not in (State.ARMED, State.CAPTURE)
    if may_light(before) and not may_light(machine) and before.state is not State.SHUTDOWN:
        assert do.LightsOff() in effects


def has_live_views(machine: Machine) -> bool:
    """In AIM, and at the steps of the calibration that record something."""
    if machine.state is State.CALIBRATE:
        return machine.calibrating is not None and machine.calibrating.step in HELD
    return machine.state is State.AIM


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_live_views_run_where_the_diver_aims_and_nowhere_else(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    went_live = any(isinstance(effect, do.GoLive) for effect in effects)
    if has_live_views(before) and not has_live_views(machine):
        assert effects[effects.index(do.StopLive()) :]
        assert not went_live
    if not has_live_views(before) and has_live_views(machine):
        assert went_live
    if went_live:
        assert has_live_views(machine)
    captures = [i for i, effect in enumerate(effects) if isinstance(effect, do.Arm)]
    if captures and has_live_views(before):
        assert effects.index(do.StopLive()) < captures[0]


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_a_recording_of_a_step_is_accepted_or_rejected_but_never_forgotten(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    at, now = before.calibrating, machine.calibrating
    if at is None or at.task not in (Task.STORE, Task.EXAMINE) or before.state is not State.CALIBRATE:
        return
    if now is not None and now.task in (Task.STORE, Task.EXAMINE) and now.number == at.number:
        return
    settled = any(isinstance(e, do.AcceptRecording | do.Reject) and e.number == at.number for e in effects)
    assert (
        settled or (isinstance(event, on.SaveFailed) and event.number == at.number) or machine.state is State.SHUTDOWN
    )


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_one_task_of_the_calibration_at_a_time(start: Machine, events: list[on.Event], event: on.Event) -> None:
    before = walk(start, events)
    _, effects = step(before, event)
    at = before.calibrating
    if at is not None and at.task not in (None, Task.STORE, Task.EXAMINE):
        assert not any(
            isinstance(e, do.Arm | do.SolveCalibration | do.UseSolved | do.RestoreKeptCalibration | do.BeginSession)
            for e in effects
        )


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_a_recorded_scan_is_published_or_rejected_but_never_forgotten(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    if before.scan is None or machine.scan is not None or machine.state is State.SHUTDOWN:
        return
    saved = isinstance(event, on.Saved) and event.number == before.scan.number
    rejected = any(isinstance(e, do.Reject) and e.number == before.scan.number for e in effects)
    assert saved or rejected


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_numbers_of_captures_are_never_used_twice(start: Machine, events: list[on.Event], event: on.Event) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    for effect in effects:
        if isinstance(effect, do.Arm):
            assert effect.number == machine.captures == before.captures + 1


def test_what_stops_a_capture_also_refuses_one() -> None:
    aim = WAYS[State.AIM]()
    for code in FaultCode:
        machine = run(aim, on.ConditionRaised(Fault(code)))
        if interruption(machine) is not None:
            assert refusal(machine) is not None
    for device in NEEDED_FOR_A_SCAN:
        assert refusal(run(aim, on.DeviceDown(device, "gone"))) is not None


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_only_the_key_that_says_so_changes_the_exposure(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    before = walk(start, events)
    machine, _ = step(before, event)
    if machine.exposure != before.exposure:
        assert before.state in (State.REVIEW, State.MENU)
        label = labels(before)[event.key] if isinstance(event, on.KeyPressed) else ""
        assert label == "OK" if before.state is State.MENU else label.startswith(("EXPOSE ", "GAIN "))


@given(START, WALKS)
@settings(max_examples=70, deadline=None)
def test_water_in_the_housing_leads_to_safe_in_one_step(start: Machine, events: list[on.Event]) -> None:
    before = walk(start, events)
    if before.state is State.SHUTDOWN or not may_light(before):
        return
    machine, effects = step(before, on.ConditionRaised(Fault(FaultCode.LEAK)))
    assert machine.state is State.SAFE
    assert effects[0] == do.LightsOff()
    assert alerts(machine)[0].code is FaultCode.LEAK
    if before.state in (State.ARMED, State.CAPTURE):
        assert do.AbortCapture(before.captures) in effects


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_a_scan_the_diver_kept_is_saved_or_still_in_hand(
    start: Machine, events: list[on.Event], event: on.Event
) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    kept = before.scan
    if kept is None or not kept.kept or machine.scan is not None:
        return
    if isinstance(event, on.Saved):
        return
    if any(isinstance(effect, do.Quit) for effect in effects):
        assert kept.failures >= 1 or isinstance(event, on.ReconstructionFailed), "the disk refused it again and again"
        return
    asked = isinstance(event, on.KeyPressed) and before.state is State.REVIEW
    spoilt = isinstance(event, on.ReconstructionFailed) and not kept.publishing
    assert asked or spoilt, "only the diver gives it up, after the disk refused it, or it was worthless"
    assert any(isinstance(effect, do.Reject) for effect in effects)


@given(START, WALKS)
@settings(max_examples=70, deadline=None)
def test_a_press_of_scan_that_begins_nothing_says_why(start: Machine, events: list[on.Event]) -> None:
    before = walk(start, events)
    if before.state is not State.AIM or Key.SCAN in before.stuck or before.off_question is not None:
        return
    machine, effects = step(before, on.KeyPressed(Key.SCAN))
    if any(isinstance(effect, do.Arm) for effect in effects):
        return
    assert alerts(machine), "a reason is on the screen"
    assert (
        machine.state is State.COOLING
        or machine.insists_until_ns is not None
        or (alerts(machine)[0].action == "SCAN REFUSED")
    )


@given(START, WALKS, EVENTS)
@settings(max_examples=70, deadline=None)
def test_what_is_chosen_takes_effect_and_is_remembered(start: Machine, events: list[on.Event], event: on.Event) -> None:
    before = walk(start, events)
    machine, effects = step(before, event)
    was, now = before.choices, machine.choices
    assert (do.RememberChoices(now) in effects) == (was != now)
    assert (do.UsePeriod(now.period_px) in effects) == (was.period_px != now.period_px)
    other_water = (was.salinity_psu, was.water_c) != (now.salinity_psu, now.water_c)
    assert (do.UseWater(now.salinity_psu, now.water_c) in effects) == other_water
    if was != now:
        assert before.state in (State.MENU, State.REVIEW)
