"""One camera behind Aravis from opening to closing: in which order it is set and started, and what each failure tells."""

from __future__ import annotations

import math
import struct
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.api import CameraSettings, CameraSpec, DeviceGone, DeviceRefused
from drivers.aravis import AravisCamera, library
from drivers.aravis.camera import listed_cameras
from drivers.camera_families import aravis as family
from tests.drivers.aravis.foreign import ForeignLibrary, OnABus
from tests.drivers.camera.scripted import ADDRESS, SIRM, description

SPEC = CameraSpec("camera.left", "KF-CAM-L")
SETTINGS = CameraSettings(64, 48, 8000.0, 3.0)


def opened(
    foreign: ForeignLibrary, spec: CameraSpec = SPEC, protocol: str = "USB3Vision", **more: Any
) -> tuple[OnABus, AravisCamera]:
    there = foreign.add(protocol, **more)
    there.camera.set(SIRM + 4, struct.pack("<I", 1))
    return there, AravisCamera.open(spec, foreign.clock)


def test_registers_that_make_no_sense_are_the_firmwares(foreign: ForeignLibrary) -> None:
    there = foreign.add("GigEVision", serial="GV-L", xml=description().replace("BlackLevel", "GevLinkSpeed").encode())
    there.camera.set_feature("BlackLevel", math.nan)
    with pytest.raises(DeviceRefused, match=r"its registers contradict each other \(.*NaN.*\). Update its firmware"):
        AravisCamera.open(CameraSpec("camera.left", "GV-L"), foreign.clock)
    assert not foreign.open


PAYLOAD = description().replace("BinningVertical", "PayloadSize").encode()


@pytest.mark.parametrize(("sent_bytes", "fine"), [(3071, False), (3072, True), (3073, False)])
def test_a_camera_that_sends_more_than_an_image_is_refused_and_a_lost_ones_stream_goes_all_the_same(
    foreign: ForeignLibrary, sent_bytes: int, fine: bool
) -> None:
    there, camera = opened(foreign, xml=PAYLOAD)
    there.camera.set_feature("BinningVertical", sent_bytes)
    camera.configure(SETTINGS)
    if not fine:
        said = f"sends {sent_bytes} bytes for an image of 3072. Switch off chunk"
        with pytest.raises(DeviceRefused, match=said):
            camera.start()
        return
    camera.start()
    there.refusing[ADDRESS["AcquisitionStop"]] = 5
    with pytest.raises(DeviceGone):
        camera.stop()
    assert len(foreign.open) == 1


def test_health_of_a_network_camera_has_its_packets_and_a_slow_link(foreign: ForeignLibrary) -> None:
    xml = description().replace("BlackLevel", "GevLinkSpeed").encode()
    there = foreign.add("GigEVision", serial="KF-CAM-L", xml=xml)
    health = AravisCamera.open(SPEC, foreign.clock).health()
    assert not health.ok
    assert health.summary == "link slow: 0 Mbit/s. Check connector and cable"
    assert health.details["transport"] == "packets of 8192 bytes"
    there.camera.set_feature("BlackLevel", 1000.0)
    assert AravisCamera.open(SPEC, foreign.clock).health().ok
    there.xml = description().encode()
    health = AravisCamera.open(SPEC, foreign.clock).health()
    assert health.ok
    assert health.details["link"] == "unknown"


def test_a_camera_is_found_by_its_own_number_or_by_the_librarys_name_and_listed(foreign: ForeignLibrary) -> None:
    wires: Any = SimpleNamespace(clock=foreign.clock)
    foreign.add("GigEVision", serial="GV-R")
    foreign.add("USB3Vision", id="Reef-U")
    foreign.add("GigEVision", serial="")
    foreign.add("CoaXPress", serial="C1", address=None)
    foreign.add("Fake", serial="1")
    for serial, model in (("GV-R", 0), ("Reef-U", 1), ("KF-CAM-L", 1), ("Reef-2", 2)):
        with family.open_camera(CameraSpec("camera.left", serial), wires):
            assert list(foreign.open.values()) == [foreign.devices[model]]
    assert not foreign.open
    assert list(family.list_cameras(wires)) == [
        "GV-R (GigE Vision, 10.0.0.2)",
        "KF-CAM-L (USB3 Vision, 10.0.0.2)",
        "no serial number (GigE Vision, 10.0.0.2)",
        "C1 (CoaXPress, Reef-3)",
    ]


def test_a_usb_cameras_own_number_is_asked_for_once(foreign: ForeignLibrary) -> None:
    """What is open cannot be asked again."""
    there = foreign.add("USB3Vision")
    asked = ("read", 0x144, 64)
    for _ in range(2):
        with pytest.raises(DeviceGone, match=r"serial number X not found; there are KF-CAM-L\. Check the connector"):
            AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)
    assert list(listed_cameras(library.library("cameras"))) == ["KF-CAM-L (USB3 Vision, 10.0.0.2)"]
    assert there.asked == [asked]
    assert not foreign.open


def test_a_camera_that_is_not_there_is_gone_with_the_others_in_order_and_without_the_built_in(
    foreign: ForeignLibrary,
) -> None:
    foreign.add("Fake", serial="1")
    for added, said in ((), "sees no camera"), (("GV-R", "GV-L"), "there are GV-L, GV-R"):
        for serial in added:
            foreign.add("GigEVision", serial=serial)
        with pytest.raises(DeviceGone, match=f"serial number X not found; .*{said}"):
            AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)


@pytest.mark.parametrize("more", [{"opens": (4, "no permission")}, {"refusing": {0x144: 3}}])
def test_a_camera_that_cannot_be_asked_is_refused_with_the_remedy_and_listed(
    foreign: ForeignLibrary, more: dict[str, Any]
) -> None:
    foreign.add("USB3Vision", id="Reef-U", address="", **more)
    with pytest.raises(
        DeviceRefused, match=r"X not found, and the serial number of a camera cannot be read \(Reef-U: .*\)"
    ):
        AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)
    (line,) = listed_cameras(library.library("cameras"))
    assert line.startswith("serial number not readable (")
    assert line.endswith(") (USB3 Vision, Reef-U)")
    assert not foreign.open
    foreign.add("GigEVision", serial="GV-L")
    AravisCamera.open(CameraSpec("camera.left", "GV-L"), foreign.clock).close()
