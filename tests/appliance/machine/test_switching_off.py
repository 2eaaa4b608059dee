"""Nobody switches the instrument off by accident: every way the diver has asks, and the harmless answer comes first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import chain, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Answer, Machine, State, boot
from appliance.machine.step import step
from drivers.api import Key
from tests.appliance.machine.english import labels
from tests.appliance.machine.walks import (
    HOLD_BACK,
    SECOND_NS,
    START,
    STARTS,
    WALKS,
    about_to_switch_off,
    after,
    aim,
    asked,
    capturing,
    heartbeat,
    in_menu,
    reviewing,
    run,
    safe,
    self_testing,
    walk,
)

KEY_EVENTS: tuple[on.Event, ...] = (
    *(on.KeyPressed(key) for key in Key),
    *(on.KeyHeld(key) for key in Key),
    *(on.KeyJammed(key) for key in (Key.SCAN, Key.BACK)),
)
GESTURES: tuple[tuple[on.Event, ...], ...] = (
    *((on.KeyPressed(key),) for key in Key),
    *((on.KeyPressed(key), on.KeyHeld(key)) for key in Key),
    *((on.KeyJammed(key),) for key in (Key.SCAN, Key.BACK)),
)
WHERE: tuple[Callable[[], Machine], ...] = (lambda: boot(0), self_testing, aim, safe)


def ends(machine: Machine) -> bool:
    return machine.state is State.SHUTDOWN or machine.stopping is not None


def answered(before: Machine, event: on.Event) -> bool:
    """Whether this event is the press of OK on SWITCH OFF, of a question that was on the screen."""
    question = before.off_question
    if question is None or question.answer is not Answer.SWITCH_OFF or not isinstance(event, on.KeyPressed):
        return False
    # A stuck key that is seen to go down again has come loose: it means what it says once more.
    loose = replace(before, stuck=before.stuck - {event.key})
    return labels(loose).get(event.key) == "OK"


@pytest.mark.parametrize("start", [way() for way in STARTS], ids=lambda m: m.state.value)
def test_no_two_gestures_switch_off_without_an_answered_question(start: Machine) -> None:
    if ends(start):
        return
    for gestures in product(GESTURES, repeat=2):
        machine = start
        for event in chain(*gestures):
            before, machine = machine, run(machine, event)
            if ends(machine):
                assert answered(before, event), (gestures, event)
                break


@given(START, WALKS, st.lists(st.sampled_from(KEY_EVENTS), max_size=12))
@settings(deadline=None)
def test_after_any_walk_keys_alone_switch_off_by_an_answered_question_only(
    start: Machine, events: list[on.Event], keys: list[on.Event]
) -> None:
    machine = walk(start, events)
    for event in keys:
        if ends(machine):
            return
        before = machine
        machine, effects = step(machine, event)
        if ends(machine) or any(isinstance(effect, do.Quit) for effect in effects):
            assert answered(before, event)


@pytest.mark.parametrize("way", WHERE)
def test_back_held_asks_and_stay_on_is_selected(way: Callable[[], Machine]) -> None:
    machine, effects = after(way(), *HOLD_BACK)
    assert machine.state is way().state
    assert effects == []
    assert machine.off_question is not None
    assert machine.off_question.answer is Answer.STAY_ON
    assert labels(machine) == {Key.SCAN: "OK", Key.BACK: "BACK", Key.DOWN: "▼"}
    stays, effects = after(machine, on.KeyPressed(Key.SCAN))
    assert (stays.state, stays.off_question, effects) == (way().state, None, [])


@pytest.mark.parametrize("way", WHERE)
def test_the_second_answer_switches_off(way: Callable[[], Machine]) -> None:
    _, effects = after(about_to_switch_off(way()), on.KeyPressed(Key.SCAN))
    assert effects[-1] == do.Quit(power_off=True)


def test_a_second_hold_that_was_meant_for_another_screen_switches_nothing_off() -> None:
    """As it happened: BACK held to discard a capture that was still running stopped it; the second hold came in AIM."""
    machine = run(capturing(), *HOLD_BACK)
    assert machine.state is State.AIM
    machine = run(machine, *HOLD_BACK, *HOLD_BACK, *HOLD_BACK)
    assert machine.state is State.AIM


def test_the_press_that_leaves_the_question_does_not_ask_again_when_it_is_held_on() -> None:
    machine = run(asked(aim()), *HOLD_BACK)
    assert machine.off_question is None
    assert run(machine, *HOLD_BACK).off_question is not None, "the next one does"


def test_without_an_answer_it_stays_on() -> None:
    machine = about_to_switch_off(aim())
    waits = run(machine, on.Tick(machine.now_ns + 19 * SECOND_NS))
    assert waits.off_question is not None
    over = run(waits, on.Tick(machine.now_ns + 20 * SECOND_NS))
    assert (over.state, over.off_question) == (State.AIM, None)


def test_the_question_of_the_menu_is_the_same_one_and_leads_back_to_its_row() -> None:
    machine = in_menu(*(Key.DOWN,) * 9, Key.SCAN)
    assert machine.off_question is not None
    assert labels(machine) == labels(asked(aim()))
    back = run(machine, on.KeyPressed(Key.SCAN))
    assert (back.state, back.menu, back.off_question) == (State.MENU, in_menu(*(Key.DOWN,) * 9).menu, None)
    assert run(machine, *HOLD_BACK).state is State.MENU


def test_with_back_stuck_its_stand_in_asks_and_the_other_key_selects() -> None:
    seen = run(aim(), on.KeyJammed(Key.BACK), on.KeyPressed(Key.DOWN))
    machine = run(seen, on.KeyPressed(Key.DOWN), on.KeyHeld(Key.DOWN))
    assert labels(machine) == {Key.SCAN: "OK", Key.DOWN: "BACK", Key.UP: "▼"}
    assert run(machine, on.KeyPressed(Key.DOWN)).off_question is None
    machine = run(machine, on.KeyPressed(Key.UP))
    assert labels(machine)[Key.UP] == "▲"
    assert run(machine, on.KeyPressed(Key.SCAN)).state is State.SHUTDOWN


def test_the_question_stays_while_the_start_goes_on_and_gives_way_to_a_leak() -> None:
    machine = run(asked(self_testing()), on.Tick(SECOND_NS))
    assert machine.state is State.AIM
    assert machine.off_question is not None
    machine = run(machine, heartbeat(leak=True), heartbeat(leak=True))
    assert (machine.state, machine.off_question) == (State.SAFE, None)


def test_where_back_held_means_something_else_nothing_is_asked() -> None:
    assert run(reviewing(), *HOLD_BACK).off_question is None
    assert run(in_menu(), *HOLD_BACK).off_question is None
