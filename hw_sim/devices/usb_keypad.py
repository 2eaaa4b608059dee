"""The keypad on the bus: a full-speed HID device with one interrupt pipe.

All calls with the world's lock held.
"""

from __future__ import annotations

import struct

from hw_sim.devices import keypad as pad
from hw_sim.devices import usb_standard as usb
from hw_sim.devices.keypad import Keypad
from hw_sim.devices.usb_standard import StandardRequests

REPORT_IN = 0x81
PACKET, POLLED_EVERY_MS = 8, 4
_HID, _REPORT = 0x21, 0x22
_HID_CLASS = (3, 0, 0)


class UsbKeypad:
    """The keypad behind its endpoints. An unread report is overwritten by the next one."""

    speed = 2
    """Full speed, 12 Mbit/s, as USB/IP and Linux number it."""

    def __init__(self, keypad: Keypad) -> None:
        self._keypad = keypad
        self._report: bytes | None = None
        # HID 1.11: the HID descriptor stands between interface and endpoint, and announces the report descriptor.
        hid = struct.pack("<BBHBBBH", 9, _HID, 0x0111, 0, 1, _REPORT, len(pad.REPORT_DESCRIPTOR))
        body = usb.interface(0, 1, _HID_CLASS) + hid + usb.endpoint(REPORT_IN, usb.INTERRUPT, PACKET, POLLED_EVERY_MS)
        self._standard = StandardRequests(
            usb.device(0x0200, (0, 0, 0), 8, pad.VENDOR, pad.PRODUCT, pad.RELEASE),
            usb.configuration(1, 100, body),
            (pad.MANUFACTURER, pad.NAME, pad.SERIAL),
            {(_HID, 0): hid, (_REPORT, 0): pad.REPORT_DESCRIPTOR},
        )

    @property
    def plugged(self) -> bool:
        """True if it is on the bus."""
        return self._keypad.plugged

    @property
    def enumeration(self) -> int:
        """Number of times that it appeared on the bus."""
        return self._keypad.enumeration

    def attach(self) -> None:
        """Connect the keypad to a host: it starts as after plugging in."""
        self._standard.restart()
        self._report = None
        self._keypad.listen(self._receive)

    def detach(self) -> None:
        """Disconnect the keypad from its host."""
        self._keypad.forget(self._receive)

    def device_descriptor(self) -> bytes:
        """Return the device descriptor: 18 bytes."""
        return self._standard.device

    def configuration_descriptor(self) -> bytes:
        """Return the complete configuration descriptor."""
        return self._standard.configuration

    def control(self, kind: int, request: int, value: int, index: int, length: int, data: bytes) -> bytes:
        """Do a control transfer; return the data of an IN request. Raises Stall."""
        match kind, request:
            case 0xA1, 0x02:  # GET_IDLE: as often as it likes
                return b"\0"
            case 0x21, (0x0A | 0x0B):  # SET_IDLE, SET_PROTOCOL
                return b""
            case _:
                return self._standard.answer(kind, request, value, index)[:length]

    def write(self, endpoint: int, data: bytes) -> int:
        """Refuse a transfer towards the pad, which has no such pipe. Raises Stall."""
        raise usb.Stall

    def read(self, endpoint: int, buffer: memoryview) -> tuple[int, bool]:
        """Read one report, if there is one; return the bytes, and whether the transfer ends. Raises Stall."""
        if endpoint != REPORT_IN or endpoint in self._standard.halted:
            raise usb.Stall
        if self._report is None:
            return 0, False
        report, self._report = self._report[: len(buffer)], None
        buffer[: len(report)] = report
        return len(report), True

    def _receive(self, report: bytes) -> None:
        self._report = report
