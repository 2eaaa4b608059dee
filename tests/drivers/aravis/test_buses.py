"""What differs between USB3 Vision and GigE Vision: who a camera is, its clock, its numbers, and whether it is still there."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.api import ClockReading, DeviceGone, DeviceRefused
from drivers.aravis import library
from drivers.aravis.buses import Bus, NetworkBus, UsbBus, bus_of
from drivers.aravis.device import AravisDevice
from drivers.camera.features import Features
from tests.drivers.aravis.foreign import LATCH, TICKS, ForeignLibrary, OnABus
from tests.drivers.camera.scripted import SBRM, SIRM, description

TICKS_HZ = 0x93C


def plugged(foreign: ForeignLibrary, protocol: str, **more: Any) -> tuple[OnABus, AravisDevice, Bus]:
    there = foreign.add(protocol, **more)
    aravis = library.library("camera.left")
    device = AravisDevice("camera.left", aravis, aravis.cameras()[0])
    there.asked.clear()
    return there, device, bus_of(device)


def features(device: AravisDevice, xml: str | None = None) -> Features:
    return Features("camera.left", description() if xml is None else xml, device)


@pytest.mark.parametrize(
    ("protocol", "bus", "needed_mbps"),
    [("USB3Vision", UsbBus, 5000), ("GigEVision", NetworkBus, 1000), ("Fake", NetworkBus, 1000)],
)
def test_a_bus_is_known_by_its_protocol_and_tells_a_slow_link(
    foreign: ForeignLibrary, protocol: str, bus: type[Bus], needed_mbps: int
) -> None:
    made = plugged(foreign, protocol)[2]
    assert type(made) is bus
    slow = str(made.slow_link(needed_mbps - 1))
    assert f"{needed_mbps - 1} Mbit/s" in slow
    assert f"({needed_mbps})" in slow
    assert made.slow_link(needed_mbps) is made.slow_link(None) is None


def test_a_usb_camera_says_who_it_is_and_whether_it_is_there_and_images_wait_in_the_kernel(
    foreign: ForeignLibrary,
) -> None:
    there, device, bus = plugged(foreign, "USB3Vision")
    bus.confirm(3072)
    assert not there.asked, "where its stream's registers are is not known yet"
    who = bus.identity(features(device))
    assert (who.vendor, who.model, who.serial, who.firmware) == ("Reef", "Eye", "KF-CAM-L", "1.2")
    assert who.link_speed_mbps == 5000
    assert bus.prepare() == ""
    assert there.usb_mode == 1
    assert bus.block_id(0) == 0
    with pytest.raises(DeviceRefused, match=r"3072 bytes, .* 1024 bytes"):
        bus.confirm(3072)
    there.camera.set(SIRM + 4, struct.pack("<I", 1))
    bus.confirm(3072)
    there.camera.set(SBRM + 0x40, struct.pack("<I", 4))
    assert bus.identity(features(device)).link_speed_mbps == 480
    there.asked.clear()
    bus.check()
    assert there.asked == [("read", 0, 4)]
    there.refusing[0] = 18  # busy is there
    bus.check()
    there.refusing[0] = 5
    with pytest.raises(DeviceGone, match="no longer answers"):
        bus.check()


def networked(foreign: ForeignLibrary, protocol: str = "GigEVision", **more: Any) -> tuple[OnABus, AravisDevice, Bus]:
    there, device, bus = plugged(foreign, protocol, **more)
    for address, size, text in ((0x48, 32, "V" * 32), (0x68, 32, "M" * 32), (0x88, 32, " 1.7 "), (0xD8, 16, "N" * 16)):
        there.camera.set(address, text.encode().ljust(size, b"\0"))
    there.camera.set(TICKS_HZ, struct.pack(">Q", 125_000_000))
    there.camera.set(TICKS, struct.pack(">Q", 250_000_001))
    return there, device, bus


def test_a_network_camera_says_who_it_is_and_how_fast_its_link_is(foreign: ForeignLibrary) -> None:
    there, device, bus = networked(foreign)
    who = bus.identity(features(device))
    assert (who.vendor, who.model, who.firmware, who.serial) == ("V" * 32, "M" * 32, "1.7", "N" * 16)
    assert who.link_speed_mbps is None
    there.camera.set(0xD8, bytes(16))
    there.camera.set_feature("BlackLevel", 2500.0)
    who = bus.identity(features(device, description().replace("BlackLevel", "GevLinkSpeed")))
    assert (who.serial, who.link_speed_mbps) == ("S0", 2500), "without a number of its own the listed one"


def test_the_network_clock_counts_ticks(foreign: ForeignLibrary) -> None:
    there, _, bus = networked(foreign)
    sent_ns = foreign.clock.now_ns()
    assert bus.read_clock(foreign.clock) == ClockReading(2_000_000_008, sent_ns, sent_ns + 100_000)
    assert there.camera.log == [("latch", 2)]
    there.camera.set(TICKS, bytes(8))
    assert bus.read_clock(foreign.clock) is None, "a clock that stands at zero was not latched"
    there.camera.set(TICKS, struct.pack(">Q", 1))
    assert bus.read_clock(foreign.clock) is not None
    there.refusing[LATCH] = 12
    assert bus.read_clock(foreign.clock) is None
    there.camera.set(TICKS_HZ, bytes(8))
    assert bus.read_clock(foreign.clock) is None


@pytest.mark.parametrize("protocol", ["GigEVision", "Fake"])
def test_only_a_real_network_camera_can_be_lost_to_another_program(foreign: ForeignLibrary, protocol: str) -> None:
    there, _, bus = networked(foreign, protocol)
    bus.check()
    bus.confirm(3072)
    assert bus.prepare() == ("packets of 8192 bytes" if protocol == "GigEVision" else "")
    there.controlled = False
    if protocol == "Fake":
        bus.check()
        assert bus.prepare() == ""
        return
    with pytest.raises(DeviceGone, match="no longer answers over the network"):
        bus.check()
    with pytest.raises(DeviceRefused, match=r"another program controls the camera\. Stop it"):
        bus.prepare()
    there.controlled, there.fails = True, {"packet": 5}
    with pytest.raises(DeviceGone, match="packet sizes"):
        bus.prepare()


@pytest.mark.parametrize(
    ("protocol", "wire", "numbers"),
    [
        ("GigEVision", [0, 1, 2], [None, 1, 2]),
        ("GigEVision", [65534, 65535, 1, 2, 65535, 1], [65534, 65535, 65536, 65537, 131070, 131071]),
        # A frame that comes late by some does not go round, half of the circle backwards does.
        ("GigEVision", [40_000, 7_232], [40_000, 7_232]),
        ("GigEVision", [40_001, 7_232], [40_001, 7_232 + 65535]),
        ("Fake", [0, 1, 65535, 65536, 1], [0, 1, 65535, 65536, 1]),
    ],
)
def test_sixteen_bits_go_round_from_65535_to_1(
    foreign: ForeignLibrary, protocol: str, wire: list[int], numbers: list[int | None]
) -> None:
    bus = networked(foreign, protocol)[2]
    assert [bus.block_id(one) for one in wire] == numbers
