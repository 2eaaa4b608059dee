"""The layout of stream leaders and trailers: bytes in, values out, no I/O.

Source: USB3 Vision 1.0, tables 5-3 (leader), 5-4 (image leader) and 5-7 (image trailer).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.camera import u3v

_LEADER = struct.Struct("<IHHQHHQIIIIIHH")
_TRAILER = struct.Struct("<IHHQHHQI")


class MalformedStreamPacket(ValueError):
    """The bytes are no image leader or trailer."""


@dataclass(frozen=True, slots=True)
class Leader:
    """Packet that the camera sends before an image."""

    block_id: int
    timestamp_ns: int
    pixel_format: int
    width_px: int
    height_px: int
    x_offset_px: int
    y_offset_px: int
    x_padding: int


@dataclass(frozen=True, slots=True)
class Trailer:
    """Packet that the camera sends after an image.

    ``status`` is a raw GenCP code, sizes are those really sent.
    """

    block_id: int
    status: int
    valid_payload_size: int
    height_px: int


def is_leader(data: bytes) -> bool:
    """Return True if ``data`` begins with the leader's magic."""
    return data[:4] == u3v.LEADER_MAGIC.to_bytes(4, "little")


def is_trailer(data: bytes) -> bool:
    """Return True if ``data`` begins with the trailer's magic."""
    return data[:4] == u3v.TRAILER_MAGIC.to_bytes(4, "little")


def parse_leader(data: bytes) -> Leader:
    """Parse an image leader; longer ones (vendor fields after the standard's) are accepted.

    Raises MalformedStreamPacket for a wrong magic, size or payload type.
    """
    if len(data) < u3v.LEADER_SIZE:
        raise MalformedStreamPacket(f"leader of {len(data)} bytes, expected {u3v.LEADER_SIZE}")
    (magic, _, size, block_id, _, payload_type, timestamp_ns, pixel_format, width, height, x, y, padding, _) = (
        _LEADER.unpack_from(data)
    )
    if magic != u3v.LEADER_MAGIC:
        raise MalformedStreamPacket(f"leader magic {magic:#010x}, expected {u3v.LEADER_MAGIC:#010x}")
    if not u3v.LEADER_SIZE <= size <= len(data):
        raise MalformedStreamPacket(f"leader says {size} bytes, {len(data)} arrived")
    if payload_type != u3v.PAYLOAD_TYPE_IMAGE:
        raise MalformedStreamPacket(f"payload type {payload_type:#06x}, expected image ({u3v.PAYLOAD_TYPE_IMAGE:#06x})")
    return Leader(block_id, timestamp_ns, pixel_format, width, height, x, y, padding)


def parse_trailer(data: bytes) -> Trailer:
    """Parse an image trailer. Raises MalformedStreamPacket for a wrong magic or size."""
    if len(data) < u3v.TRAILER_SIZE:
        raise MalformedStreamPacket(f"trailer of {len(data)} bytes, expected {u3v.TRAILER_SIZE}")
    magic, _, size, block_id, status, _, valid_payload, height = _TRAILER.unpack_from(data)
    if magic != u3v.TRAILER_MAGIC:
        raise MalformedStreamPacket(f"trailer magic {magic:#010x}, expected {u3v.TRAILER_MAGIC:#010x}")
    if not u3v.TRAILER_SIZE <= size <= len(data):
        raise MalformedStreamPacket(f"trailer says {size} bytes, {len(data)} arrived")
    return Trailer(block_id, status, valid_payload, height)
