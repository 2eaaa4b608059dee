"""Control packets against bytes worked out by hand from GenCP 1.1, section 3, and USB3 Vision 1.0, section 4."""

import pytest

from drivers.camera import gencp, u3v
from drivers.camera.gencp import Answer, MalformedPacket

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


def test_acknowledges_tell_their_number_unless_they_are_cut_short() -> None:
    assert gencp.parse_pending(bytes.fromhex("0000 e803")) == 1000
    with pytest.raises(MalformedPacket, match="3 bytes, expected 4"):
        gencp.parse_pending(bytes.fromhex("0000 e8"))
    assert [gencp.parse_written(bytes.fromhex(said)) for said in ("0000 0800", "0000 08", "")] == [8, None, None]
    assert [gencp.next_request_id(i) for i in (0, 1, 0xFFFE, 0xFFFF)] == [1, 2, 0xFFFF, 1]
    assert gencp.status_name(0x8006) == "ACCESS_DENIED (0x8006)"
    assert "0x8abc" in gencp.status_name(0x8ABC)


def test_every_status_has_the_name_and_number_of_the_standards() -> None:
    gencp_names = "NOT_IMPLEMENTED INVALID_PARAMETER INVALID_ADDRESS WRITE_PROTECT BAD_ALIGNMENT ACCESS_DENIED BUSY"
    named = {0x8001 + k: name for k, name in enumerate(gencp_names.split())}
    named |= {0: "SUCCESS", 0x800B: "MESSAGE_TIMEOUT", 0x800E: "INVALID_HEADER", 0x800F: "WRONG_CONFIGURATION"}
    named |= {0x8FFF: "GENERIC_ERROR", 0xA001: "RESEND_NOT_SUPPORTED", 0xA002: "STREAM_ENDPOINT_HALTED"}
    named |= {0xA003: "PAYLOAD_SIZE_NOT_ALIGNED", 0xA004: "STREAM_REGISTERS_INCONSISTENT"}
    named |= {0xA100: "DATA_DISCARDED", 0xA101: "DATA_OVERRUN"}
    assert {int(status): status.name for status in u3v.Status} == named
