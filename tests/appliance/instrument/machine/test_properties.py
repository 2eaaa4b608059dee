"""What holds from every state, whatever happened before and whatever comes next."""

from __future__ import annotations

import re
import typing
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from hypothesis import given, settings

from appliance.calibrate.guide import HELD
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.alerts import RULES, Severity, lasting
from appliance.instrument.machine.asking import pending_fault
from appliance.instrument.machine.conditions import interruption, may_lase, may_light, may_shine, refusal
from appliance.instrument.machine.leading import alerts
from appliance.instrument.machine.states import NEEDED_FOR_A_SCAN, Answer, Machine, State, Task
from appliance.instrument.machine.step import step
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.news import News, PatternIdentity, ReconstructionFailure
from drivers.api import Key, KeyLongPress, KeyPress, KeyStuck
from tests.appliance.instrument.machine.walks import (
    EVERY_EVENT,
    KINDS,
    SECOND_NS,
    START,
    STARTS,
    WALKS,
    WAYS,
    capturing,
    kind,
    labels,
    run,
)

Effects = Sequence[do.Effect]
DARK = (State.ARMED, State.CAPTURE)
KEY_EVENTS = (KeyPress, KeyLongPress, KeyStuck)


def test_every_event_is_in_the_list_and_every_state_is_reached_by_events() -> None:
    assert {kind(event) for event in EVERY_EVENT} == KINDS
    assert [way().state for way in WAYS.values()] == list(State)


def called(before: Machine, event: on.Event) -> str:
    match event:
        case KeyPress(key) | KeyLongPress(key):
            return f"key {labels(before).get(key, key.value)}"
        case on.ConditionRaised(fault):
            return fault.code.value
        case News(_, PatternIdentity(judgement)) if judgement.fault is not None:
            return judgement.fault.code.value
        case on.Tick():
            return "time"
        case _:
            return kind(event).__name__


def test_every_state_answers_every_event_and_the_page_of_states_says_how() -> None:
    found: dict[tuple[State, State], set[str]] = defaultdict(set)
    for start in (way() for way in STARTS):
        for event in EVERY_EVENT:
            machine, effects = step(start, event)
            if machine.state is not start.state:
                found[start.state, machine.state].add(called(start, event))
            assert isinstance(machine, Machine)
            assert all(isinstance(effect, typing.get_args(do.Effect)) for effect in effects)
            for alert in alerts(machine):
                assert 0 < len(alert.headline) <= 16
                assert 0 < len(alert.action) <= 32
            labels(machine)
            for promise in OF_STEPS:
                promise(start, event, machine, effects)
            for key in EVERY_EVENT if isinstance(event, KEY_EVENTS) else ():
                if isinstance(key, KEY_EVENTS):  # a second one
                    keys_switch_off_by_an_answered_question_only(machine, key, *step(machine, key))
    page = (Path(__file__).parents[4] / "docs" / "states.md").read_text(encoding="utf-8")
    steps = [(a, b) for a in State for b in State if (a, b) in found]
    wanted = [f"| {a.value} | {b.value} | {', '.join(sorted(found[a, b]))} |" for a, b in steps]
    assert re.findall(r"^\| [A-Z_]+ \| [A-Z_]+ \|.*$", page, re.MULTILINE) == wanted
    drawn = re.findall(r"^    (\w+) --> (\w+) : (.+?)(?: …)?$", page, re.MULTILINE)
    for source, target, names in drawn:
        for name in names.split(", "):
            sources = {a.value for (a, b), said in found.items() if b.value == target and name in said}
            assert len(sources) >= 12 if source == "ANY" else source in sources, (source, target, name)
    arrows = {(a, b) for a, b, _ in drawn}
    assert all((a.value, b.value) in arrows or ("ANY", b.value) in arrows for a, b in steps)
    assert {a for a, _ in steps} == set(State) - {State.SHUTDOWN}
    assert {b for _, b in steps} == set(State) - {State.BOOT}


