"""USB descriptors against bytes worked out by hand from USB3 Vision 1.0, section 3."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.descriptors import (
    InterfaceDescription,
    MalformedDescriptor,
    find_device_info,
    find_layout,
    parse_device_info,
    parse_string,
)

# length 20, type 0x24, subtype 1, GenCP 1.3 and U3V 1.0 (minor first), strings 4 5 2 6 7 8 3 9, SuperSpeed.
DEVICE_INFO = bytes.fromhex("14 24 01 0300 0100 0000 0100 04 05 02 06 07 08 03 09 08".replace(" ", ""))


def test_device_info_is_taken_apart() -> None:
    info = parse_device_info(DEVICE_INFO)
    assert (info.gencp_version, info.u3v_version) == ((1, 3), (1, 0))
    assert (info.guid_index, info.vendor_index, info.model_index, info.serial_index) == (4, 5, 2, 3)
    assert (info.user_name_index, info.speed_mask) == (9, 8)


def test_device_info_is_found_behind_other_descriptors() -> None:
    companion = bytes.fromhex("06 30 00 00 00 00")
    found = find_device_info(companion + DEVICE_INFO)
    assert found is not None
    assert found.serial_index == 3


def test_a_descriptor_of_another_type_is_named() -> None:
    with pytest.raises(MalformedDescriptor, match="0x25/0x01"):
        parse_device_info(b"\x14\x25" + DEVICE_INFO[2:])


def test_a_string_is_utf16_of_the_stated_length() -> None:
    assert parse_string(b"\x06\x03K\x00F\x00garbage behind it") == "KF"


def interface(number: int, protocol: int, *, bulk_in: int = 0x81, bulk_out: int | None = None) -> InterfaceDescription:
    out = () if bulk_out is None else (bulk_out,)
    return InterfaceDescription(number, 0xEF, 0x05, protocol, (bulk_in,), out, DEVICE_INFO if protocol == 0 else b"")


def test_pipes_are_found_by_class_not_by_order() -> None:
    event = interface(1, 1, bulk_in=0x82)
    control = interface(0, 0, bulk_in=0x81, bulk_out=0x01)
    stream = interface(2, 2, bulk_in=0x83)
    layout = find_layout(1, [stream, event, control])
    assert layout is not None
    assert (layout.control_interface, layout.control_in, layout.control_out) == (0, 0x81, 0x01)
    assert (layout.stream_interface, layout.stream_in) == (2, 0x83)
    assert layout.info is not None


def test_a_webcam_is_no_usb3_vision_camera() -> None:
    video = InterfaceDescription(0, 0x0E, 0x01, 0x00, (0x81,), (0x01,), b"")
    assert find_layout(1, [video]) is None


@given(st.binary(max_size=64))
def test_arbitrary_bytes_never_break_the_search(data: bytes) -> None:
    info = find_device_info(data)
    assert info is None or b"\x24\x01" in data
    try:
        parse_string(data)
    except MalformedDescriptor:
        assert len(data) < 2 or data[1] != 3 or data[0] < 2 or data[0] > len(data)
