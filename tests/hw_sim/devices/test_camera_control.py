"""Cameras answer as USB, GenCP and USB3 Vision say, by descriptions of themselves that work; also those in the manner of three makers."""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable

import pytest
import usb.core
import usb.util
from genicam.genapi import AccessException, EAccessMode, LogicalErrorException, OutOfRangeException

from hw_sim.devices.usb_standard import Stall
from tests.hw_sim.conftest import Bench, HandTime
from tests.hw_sim.devices.bus import CONTROL_IN, SIRM, STREAM, Bus, Sizes
from tests.hw_sim.devices.host import U3vHost

READ, WRITE = 0x0800, 0x0802
BAD_ADDRESS, INVALID, NOT_WRITABLE, NOT_ALIGNED, DENIED = 0x8003, 0x8002, 0x8004, 0x8005, 0x8006
STREAM_HALTED, STREAM_NOT_ALIGNED, STREAM_INCONSISTENT = 0xA002, 0xA003, 0xA004
WIDTH, MODEL, HOLE = 0x200000, 0x044, 0x7_0000_0000
"""Addresses: the first is the usual camera's."""


@pytest.fixture
def usual(hand_time: HandTime) -> Bus:
    return Bus(hand_time, "usual")


def test_the_bus_shows_two_cameras_with_three_interfaces_each_as_fast_as_their_link(
    make_bench: Callable[..., Bench],
) -> None:
    bench = make_bench(faults=("camera.left slow",), cameras={"right": {"personality": "blackfly"}})
    devices = list(usb.core.find(find_all=True, backend=bench.wires.usb_backend))
    assert len({(d.bus, d.address) for d in devices}) == len(devices) == 2
    left, right = devices
    assert (left.idVendor, right.idVendor, usb.util.get_string(right, 3).split()[0]) == (0x1209, 0x1E10, "Blackfly")
    assert (left.speed, left.bcdUSB, left.bMaxPacketSize0) == (usb.util.SPEED_HIGH, 0x0210, 64)
    assert (right.speed, right.bcdUSB, right.bMaxPacketSize0) == (usb.util.SPEED_SUPER, 0x0300, 9)
    for device, packet, companion in ((left, 512, []), (right, 1024, [6, 48])):
        assert (device.bDeviceClass, device.bDeviceSubClass, device.bDeviceProtocol) == (0xEF, 0x02, 0x01)
        (configuration,) = list(device)
        assert bytes(configuration.extra_descriptors)[:7] == bytes([8, 11, 0, 3, 0xEF, 0x05, 0x00]), "association"
        interfaces = list(configuration)
        kinds = [(i.bInterfaceClass, i.bInterfaceSubClass, i.bInterfaceProtocol) for i in interfaces]
        assert kinds == [(0xEF, 0x05, protocol) for protocol in (0, 1, 2)]
        assert [sorted(e.bEndpointAddress >> 7 for e in i) for i in interfaces] == [[0, 1], [1], [1]]
        for endpoint in (e for i in interfaces for e in i):
            assert (endpoint.bmAttributes & 3, endpoint.wMaxPacketSize) == (2, packet)
            assert list((endpoint.extra_descriptors or ())[:2]) == companion, "SuperSpeed companion"
    slow, fast = (U3vHost(bench.wires.usb_backend, f"KF-CAM-{side}") for side in "LR")
    assert [host.u32(host.u64(0x1D8) + 0x40) for host in (slow, fast)] == [4, 8], "current speed"
    slow.device.write(0x01, struct.pack("<IHHHHQHH", 0x43563355, 0x4000, READ, 12, 1, MODEL, 0, 64))
    with pytest.raises(usb.core.USBError) as babbled:
        slow.device.read(CONTROL_IN, 16, 1000)
    assert babbled.value.errno == errno.EOVERFLOW, "76 bytes"


