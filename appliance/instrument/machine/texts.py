"""Owns the labels beside the four keys: what a press would do now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import assert_never

from appliance.instrument.machine import asking, calibrate, gallery, menu, start
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.permissions import other_exposure, second_exposure
from appliance.instrument.machine.states import Answer, Machine, NoticeKind, State
from appliance.instrument.machine.words import STEP_NAMES, Label, Text
from drivers.api import Key


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
            # Of a second exposure only that one is given up.
            adding = machine.scan is not None and machine.scan.adding is not None
            return {Key.BACK: Text.STOP if adding else Text.HOLD_REDO}
        case State.REVIEW:
            kept: dict[Key, Label] = {Key.SCAN: Text.KEEP, Key.BACK: Text.HOLD_REDO, Key.UP: Text.TURN}
            exposure = _add(machine) or _expose(machine)
            return kept if exposure is None else {**kept, Key.DOWN: exposure}
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


def _question(machine: Machine) -> dict[Key, Label]:
    meant: dict[Key, Label] = {Key.SCAN: Text.OK, Key.BACK: Text.BACK}
    for key in (Key.UP, Key.DOWN):
        other = asking.other_answer(machine, key)
        if other is not None:
            meant[key] = Text.ARROW_UP if other is Answer.STAY_ON else Text.ARROW_DOWN
    return meant


def _add(machine: Machine) -> Label | None:
    """Return the label for a second exposure of the scene that is being reviewed; ``None``: there is nothing to be
    gained."""
    wanted = second_exposure(machine)
    return None if wanted is None else (Text.HOLD_ADD, wanted.label)


def _expose(machine: Machine) -> Label | None:
    """Gain is only proposed where the exposure stays as long as it can be."""
    wanted = other_exposure(machine)
    if wanted is None:
        return None
    if wanted.time_us == machine.exposure.time_us:
        return (Text.GAIN, f"{wanted.gain_db:g} dB")
    return (Text.EXPOSE, wanted.label)


def _menu(machine: Machine) -> dict[Key, Label]:
    changing = machine.menu is not None and machine.menu.draft is not None
    meant: dict[Key, Label] = {
        key: word for key, word in ((Key.UP, Text.ARROW_UP), (Key.DOWN, Text.ARROW_DOWN)) if menu.may_move(machine, key)
    }
    meant[Key.BACK] = Text.CANCEL if changing else Text.BACK
    if menu.may_choose(machine):
        meant[Key.SCAN] = Text.OK if changing else menu.verb(machine)
    return meant


def _calibrate(machine: Machine) -> dict[Key, Label]:
    """UP and DOWN are labelled with the step they lead to."""
    meant: dict[Key, Label] = {Key.BACK: Text.BACK}
    at = machine.calibrating
    if at is None or at.task is not None:
        return meant
    for key in (Key.UP, Key.DOWN):
        step = calibrate.neighbour(machine, key)
        if step is not None:
            meant[key] = STEP_NAMES[step]
    if calibrate.may_begin_session(machine):
        # RESULT is the last step: DOWN leads nowhere from it, so that its label is free for what holding it does.
        meant[Key.DOWN] = Text.HOLD_NEW
    if calibrate.records(machine):
        meant[Key.SCAN] = Text.REDO if machine.session.done(at.step) else Text.SCAN
    match calibrate.decision(machine):
        case do.SolveCalibration():
            meant[Key.SCAN] = Text.SOLVE
        case do.UseSolved():
            meant[Key.SCAN] = Text.KEEP
        case do.RestoreKeptCalibration():
            meant[Key.SCAN] = Text.RESTORE
        case None:
            pass
        case unknown:
            assert_never(unknown)
    return meant
