"""The bytes of USB/IP 1.1.1, as in the kernel's ``Documentation/usb/usbip_protocol.rst``.

All numbers are big endian; the eight bytes of a set-up packet are as on the bus.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

VERSION = 0x0111
REQUEST_LIST, REPLY_LIST, REQUEST_IMPORT, REPLY_IMPORT = 0x8005, 0x0005, 0x8003, 0x0003
OK, REFUSED = 0, 1
CMD_SUBMIT, CMD_UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
OPERATION_BYTES, BUS_ID_BYTES, PATH_BYTES, HEADER_BYTES = 8, 32, 256, 48
SHORT_NOT_OK = 0x0001
"""A transfer that ends early is an error for the host."""
LONGEST_TRANSFER = 16 << 20
MOST_PACKETS = 0xFFFFFFFF
"""Means none in transfers that are not isochronous; so does 0."""

_OPERATION = struct.Struct(">HHI")
_BASIC = struct.Struct(">IIIII")
_SUBMIT = struct.Struct(">IiiIi8s")
_RETURN = struct.Struct(">iiiii8x")


class ProtocolError(Exception):
    """The host does not speak USB/IP 1.1.1, or requests a feature that these devices do not have."""


@dataclass(frozen=True, slots=True)
class Submit:
    """A transfer requested by the host's kernel; ``endpoint`` with the direction bit, 0 is the control pipe."""

    number: int
    endpoint: int
    device_to_host: bool
    flags: int
    length: int
    setup: bytes


@dataclass(frozen=True, slots=True)
class Unlink:
    """The host withdraws the transfer ``victim``."""

    number: int
    victim: int


def operation(code: int, status: int = OK) -> bytes:
    """Return the head of a reply before the import."""
    return _OPERATION.pack(VERSION, code, status)


def parse_operation(data: bytes) -> int:
    """Return the code of a request. Raises ProtocolError."""
    version, code, _ = _OPERATION.unpack(data)
    if version != VERSION:
        raise ProtocolError(f"USB/IP version {version:#06x}; spoken is {VERSION:#06x}")
    return int(code)


def parse_bus_id(data: bytes) -> str:
    """Return a bus id; one with other than ASCII characters never matches."""
    return data.split(b"\0", 1)[0].decode("ascii", errors="replace")


def record(
    bus_id: str, bus: int, number: int, speed: int, device: bytes, configuration: bytes, with_interfaces: bool
) -> bytes:
    """Return the record of one device: 312 bytes and, in a list, four for each interface."""
    vendor, product, release = struct.unpack_from("<HHH", device, 8)
    path = f"/sys/devices/kingfisher/usb{bus}/{bus_id}"
    fields = (path.encode(), bus_id.encode(), bus, number, speed, vendor, product, release)
    head = struct.pack(f">{PATH_BYTES}s{BUS_ID_BYTES}sIIIHHH", *fields)
    head += bytes([*device[4:7], configuration[5], device[17], configuration[4]])
    return head + (_interfaces(configuration) if with_interfaces else b"")


def _interfaces(configuration: bytes) -> bytes:
    classes, offset = b"", 0
    while offset < len(configuration):
        # Class, subclass and protocol of each interface descriptor (type 4), and a byte of padding.
        if configuration[offset + 1] == 4:
            classes += configuration[offset + 5 : offset + 8] + b"\0"
        offset += configuration[offset]
    return classes


def parse_command(header: bytes) -> Submit | Unlink:
    """Return one of the two commands. Raises ProtocolError."""
    command, number, _, direction, endpoint = _BASIC.unpack_from(header)
    if command == CMD_UNLINK:
        return Unlink(number, int.from_bytes(header[20:24], "big"))
    if command != CMD_SUBMIT:
        raise ProtocolError(f"command {command:#x}; known are submit and unlink")
    flags, length, _, packets, _, setup = _SUBMIT.unpack_from(header, 20)
    if packets not in (0, MOST_PACKETS):
        raise ProtocolError(f"{packets} isochronous packets; no device here has such a pipe")
    if not 0 <= length <= LONGEST_TRANSFER:
        raise ProtocolError(f"a transfer of {length} bytes; the longest is {LONGEST_TRANSFER}")
    if endpoint > 15 or direction > 1:
        raise ProtocolError(f"endpoint {endpoint}, direction {direction}; there are 0..15 and 0, 1")
    address = endpoint | (0x80 if direction and endpoint else 0)
    return Submit(number, address, bool(direction), flags, length, setup)


def returned(submit: Submit, status: int, length: int, data: bytes | memoryview = b"") -> bytes:
    """Return the message that ends a transfer: status, number of bytes, and the data read."""
    head = _BASIC.pack(RET_SUBMIT, submit.number, 0, 0, 0) + _RETURN.pack(status, length, 0, 0, 0)
    return head + bytes(data)


def unlinked(unlink: Unlink, status: int) -> bytes:
    """Return the answer to an unlink."""
    return _BASIC.pack(RET_UNLINK, unlink.number, 0, 0, 0) + struct.pack(">i24x", status)
