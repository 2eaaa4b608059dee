"""Owns the labels beside the four keys: what a press would do now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import assert_never

from appliance.machine import acknowledge, asking, calibrate, gallery, menu, start
from appliance.machine import effects as do
from appliance.machine.permissions import other_exposure, second_exposure
from appliance.machine.states import Answer, Machine, NoticeKind, State
from drivers.api import Key

SEEN = "SEEN"
"""Beside BACK while it acknowledges what is shown in full."""


def labels(machine: Machine) -> Mapping[Key, str]:
    """Label per physical key; a key without one does nothing now. A stuck key's label moves to its stand-in."""
    meant = _meant(machine)
    if acknowledge.pending(machine) is not None:
        meant[Key.BACK] = SEEN
    for broken, stand_in in ((Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)):
        if broken in machine.stuck:
            label = meant.pop(broken, None)
            meant.pop(stand_in, None)
            if label is not None:
                meant[stand_in] = label
    return meant


def _meant(machine: Machine) -> dict[Key, str]:
    if machine.off_question is not None:
        return _question(machine)
    match machine.state:
        case State.AIM:
            failed = machine.notice is not None and machine.notice.kind is NoticeKind.FAILURE
            scan = "ANYWAY" if machine.insists_until_ns is not None else "REPEAT" if failed else "SCAN"
            return {Key.SCAN: scan, Key.BACK: "HOLD: OFF", Key.UP: "MENU", Key.DOWN: "GALLERY"}
        case State.SELF_TEST:
            waits = start.waits_for_ok(machine)
            return {Key.SCAN: "GO ON", Key.BACK: "HOLD: OFF"} if waits else {Key.BACK: "HOLD: OFF"}
        case State.MENU:
            return _menu(machine)
        case State.GALLERY:
            moves = {Key.UP: "NEWER", Key.DOWN: "OLDER"}
            return {Key.BACK: "BACK", **{key: word for key, word in moves.items() if gallery.may_move(machine, key)}}
        case State.ARMED | State.CAPTURE:
            return {Key.BACK: "STOP"}
        case State.CHECK | State.RECONSTRUCT:
            # Of a second exposure only that one is given up.
            adding = machine.scan is not None and machine.scan.adding is not None
            return {Key.BACK: "STOP" if adding else "HOLD: REDO"}
        case State.REVIEW:
            return {
                Key.SCAN: "KEEP",
                Key.BACK: "HOLD: REDO",
                Key.UP: "TURN",
                Key.DOWN: _add(machine) or _expose(machine) or "TURN",
            }
        case State.CALIBRATE:
            return _calibrate(machine)
        case State.BOOT:
            return {Key.BACK: "HOLD: OFF"}
        case State.COOLING:
            return {Key.BACK: "BACK"}
        case State.SAFE:
            refused = machine.scan is not None and machine.scan.settled and not machine.scan.publishing
            return {Key.SCAN: "RETRY", Key.BACK: "HOLD: OFF"} if refused else {Key.BACK: "HOLD: OFF"}
        case State.SAVING | State.SHUTDOWN:
            return {}
        case _:
            assert_never(machine.state)


def _question(machine: Machine) -> dict[Key, str]:
    meant = {Key.SCAN: "OK", Key.BACK: "BACK"}
    for key in (Key.UP, Key.DOWN):
        other = asking.other_answer(machine, key)
        if other is not None:
            meant[key] = "▲" if other is Answer.STAY_ON else "▼"
    return meant


def _add(machine: Machine) -> str | None:
    """A second exposure of the scene that is being reviewed."""
    wanted = second_exposure(machine)
    return None if wanted is None else f"ADD {wanted.label}"


def _expose(machine: Machine) -> str | None:
    """Gain is only proposed where the exposure stays as long as it can be."""
    wanted = other_exposure(machine)
    if wanted is None:
        return None
    if wanted.time_us == machine.exposure.time_us:
        return f"GAIN {wanted.gain_db:g} dB"
    return f"EXPOSE {wanted.label}"


def _menu(machine: Machine) -> dict[Key, str]:
    changing = machine.menu is not None and machine.menu.draft is not None
    meant = {key: word for key, word in ((Key.UP, "▲"), (Key.DOWN, "▼")) if menu.may_move(machine, key)}
    meant[Key.BACK] = "CANCEL" if changing else "BACK"
    if menu.may_choose(machine):
        meant[Key.SCAN] = "OK" if changing else menu.verb(machine)
    return meant


def _calibrate(machine: Machine) -> dict[Key, str]:
    """UP and DOWN are labelled with the step they lead to."""
    meant = {Key.BACK: "BACK"}
    at = machine.calibrating
    if at is None or at.task is not None:
        return meant
    for key in (Key.UP, Key.DOWN):
        step = calibrate.neighbour(machine, key)
        if step is not None:
            meant[key] = step.value
    if calibrate.may_begin_session(machine):
        meant[Key.DOWN] = "HOLD: NEW"
    if calibrate.records(machine):
        meant[Key.SCAN] = "REDO" if machine.session.done(at.step) else "SCAN"
    match calibrate.decision(machine):
        case do.SolveCalibration():
            meant[Key.SCAN] = "SOLVE"
        case do.UseSolved():
            meant[Key.SCAN] = "KEEP"
        case do.RestoreCalibration():
            meant[Key.SCAN] = "RESTORE"
        case None:
            pass
    return meant
