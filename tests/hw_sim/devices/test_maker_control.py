"""Control and stream interface of cameras in the manner of three makers: user sets, locks, alignment, halts, long transfers."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any

import pytest
import usb.core
import usb.util
from genicam.genapi import AccessException, EAccessMode, LogicalErrorException, OutOfRangeException

from hw_sim.devices.feature_book import FeatureBook
from hw_sim.devices.makers import MAKERS
from hw_sim.devices.u3v_stream import Region
from hw_sim.devices.usb_standard import Stall
from hw_sim.options import OptionError, WorldOptions
from tests.hw_sim.conftest import Bench, HandTime
from tests.hw_sim.devices.bus import SIRM, Bus, Sizes, careful
from tests.hw_sim.devices.host import GencpError, U3vHost

PERSONALITIES = ("blackfly", "ace", "alvium")
NOT_ALIGNED, INCONSISTENT, HALTED, DENIED, INVALID = 0xA003, 0xA004, 0xA002, 0x8006, 0x8002


# ---------------------------------------------------------------------------------------------- what they start with


@pytest.mark.parametrize(
    ("personality", "expected"),
    [
        (
            "blackfly",
            {
                "DeviceVendorName": "FLIR",
                "TriggerSelector": "FrameStart",
                "TriggerSource": "Line0",
                "TriggerOverlap": "Off",
                "ExposureAuto": "Continuous",
                "GainAuto": "Continuous",
                "GammaEnable": True,
                "Gamma": 0.8,
                "SensorWidth": 176,
            },
        ),
        (
            "ace",
            {
                "DeviceVendorName": "Basler",
                "TriggerSelector": "FrameBurstStart",
                "DeviceLinkThroughputLimitMode": "On",
                "DeviceLinkThroughputLimit": 158_000_000,
                "OverlapMode": "On",
                "ExposureAuto": "Off",
            },
        ),
        (
            "alvium",
            {
                "DeviceVendorName": "Allied Vision",
                "TriggerSelector": "AcquisitionStart",
                "TriggerSource": "Software",
                "DeviceLinkThroughputLimit": 200_000_000,
                "SensorHeight": 136,
            },
        ),
    ],
)
def test_out_of_the_box(hand_time: HandTime, personality: str, expected: dict[str, Any]) -> None:
    bus = Bus(hand_time, personality)
    assert {name: bus.get(name) for name in expected} == expected
    assert (bus.get("Width"), bus.get("OffsetX"), bus.get("TriggerMode")) == (bus.get("SensorWidth"), 0, "Off")


class Idle:
    """A camera that does nothing."""

    streaming = False
    acquiring = False


@pytest.mark.parametrize(
    ("personality", "sensor", "middle"),
    [("blackfly", (1616, 1240), (8, 20)), ("ace", (1920, 1200), (160, 0)), ("alvium", (1936, 1216), (168, 8))],
)
def test_full_sized_sensors_have_the_worlds_picture_at_a_step_of_their_offsets(
    personality: str, sensor: tuple[int, int], middle: tuple[int, int]
) -> None:
    book = FeatureBook(MAKERS[personality], (1600, 1200), {}, Idle())
    assert book.region == Region(*sensor, 0, 0)
    for name, value in (("Width", 1600), ("Height", 1200), ("OffsetX", middle[0]), ("OffsetY", middle[1])):
        book.write(name, value)
    assert book.region == Region(1600, 1200, *middle)


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
    bus.set(UserSetSelector="UserSet1")
    bus.press("UserSetLoad")
    assert (bus.get("ReverseX"), bus.get("UserSetSelector")) == (True, "UserSet1")
    with hand_time.condition:
        bus.camera.restart()
    assert (bus.get("Gamma"), bus.get("UserSetSelector")) == (0.5, "Default"), "as after every power-on"


# ---------------------------------------------------------------------------------------------- who may write when


def test_what_shapes_the_stream_is_locked_by_the_host_and_by_the_stream(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    bus.set(TLParamsLocked=1)
    assert bus.nodes.get_node("Width").get_access_mode() == EAccessMode.RO
    with pytest.raises(AccessException):
        bus.set(ReverseX=True)
    assert bus.refusal("Width", 80) == DENIED, "the camera refuses, whatever the host's node map thinks"
    assert bus.refusal("UserSetLoad", 1) == DENIED
    bus.set(TLParamsLocked=0, ReverseX=True)
    assert bus.stream() == 0
    assert bus.refusal("Width", 80) == DENIED
    bus.set(TestPattern="GreyHorizontalRamp")


def test_a_camera_that_needs_the_lock_does_not_start_without_it(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "ace", needs_lock=True)
    careful(bus, "ace")
    assert bus.stream() == 0
    assert bus.refusal("AcquisitionStart", 1) == DENIED
    bus.set(TLParamsLocked=1)
    assert bus.announced == 1, "a start takes longer than the response time"
    assert bus.refusal("AcquisitionStart", 1) == 0
    assert bus.announced == 2


def test_an_exposure_time_that_the_camera_chooses_is_read_only(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    with pytest.raises(AccessException):
        bus.set(ExposureTime=8000.0)
    place = re.search(r'Name="ExposureTimeReg">.*?<Address>(\w+)<', bus.description(), re.DOTALL)
    assert place is not None
    with pytest.raises(GencpError) as caught:
        bus.write(int(place[1], 16), struct.pack("<d", 8000.0))
    assert caught.value.args[0] == DENIED, "by the camera itself, too"
    bus.set(ExposureAuto="Off", ExposureTime=8000.5)
    assert bus.get("ExposureTime") == 8000.5


def test_limits_follow_offset_and_binning(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "ace")
    with pytest.raises(OutOfRangeException):
        bus.set(OffsetX=4)
    bus.set(Width=160, OffsetX=160)
    assert bus.nodes.get_node("Width").max == 320
    assert bus.refusal("Width", 328) == INVALID
    assert bus.refusal("OffsetX", 6) == INVALID, "no step"
    bus.set(BinningHorizontal=4)
    assert (bus.get("WidthMax"), bus.get("OffsetX"), bus.get("Width")) == (120, 104, 16), "what does not fit shrinks"
    assert bus.refusal("PixelFormat", 99) == INVALID


# ---------------------------------------------------------------------------------------------- stream interface


@pytest.mark.parametrize(
    ("sizes", "status"),
    [
        (Sizes(1024, 66 * 1024, 1024), 0),
        (Sizes(52, 66 * 1024, 1024), INCONSISTENT),
        (Sizes(1024, 66 * 1024, 32), INCONSISTENT),
        (Sizes(1024, 496 * 136, 1024), NOT_ALIGNED),
        (Sizes(1024, 65 * 1024, 1024), INCONSISTENT),
    ],
)
def test_an_alvium_takes_multiples_of_1024_only(hand_time: HandTime, sizes: Sizes, status: int) -> None:
    bus = Bus(hand_time, "alvium")
    assert bus.u32(SIRM) == 0x0A00_0000
    assert bus.stream(sizes) == status
    assert bus.u32(SIRM + 4) == (status == 0)


def test_a_blackfly_aligns_nothing(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    bus.set(Width=20, Height=2, PixelFormat="Mono12p")
    assert bus.u32(SIRM) == 0
    assert bus.stream(Sizes(53, 61, 33)) == 0


def test_a_blackfly_says_its_sizes_once_the_stream_was_enabled(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly")
    assert (bus.u32(SIRM + 0x10), bus.u32(SIRM + 0x14)) == (0, 0)
    assert bus.stream() == 0
    bus.put(SIRM + 4, 0)
    assert (bus.u32(SIRM + 0x10), bus.u32(SIRM + 0x14)) == (52, 32)
    with hand_time.condition:
        bus.camera.restart()
    assert bus.u32(SIRM + 0x10) == 0


@pytest.mark.parametrize("personality", ["usual", "ace"])
def test_an_endpoint_left_halted_must_be_halted_before_it_is_cleared(hand_time: HandTime, personality: str) -> None:
    bus = Bus(hand_time, personality, left_halted=True)
    bus.clear_halt()
    assert bus.stream() == HALTED
    with pytest.raises(Stall):
        bus.bulk_stream(1024)
    bus.halt()
    assert bus.stream() == HALTED
    bus.clear_halt()
    assert bus.stream() == 0
    assert bus.bulk_stream(1024) == b""


def test_a_longer_transfer_than_the_largest_fails_and_pieces_go_through(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "alvium", largest_transfer_bytes=8192)
    careful(bus, "alvium")
    bus.start()
    bus.pulses(1)
    assert bus.bulk_stream(1024)[:4] == b"U3VL"
    with pytest.raises(Stall):
        bus.bulk_stream(9216)
    assert [len(bus.bulk_stream(8192)) for _ in range(3)] == [8192, 8192, 160 * 120 - 16384]
    assert bus.bulk_stream(1024)[:4] == b"U3VT"


# ---------------------------------------------------------------------------------------------- in the world


def test_the_bus_shows_what_the_options_name(make_bench: Callable[..., Bench]) -> None:
    bench = make_bench(cameras={"left": {"personality": "alvium"}, "right": {"personality": "blackfly"}})
    devices = {usb.util.get_string(d, 7): d for d in usb.core.find(find_all=True, backend=bench.wires.usb_backend)}
    left, right = devices["KF-CAM-L"], devices["KF-CAM-R"]
    assert (left.idVendor, right.idVendor) == (0x1AB2, 0x1E10)
    assert (left.serial_number[:4], right.serial_number[:4]) == ("1AB2", "1E10"), "the GUID begins with the vendor"
    assert usb.util.get_string(right, 3).startswith("Blackfly")
    host = U3vHost(bench.wires.usb_backend, "KF-CAM-L")
    assert host.u32(host.sirm) == 0x0A00_0000
    assert host.read(0x004, 64).rstrip(b"\0") == b"Allied Vision"


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ({"personality": "leica"}, "personality 'leica'; allowed are usual, blackfly, ace, alvium"),
        ({"personality": "ace", "saved": {"TriggerOverlap": "Off"}}, "no feature 'TriggerOverlap'"),
        ({"personality": "ace", "saved": {"ReversX": True}}, "did you mean 'ReverseX'?"),
        ({"personality": "ace", "saved": {"TriggerMode": "Sometimes"}}, "allowed are Off, On"),
        ({"personality": "ace", "saved": {"TriggerMode[FrameEnd]": "On"}}, "FrameBurstStart, FrameStart"),
        ({"personality": "ace", "saved": {"Gamma": 9.0}}, "allowed are 0.25..4"),
        ({"personality": "ace", "saved": {"ReverseX": 1}}, "allowed are true and false"),
        ({"personality": "ace", "saved": {"OffsetX": 2}}, "steps of 4 from 0"),
        ({"personality": "ace", "exposure_auto": "Continuous"}, "exposure_auto is for the usual camera"),
        ({"saved": {"Gamma": 1.0}}, "name one"),
        ({"memory_blocks": 0}, "allowed are 1..1000"),
        ({"largest_transfer_bytes": 100}, "allowed are 4096 and more"),
    ],
)
def test_options_that_no_camera_knows_are_refused_by_name(camera: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError) as caught:
        WorldOptions(cameras={"left": camera})
    assert said in str(caught.value)


def test_a_feature_that_is_lacking_bears_a_name_of_the_makers_own(hand_time: HandTime) -> None:
    bus = Bus(hand_time, "blackfly", lacks=("TriggerOverlap",))
    with pytest.raises(LogicalErrorException):
        bus.nodes.get_node("TriggerOverlap")
    assert bus.nodes.get_node("MakerTriggerOverlap").value == "Off"
