"""Owns what the four keys do in each state, and the labels beside them.

A press has one meaning in each state. Holding a key is for what cannot be taken back, or needs a still hand: rejecting
a scan, a second exposure, putting a calibration away, and asking whether to switch off.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from appliance.instrument.machine import asking, by_state, calibrate, scanning
from appliance.instrument.machine.conditions import second_exposure
from appliance.instrument.machine.moves import Result
from appliance.instrument.machine.states import Answer, Machine, State
from appliance.instrument.machine.words import Label, Text
from drivers.api import Key

HELD_TO_SWITCH_OFF = (State.BOOT, State.SELF_TEST, State.AIM, State.SAFE)
"""States in which BACK held asks whether to switch off."""
HELD_TO_REJECT = (State.CHECK, State.RECONSTRUCT, State.REVIEW)
"""States in which BACK held rejects the scan in hand: a glove that brushes the key costs no scan."""


def meaning(machine: Machine, key: Key) -> Key:
    """Return the key a press stands for: while SCAN is stuck UP takes over, while BACK is stuck DOWN does."""
    if key is Key.UP and Key.SCAN in machine.stuck:
        return Key.SCAN
    if key is Key.DOWN and Key.BACK in machine.stuck:
        return Key.BACK
    return key


def pressed(machine: Machine, key: Key) -> Result:
    """Do what a key that went down means; ``key`` is what it stands for."""
    # Asked before the notice is taken away: the press is about what was on the screen when the finger came down.
    known = asking.pending_fault(machine) if key is Key.BACK else None
    machine = replace(machine, notice=None, just_saved=None, last_key_ns=machine.now_ns)
    if key is Key.BACK:
        # That a key is held is known 0.8 s after the press. In between the state may change by itself (a capture
        # ends, a cloud is there), and what was meant for the state before must neither reject a scan nor switch
        # off.
        machine = replace(machine, back_from=machine.state, back_spent=False)
    if key is Key.DOWN:
        machine = replace(machine, add_offered=second_exposure(machine) is not None)
    if known is not None:
        return asking.with_acknowledged(machine, known), ()
    if key is not Key.SCAN:
        # To insist is to press SCAN twice in a row: any other key takes the first press back.
        machine = replace(machine, insists_until_ns=None)
    if machine.off_question is not None:
        return asking.pressed(machine, key)
    return by_state.pressed(machine, key)


def held(machine: Machine, key: Key) -> Result:
    """BACK held rejects the scan in hand, or asks whether to switch off; DOWN held adds a second exposure to the scan
    in review, and at the calibration's result puts that away for a new one."""
    if machine.off_question is not None:
        return machine, ()
    if key is Key.DOWN and calibrate.may_begin_session(machine):
        return calibrate.begin_session(machine)
    if key is Key.DOWN and machine.state is State.REVIEW and machine.add_offered:
        return scanning.add(machine)
    if key is not Key.BACK or machine.back_spent:
        return machine, ()
    if machine.state in HELD_TO_REJECT and machine.back_from in HELD_TO_REJECT:
        return scanning.rejected(machine)
    # Both sides are looked at: BOOT and SELF_TEST pass by themselves while a key is held, and still mean the
    # same.
    if machine.state in HELD_TO_SWITCH_OFF and machine.back_from in (None, *HELD_TO_SWITCH_OFF):
        return asking.ask(machine), ()
    return machine, ()


def labels(machine: Machine) -> Mapping[Key, Label]:
    """Return the label per physical key; a key without one does nothing now.

    A stuck key's label moves to its stand-in.
    """
    meant = _meant(machine)
    if asking.pending_fault(machine) is not None:
        meant[Key.BACK] = Text.SEEN
    for broken, stand_in in ((Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)):
        if broken in machine.stuck:
            label = meant.pop(broken, None)
            # The stand-in's own meaning goes with it: a key has one meaning, and the stuck one's is needed more.
            meant.pop(stand_in, None)
            if label is not None:
                meant[stand_in] = label
    return meant


def _meant(machine: Machine) -> dict[Key, Label]:
    if machine.off_question is not None:
        return _question(machine)
    return by_state.labels(machine)


def _question(machine: Machine) -> dict[Key, Label]:
    meant: dict[Key, Label] = {Key.SCAN: Text.OK, Key.BACK: Text.BACK}
    for key in (Key.UP, Key.DOWN):
        other = asking.other_answer(machine, key)
        if other is not None:
            meant[key] = Text.ARROW_UP if other is Answer.STAY_ON else Text.ARROW_DOWN
    return meant
