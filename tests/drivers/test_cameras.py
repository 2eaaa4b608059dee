"""What every family's camera does alike from opening to closing: one suite for our own driver and for Aravis."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from drivers.api import CameraSettings, CameraSpec, ClockReading, DeviceGone, DeviceRefused, Frame, FrameStatus
from drivers.aravis import AravisCamera
from drivers.camera import UsbVisionCamera
from tests.drivers.aravis.foreign import ForeignLibrary, SentImage
from tests.drivers.camera.scripted import (
    ADDRESS,
    CHOICES,
    FLAGS,
    FLOATS,
    SIRM,
    WHOLE,
    Bus,
    ScriptedCamera,
    description,
    frame_of,
)
from tests.drivers.clock import SteppedClock

SPEC = CameraSpec("camera.left", "KF-CAM-L")
SETTINGS = CameraSettings(64, 48, 8000.0, 3.0)
LATCH = 0x1F8
HALTED = ["AcquisitionStop", "TLParamsLocked"]
STARTED = ["TLParamsLocked", "latch", "AcquisitionStart"]


@dataclass
class Camera:
    """A camera, its registers, and what differs between the ways to it."""

    device: ScriptedCamera
    open: Callable[[CameraSpec], Any]
    lose: Callable[[], None]
    refuse: Callable[[int], None]
    send: Callable[[int, int], None]
    """Send one image of a block at a time of the camera's clock."""
    left_open: Callable[[], int]

    def streaming(self, spec: CameraSpec = SPEC) -> Any:
        camera = self.open(spec)
        camera.configure(SETTINGS)
        camera.start()
        self.device.log.clear()
        return camera

    def done(self) -> list[str]:
        """Return and forget what was written of what starts and ends a stream."""
        names = [name for name, _ in self.device.log if name in {*HALTED, *STARTED}]
        self.device.log.clear()
        return names


def usb3vision(xml: str, foreign: ForeignLibrary) -> Camera:
    device = ScriptedCamera(SteppedClock(), xml)
    return Camera(
        device,
        lambda spec: UsbVisionCamera.open(spec, Bus(device), device.clock),
        lambda: setattr(device, "plugged", False),
        lambda address: device.refusing.update({address: 0x8003}),
        lambda block, stamp_ns: device.stream.extend(frame_of(bytes(3072), block, stamp_ns)),
        lambda: int(device.is_open),
    )


def aravis(xml: str, foreign: ForeignLibrary) -> Camera:
    there = foreign.add("USB3Vision", xml=xml.encode())
    there.camera.set(SIRM + 4, struct.pack("<I", 1))  # the library enables the stream
    return Camera(
        there.camera,
        lambda spec: AravisCamera.open(spec, foreign.clock),
        lambda: setattr(there, "lost", True),
        lambda address: there.refusing.update({address: 3}),
        lambda block, stamp_ns: there.coming.append(SentImage(bytes(3072), number=block, stamp_ns=stamp_ns)),
        lambda: len(foreign.open),
    )


Make = Callable[[str], Camera]


@pytest.fixture(params=[usb3vision, aravis])
def make(request: pytest.FixtureRequest, foreign: ForeignLibrary) -> Make:
    return lambda xml: request.param(xml, foreign)


@pytest.fixture
def there(make: Make) -> Camera:
    return make(description())


def next_frame(camera: Any) -> Frame:
    frame = camera.next_frame(np.zeros((48, 64), np.uint8), 0.1)
    assert isinstance(frame, Frame)
    return frame


def test_a_camera_that_was_left_streaming_is_stopped_when_it_is_opened_and_let_go_once(there: Camera) -> None:
    with there.open(SPEC) as camera:
        assert there.done() == HALTED
        assert there.left_open() == 1
    camera.close()
    assert there.done() == []
    assert not there.left_open()
    there.refuse(ADDRESS["AcquisitionStop"])
    with pytest.raises(DeviceRefused, match="refused the write of 4 bytes"):
        there.open(SPEC)
    assert not there.left_open(), "one that does not let itself be stopped is let go"


@pytest.mark.parametrize(
    ("spec", "xml", "said"),
    [
        (replace(SPEC, pixel_format="RGB8"), description(), r"'RGB8'.* Mono8, "),
        (SPEC, "<a/>", "its description cannot be loaded"),
    ],
)
def test_a_camera_that_cannot_be_used_says_why_and_is_let_go(make: Make, spec: CameraSpec, xml: str, said: str) -> None:
    there = make(xml)
    with pytest.raises(DeviceRefused, match=f"^camera.left: .*{said}"):
        there.open(spec)
    assert not there.left_open()


def test_a_camera_is_set_whole_once_and_then_only_its_light(there: Camera) -> None:
    camera = there.open(SPEC)
    for settings, width, unloaded in (
        (SETTINGS, True, 1),
        (replace(SETTINGS, exposure_us=500.0), False, 0),
        (replace(SETTINGS, width_px=128), True, 0),
        (replace(SETTINGS, width_px=128, height_px=96), True, 0),
    ):
        there.device.log.clear()
        assert camera.configure(settings) == settings
        names = [name for name, _ in there.device.log]
        assert ("Width" in names) is ("TriggerOverlap" in names) is width
        assert names.count("UserSetLoad") == unloaded, "at opening only"
        assert ("ExposureTime", settings.exposure_us) in there.device.log
        held = {one.feature: one.held for one in camera.read_back()}
        assert (held["Width"], held["ExposureTime"]) == (settings.width_px, settings.exposure_us)
    camera.configure(SETTINGS)
    camera.start()
    there.done()
    with pytest.raises(DeviceRefused, match="Width"):
        camera.configure(replace(SETTINGS, width_px=4096))
    with pytest.raises(DeviceRefused, match="before it was configured"):
        camera.start()
    assert there.done()[:2] == HALTED, "a size that was refused leaves nothing to start with"
    camera.configure(SETTINGS)
    camera.start()


