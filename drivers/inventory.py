"""The list of devices on the buses: cameras, serial ports, HID devices, connectors.

They need not be in the rig file. No device is opened for use or changed; a camera is asked for its serial number, a
card for its connectors.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import serial.tools.list_ports
import usb.core

from drivers.api import DeviceError, Wires
from drivers.camera_families import USUAL, lister
from drivers.output.card import Card

MOST = 32
"""Largest number of listed devices of one kind: a broken hub may enumerate without end."""


@dataclass(frozen=True, slots=True)
class BusInventory:
    """The devices on the buses, each in one line of words.

    A bus that could not be read has a line with the reason.
    """

    cameras: tuple[str, ...] = ()
    ports: tuple[str, ...] = ()
    hid: tuple[str, ...] = ()
    connectors: tuple[str, ...] = ()


def list_buses(wires: Wires, kind: str = USUAL, named: Sequence[str] = ()) -> BusInventory:
    """List the cameras of family ``kind``, ports, HID devices, and the connectors of all cards.

    The cards are those of ``wires`` and those that the rig file has ``named`` (``/dev/dri/card0``). Never raises for a
    device.
    """
    cards = (*named, *wires.cards())
    return BusInventory(
        tuple(_limited(_cameras(wires, kind))),
        tuple(_limited(_ports())),
        tuple(_limited(_hid(wires.hidraw))),
        tuple(line for card in dict.fromkeys(cards) for line in _limited(_connectors(wires, card))),
    )


def _limited(lines: Iterator[str]) -> Iterator[str]:
    for number, line in enumerate(lines):
        if number == MOST:
            yield f"and more than {MOST}"
            return
        yield line


def _cameras(wires: Wires, kind: str) -> Iterator[str]:
    # A family without a list of its own is most likely on USB.
    list_cameras = lister(kind) or lister(USUAL)
    assert list_cameras is not None
    try:
        yield from list_cameras(wires)
    except (DeviceError, usb.core.USBError) as error:
        yield f"cameras of kind {kind} cannot be listed: {error}"


def _ports() -> Iterator[str]:
    for port in sorted(serial.tools.list_ports.comports(), key=lambda listed_port: str(listed_port.device)):
        # Ports of the mainboard have no USB identity, and exist with or without a device.
        if port.vid is None:
            continue
        number = f", serial {port.serial_number}" if port.serial_number else ""
        yield f"{port.device} ({port.vid:04x}:{port.pid:04x} {port.product or 'without a name'}{number})"


def _hid(hidraw: Any) -> Iterator[str]:
    try:
        for entry in hidraw.enumerate(0, 0):
            name = entry.get("product_string") or "without a name"
            path = entry.get("path", b"")
            yield f"{entry['vendor_id']:04x}:{entry['product_id']:04x} {name} ({path.decode(errors='replace')})"
    except OSError as error:
        yield f"HID devices cannot be listed: {error}"


def _connectors(wires: Wires, path: str) -> Iterator[str]:
    try:
        card = Card(wires.open_card(path), wires.clock)
    except (DeviceError, OSError) as error:
        yield f"{path} could not be opened: {error}"
        return
    try:
        # Lists of the kernel, no probing: that would need mastery of the card, which a running program has.
        card.scan()
        for connector in card.connectors():
            if not connector.connected:
                yield f"{connector.name} on {path} (nothing plugged in)"
                continue
            modes = ", ".join(dict.fromkeys(str(mode) for mode in connector.modes))
            yield f"{connector.name} on {path} ({modes or 'offers no mode'})"
    except OSError as error:
        yield f"{path} cannot be read: {error}"
    finally:
        with contextlib.suppress(OSError):
            card.close()
