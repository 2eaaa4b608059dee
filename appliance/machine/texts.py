"""Owns the labels beside the four keys: what a press would do now."""

from __future__ import annotations

from collections.abc import Mapping
from typing import assert_never

from appliance.machine.states import Machine, NoticeKind, State
from drivers.api import Key


def labels(machine: Machine) -> Mapping[Key, str]:
    """Label per physical key; a key without one does nothing now. A stuck key's label moves to its stand-in."""
    meant = _meant(machine)
    for broken, stand_in in ((Key.SCAN, Key.UP), (Key.BACK, Key.DOWN)):
        if broken in machine.stuck:
            label = meant.pop(broken, None)
            meant.pop(stand_in, None)
            if label is not None:
                meant[stand_in] = label
    return meant


def _meant(machine: Machine) -> dict[Key, str]:
    match machine.state:
        case State.AIM:
            failed = machine.notice is not None and machine.notice.kind is NoticeKind.FAILURE
            return {Key.SCAN: "REPEAT" if failed else "SCAN", Key.BACK: "HOLD: OFF"}
        case State.CAPTURE:
            return {Key.BACK: "STOP"}
        case State.RECONSTRUCT:
            return {Key.BACK: "REPEAT"}
        case State.REVIEW:
            return {Key.SCAN: "KEEP", Key.BACK: "REPEAT", Key.UP: "TURN", Key.DOWN: "TURN"}
        case State.BOOT:
            return {Key.BACK: "HOLD: OFF"}
        case State.SAVING | State.SHUTDOWN:
            return {}
        case _:
            assert_never(machine.state)
