"""Effects of the four keys in each state, and the labels beside them.

A press has one meaning in each state. A key is held for actions that cannot be undone, or need a still hand: rejecting
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
"""States in which holding BACK asks whether to switch off."""
HELD_TO_REJECT = (State.CHECK, State.RECONSTRUCT, State.REVIEW)
"""States in which holding BACK rejects the scan in hand: a glove that brushes the key costs no scan."""


def meaning(machine: Machine, key: Key) -> Key:
    """Return the key that a press stands for: UP replaces a stuck SCAN, DOWN a stuck BACK."""
    if key is Key.UP and Key.SCAN in machine.stuck:
        return Key.SCAN
    if key is Key.DOWN and Key.BACK in machine.stuck:
        return Key.BACK
    return key


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a press; for a stuck key's stand-in, ``key`` is the stuck one."""
    # Asked before the notice is removed: the press refers to the screen at that moment.
    acknowledged = asking.pending_fault(machine) if key is Key.BACK else None
    machine = replace(machine, notice=None, just_saved=None, last_key_ns=machine.now_ns)
    if key is Key.BACK:
        # A key counts as held 0.8 s after the press. Meanwhile the state may change by itself (a capture ends, a
        # cloud arrives), and a press from the state before must neither reject a scan nor switch off.
        machine = replace(machine, back_from=machine.state, back_spent=False)
    if key is Key.DOWN:
        machine = replace(machine, add_offered=second_exposure(machine) is not None)
    if acknowledged is not None:
        return asking.with_acknowledged(machine, acknowledged), ()
    if key is not Key.SCAN:
        # To insist is to press SCAN twice in a row: any other key cancels the first press.
        machine = replace(machine, insists_until_ns=None)
    if machine.off_question is not None:
        return asking.pressed(machine, key)
    return by_state.pressed(machine, key)


def held(machine: Machine, key: Key) -> Result:
    """Handle a held key.

    BACK rejects the scan in hand, or asks whether to switch off. DOWN adds a second exposure to the scan in review, or,
    at the calibration's result, puts the session away for a new one.
    """
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
    # Both states are checked: BOOT and SELF_TEST end by themselves while a key is held, and BACK means the same in
    # each.
    if machine.state in HELD_TO_SWITCH_OFF and machine.back_from in (None, *HELD_TO_SWITCH_OFF):
        return asking.ask(machine), ()
    return machine, ()


def labels(machine: Machine) -> Mapping[Key, Label]:
    """Return the label of each physical key; a key without one has no effect now.

    The label of a stuck key moves to its stand-in.
    """
    labels_by_key = _labels_by_key(machine)
    if asking.pending_fault(machine) is not None:
        labels_by_key[Key.BACK] = Text.SEEN
    for broken, stand_in in ((Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)):
        if broken in machine.stuck:
            label = labels_by_key.pop(broken, None)
            # The stand-in loses its own meaning: a key has one, and that of the stuck key is needed more.
            labels_by_key.pop(stand_in, None)
            if label is not None:
                labels_by_key[stand_in] = label
    return labels_by_key


def _labels_by_key(machine: Machine) -> dict[Key, Label]:
    if machine.off_question is not None:
        return _question(machine)
    return by_state.labels(machine)


def _question(machine: Machine) -> dict[Key, Label]:
    labels_by_key: dict[Key, Label] = {Key.SCAN: Text.OK, Key.BACK: Text.BACK}
    for key in (Key.UP, Key.DOWN):
        answer = asking.other_answer(machine, key)
        if answer is not None:
            labels_by_key[key] = Text.ARROW_UP if answer is Answer.STAY_ON else Text.ARROW_DOWN
    return labels_by_key
