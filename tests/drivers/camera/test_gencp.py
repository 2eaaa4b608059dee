"""Control packets against bytes worked out by hand from GenCP 1.1, section 3, and USB3 Vision 1.0, section 4."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import gencp
from drivers.camera.gencp import Answer, MalformedPacket
from tests.support.damage import damaged

# "U3VC", acknowledge wanted, READMEM, 12 bytes of payload, request 0x1234; address 0x1D0, reserved, 8 bytes.
READ_MANIFEST_ADDRESS = bytes.fromhex("55335643 0040 0008 0c00 3412 d001000000000000 0000 0800")
# The same head with WRITEMEM and 8 + 4 bytes; address 0x0001_0004; the value 1, little endian.
WRITE_STREAM_ENABLE = bytes.fromhex("55335643 0040 0208 0c00 0700 0400010000000000 01000000")
# Status 0, READMEM_ACK, 4 bytes, request 0x1234; the bytes 78 56 34 12.
READ_ANSWER = bytes.fromhex("55335643 0000 0108 0400 3412 78563412")


def test_commands_are_the_standards_bytes() -> None:
    assert gencp.pack_read(0x1234, 0x1D0, 8) == READ_MANIFEST_ADDRESS
    assert gencp.pack_write(7, 0x0001_0004, b"\x01\0\0\0") == WRITE_STREAM_ENABLE


@pytest.mark.parametrize("behind", [b"", bytes(20)], ids=["alone", "with bytes behind it"])
def test_an_answer_is_taken_apart(behind: bytes) -> None:
    assert gencp.parse_answer(READ_ANSWER + behind) == Answer(0, 0x0801, 0x1234, bytes.fromhex("78563412"))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (READ_ANSWER[:11], "11 bytes"),
        (b"U3VX" + READ_ANSWER[4:], "magic"),
        (READ_ANSWER[:-1], "3 bytes of payload where the header says 4"),
    ],
)
def test_a_damaged_answer_is_named(data: bytes, reason: str) -> None:
    with pytest.raises(MalformedPacket, match=reason):
        gencp.parse_answer(data)


def test_a_pending_acknowledge_tells_its_milliseconds_unless_it_is_cut_short() -> None:
    assert gencp.parse_pending(bytes.fromhex("0000 e803")) == 1000
    with pytest.raises(MalformedPacket, match="3 bytes, expected 4"):
        gencp.parse_pending(bytes.fromhex("0000 e8"))


def test_a_write_acknowledge_tells_its_bytes_or_leaves_them_out() -> None:
    assert gencp.parse_written(bytes.fromhex("0000 0800")) == 8
    assert gencp.parse_written(bytes.fromhex("0000 08")) is None
    assert gencp.parse_written(b"") is None


def test_request_ids_skip_zero_when_they_wrap() -> None:
    assert [gencp.next_request_id(i) for i in (0, 1, 0xFFFE, 0xFFFF)] == [1, 2, 0xFFFF, 1]


def test_a_status_has_a_name_and_an_unknown_one_its_number() -> None:
    assert gencp.status_name(0x8006) == "ACCESS_DENIED (0x8006)"
    assert "0x8abc" in gencp.status_name(0x8ABC)


@given(st.binary(max_size=64) | damaged([READ_ANSWER, WRITE_STREAM_ENABLE]))
def test_arbitrary_bytes_are_an_answer_or_a_named_error(data: bytes) -> None:
    try:
        answer = gencp.parse_answer(data)
    except MalformedPacket:
        return
    assert data.startswith(b"U3VC")
    assert answer.payload == data[12 : 12 + int.from_bytes(data[8:10], "little")]
    assert gencp.status_name(answer.status)
    gencp.parse_written(answer.payload)