def no_light_without_permission(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    for effect in effects:
        if isinstance(effect, do.GoLive):
            assert not effect.light or may_shine(machine)
            assert not effect.lasers or may_lase(machine)
        if isinstance(effect, do.Arm | do.Capture):
            assert may_light(machine)
            assert interruption(machine) is None
    assert may_light(machine) or machine.state not in DARK
    if may_light(before) and not may_light(machine) and before.state is not State.SHUTDOWN:
        assert do.Wish.DARK in effects


def has_live_views(machine: Machine) -> bool:
    at = machine.calibrating
    return machine.state is State.AIM or (machine.state is State.CALIBRATE and at is not None and at.step in HELD)


def live_where_the_diver_aims(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    was, now = has_live_views(before), has_live_views(machine)
    went_live = any(isinstance(effect, do.GoLive) for effect in effects)
    assert not went_live or now
    assert was or not now or went_live
    assert not was or now or do.Wish.DARK in effects
    arms = [i for i, effect in enumerate(effects) if isinstance(effect, do.Arm)]
    if arms and was:
        assert effects.index(do.Wish.DARK) < arms[0]


def no_recording_of_a_step_is_forgotten(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    at, now = before.calibrating, machine.calibrating
    looked_at = (Task.STORE, Task.EXAMINE)
    if at is None or before.state is not State.CALIBRATE:
        return
    if at.task in looked_at and (now is None or now.task not in looked_at or now.number != at.number):
        settled = any(isinstance(e, do.AcceptRecording | do.Reject) and e.number == at.number for e in effects)
        refused = isinstance(event, on.SaveFailed) and event.number == at.number
        assert settled or refused or machine.state is State.SHUTDOWN
    if at.task not in (None, *looked_at):
        work = {do.Wish.SOLVE_CALIBRATION, do.Wish.USE_SOLVED, do.Wish.RESTORE_KEPT, do.Wish.BEGIN_SESSION}
        assert not any(isinstance(e, do.Arm) or e in work for e in effects), "one task at a time"


def no_points(event: on.Event) -> bool:
    """Whether an event says that the frames give none."""
    if not isinstance(event, News):
        return False
    fact = event.fact
    wrong = isinstance(fact, PatternIdentity) and fact.judgement.fault is not None
    return wrong or isinstance(fact, ReconstructionFailure)


def no_scan_is_forgotten(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    kept = before.scan
    if kept is None or machine.scan is not None:
        return
    saved = isinstance(event, on.Saved) and event.number == kept.number
    rejected = any(isinstance(e, do.Reject) and e.number == kept.number for e in effects)
    assert saved or rejected or machine.state is State.SHUTDOWN
    if not kept.is_kept or isinstance(event, on.Saved):
        return
    if any(isinstance(effect, do.Quit) for effect in effects):
        assert kept.failures >= 1 or no_points(event), "the disk refused it again and again"
        return
    asked = isinstance(event, KeyPress | KeyLongPress) and before.state is State.REVIEW
    spoilt = no_points(event) and not kept.publishing
    assert asked or spoilt, "only the diver gives it up, after the disk refused it, or it was worthless"


def no_number_is_used_twice(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    for effect in effects:
        if isinstance(effect, do.Arm):
            assert effect.number == machine.captures == before.captures + 1


def choices_take_effect(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    was, now = before.choices, machine.choices
    assert (do.UseChoices(was, now) in effects) == (was != now)
    assert was == now or before.state in (State.MENU, State.REVIEW)
    if was.exposure != now.exposure:
        label = labels(before)[event.key] if isinstance(event, KeyPress) else ""
        assert label == "OK" if before.state is State.MENU else label.startswith(("EXPOSE ", "GAIN "))


def ends(machine: Machine) -> bool:
    return machine.state is State.SHUTDOWN or machine.stopping is not None


def keys_switch_off_by_an_answered_question_only(
    before: Machine, event: on.Event, machine: Machine, effects: Effects
) -> None:
    """By the press of OK on SWITCH OFF, of a question that was on the screen."""
    quits = any(isinstance(effect, do.Quit) for effect in effects)
    if ends(before) or not isinstance(event, KEY_EVENTS) or not (ends(machine) or quits):
        return
    question = before.off_question
    assert question is not None
    assert question.answer is Answer.SWITCH_OFF
    assert isinstance(event, KeyPress)
    # A stuck key that is seen to go down again has come loose: it means what it says once more.
    assert labels(replace(before, stuck=before.stuck - {event.key})).get(event.key) == "OK"


def nothing_becomes_known_but_by_its_key(before: Machine, event: on.Event, machine: Machine, effects: Effects) -> None:
    gained = set(machine.acknowledged) - set(before.acknowledged)
    if gained:
        assert isinstance(event, KeyPress)
        assert labels(replace(before, stuck=before.stuck - {event.key}))[event.key] == "SEEN"
        assert gained == {pending_fault(before)} or before.stuck
    there = {(fault.code, fault.device) for fault in lasting(machine)}
    assert all((was.code, was.device) in there for was in machine.acknowledged)
    assert not any(
        alert.is_acknowledged and RULES[alert.code].severity is Severity.CRITICAL for alert in alerts(machine)
    )


def water_leads_to_safe(before: Machine) -> None:
    if before.state is State.SHUTDOWN or not may_light(before):
        return
    wet, told = step(before, on.ConditionRaised(Fault(FaultCode.LEAK)))
    assert (wet.state, told[0], alerts(wet)[0].code) == (State.SAFE, do.Wish.DARK, FaultCode.LEAK)
    assert before.state not in DARK or do.Wish.ABORT_CAPTURE in told


def a_press_of_scan_begins_something_or_says_why(before: Machine) -> None:
    if before.state is not State.AIM or Key.SCAN in before.stuck or before.off_question is not None:
        return
    pressed, told = step(before, KeyPress(Key.SCAN, 0))
    if not any(isinstance(effect, do.Arm) for effect in told):
        said = alerts(pressed)
        led = pressed.state is State.COOLING or pressed.insists_until_ns is not None
        assert said
        assert led or said[0].action == "SCAN REFUSED"


OF_STEPS: tuple[Callable[[Machine, on.Event, Machine, Effects], None], ...] = (
    no_light_without_permission,
    live_where_the_diver_aims,
    no_recording_of_a_step_is_forgotten,
    no_scan_is_forgotten,
    no_number_is_used_twice,
    choices_take_effect,
    keys_switch_off_by_an_answered_question_only,
    nothing_becomes_known_but_by_its_key,
)


@given(START, WALKS)
@settings(max_examples=150, deadline=None)
def test_every_step_of_any_walk_keeps_every_promise(start: Machine, events: list[on.Event]) -> None:
    machine = start
    for event in events:
        before, shown = machine, repr(machine)
        machine, effects = step(before, event)
        assert step(before, event) == (machine, effects), "the same event, the same answer"
        assert repr(before) == shown
        for promise in OF_STEPS:
            promise(before, event, machine, effects)
        water_leads_to_safe(machine)
        a_press_of_scan_begins_something_or_says_why(machine)


@given(START, WALKS)
@settings(max_examples=40, deadline=None)
def test_back_repeated_reaches_aim_unless_what_keeps_it_dark_lasts(start: Machine, events: list[on.Event]) -> None:
    machine = run(start, *events)
    for _ in range(200):
        machine = run(machine, KeyPress(Key.BACK, 0))
        if labels(machine).get(Key.BACK) == "HOLD: REDO":
            machine = run(machine, KeyLongPress(Key.BACK, 0))
        machine = run(machine, on.Tick(machine.now_ns + SECOND_NS))
        if machine.state is State.AIM:
            return
    assert ends(machine) or (machine.state is State.SAFE and not may_light(machine))


@given(START, WALKS)
@settings(max_examples=60, deadline=None)
def test_without_the_diver_every_state_ends_where_the_diver_decides(start: Machine, events: list[on.Event]) -> None:
    machine = run(start, *events)
    recording = machine if machine.state is State.CAPTURE else capturing()
    limit_ns = recording.since_ns + int(recording.settings.capture_s(recording.choices.period_px) * 1e9)
    assert run(recording, on.Tick(limit_ns)).state not in DARK
    for _ in range(12):  # each state has one deadline; a save is tried again three times
        machine = run(machine, on.Tick(machine.now_ns + 100 * SECOND_NS))
    passing = (State.BOOT, State.ARMED, State.CAPTURE, State.CHECK, State.RECONSTRUCT, State.SAVING)
    assert machine.state not in passing
    assert machine.deadline_ns is None
    assert machine.calibrating is None or machine.calibrating.task is None


def test_what_stops_a_capture_also_refuses_one() -> None:
    aim = WAYS[State.AIM]()
    for code in FaultCode:
        machine = run(aim, on.ConditionRaised(Fault(code)))
        assert interruption(machine) is None or refusal(machine) is not None
    assert all(refusal(run(aim, on.DeviceDown(device, "gone"))) is not None for device in NEEDED_FOR_A_SCAN)
