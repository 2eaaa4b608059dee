"""Chapter 9 of the USB specification for the simple devices: descriptors and standard requests."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

LANGUAGE = 0x0409
DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT, ASSOCIATION = 1, 2, 3, 4, 5, 11
BULK, INTERRUPT = 2, 3
_ENDPOINT_HALT = 0


class Stall(Exception):
    """The endpoint is halted, or the device does not know the request."""


def device(
    usb: int, device_class: tuple[int, int, int], packet0: int, vendor: int, product: int, release: int
) -> bytes:
    """Return a device descriptor with one configuration; strings 1 to 3: manufacturer, product, serial number."""
    return struct.pack("<BBHBBBBHHHBBBB", 18, DEVICE, usb, *device_class, packet0, vendor, product, release, 1, 2, 3, 1)


def configuration(interfaces: int, power_ma: int, body: bytes) -> bytes:
    """Return the configuration followed by ``body`` (interfaces, endpoints, class descriptors).

    The device is bus-powered.
    """
    head = struct.pack("<BBHBBBBB", 9, CONFIGURATION, 9 + len(body), interfaces, 1, 0, 0x80, power_ma // 2)
    return head + body


def interface(number: int, endpoints: int, kind: tuple[int, int, int]) -> bytes:
    """Return an interface descriptor of class, subclass and protocol ``kind``."""
    return struct.pack("<BBBBBBBBB", 9, INTERFACE, number, 0, endpoints, *kind, 0)


def endpoint(address: int, transfer: int, packet: int, interval: int) -> bytes:
    """Return an endpoint descriptor; ``transfer`` is BULK or INTERRUPT."""
    return struct.pack("<BBBBHB", 7, ENDPOINT, address, transfer, packet, interval)


def string(text: str) -> bytes:
    """Return a string descriptor."""
    coded = text.encode("utf-16-le")
    return struct.pack("<BB", 2 + len(coded), STRING) + coded


@dataclass(slots=True)
class StandardRequests:
    """The answers of every device on endpoint 0.

    ``interface_descriptors``: by (kind, number). ``halt_cleared`` is called with an endpoint's address.
    """

    device: bytes
    configuration: bytes
    strings: tuple[str, ...]
    interface_descriptors: Mapping[tuple[int, int], bytes] = field(default_factory=dict)
    configured: int = 0
    halted: set[int] = field(default_factory=set)
    halt_cleared: Callable[[int], None] = lambda endpoint: None

    def restart(self) -> None:
        """Return to the state after plugging in."""
        self.configured = 0
        self.halted.clear()

    def answer(self, kind: int, request: int, value: int, index: int) -> bytes:
        """Return the data of an IN request, b"" for an OUT request. Raises Stall."""
        match kind, request:
            # USB 2.0, 9.4: GET_DESCRIPTOR, GET_CONFIGURATION, GET_INTERFACE, GET_STATUS;
            case ((0x80 | 0x81), 0x06):
                return self._descriptor(kind, value >> 8, value & 0xFF)
            case 0x80, 0x08:
                return bytes([self.configured])
            case 0x81, 0x0A if index < self.configuration[4]:
                return b"\0"
            case ((0x80 | 0x81), 0x00):
                return b"\0\0"
            case 0x82, 0x00:
                return struct.pack("<H", index in self.halted)
            # SET_CONFIGURATION, SET_INTERFACE, CLEAR_FEATURE and SET_FEATURE of ENDPOINT_HALT.
            case 0x00, 0x09 if value in (0, self.configuration[5]):
                self.configured = value
            case 0x01, 0x0B if value == 0 and index < self.configuration[4]:
                pass
            case 0x02, 0x01 if value == _ENDPOINT_HALT:
                self.halted.discard(index)
                self.halt_cleared(index)
            case 0x02, 0x03 if value == _ENDPOINT_HALT:
                self.halted.add(index)
            case _:
                raise Stall
        return b""

    def _descriptor(self, kind: int, descriptor: int, number: int) -> bytes:
        match descriptor:
            case 1 if kind == 0x80:
                return self.device
            case 2 if kind == 0x80 and number == 0:
                return self.configuration
            case 3 if kind == 0x80 and number == 0:
                return struct.pack("<BBH", 4, STRING, LANGUAGE)
            case 3 if kind == 0x80 and number <= len(self.strings):
                return string(self.strings[number - 1])
            case _ if (descriptor, number) in self.interface_descriptors:
                return self.interface_descriptors[descriptor, number]
            case _:
                raise Stall
