"""One camera behind Aravis from opening to closing: in which order it is set and started, and what each failure tells."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.api import CameraSettings, CameraSpec, ClockReading, DeviceGone, DeviceRefused, FrameStatus
from drivers.aravis import AravisCamera, library
from drivers.aravis.camera import listed_cameras
from drivers.camera_families import aravis as family
from tests.drivers.aravis.foreign import ForeignLibrary, OnABus, SentImage
from tests.drivers.camera.scripted import ADDRESS, SIRM, description

SPEC = CameraSpec("camera.left", "KF-CAM-L")
SETTINGS = CameraSettings(64, 48, 8000.0, 3.0)
IMAGE = bytes(64 * 48)
HALTED = [("AcquisitionStop", 1), ("TLParamsLocked", 0)]
STARTED = [("stream", 1), ("TLParamsLocked", 1), ("latch", 1), ("AcquisitionStart", 1)]


def opened(
    foreign: ForeignLibrary, spec: CameraSpec = SPEC, protocol: str = "USB3Vision", **more: Any
) -> tuple[OnABus, AravisCamera]:
    there = foreign.add(protocol, **more)
    there.camera.set(SIRM + 4, struct.pack("<I", 1))
    return there, AravisCamera.open(spec, foreign.clock)


def streaming(foreign: ForeignLibrary, **more: Any) -> tuple[OnABus, AravisCamera]:
    there, camera = opened(foreign, **more)
    camera.configure(SETTINGS)
    camera.start()
    there.camera.log.clear()
    return there, camera


def slot() -> Any:
    return np.zeros((48, 64), np.uint8)


# ------------------------------------------------------------------------------------------- opening


def test_a_camera_that_was_left_streaming_is_stopped_when_it_is_opened(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    assert there.camera.log == HALTED
    assert there.usb_mode == 1
    assert camera.identity.serial == "KF-CAM-L"
    with camera:
        assert len(foreign.open) == 1
    camera.close()
    assert not foreign.open


@pytest.mark.parametrize(
    ("spec", "more", "said"),
    [
        (replace(SPEC, pixel_format="RGB8"), {}, "pixel_format 'RGB8' is none of Mono8, .*. Correct the rig file"),
        (SPEC, {"xml": b"<a/>"}, "its description cannot be loaded"),
        (SPEC, {"refusing": {ADDRESS["AcquisitionStop"]: 3}}, "refused the write of 4 bytes"),
    ],
)
def test_a_camera_that_cannot_be_used_says_why_and_is_let_go(
    foreign: ForeignLibrary, spec: CameraSpec, more: dict[str, Any], said: str
) -> None:
    with pytest.raises(DeviceRefused, match=said):
        opened(foreign, spec, **more)
    assert not foreign.open


def test_registers_that_make_no_sense_are_the_firmwares(foreign: ForeignLibrary) -> None:
    there = foreign.add("GigEVision", serial="GV-L", xml=description().replace("BlackLevel", "GevLinkSpeed").encode())
    there.camera.set_feature("BlackLevel", math.nan)
    with pytest.raises(DeviceRefused, match=r"its registers make no sense \(.*NaN.*\). Update its firmware"):
        AravisCamera.open(CameraSpec("camera.left", "GV-L"), foreign.clock)
    assert not foreign.open


def test_the_family_opens_and_lists_through_the_library(foreign: ForeignLibrary) -> None:
    foreign.add("USB3Vision")
    wires: Any = SimpleNamespace(clock=foreign.clock)
    with family.open_camera(SPEC, wires) as camera:
        assert camera.identity.model == "Eye"
    assert list(family.list_cameras(wires)) == ["KF-CAM-L (USB3 Vision, 10.0.0.2)"]


# ------------------------------------------------------------------------------------------- settings


def test_a_camera_is_set_whole_once_and_then_only_its_light(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    there.camera.log.clear()
    assert camera.configure(SETTINGS) == SETTINGS
    names = [name for name, _ in there.camera.log]
    assert names[:2] == ["UserSetSelector", "UserSetLoad"]
    assert {"Width", "Height", "TriggerMode", "ExposureTime"} <= set(names)
    assert {one.feature: one.held for one in camera.read_back()}["Width"] == 64
    there.camera.log.clear()
    assert camera.configure(replace(SETTINGS, exposure_us=500.0)).exposure_us == 500.0
    assert {"Width", "Height", "UserSetLoad"}.isdisjoint(name for name, _ in there.camera.log)
    assert ("ExposureTime", 500.0) in there.camera.log
    for other in (replace(SETTINGS, width_px=128), replace(SETTINGS, width_px=128, height_px=96)):
        there.camera.log.clear()
        camera.configure(other)
        names = [name for name, _ in there.camera.log]
        assert "Width" in names
        assert "UserSetLoad" not in names, "at opening only"


def test_a_size_that_was_refused_leaves_nothing_to_start_with(foreign: ForeignLibrary) -> None:
    there, camera = streaming(foreign)
    with pytest.raises(DeviceRefused, match="Width"):
        camera.configure(replace(SETTINGS, width_px=4096))
    with pytest.raises(DeviceRefused, match=r"started before it was configured\. Call configure first"):
        camera.start()
    assert there.camera.log[:2] == HALTED
    camera.configure(SETTINGS)
    camera.start()


# ------------------------------------------------------------------------------------------- streaming


def test_a_stream_starts_and_ends_in_order(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    camera.configure(SETTINGS)
    there.camera.log.clear()
    camera.start()
    assert there.camera.log == [*HALTED, *STARTED]
    assert len(foreign.open) == 2
    there.camera.log.clear()
    camera.start()
    assert there.camera.log == [*HALTED, *STARTED], "a running one begins anew"
    assert len(foreign.open) == 2
    there.camera.log.clear()
    camera.configure(SETTINGS)
    assert there.camera.log[:2] == HALTED
    assert there.camera.log[-6:] == [*HALTED, *STARTED], "a running one goes on with what was set"
    camera.stop()
    camera.stop()
    assert len(foreign.open) == 1
    with pytest.raises(DeviceRefused, match=r"asked for a frame while stopped\. Call start first"):
        camera.next_frame(slot(), 1.0)


def test_what_was_exposed_before_the_start_is_not_frame_0(foreign: ForeignLibrary) -> None:
    there, camera = streaming(foreign)
    # The camera's own clock stands half a second behind the host's.
    started_ns = foreign.clock.now_ns() - 500_000_000
    there.coming.extend(SentImage(IMAGE, number=k, stamp_ns=started_ns + k - 1) for k in (0, 1))
    frame = camera.next_frame(slot(), 1.0)
    assert (frame.status, frame.block_id) == (FrameStatus.COMPLETE, 1)


def test_a_camera_without_a_clock_starts_all_the_same(foreign: ForeignLibrary) -> None:
    there, camera = streaming(foreign, refusing={0x1F8: 3})
    there.coming.append(SentImage(IMAGE, stamp_ns=1))
    assert camera.next_frame(slot(), 1.0).status is FrameStatus.COMPLETE
    assert camera.read_clock() is None


def test_a_lost_cameras_stream_goes_all_the_same(foreign: ForeignLibrary) -> None:
    there, camera = streaming(foreign)
    there.refusing[ADDRESS["AcquisitionStop"]] = 5
    with pytest.raises(DeviceGone):
        camera.stop()
    assert len(foreign.open) == 1


@pytest.mark.parametrize("lost", [False, True])
def test_a_running_camera_is_stopped_when_it_is_closed_and_a_lost_one_without_a_word(
    foreign: ForeignLibrary, lost: bool
) -> None:
    there, camera = streaming(foreign)
    if lost:
        there.refusing[ADDRESS["AcquisitionStop"]] = 5
    camera.close()
    assert there.camera.log == ([] if lost else HALTED)
    assert not foreign.open


def test_a_stream_that_the_camera_refuses_is_told_at_its_start(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    there.camera.set(SIRM + 4, struct.pack("<I", 0))
    camera.configure(SETTINGS)
    with pytest.raises(DeviceRefused, match="images of 3072 bytes, which are no multiple of its 1024"):
        camera.start()


PAYLOAD = description().replace("BinningVertical", "PayloadSize").encode()


@pytest.mark.parametrize(("sent_bytes", "fine"), [(3071, False), (3072, True), (3073, False)])
def test_a_camera_that_sends_more_than_an_image_is_refused(
    foreign: ForeignLibrary, sent_bytes: int, fine: bool
) -> None:
    there, camera = opened(foreign, xml=PAYLOAD)
    there.camera.set_feature("BinningVertical", sent_bytes)
    camera.configure(SETTINGS)
    if fine:
        camera.start()
        return
    with pytest.raises(DeviceRefused, match=f"wants to send {sent_bytes} bytes for an image of 3072. Switch off chunk"):
        camera.start()


def test_a_size_that_cannot_be_packed_is_refused(foreign: ForeignLibrary) -> None:
    xml = (
        description(choices={"PixelFormat": ("Mono16", "Mono8", "Mono10p")})
        .replace("<Inc>8</Inc>", "<Inc>1</Inc>")
        .encode()
    )
    _, camera = opened(foreign, replace(SPEC, pixel_format="Mono10p"), xml=xml)
    camera.configure(replace(SETTINGS, width_px=65, height_px=50))
    with pytest.raises(DeviceRefused, match=r"3250 pixels cannot be packed as Mono10p\. Choose Mono8, or another size"):
        camera.start()


def test_what_is_locked_or_lacking_is_not_written(foreign: ForeignLibrary) -> None:
    there, camera = streaming(foreign, xml=description(fixed=("TLParamsLocked", "AcquisitionStop")).encode())
    camera.stop()
    assert "TLParamsLocked" not in dict(there.camera.log)
    foreign.devices.clear()
    there, camera = streaming(foreign, xml=description(lacking=("TLParamsLocked", "AcquisitionStop")).encode())
    camera.stop()
    assert there.camera.log == []


# --------------------------------------------------------------------------------------- what it says


def test_the_shortest_of_four_readings_of_the_clock_counts(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    there.camera.latches_take_s = [0.004, 0.003, 0.005, 0.001, 0.0005]
    begun_ns = foreign.clock.now_ns()
    sent_ns, received_ns = begun_ns + 12_000_000, begun_ns + 13_000_000
    assert camera.read_clock() == ClockReading(received_ns - 500_000_000, sent_ns, received_ns)


def test_a_thermometer_that_is_not_there_or_does_not_answer_is_unknown(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    assert camera.temperature_c() == 41.5
    there.refusing[ADDRESS["DeviceTemperature"]] = 3
    assert camera.temperature_c() is None
    there.refusing[ADDRESS["DeviceTemperature"]] = 5
    with pytest.raises(DeviceGone):
        camera.temperature_c()
    foreign.devices.clear()
    assert opened(foreign, xml=description(lacking=("DeviceTemperature",)).encode())[1].temperature_c() is None


def test_health_names_the_camera_its_way_and_what_it_does_not_offer(foreign: ForeignLibrary) -> None:
    there, camera = opened(foreign)
    health = camera.health()
    assert (health.device, health.ok, health.summary) == ("camera.left", True, "Reef Eye")
    assert health.details == {
        "model": "Reef Eye",
        "serial": "KF-CAM-L",
        "firmware": "1.2",
        "link": "5000 Mbit/s",
        "through": "Aravis 0.8.26, USB3Vision at 10.0.0.2",
        "temperature": "41.5 °C",
    }
    there.refusing[ADDRESS["DeviceTemperature"]] = 3
    camera.configure(SETTINGS)
    details = camera.health().details
    assert details["temperature"] == "unknown"
    assert "no ReverseX" not in details["not offered"]
    assert "no TestImageSelector, " in details["not offered"]
    there.refusing[0] = 5
    health = camera.health()
    assert not health.ok
    assert "no longer answers a read" in health.summary
    assert "temperature" not in health.details


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


def test_a_curve_of_the_grey_values_that_somebody_asked_for_is_told(foreign: ForeignLibrary) -> None:
    _, camera = opened(foreign, replace(SPEC, features=(("GammaEnable", True), ("Gamma", 0.5))))
    camera.configure(SETTINGS)
    health = camera.health()
    assert not health.ok
    assert "grey values are not proportional to light. Take that out of features" in health.summary
    assert camera.slow_link is None


# -------------------------------------------------------------------------------------------- finding


def test_a_camera_is_found_by_its_own_number_or_by_the_librarys_name(foreign: ForeignLibrary) -> None:
    foreign.add("GigEVision", serial="GV-R")
    foreign.add("USB3Vision", id="Reef-U")
    foreign.add("GigEVision", serial="GV-L")
    for serial, model in (("GV-L", 2), ("Reef-U", 1), ("KF-CAM-L", 1), ("Reef-0", 0)):
        with AravisCamera.open(CameraSpec("camera.left", serial), foreign.clock):
            assert list(foreign.open.values()) == [foreign.devices[model]]
    assert not foreign.open


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
    with pytest.raises(DeviceGone, match="serial number X not found; Aravis sees no camera"):
        AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)
    foreign.add("GigEVision", serial="GV-R")
    foreign.add("GigEVision", serial="GV-L")
    with pytest.raises(DeviceGone, match="there are GV-L, GV-R"):
        AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)


@pytest.mark.parametrize("more", [{"opens": (4, "no permission")}, {"refusing": {0x144: 3}}])
def test_a_camera_that_cannot_be_asked_is_refused_with_the_remedy_and_listed(
    foreign: ForeignLibrary, more: dict[str, Any]
) -> None:
    foreign.add("USB3Vision", id="Reef-U", address="", **more)
    with pytest.raises(DeviceRefused, match=r"X not found, and a camera could not be asked for its own \(Reef-U: .*\)"):
        AravisCamera.open(CameraSpec("camera.left", "X"), foreign.clock)
    (line,) = listed_cameras(library.library("cameras"))
    assert line.startswith("serial number not readable (")
    assert line.endswith(") (USB3 Vision, Reef-U)")
    assert not foreign.open
    foreign.add("GigEVision", serial="GV-L")
    AravisCamera.open(CameraSpec("camera.left", "GV-L"), foreign.clock).close()


def test_each_camera_is_listed_with_how_it_speaks_and_where_but_for_the_built_in(foreign: ForeignLibrary) -> None:
    foreign.add("Fake", serial="1")
    foreign.add("GigEVision", serial="")
    foreign.add("CoaXPress", serial="C1", address=None)
    assert list(listed_cameras(library.library("cameras"))) == [
        "no serial number (GigE Vision, 10.0.0.2)",
        "C1 (CoaXPress, Reef-2)",
    ]
