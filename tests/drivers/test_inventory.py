"""What is on the buses is listed whatever the rig file wants, and a bus that cannot be asked says so."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import usb.core

from drivers.api import DeviceGone
from drivers.inventory import MOST, BusInventory, list_buses
from tests.drivers.clock import SteppedClock


def listed(monkeypatch: pytest.MonkeyPatch, ports: list[Any], hid: Any, devices: Any) -> BusInventory:
    def gone(path: str) -> object:
        raise DeviceGone(path, "does not exist", "Check")

    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    wires: Any = SimpleNamespace(
        usb_backend=SimpleNamespace(enumerate_devices=devices),
        hidraw=SimpleNamespace(enumerate=hid),
        clock=SteppedClock(),
        open_card=gone,
        cards=lambda: ("/dev/dri/card0", "/dev/dri/card1"),
    )
    return list_buses(wires, "usb3vision", ["/dev/dri/card0", "/dev/dri/card0"])


def test_a_bus_that_cannot_be_asked_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: int) -> list[Any]:
        raise OSError("no permission")

    def busy() -> list[Any]:
        raise usb.core.USBError("busy")

    found = listed(monkeypatch, [], refuse, busy)
    assert found.cameras == ("cameras of kind usb3vision cannot be listed: [Errno None] busy",)
    assert found.ports == ()
    assert found.hid == ("HID devices cannot be listed: no permission",)
    first, second = found.connectors
    assert first.startswith("/dev/dri/card0 could not be opened:"), "one card is asked once"
    assert second.startswith("/dev/dri/card1 could not be opened:"), "a card that no rig file names is asked as well"


def test_what_has_no_usb_identity_is_no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    words = ("device", "vid", "pid", "product", "serial_number")
    ports = [
        SimpleNamespace(**dict(zip(words, values, strict=True)))
        for values in (
            ("/dev/ttyS0", None, None, None, None),
            ("/dev/ttyACM1", 0x1209, 0x4B42, "Board", "B7"),
            ("/dev/ttyACM0", 0x2341, 1, None, None),
        )
    ]
    hid = {"vendor_id": 1, "product_id": 0, "product_string": "x", "path": b"/dev/hidraw0"}
    found = listed(monkeypatch, ports, lambda *_: [hid] * (MOST + 5), list)
    assert found.ports == ("/dev/ttyACM0 (2341:0001 without a name)", "/dev/ttyACM1 (1209:4b42 Board, serial B7)")
    assert found.hid == (*["0001:0000 x (/dev/hidraw0)"] * MOST, f"and more than {MOST}")
    assert found.cameras == ()
