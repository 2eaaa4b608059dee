"""What the log says is written for people: no line shows how Python prints an object."""

from __future__ import annotations

import logging
import re
import typing
from collections.abc import Mapping
from dataclasses import fields
from enum import Enum
from types import UnionType
from typing import Any

import pytest

from appliance.machine import events as on
from appliance.machine.ashore import ASHORE
from appliance.machine.states import Device
from appliance.scan.fault import Fault, FaultCode
from appliance.service.loop import fault_text, spoken
from hw_sim.people import status_file

REPR = re.compile(r"<\w+[.:]|\w\(\w+=|\{'|\['|\(\)|\('|\bNone\b|Device\.|FaultCode\.")
"""``<Device.DISPLAY: 'display'>``, ``Fault(code=…)``, a dict, a list, a tuple."""
SAID = ("DeviceUp", "DeviceDown", "CaptureFailed", "SaveFailed", "ReconstructionFailed")
SOME: Mapping[Any, Any] = {
    int: 3, str: "the cable is out", float: 0.25, bool: True, Device: Device.CAMERA_LEFT, FaultCode: FaultCode.CAMERA_SLOW_LINK,
    Fault: Fault(FaultCode.FRAME_MISSING, "of pulse 7 nothing came", {"received": 23.0, "expected": 24.0}, "camera.left"),
}  # fmt: skip


def some(kind: Any) -> Any:
    """Any value of a type."""
    if isinstance(kind, UnionType) or typing.get_origin(kind) is typing.Union:
        kind = typing.get_args(kind)[0]
    if kind in SOME:
        return SOME[kind]
    if isinstance(kind, type) and issubclass(kind, Enum):
        return next(iter(kind))
    return None


def events() -> list[on.Event]:
    made = []
    for kind in typing.get_args(on.Event):
        hints = typing.get_type_hints(kind, {**vars(on), "CloudSummary": object})
        made.append(kind(**{one.name: some(hints[one.name]) for one in fields(kind)}))
    return made


@pytest.mark.parametrize("event", events(), ids=lambda event: type(event).__name__)
def test_no_event_is_logged_as_python_prints_it(event: on.Event) -> None:
    line = spoken(event)
    assert (line is not None) == (type(event).__name__ in SAID)
    if line is not None:
        level, text = line
        assert level in (logging.INFO, logging.WARNING)
        assert not REPR.search(text), text


def test_a_display_that_cannot_be_opened_is_told_in_words() -> None:
    down = on.DeviceDown(Device.DISPLAY, "/dev/dri/card0 cannot be opened (No such file or directory)")
    assert spoken(down) == (
        logging.WARNING,
        f"display lost: /dev/dri/card0 cannot be opened (No such file or directory); ashore: {ASHORE[FaultCode.DISPLAY_LOST]}",
    )
    slow = on.DeviceDown(Device.CAMERA_LEFT, "480 Mbit/s", FaultCode.CAMERA_SLOW_LINK)
    assert spoken(slow) == (
        logging.WARNING,
        f"camera.left lost (CAMERA_SLOW_LINK): 480 Mbit/s; ashore: {ASHORE[FaultCode.CAMERA_SLOW_LINK]}",
    )


def test_a_failed_scan_is_told_with_its_fault_and_its_numbers() -> None:
    fault = Fault(FaultCode.MOVED, "the hands shook", {"shift_px": 3.14159})
    assert spoken(on.CaptureFailed(3, fault)) == (
        logging.WARNING,
        "scan 3 of this start failed: MOVED: the hands shook; shift_px 3.142",
    )
    assert fault_text(Fault(FaultCode.INTERNAL)) == "INTERNAL"


def test_what_is_held_against_a_scan_is_told_with_its_remedy() -> None:
    bent = Fault(FaultCode.GREY_BENT, "set Gamma = 1.0", device="camera.left")
    ashore = f"; ashore: {ASHORE[FaultCode.GREY_BENT]}"
    line = (logging.INFO, f"scan 3 of this start: GREY_BENT of camera.left: set Gamma = 1.0{ashore}")
    assert spoken(on.Judged(3, (bent,))) == line
    assert spoken(on.Judged(3)) is None


def test_what_the_console_sees_is_written_in_words() -> None:
    status = {
        "state": "REVIEW",
        "alerts": [{"code": "MOVED", "headline": "MOVED 3.1 px", "action": "REPEAT"}],
        "keys": {"scan": "SAVE", "back": None},
        "scans": 3,
        "range": {"distance_mm": 498.76543, "word": "OK"},
        "calibration": {"busy": False, "steps": ["M1", "M2"]},
    }
    said = status_file.summary(status)
    assert not REPR.search(said), said
    assert said == (
        "the state is REVIEW; alerts: MOVED (MOVED 3.1 px: REPEAT); keys: scan SAVE, back -; scans: 3; "
        "range: distance_mm 498.8, word OK; calibration: busy no, steps M1, M2"
    )
    assert "alerts: none" in status_file.summary({})
