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
from tests.support.damage import damaged

# length 20, type 0x24, subtype 1, GenCP 1.3 and U3V 1.0 (minor first), strings 4 5 2 6 7 8 3 9, SuperSpeed.
DEVICE_INFO = bytes.fromhex("14 24 01 0300 0100 0000 0100 04 05 02 06 07 08 03 09 08".replace(" ", ""))


def test_device_info_is_taken_apart() -> None:
    info = parse_device_info(DEVICE_INFO)
    assert (info.gencp_version, info.u3v_version) == ((1, 3), (1, 0))
    assert (info.guid_index, info.vendor_index, info.model_index, info.serial_index) == (4, 5, 2, 3)
    assert (info.device_version_index, info.manufacturer_info_index, info.family_index) == (7, 8, 6)
    assert (info.user_name_index, info.speed_mask) == (9, 8)
    assert parse_device_info(DEVICE_INFO + b"more") == info


def interface(number: int, protocol: int, *, bulk_in: int = 0x81, bulk_out: int | None = None) -> InterfaceDescription:
    out = () if bulk_out is None else (bulk_out,)
    return InterfaceDescription(number, 0xEF, 0x05, protocol, (bulk_in,), out, DEVICE_INFO if protocol == 0 else b"")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (DEVICE_INFO[:19], "device info of 19 bytes; the standard says 20"),
        (b"\x13" + DEVICE_INFO[1:], "device info of 20 bytes"),
        (b"\x14\x25" + DEVICE_INFO[2:], "0x25/0x01"),
        (DEVICE_INFO[:2] + b"\x02" + DEVICE_INFO[3:], "0x24/0x02"),
    ],
)
def test_a_device_info_that_is_none_is_named(data: bytes, said: str) -> None:
    with pytest.raises(MalformedDescriptor, match=said):
        parse_device_info(data)


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


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"\x02\x03", ""),
        (b"\x04\x03K\0", "K"),
        (b"\x06\x03K\0\0\0", "K"),
        (b"\x06\x03K\0F\0garbage behind it", "KF"),
        (b"\x04\x03K", None),
        (b"\x02", None),
        (b"\x01\x03", None),
        (b"\x04\x02K\0", None),
        (b"", None),
    ],
)
def test_a_string_is_as_long_as_it_says_or_none_at_all(data: bytes, text: str | None) -> None:
    if text is not None:
        assert parse_string(data) == text
        return
    with pytest.raises(MalformedDescriptor, match="not a string descriptor"):
        parse_string(data)


CONTROL, STREAM = interface(0, 0, bulk_in=0x81, bulk_out=0x01), interface(2, 2, bulk_in=0x83)
NO_WAY_OUT = InterfaceDescription(7, 0xEF, 0x05, 0, (0x87,), (), b"")
NO_STREAM = InterfaceDescription(8, 0xEF, 0x05, 2, (), (), b"")
OTHER_CLASS = InterfaceDescription(9, 0xEF, 0x02, 0, (0x88,), (0x08,), b"")
WEBCAM = InterfaceDescription(0, 0x0E, 0x01, 0x00, (0x81,), (0x01,), b"")


@pytest.mark.parametrize(
    ("interfaces", "is_camera"),
    [
        ([STREAM, interface(1, 1, bulk_in=0x82), CONTROL], True),
        ([NO_WAY_OUT, NO_STREAM, OTHER_CLASS, CONTROL, interface(3, 0, bulk_in=0x85, bulk_out=0x02), STREAM], True),
        ([CONTROL, STREAM, interface(4, 2, bulk_in=0x84)], True),
        ([NO_WAY_OUT, STREAM], False),
        ([CONTROL, NO_STREAM], False),
        ([OTHER_CLASS, STREAM], False),
        ([WEBCAM], False),
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


@given(
    st.binary(max_size=64) | damaged([DEVICE_INFO, bytes([5, 0x24, 0x7F, 1, 2]) + DEVICE_INFO, b"\x06\x03K\x00F\x00"])
)
def test_arbitrary_bytes_never_break_the_search(data: bytes) -> None:
    info = find_device_info(data)
    assert info is None or b"\x24\x01" in data
    try:
        parse_string(data)
    except MalformedDescriptor:
        assert len(data) < 2 or data[1] != 3 or data[0] < 2 or data[0] > len(data)
