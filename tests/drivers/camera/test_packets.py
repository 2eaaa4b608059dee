"""Leader and trailer against bytes worked out by hand from USB3 Vision 1.0, section 5."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.packets import (
    Leader,
    MalformedStreamPacket,
    Trailer,
    is_leader,
    is_trailer,
    parse_leader,
    parse_trailer,
)
from tests.support.damage import damaged

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


def test_the_samples_have_the_sizes_of_the_standard() -> None:
    assert (len(LEADER), len(TRAILER)) == (52, 32)


def test_a_leader_is_taken_apart() -> None:
    assert parse_leader(LEADER) == Leader(9, 1_000_000_000, 0x01080001, 1600, 1200, 0, 0, 0)


def test_a_trailer_is_taken_apart() -> None:
    assert parse_trailer(TRAILER) == Trailer(9, 0xA100, 1_920_000, 1200)


def test_a_leader_is_no_trailer() -> None:
    assert is_leader(LEADER)
    assert not is_trailer(LEADER)
    with pytest.raises(MalformedStreamPacket, match="magic"):
        parse_trailer(LEADER)


def test_a_short_leader_is_named() -> None:
    with pytest.raises(MalformedStreamPacket, match="51 bytes"):
        parse_leader(LEADER[:51])


def test_a_leader_of_another_payload_type_is_named() -> None:
    with pytest.raises(MalformedStreamPacket, match="payload type 0x4000"):
        parse_leader(LEADER[:18] + b"\x00\x40" + LEADER[20:])


def test_vendor_bytes_behind_a_leader_are_accepted() -> None:
    longer = LEADER[:6] + b"\x40\x00" + LEADER[8:] + b"\0" * 12
    assert parse_leader(longer).block_id == 9


def with_size(packet: bytes, size: int) -> bytes:
    return packet[:6] + size.to_bytes(2, "little") + packet[8:]


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"U3VX" + LEADER[4:], "leader magic 0x58563355, expected 0x4c563355"),
        (with_size(LEADER, 51), "leader says 51 bytes, 52 arrived"),
        (with_size(LEADER, 53), "leader says 53 bytes, 52 arrived"),
    ],
)
def test_a_leader_that_is_none_or_of_another_size_is_named(data: bytes, reason: str) -> None:
    with pytest.raises(MalformedStreamPacket, match=reason):
        parse_leader(data)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (TRAILER[:31], "trailer of 31 bytes, expected 32"),
        (b"U3VL" + TRAILER[4:], "trailer magic 0x4c563355, expected 0x54563355"),
        (with_size(TRAILER, 31), "trailer says 31 bytes, 32 arrived"),
        (with_size(TRAILER, 33), "trailer says 33 bytes, 32 arrived"),
    ],
)
def test_a_trailer_that_is_none_or_of_another_size_is_named(data: bytes, reason: str) -> None:
    with pytest.raises(MalformedStreamPacket, match=reason):
        parse_trailer(data)


def test_vendor_bytes_behind_a_trailer_are_accepted() -> None:
    assert parse_trailer(with_size(TRAILER, 40) + bytes(8)).block_id == 9


def test_every_field_of_a_leader_has_its_place() -> None:
    fields = (0x01020304, 7, 1234567890123, 0x01080001, 640, 480, 16, 8, 3)
    head = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, fields[0], 0, 1, *fields[2:], 0)
    assert parse_leader(head) == Leader(0x01020304, 1234567890123, 0x01080001, 640, 480, 16, 8, 3)


def test_a_packet_is_known_by_all_four_letters() -> None:
    assert not is_leader(b"U3V")
    assert not is_leader(b"U3VX" + LEADER[4:])
    assert not is_trailer(b"U3VX" + TRAILER[4:])
    assert is_trailer(TRAILER)
    assert not is_leader(TRAILER)


@given(st.binary(max_size=80) | damaged([LEADER[4:], TRAILER[4:]]))
def test_arbitrary_bytes_are_a_packet_or_a_named_error(data: bytes) -> None:
    for head, parse in ((b"", parse_leader), (LEADER[:4], parse_leader), (TRAILER[:4], parse_trailer)):
        try:
            packet = parse(head + data)
        except MalformedStreamPacket:
            continue
        assert packet.block_id == int.from_bytes((head + data)[8:16], "little")
