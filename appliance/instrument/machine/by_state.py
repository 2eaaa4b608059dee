"""Effect of the deadline, effects of the keys, and labels of the keys, for each state.

Each is a closed match over the states: a new state needs a row in each.
"""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from appliance.instrument.machine import calibrate, gallery, menu, safety, saving, scanning, start
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.conditions import other_exposure, second_exposure
from appliance.instrument.machine.moves import Result
from appliance.instrument.machine.states import Machine, NoticeKind, State
from appliance.instrument.machine.words import STEP_NAMES, Label, Text
from drivers.api import Key

_DECISIONS = {
    do.Wish.SOLVE_CALIBRATION: Text.SOLVE,
    do.Wish.USE_SOLVED: Text.KEEP,
    do.Wish.RESTORE_KEPT: Text.RESTORE,
}
"""Label of SCAN at a step of the calibration without a recording, by its effect there."""


def late(machine: Machine) -> Result:
    """Handle a deadline that has passed."""
    match machine.state:
        case State.BOOT | State.SELF_TEST:
            return start.late(machine)
        case State.ARMED | State.CAPTURE:
            return scanning.late(machine)
        case State.CHECK | State.RECONSTRUCT:
            return scanning.no_cloud_in_time(machine)
        case State.SAVING | State.SAFE:
            scan = machine.scan
            if scan is None or scan.publishing:
                return saving.late(machine)
            if scan.settled and scan.retry_ns is not None:  # the disk refused before there was a cloud to wait for
                return saving.retry(replace(machine, deadline_ns=None))
            return scanning.no_cloud_in_time(machine)  # the diver kept it before the cloud was there
        case State.CALIBRATE:
            return calibrate.late(machine)
        case State.AIM | State.MENU | State.GALLERY | State.REVIEW | State.COOLING | State.SHUTDOWN:
            return replace(machine, deadline_ns=None), ()
        case _:
            assert_never(machine.state)


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a key in this state; for a stuck key's stand-in, ``key`` is the stuck one."""
    match machine.state:
        case State.SELF_TEST:
            return start.pressed(machine, key)
        case State.AIM:
            return _aim_key(machine, key)
        case State.MENU:
            return menu.pressed(machine, key)
        case State.GALLERY:
            return gallery.pressed(machine, key)
        case State.ARMED | State.CAPTURE:
            return scanning.abandon(machine, None) if key is Key.BACK else (machine, ())
        case State.CHECK | State.RECONSTRUCT:
            return scanning.stopped_adding(machine) if key is Key.BACK else (machine, ())
        case State.REVIEW:
            return scanning.review_key(machine, key)
        case State.CALIBRATE:
            return _calibrate_key(machine, key)
        case State.COOLING:
            return safety.cooling_key(machine, key)
        case State.SAFE:
            return safety.safe_key(machine, key)
        case State.BOOT | State.SAVING | State.SHUTDOWN:
            return machine, ()
        case _:
            assert_never(machine.state)


