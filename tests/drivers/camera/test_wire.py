"""What lies on the wire against bytes worked out by hand from GenCP 1.1, section 3, and USB3 Vision 1.0, sections 3 to 5."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import gencp
from drivers.camera.descriptors import (
    DeviceInfo,
    InterfaceDescription,
    MalformedDescriptor,
    find_device_info,
    find_layout,
    parse_device_info,
    parse_string,
)
from drivers.camera.packets import (
    Leader,
    MalformedStreamPacket,
    Trailer,
    is_leader,
    is_trailer,
    parse_leader,
    parse_trailer,
)
from drivers.camera.transfers import Transfers, transfers_of
from tests.drivers.camera.scripted import DEVICE_INFO
from tests.support.damage import damaged

# "U3VC", acknowledge wanted, READMEM, 12 bytes of payload, request 0x1234; address 0x1D0, reserved, 8 bytes.
READ_MANIFEST_ADDRESS = bytes.fromhex("55335643 0040 0008 0c00 3412 d001000000000000 0000 0800")
# The same head with WRITEMEM and 8 + 4 bytes; address 0x0001_0004; the value 1, little endian.
WRITE_STREAM_ENABLE = bytes.fromhex("55335643 0040 0208 0c00 0700 0400010000000000 01000000")
# Status 0, READMEM_ACK, 4 bytes, request 0x1234; the bytes 78 56 34 12.
READ_ANSWER = bytes.fromhex("55335643 0000 0108 0400 3412 78563412")
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


def test_commands_and_statuses_are_the_standards() -> None:
    assert gencp.pack_read(0x1234, 0x1D0, 8) == READ_MANIFEST_ADDRESS
    assert gencp.pack_write(7, 0x0001_0004, b"\x01\0\0\0") == WRITE_STREAM_ENABLE
    assert [gencp.next_request_id(i) for i in (0, 1, 0xFFFE, 0xFFFF)] == [1, 2, 0xFFFF, 1]
    for status, name in ((0x8006, "ACCESS_DENIED"), (0xA100, "DATA_DISCARDED"), (0xA101, "DATA_OVERRUN")):
        assert gencp.status_name(status) == f"{name} ({status:#06x})"
    assert "0x8abc" in gencp.status_name(0x8ABC)


def test_answers_tell_what_they_carry_unless_they_are_cut_short() -> None:
    for behind in (b"", bytes(20)):
        assert gencp.parse_answer(READ_ANSWER + behind) == gencp.Answer(0, 0x0801, 0x1234, b"\x78\x56\x34\x12")
    assert gencp.parse_pending(bytes.fromhex("0000 e803")) == 1000
    assert [gencp.parse_written(bytes.fromhex(said)) for said in ("0000 0800", "0000 08", "")] == [8, None, None]


def test_leader_and_trailer_are_taken_apart_whatever_the_vendor_puts_behind_them() -> None:
    leader = Leader(9, 1_000_000_000, 0x01080001, 1600, 1200, 0, 0, 0)
    assert parse_leader(LEADER) == parse_leader(with_size(LEADER, 64) + bytes(12)) == leader
    fields = (0x01020304, 1234567890123, 0x01080001, 640, 480, 16, 8, 3)
    head = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, fields[0], 0, 1, *fields[1:], 0)
    assert parse_leader(head) == Leader(*fields)
    trailer = Trailer(9, 0xA100, 1_920_000, 1200)
    assert parse_trailer(TRAILER) == parse_trailer(with_size(TRAILER, 40) + bytes(8)) == trailer
    known = [(is_leader(data), is_trailer(data)) for data in (LEADER, TRAILER, b"U3V", b"U3VX" + LEADER[4:])]
    assert known == [(True, False), (False, True), (False, False), (False, False)]


def test_device_info_and_strings_are_taken_apart() -> None:
    """GenCP 1.3 and U3V 1.0 (minor first), strings 4 5 2 6 7 8 3 9, SuperSpeed."""
    info = DeviceInfo((1, 3), (1, 0), 4, 5, 2, 6, 7, 8, 3, 9, 8)
    assert parse_device_info(DEVICE_INFO) == parse_device_info(DEVICE_INFO + b"more") == info
    told = {b"\x02\x03": "", b"\x04\x03K\0": "K", b"\x06\x03K\0\0\0": "K", b"\x06\x03K\0F\0behind it": "KF"}
    assert {data: parse_string(data) for data in told} == told


@pytest.mark.parametrize(
    ("parse", "data", "said"),
    [
        (gencp.parse_answer, READ_ANSWER[:11], "11 bytes"),
        (gencp.parse_answer, b"U3VX" + READ_ANSWER[4:], "magic"),
        (gencp.parse_answer, READ_ANSWER[:-1], "3 bytes of payload where the header says 4"),
        (gencp.parse_pending, bytes.fromhex("0000 e8"), "3 bytes, expected 4"),
        (parse_leader, LEADER[:51], "51 bytes"),
        (parse_leader, b"U3VX" + LEADER[4:], "leader magic 0x58563355, expected 0x4c563355"),
        (parse_leader, with_size(LEADER, 51), "leader says 51 bytes, 52 arrived"),
        (parse_leader, with_size(LEADER, 53), "leader says 53 bytes, 52 arrived"),
        (parse_leader, LEADER[:18] + b"\x00\x40" + LEADER[20:], "payload type 0x4000"),
        (parse_trailer, TRAILER[:31], "trailer of 31 bytes, expected 32"),
        (parse_trailer, LEADER, "trailer magic 0x4c563355, expected 0x54563355"),
        (parse_trailer, with_size(TRAILER, 31), "trailer says 31 bytes, 32 arrived"),
        (parse_trailer, with_size(TRAILER, 33), "trailer says 33 bytes, 32 arrived"),
        (parse_device_info, DEVICE_INFO[:19], "device info of 19 bytes; the standard says 20"),
        (parse_device_info, b"\x13" + DEVICE_INFO[1:], "device info of 20 bytes"),
        (parse_device_info, b"\x14\x25" + DEVICE_INFO[2:], "0x25/0x01"),
        (parse_device_info, DEVICE_INFO[:2] + b"\x02" + DEVICE_INFO[3:], "0x24/0x02"),
        *((parse_string, bad, "not a string") for bad in (b"\x04\x03K", b"\x02", b"\x01\x03", b"\x04\x02K\0", b"")),
    ],
)
def test_what_is_none_or_of_another_size_is_named(parse: Callable[[bytes], object], data: bytes, said: str) -> None:
    with pytest.raises((gencp.MalformedPacket, MalformedStreamPacket, MalformedDescriptor), match=said):
        parse(data)


@pytest.mark.parametrize(
    ("before", "found"),
    [
        (b"", True),
        (b"\x06\x30\0\0\0\0", True),
        (b"\x03\x24\x06", True),
        (b"\x05\x24\x01\0\0", True),  # of the type, but too short to be it
        (b"\x02\x24", False),  # no descriptor is so short: nothing chains behind it
        (b"\x00", False),
        (b"\xff\x24\x01", False),  # reaches beyond the end
    ],
)
def test_descriptors_are_followed_as_long_as_they_chain(before: bytes, found: bool) -> None:
    assert (find_device_info(before + DEVICE_INFO) is not None) == found
    assert find_device_info(before + DEVICE_INFO[:-1]) is None


@given(st.binary(max_size=64) | damaged([DEVICE_INFO, bytes([5, 0x24, 0x7F, 1, 2]) + DEVICE_INFO]))
def test_arbitrary_bytes_never_break_the_search(data: bytes) -> None:
    assert find_device_info(data) is None or b"\x24\x01" in data


def interface(number: int, protocol: int, *bulk_in: int, bulk_out: tuple[int, ...] = ()) -> InterfaceDescription:
    return InterfaceDescription(number, 0xEF, 0x05, protocol, bulk_in, bulk_out, b"" if protocol else DEVICE_INFO)


CONTROL, STREAM = interface(0, 0, 0x81, bulk_out=(0x01,)), interface(2, 2, 0x83)
NO_WAY_OUT, NO_STREAM = interface(7, 0, 0x87), interface(8, 2)
OTHER_CLASS = InterfaceDescription(9, 0xEF, 0x02, 0, (0x88,), (0x08,), b"")


@pytest.mark.parametrize(
    ("interfaces", "is_camera"),
    [
        ([STREAM, interface(1, 1, 0x82), CONTROL], True),
        ([NO_WAY_OUT, NO_STREAM, OTHER_CLASS, CONTROL, interface(3, 0, 0x85, bulk_out=(0x02,)), STREAM], True),
        ([CONTROL, STREAM, interface(4, 2, 0x84)], True),
        ([NO_WAY_OUT, STREAM], False),
        ([CONTROL, NO_STREAM], False),
        ([OTHER_CLASS, STREAM], False),
    ],
)
def test_the_first_pipes_of_a_class_with_all_their_endpoints_are_a_cameras(
    interfaces: list[InterfaceDescription], is_camera: bool
) -> None:
    layout = find_layout(5, interfaces)
    assert (layout is not None) == is_camera
    if layout is not None:
        assert (layout.configuration, layout.control_interface, layout.stream_interface) == (5, 0, 2)
        assert (layout.control_in, layout.control_out, layout.stream_in) == (0x81, 0x01, 0x83)
        assert layout.info is not None


MIB = 1 << 20


@pytest.mark.parametrize(
    ("payload", "alignment", "piece", "cut"),
    [
        (1_920_000, 1024, None, Transfers(1_920_000, 1, 0, 0)),
        (1_920_001, 1024, None, Transfers(1_921_024, 1, 0, 0)),
        (1_920_000, 1024, MIB, Transfers(MIB, 1, 871_424, 0)),
        (2 * MIB, 1024, MIB, Transfers(MIB, 2, 0, 0)),
        (2 * MIB + 1, 1024, MIB, Transfers(MIB, 2, 1024, 0)),
        (MIB, 1, MIB, Transfers(MIB, 1, 0, 0)),
        (MIB - 5, 1, MIB, Transfers(MIB - 5, 1, 0, 0)),
        (5000, 2048, 1024, Transfers(2048, 2, 2048, 0)),
    ],
)
def test_an_image_is_cut_into_whole_units_none_longer_than_a_piece(
    payload: int, alignment: int, piece: int | None, cut: Transfers
) -> None:
    assert transfers_of(payload, alignment, piece) == cut
    assert payload <= sum(cut.sizes) < payload + alignment
