"""A record of the traffic on the cameras' bus in the format of the kernel's usbmon: a pcap file.

Source: Linux ``Documentation/usb/usbmon.rst`` (binary format), pcap link type 220 (``USB_LINUX_MMAPPED``).
"""

from __future__ import annotations

import errno
import struct
import time
from pathlib import Path
from types import TracebackType
from typing import Self

from hw_sim.wires.umockdev.usbfs import SETUP, URB_CONTROL, Urb, UsbDevice

_FILE = struct.Struct("<IHHiIII")
_RECORD = struct.Struct("<IIII")
_PACKET = struct.Struct("<QBBBBHBBqiiII8siiII")
"""Id, event, transfer type, endpoint, device, bus, no setup, no data, s, µs, status, length, captured, setup, …"""
LINK_TYPE = 220
LARGEST = 262_144
"""Largest packet that Wireshark reads, bytes."""
_CONTROL, _BULK = 2, 3
_IN = 0x80
_GET_DESCRIPTOR = 0x06


class Usbmon:
    """A context manager; its ``record`` is a test bed's tap. Called with the world's lock held."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._met: set[tuple[int, int]] = set()

    def __enter__(self) -> Self:
        self._file = self._path.open("wb")
        self._file.write(_FILE.pack(0xA1B2C3D4, 2, 4, 0, 0, LARGEST, LINK_TYPE))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def record(self, event: str, device: UsbDevice, urb: Urb) -> None:
        """Write one event: ``S``, the host submitted ``urb``, or ``C``, it is complete."""
        where = device.bus, device.address
        if where not in self._met:
            # A listener that starts after the kernel's enumeration would not know the endpoints.
            self._met.add(where)
            self._enumerated(where, 1, device.camera.device_descriptor())
            self._enumerated(where, 2, device.camera.configuration_descriptor())
        # usbmon: data go with the submission of OUT transfers and with the completion of IN transfers.
        control, is_in = urb.kind == URB_CONTROL, urb.is_in
        carries = (event == "C") == is_in
        data = memoryview(urb.data)[: urb.done if is_in else None] if carries else memoryview(b"")
        setup = urb.setup if control and event == "S" else b""
        requested = urb.length - (SETUP.size if control else 0)
        length = requested if event == "S" else urb.done
        status = -errno.EINPROGRESS if event == "S" else urb.status
        endpoint = (urb.setup[0] & _IN) if control else urb.endpoint
        self._packet(urb.address, event, where, _CONTROL if control else _BULK, endpoint, status, length, setup, data)

    def _enumerated(self, where: tuple[int, int], kind: int, descriptor: bytes) -> None:
        setup = SETUP.pack(_IN, _GET_DESCRIPTOR, kind << 8, 0, len(descriptor))
        status, nothing = -errno.EINPROGRESS, memoryview(b"")
        self._packet(kind, "S", where, _CONTROL, _IN, status, len(descriptor), setup, nothing)
        self._packet(kind, "C", where, _CONTROL, _IN, 0, len(descriptor), b"", memoryview(descriptor))

    def _packet(
        self,
        number: int,
        event: str,
        where: tuple[int, int],
        transfer: int,
        endpoint: int,
        status: int,
        length: int,
        setup: bytes,
        data: memoryview,
    ) -> None:
        seconds, rest_ns = divmod(time.monotonic_ns(), 1_000_000_000)
        bus, address = where
        part = data[: LARGEST - _PACKET.size]
        without_data = 0 if part else ord("<" if endpoint & _IN else ">")
        head = (number, ord(event), transfer, endpoint, address, bus, 0 if setup else ord("-"), without_data)
        tail = (seconds, rest_ns // 1000, status, length, len(part), setup, 0, 0, 0, 0)
        size = _PACKET.size + len(part)
        self._file.write(_RECORD.pack(seconds, rest_ns // 1000, size, _PACKET.size + len(data)))
        self._file.write(_PACKET.pack(*head, *tail))
        self._file.write(part)
        self._file.flush()  # a reader finds complete packets at any time