def labels(machine: Machine) -> dict[Key, Label]:
    """Return the label of each key in this state; a key without a label has no effect."""
    match machine.state:
        case State.AIM:
            failed = machine.notice is not None and machine.notice.kind is NoticeKind.FAILURE
            scan = Text.ANYWAY if machine.insists_until_ns is not None else Text.REPEAT if failed else Text.SCAN
            return {Key.SCAN: scan, Key.BACK: Text.HOLD_OFF, Key.UP: Text.MENU, Key.DOWN: Text.GALLERY}
        case State.SELF_TEST:
            waits = start.waits_for_ok(machine)
            return {Key.SCAN: Text.GO_ON, Key.BACK: Text.HOLD_OFF} if waits else {Key.BACK: Text.HOLD_OFF}
        case State.MENU:
            return _menu(machine)
        case State.GALLERY:
            moves = {Key.UP: Text.NEWER, Key.DOWN: Text.OLDER}
            return {Key.BACK: Text.BACK, **{key: word for key, word in moves.items() if gallery.may_move(machine, key)}}
        case State.ARMED | State.CAPTURE:
            return {Key.BACK: Text.STOP}
        case State.CHECK | State.RECONSTRUCT:
            # While a second exposure is added, only that one is given up.
            adding = machine.scan is not None and machine.scan.adding is not None
            return {Key.BACK: Text.STOP if adding else Text.HOLD_REDO}
        case State.REVIEW:
            keys: dict[Key, Label] = {Key.SCAN: Text.KEEP, Key.BACK: Text.HOLD_REDO, Key.UP: Text.TURN}
            exposure = _add(machine) or _expose(machine)
            return keys if exposure is None else {**keys, Key.DOWN: exposure}
        case State.CALIBRATE:
            return _calibrate(machine)
        case State.BOOT:
            return {Key.BACK: Text.HOLD_OFF}
        case State.COOLING:
            return {Key.BACK: Text.BACK}
        case State.SAFE:
            refused = machine.scan is not None and machine.scan.settled and not machine.scan.publishing
            return {Key.SCAN: Text.RETRY, Key.BACK: Text.HOLD_OFF} if refused else {Key.BACK: Text.HOLD_OFF}
        case State.SAVING | State.SHUTDOWN:
            return {}
        case _:
            assert_never(machine.state)


def _aim_key(machine: Machine, key: Key) -> Result:
    match key:
        case Key.SCAN:
            return scanning.request(machine)
        case Key.UP:
            return menu.open_menu(machine)
        case Key.DOWN:
            return gallery.open_gallery(machine)
        case Key.BACK:
            return machine, ()
        case _:
            assert_never(key)


def _calibrate_key(machine: Machine, key: Key) -> Result:
    position = machine.calibrating
    if key is not Key.SCAN or position is None or position.task is not None or not calibrate.records(machine):
        return calibrate.pressed(machine, key)
    return scanning.request(replace(machine, calibrating=replace(position, latest=None, failed=None)))


def _add(machine: Machine) -> Label | None:
    """Return the label for adding a second exposure to the reviewed scan; ``None``: there is no gain."""
    exposure = second_exposure(machine)
    return None if exposure is None else (Text.HOLD_ADD, exposure.label)


def _expose(machine: Machine) -> Label | None:
    """Return the label for the proposed exposure; it names the gain if only that differs."""
    exposure = other_exposure(machine)
    if exposure is None:
        return None
    if exposure.time_us == machine.exposure.time_us:
        return (Text.GAIN, f"{exposure.gain_db:g} dB")
    return (Text.EXPOSE, exposure.label)


def _menu(machine: Machine) -> dict[Key, Label]:
    changing = machine.menu is not None and machine.menu.draft is not None
    labels_by_key: dict[Key, Label] = {
        key: word for key, word in ((Key.UP, Text.ARROW_UP), (Key.DOWN, Text.ARROW_DOWN)) if menu.may_move(machine, key)
    }
    labels_by_key[Key.BACK] = Text.CANCEL if changing else Text.BACK
    if menu.may_choose(machine):
        labels_by_key[Key.SCAN] = Text.OK if changing else menu.verb(machine)
    return labels_by_key


def _calibrate(machine: Machine) -> dict[Key, Label]:
    """Return the labels of a calibration step; UP and DOWN have the name of the step they lead to."""
    labels_by_key: dict[Key, Label] = {Key.BACK: Text.BACK}
    position = machine.calibrating
    if position is None or position.task is not None:
        return labels_by_key
    for key in (Key.UP, Key.DOWN):
        step = calibrate.neighbour(machine, key)
        if step is not None:
            labels_by_key[key] = STEP_NAMES[step]
    if calibrate.may_begin_session(machine):
        # RESULT is the last step: DOWN has no step to lead to, so its label is free for holding it.
        labels_by_key[Key.DOWN] = Text.HOLD_NEW
    if calibrate.records(machine):
        labels_by_key[Key.SCAN] = Text.REDO if machine.session.done(position.step) else Text.SCAN
    decision = calibrate.decision(machine)
    if decision is not None:
        labels_by_key[Key.SCAN] = _DECISIONS[decision]
    return labels_by_key