@pytest.mark.parametrize(
    ("code", "payload", "status"),
    [
        pytest.param(0x0810, b"", 0x8001, id="unknown command"),
        pytest.param(READ, struct.pack("<QHH", HOLE, 0, 4), BAD_ADDRESS, id="hole"),
        pytest.param(READ, struct.pack("<QHH", 0x300, 0, 4), BAD_ADDRESS, id="past the bootstrap registers"),
        pytest.param(READ, struct.pack("<QHH", 0x000, 0, 4)[:-1], INVALID, id="short"),
        pytest.param(READ, struct.pack("<QHH", 0x000, 0, 0), INVALID, id="nothing"),
        pytest.param(READ, struct.pack("<QHH", 0x004, 0, 1013), INVALID, id="longer than an acknowledge"),
        pytest.param(READ, struct.pack("<QHH", WIDTH + 2, 0, 4), NOT_ALIGNED, id="not aligned"),
        pytest.param(READ, struct.pack("<QHH", WIDTH, 0, 3), NOT_ALIGNED, id="not a multiple of four"),
        pytest.param(READ, struct.pack("<QHH", 0x200104, 0, 4), DENIED, id="write only"),
        pytest.param(WRITE, struct.pack("<Q", MODEL) + b"mine", NOT_WRITABLE, id="read only"),
        pytest.param(WRITE, struct.pack("<QI", WIDTH, 100), INVALID, id="not a step"),
        pytest.param(WRITE, struct.pack("<QI", WIDTH, 4000), INVALID, id="too wide"),
        pytest.param(WRITE, struct.pack("<Q", WIDTH), INVALID, id="no data"),
        pytest.param(WRITE, struct.pack("<QI", HOLE, 0), BAD_ADDRESS, id="written hole"),
    ],
)
def test_what_the_control_channel_refuses(usual: Bus, code: int, payload: bytes, status: int) -> None:
    assert usual.status(code, payload) == status
    assert usual.read(MODEL, 7) == b"KFC1920", "it goes on working, and strings need no alignment"


def test_a_long_command_is_announced_and_the_next_one_is_too_early(usual: Bus) -> None:
    usual.send(WRITE, struct.pack("<QI", 0x200104, 1), 70)
    pending = struct.unpack("<IHHHHHH", usual.bulk(CONTROL_IN, 1024))
    assert pending[2:5] == (0x0805, 4, 70)
    assert pending[6] > 0, "the time to wait in ms"
    usual.send(READ, struct.pack("<QHH", 0, 0, 4), 71)
    assert struct.unpack("<IHHHH", usual.bulk(CONTROL_IN, 1024))[1:] == (0x8007, 0x0801, 0, 71)
    usual.time.run(0.04)
    assert struct.unpack("<IHHHHHH", usual.bulk(CONTROL_IN, 1024))[1:] == (0, 0x0803, 4, 70, 0, 4)


def test_the_usual_camera_wakes_up_untriggered_and_its_limits_are_real(usual: Bus) -> None:
    woken = {
        "Width": 160,
        "Height": 120,
        "OffsetX": 0,
        "PayloadSize": 19200,
        "PixelFormat": "Mono8",
        "TriggerMode": "Off",
    }
    woken |= {"TriggerSelector": "FrameStart", "TriggerSource": "Line0", "ExposureTime": 5000.0, "Gain": 0.0}
    assert {name: usual.get(name) for name in woken} == woken
    width = usual.nodes.get_node("Width")
    assert (width.min, width.max, width.inc) == (16, 160, 8)
    usual.set(Width=80, OffsetX=80)
    assert (width.max, usual.get("PayloadSize")) == (80, 80 * 120)
    usual.set(ExposureTime=12_000.4, Gain=3.14)
    assert (usual.get("ExposureTime"), usual.get("Gain")) == (12_000.0, pytest.approx(3.1)), "what it really set"
    for name, value in (("Width", 88), ("Gain", 24.1), ("ExposureTime", 19.0), ("ExposureTime", 1_000_001.0)):
        with pytest.raises(OutOfRangeException):
            usual.set(**{name: value})


