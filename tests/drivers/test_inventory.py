"""What is on the buses is listed whatever the rig file wants, and a bus that cannot be asked says so."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import usb.core

from drivers.api import DeviceGone
from drivers.inventory import MOST, OnTheBuses, on_the_buses
from tests.drivers.clock import SteppedClock


class NoBus:
    """A USB backend that has nothing on it, or fails."""

    def __init__(self, error: Exception | None = None) -> None:
        self._error = error

    def enumerate_devices(self) -> list[object]:
        if self._error is not None:
            raise self._error
        return []


def listed(
    monkeypatch: pytest.MonkeyPatch, *, hid: Any, usb_backend: Any, ports: list[Any], open_card: Any
) -> OnTheBuses:
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    wires = SimpleNamespace(usb_backend=usb_backend, hidraw=hid, clock=SteppedClock(), open_card=open_card)
    wires.cards = lambda: ("/dev/dri/card0", "/dev/dri/card1")
    return on_the_buses(wires, "usb3vision", ["/dev/dri/card0", "/dev/dri/card0"])


def gone(path: str) -> object:
    raise DeviceGone(path, "does not exist", "Check")


def test_a_bus_that_cannot_be_asked_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> list[Any]:
        raise OSError("no permission")

    found = listed(
        monkeypatch,
        hid=SimpleNamespace(enumerate=refuse),
        usb_backend=NoBus(usb.core.USBError("busy")),
        ports=[],
        open_card=gone,
    )
    assert found.cameras == ("cameras of kind usb3vision could not be asked: [Errno None] busy",)
    assert found.ports == ()
    assert found.hid == ("HID devices could not be asked: no permission",)
    first, second = found.connectors
    assert first.startswith("/dev/dri/card0 could not be opened:"), "one card is asked once"
    assert second.startswith("/dev/dri/card1 could not be opened:"), "a card that no rig file names is asked as well"


def test_what_has_no_usb_identity_is_no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [
        SimpleNamespace(device="/dev/ttyS0", vid=None, pid=None, product=None, serial_number=None),
        SimpleNamespace(device="/dev/ttyACM1", vid=0x1209, pid=0x4B42, product="Board", serial_number="B7"),
        SimpleNamespace(device="/dev/ttyACM0", vid=0x2341, pid=1, product=None, serial_number=None),
    ]
    many = [
        {"vendor_id": 1, "product_id": k, "product_string": "x", "path": b"/dev/hidraw%d" % k} for k in range(MOST + 5)
    ]
    found = listed(
        monkeypatch, hid=SimpleNamespace(enumerate=lambda *_: many), usb_backend=NoBus(), ports=ports, open_card=gone
    )
    assert found.ports == ("/dev/ttyACM0 (2341:0001 without a name)", "/dev/ttyACM1 (1209:4b42 Board, serial B7)")
    assert len(found.hid) == MOST + 1
    assert found.hid[0] == "0001:0000 x (/dev/hidraw0)"
    assert found.hid[-1] == f"and more than {MOST}"
    assert found.cameras == ()