def test_a_stream_starts_and_ends_in_order(there: Camera) -> None:
    camera = there.open(SPEC)
    with pytest.raises(DeviceRefused, match="before it was configured"):
        camera.start()
    camera.configure(SETTINGS)
    there.done()
    for _ in range(2):
        camera.start()
        assert there.done() == [*HALTED, *STARTED], "also one that runs begins anew"
    camera.configure(replace(SETTINGS, exposure_us=500.0))
    assert there.done() == [*HALTED, *HALTED, *STARTED], "it goes on with what was set"
    camera.stop()
    assert there.done() == HALTED
    with pytest.raises(DeviceRefused, match="while stopped"):
        next_frame(camera)
    camera.configure(SETTINGS)
    assert there.done() == [], "it did not stream"


@pytest.mark.parametrize("lost", [False, True])
def test_a_running_camera_is_stopped_when_it_is_closed_and_a_lost_one_without_a_word(there: Camera, lost: bool) -> None:
    camera = there.streaming()
    if lost:
        there.lose()
    camera.close()
    assert there.done() == ([] if lost else HALTED)
    assert not there.left_open()
    with pytest.raises(DeviceRefused, match="while stopped"):
        next_frame(camera)


def test_the_clock_is_read_four_times_and_the_reading_in_which_least_time_passed_counts(there: Camera) -> None:
    camera = there.open(SPEC)
    there.done()
    there.device.latches_take_s = [0.02, 0.004, 0.001, 0.009, 0.0005]
    begun_ns = there.device.clock.now_ns()
    received_ns = begun_ns + 25_000_000
    assert camera.read_clock() == ClockReading(received_ns - 500_000_000, received_ns - 1_000_000, received_ns)
    assert there.done() == ["latch"] * 4


def test_what_was_exposed_before_the_start_is_none_of_its_frames_but_of_a_camera_without_a_clock(there: Camera) -> None:
    camera = there.streaming()
    # The camera's own clock stands half a second behind the host's.
    begun_ns = there.device.clock.now_ns() - 500_000_000
    there.send(14, begun_ns - 12_000_000)
    there.send(1, begun_ns + 20_000_000)
    frame = next_frame(camera)
    assert (frame.status, frame.block_id) == (FrameStatus.COMPLETE, 1)
    there.refuse(LATCH)
    camera.start()
    assert camera.read_clock() is None
    there.send(14, 1)
    assert next_frame(camera).block_id == 14
    there.lose()
    with pytest.raises(DeviceGone):
        camera.read_clock()


def test_health_says_what_the_camera_is_what_it_does_not_offer_and_that_it_is_gone(there: Camera) -> None:
    camera = there.open(replace(SPEC, features=(("GammaEnable", True), ("Gamma", 0.5))))
    who = camera.identity
    assert (who.vendor, who.model, who.serial, who.firmware) == ("Reef", "Eye", "KF-CAM-L", "1.2")
    health = camera.health()
    assert (health.device, health.ok, health.summary) == ("camera.left", True, "Reef Eye")
    told = {
        "model": "Reef Eye",
        "serial": "KF-CAM-L",
        "firmware": "1.2",
        "link": "5000 Mbit/s",
        "temperature": "41.5 °C",
    }
    assert told.items() <= health.details.items()
    assert camera.temperature_c() == 41.5
    there.refuse(ADDRESS["DeviceTemperature"])
    assert camera.temperature_c() is None, "unknown is not zero"
    camera.configure(SETTINGS)
    health = camera.health()
    assert health.details["temperature"] == "unknown"
    assert "no ReverseX" not in health.details["not offered"]
    assert "no TestImageSelector, " in health.details["not offered"]
    assert not health.ok
    assert "Gamma is 0.5" in health.summary, "a curve of the grey values that somebody asked for"
    there.lose()
    lost = camera.health()
    assert not lost.ok
    assert "temperature" not in lost.details
    with pytest.raises(DeviceGone):
        camera.temperature_c()


def test_a_camera_without_the_optional_features_works_all_the_same(make: Make) -> None:
    needed = {"Width", "Height", "PixelFormat", "TriggerSource", "TriggerMode", "ExposureTime", "Gain"}
    optional = tuple(sorted({*CHOICES, *WHOLE, *FLOATS, *FLAGS, "UserSetLoad", "AcquisitionStop"} - needed))
    there = make(description(lacking=optional))
    camera = there.open(SPEC)
    assert camera.configure(SETTINGS) == SETTINGS
    camera.start()
    camera.stop()
    assert camera.temperature_c() is None
    assert ("AcquisitionStart", 1) in there.device.log
    assert not {name for name, _ in there.device.log} & set(optional)


def test_what_is_locked_is_not_written_and_a_size_that_cannot_be_packed_is_refused(make: Make) -> None:
    xml = description(choices={"PixelFormat": ("Mono16", "Mono8", "Mono10p")}, fixed=("TLParamsLocked",))
    there = make(xml.replace("<Inc>8</Inc>", "<Inc>1</Inc>"))
    with there.streaming() as camera:
        camera.stop()
    assert "TLParamsLocked" not in there.done()
    camera = there.open(replace(SPEC, pixel_format="Mono10p"))
    camera.configure(replace(SETTINGS, width_px=65, height_px=50))
    with pytest.raises(DeviceRefused, match=r"3250 pixels .* Mono10p"):
        camera.start()