def test_an_owner_has_saved_other_values_and_the_factorys_come_back_when_loaded(hand_time: HandTime) -> None:
    saved = {"ReverseX": True, "TriggerMode[AcquisitionStart]": "On", "Gamma": 0.5, "Width": 80, "OffsetX": 8}
    bus = Bus(hand_time, "alvium", saved=saved)
    assert (bus.get("ReverseX"), bus.get("Gamma"), bus.get("Width"), bus.get("OffsetX")) == (True, 0.5, 80, 8)
    assert bus.get("TriggerMode") == "On"
    bus.set(TriggerSelector="FrameStart")
    assert bus.get("TriggerMode") == "Off", "saved for the other one only"
    bus.set(UserSetSelector="Default")
    bus.press("UserSetLoad")
    assert (bus.get("ReverseX"), bus.get("Gamma"), bus.get("Width")) == (False, 1.0, 160 + 336)
    assert (bus.get("TriggerSelector"), bus.get("TriggerMode")) == ("AcquisitionStart", "Off")
    with hand_time.condition:
        bus.camera.restart()
    assert (bus.get("Gamma"), bus.get("UserSetSelector")) == (0.5, "Default"), "as after every power-on"


@pytest.mark.parametrize("personality", ["usual", "blackfly"])
def test_what_shapes_the_stream_is_locked_by_the_host_and_by_the_stream(hand_time: HandTime, personality: str) -> None:
    bus = Bus(hand_time, personality)
    bus.set(TLParamsLocked=1)
    assert bus.nodes.get_node("Width").get_access_mode() == EAccessMode.RO
    bus.set(TLParamsLocked=0)
    assert bus.stream() == 0
    assert bus.refusal("Width", 80) == DENIED, "the camera refuses, whatever the host's node map thinks"
    assert bus.status(WRITE, struct.pack("<QI", SIRM + 0x1C, 1024)) == DENIED


def test_a_value_that_the_camera_chooses_is_read_only_and_a_lacking_one_has_another_name(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly", lacks=("TriggerOverlap",))
    with pytest.raises(AccessException):
        bus.set(ExposureTime=8000.0)
    bus.set(ExposureAuto="Off", ExposureTime=8000.5)
    assert bus.get("ExposureTime") == 8000.5
    with pytest.raises(LogicalErrorException):
        bus.nodes.get_node("TriggerOverlap")
    assert bus.get("MakerTriggerOverlap") == "Off"


@pytest.mark.parametrize(
    ("personality", "step_bits", "sizes", "status"),
    [
        ("usual", 0, Sizes(52, 19200, 32), 0),
        ("usual", 0, Sizes(52, 1024, 32), STREAM_INCONSISTENT),
        ("usual", 0, Sizes(48, 19200, 32), STREAM_INCONSISTENT),
        ("usual", 0, Sizes(52, 19200, 28), STREAM_INCONSISTENT),
        ("blackfly", 0, Sizes(53, 176 * 160, 33), 0),
        ("alvium", 10, Sizes(1024, 66 * 1024, 1024), 0),
        ("alvium", 10, Sizes(52, 66 * 1024, 1024), STREAM_INCONSISTENT),
        ("alvium", 10, Sizes(1024, 496 * 136, 1024), STREAM_NOT_ALIGNED),
        ("alvium", 10, Sizes(1024, 65 * 1024, 1024), STREAM_INCONSISTENT),
    ],
)
def test_a_stream_that_cannot_carry_a_block_is_not_enabled(
    hand_time: HandTime, personality: str, step_bits: int, sizes: Sizes, status: int
) -> None:
    bus = Bus(hand_time, personality)
    if personality != "usual":
        assert bus.u32(SIRM) >> 24 == step_bits
    assert bus.stream(sizes) == status
    assert bus.u32(SIRM + 4) == (status == 0)


@pytest.mark.parametrize("personality", ["usual", "ace"])
def test_an_endpoint_left_halted_must_be_halted_before_it_is_cleared(hand_time: HandTime, personality: str) -> None:
    bus = Bus(hand_time, personality, left_halted=True)
    bus.halt(False)
    assert bus.stream() == STREAM_HALTED
    with pytest.raises(Stall):
        bus.bulk(STREAM, 1024)
    bus.halt(True)
    assert bus.stream() == STREAM_HALTED
    bus.halt(False)
    assert bus.stream() == 0
    assert bus.bulk(STREAM, 1024) == b""
