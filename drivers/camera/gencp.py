"""The layout of GenCP control packets: bytes in, values out, no I/O.

Source: GenICam GenCP 1.1, section 3; USB3 Vision 1.0, section 4 (prefix).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.camera import u3v

_HEADER = struct.Struct("<IHHHH")
_READ = struct.Struct("<QHH")
_ADDRESS = struct.Struct("<Q")
_TWO_WORDS = struct.Struct("<HH")


class MalformedPacket(ValueError):
    """The bytes are no control answer: wrong magic, or lengths that contradict each other."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One acknowledge packet.

    ``status`` is the raw code; ``payload`` is exactly as long as the header says.
    """

    status: int
    command: int
    request_id: int
    payload: bytes


def next_request_id(request_id: int) -> int:
    """Return the id after ``request_id``: counts up, wraps 0xFFFF → 1 (0 is never used)."""
    return u3v.REQUEST_ID_FIRST if request_id >= u3v.REQUEST_ID_LAST else request_id + 1


def pack_read(request_id: int, address: int, count: int) -> bytes:
    """Return READMEM of ``count`` (1..65535) bytes at ``address``, acknowledge requested."""
    header = _HEADER.pack(u3v.CONTROL_MAGIC, u3v.FLAG_ACKNOWLEDGE, u3v.COMMAND_READ, u3v.READ_COMMAND_SIZE, request_id)
    return header + _READ.pack(address, 0, count)


def pack_write(request_id: int, address: int, data: bytes) -> bytes:
    """Return WRITEMEM of ``data`` at ``address``, acknowledge requested."""
    size = u3v.WRITE_ADDRESS_SIZE + len(data)
    header = _HEADER.pack(u3v.CONTROL_MAGIC, u3v.FLAG_ACKNOWLEDGE, u3v.COMMAND_WRITE, size, request_id)
    return header + _ADDRESS.pack(address) + data


def parse_answer(data: bytes) -> Answer:
    """Parse one acknowledge. Bytes beyond the stated size are ignored. Raises MalformedPacket."""
    if len(data) < u3v.CONTROL_HEADER_SIZE:
        raise MalformedPacket(f"{len(data)} bytes; a header has {u3v.CONTROL_HEADER_SIZE}")
    magic, status, command, size, request_id = _HEADER.unpack_from(data)
    if magic != u3v.CONTROL_MAGIC:
        raise MalformedPacket(f"magic {magic:#010x}, expected {u3v.CONTROL_MAGIC:#010x}")
    payload = data[u3v.CONTROL_HEADER_SIZE : u3v.CONTROL_HEADER_SIZE + size]
    if len(payload) != size:
        raise MalformedPacket(f"{len(payload)} bytes of payload where the header says {size}")
    return Answer(status, command, request_id, payload)


def parse_pending(payload: bytes) -> int:
    """Return the milliseconds that a PENDING_ACK asks the host to wait further. Raises MalformedPacket."""
    if len(payload) < _TWO_WORDS.size:
        raise MalformedPacket(f"PENDING_ACK with {len(payload)} bytes, expected {_TWO_WORDS.size}")
    timeout_ms: int = _TWO_WORDS.unpack_from(payload)[1]
    return timeout_ms


def parse_written(payload: bytes) -> int | None:
    """Return the number of bytes that a WRITEMEM acknowledge reports.

    It is ``None`` if the device leaves it out.
    """
    if len(payload) < _TWO_WORDS.size:
        return None
    written: int = _TWO_WORDS.unpack_from(payload)[1]
    return written


def status_name(status: int) -> str:
    """Return a name like ``WRITE_PROTECT (0x8004)``, or the bare number for an unlisted code."""
    try:
        return f"{u3v.Status(status).name} ({status:#06x})"
    except ValueError:
        return f"status {status:#06x}"
