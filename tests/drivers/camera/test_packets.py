"""Leader and trailer against bytes worked out by hand from USB3 Vision 1.0, section 5."""

import struct
from collections.abc import Callable

import pytest

from drivers.camera.packets import (
    Leader,
    MalformedStreamPacket,
    Trailer,
    is_leader,
    is_trailer,
    parse_leader,
    parse_trailer,
)

LEADER = bytes.fromhex(
    "5533564c"  # "U3VL"
    "0000 3400"  # reserved; 52 bytes
    "0900000000000000"  # block 9
    "0000 0100"  # reserved; image
    "00ca9a3b00000000"  # 1 000 000 000 ns
    "01000801"  # Mono8
    "40060000 b0040000"  # 1600 x 1200
    "00000000 00000000"  # offsets
    "0000 0000"  # padding; reserved
)
TRAILER = bytes.fromhex(
    "55335654"  # "U3VT"
    "0000 2000"  # reserved; 32 bytes
    "0900000000000000"  # block 9
    "00a1 0000"  # status A100; reserved
    "004c1d0000000000"  # 1 920 000 bytes
    "b0040000"  # 1200 lines
)


def with_size(packet: bytes, size: int) -> bytes:
    return packet[:6] + size.to_bytes(2, "little") + packet[8:]


def test_a_leader_is_taken_apart_whatever_the_vendor_puts_behind_it() -> None:
    taken = Leader(9, 1_000_000_000, 0x01080001, 1600, 1200, 0, 0, 0)
    assert parse_leader(LEADER) == parse_leader(with_size(LEADER, 64) + bytes(12)) == taken
    fields = (0x01020304, 1234567890123, 0x01080001, 640, 480, 16, 8, 3)
    head = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, fields[0], 0, 1, *fields[1:], 0)
    assert parse_leader(head) == Leader(*fields)


def test_a_trailer_is_taken_apart_whatever_the_vendor_puts_behind_it() -> None:
    taken = Trailer(9, 0xA100, 1_920_000, 1200)
    assert parse_trailer(TRAILER) == parse_trailer(with_size(TRAILER, 40) + bytes(8)) == taken


@pytest.mark.parametrize(
    ("parse", "data", "reason"),
    [
        (parse_leader, LEADER[:51], "51 bytes"),
        (parse_leader, b"U3VX" + LEADER[4:], "leader magic 0x58563355, expected 0x4c563355"),
        (parse_leader, with_size(LEADER, 51), "leader says 51 bytes, 52 arrived"),
        (parse_leader, with_size(LEADER, 53), "leader says 53 bytes, 52 arrived"),
        (parse_leader, LEADER[:18] + b"\x00\x40" + LEADER[20:], "payload type 0x4000"),
        (parse_trailer, TRAILER[:31], "trailer of 31 bytes, expected 32"),
        (parse_trailer, LEADER, "trailer magic 0x4c563355, expected 0x54563355"),
        (parse_trailer, with_size(TRAILER, 31), "trailer says 31 bytes, 32 arrived"),
        (parse_trailer, with_size(TRAILER, 33), "trailer says 33 bytes, 32 arrived"),
    ],
)
def test_a_packet_that_is_none_or_of_another_size_is_named(
    parse: Callable[[bytes], object], data: bytes, reason: str
) -> None:
    with pytest.raises(MalformedStreamPacket, match=reason):
        parse(data)


@pytest.mark.parametrize(
    ("data", "leads", "trails"),
    [
        (LEADER, True, False),
        (TRAILER, False, True),
        (b"U3V", False, False),
        (b"U3VX" + LEADER[4:], False, False),
    ],
)
def test_a_packet_is_known_by_all_four_letters(data: bytes, leads: bool, trails: bool) -> None:
    assert (is_leader(data), is_trailer(data)) == (leads, trails)
