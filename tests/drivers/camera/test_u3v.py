"""The table of the wire against the standards: every place follows from the sizes of the fields before it."""

from __future__ import annotations

from itertools import accumulate

from drivers.camera import u3v
from drivers.camera.gencp import status_name


def places(*sizes: int) -> list[int]:
    """Where fields begin that follow each other without gaps."""
    return [0, *accumulate(sizes)]


def test_the_general_registers_follow_each_other_as_in_gencp() -> None:
    # version; seven texts; capability, response time, manifest, SBRM; configuration, heartbeat, channel; time stamp, latch
    found = places(4, *[64] * 7, 8, 4, 8, 8, 8, 4, 4, 8, 4)
    assert [
        *(u3v.ABRM_GENCP_VERSION, u3v.ABRM_MANUFACTURER_NAME, u3v.ABRM_MODEL_NAME, u3v.ABRM_FAMILY_NAME),
        *(u3v.ABRM_DEVICE_VERSION, u3v.ABRM_MANUFACTURER_INFO, u3v.ABRM_SERIAL_NUMBER, u3v.ABRM_USER_NAME),
        *(u3v.ABRM_DEVICE_CAPABILITY, u3v.ABRM_MAX_RESPONSE_TIME_MS, u3v.ABRM_MANIFEST_ADDRESS, u3v.ABRM_SBRM_ADDRESS),
        u3v.ABRM_HEAD_SIZE,
    ] == found[:13]
    assert found[15:17] == [u3v.ABRM_TIMESTAMP, u3v.ABRM_TIMESTAMP_LATCH]
    assert u3v.ABRM_STRING_SIZE == 64


def test_the_usb_registers_follow_each_other_as_in_usb3_vision() -> None:
    # version, capability, configuration, command, answer, streams, SIRM and its length, EIRM and its, IIDC2; speed
    found = places(4, 8, 8, 4, 4, 4, 8, 4, 8, 4, 8, 4)
    assert found[:2] == [u3v.SBRM_U3V_VERSION, u3v.SBRM_CAPABILITY]
    assert [
        *(u3v.SBRM_MAX_COMMAND_SIZE, u3v.SBRM_MAX_ACKNOWLEDGE_SIZE, u3v.SBRM_STREAM_COUNT, u3v.SBRM_SIRM_ADDRESS)
    ] == found[3:7]
    assert found[11:] == [u3v.SBRM_CURRENT_SPEED, u3v.SBRM_SIZE]


def test_the_stream_registers_follow_each_other_as_in_usb3_vision() -> None:
    found = places(4, 4, 8, 4, 4, 4, 4, 4, 4, 4)
    assert [
        *(u3v.SIRM_INFO, u3v.SIRM_CONTROL, u3v.SIRM_REQUIRED_PAYLOAD_SIZE, u3v.SIRM_REQUIRED_LEADER_SIZE),
        *(u3v.SIRM_REQUIRED_TRAILER_SIZE, u3v.SIRM_MAX_LEADER_SIZE, u3v.SIRM_PAYLOAD_TRANSFER_SIZE),
        *(u3v.SIRM_PAYLOAD_TRANSFER_COUNT, u3v.SIRM_FINAL_TRANSFER1_SIZE, u3v.SIRM_FINAL_TRANSFER2_SIZE),
        u3v.SIRM_MAX_TRAILER_SIZE,
    ] == found
    assert u3v.SIRM_REQUIREMENTS_SIZE == u3v.SIRM_MAX_LEADER_SIZE
    assert u3v.SIRM_ENABLE == 1


def test_device_classes_and_protocols_are_those_of_usb3_vision() -> None:
    assert (u3v.USB_CLASS_MISCELLANEOUS, u3v.U3V_SUBCLASS) == (0xEF, 0x05)
    assert (u3v.PROTOCOL_CONTROL, u3v.PROTOCOL_EVENT, u3v.PROTOCOL_STREAM) == (0, 1, 2)


def test_every_status_has_the_name_and_number_of_the_standards() -> None:
    gencp = [
        "NOT_IMPLEMENTED",
        "INVALID_PARAMETER",
        "INVALID_ADDRESS",
        "WRITE_PROTECT",
        "BAD_ALIGNMENT",
        "ACCESS_DENIED",
        "BUSY",
    ]
    named = {0x8001 + k: name for k, name in enumerate(gencp)}
    named |= {0: "SUCCESS", 0x800B: "MESSAGE_TIMEOUT", 0x800E: "INVALID_HEADER", 0x800F: "WRONG_CONFIGURATION"}
    named |= {0x8FFF: "GENERIC_ERROR", 0xA001: "RESEND_NOT_SUPPORTED", 0xA002: "STREAM_ENDPOINT_HALTED"}
    named |= {0xA003: "PAYLOAD_SIZE_NOT_ALIGNED", 0xA004: "STREAM_REGISTERS_INCONSISTENT"}
    named |= {0xA100: "DATA_DISCARDED", 0xA101: "DATA_OVERRUN"}
    assert {int(status): status.name for status in u3v.Status} == named
    assert status_name(0x8005) == "BAD_ALIGNMENT (0x8005)"
