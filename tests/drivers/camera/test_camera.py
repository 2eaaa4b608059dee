"""One camera from opening to closing: which registers are set to what, in which order, and what each failure tells."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from drivers.api import CameraSettings, ClockReading, DeviceGone, DeviceRefused, FrameStatus
from drivers.camera import CameraSpec, UsbVisionCamera
from drivers.camera.stream import StreamCounters
from tests.drivers.camera.scripted import ADDRESS, MANIFEST, SBRM, SIRM, ScriptedCamera, description
from tests.drivers.clock import SteppedClock

SPEC = CameraSpec("camera.left", "KF-CAM-L")
SETTINGS = CameraSettings(64, 48, 8000.0, 3.0)


def opened(
    prepare: Callable[[ScriptedCamera], None] = lambda device: None, xml: str | None = None, spec: CameraSpec = SPEC
) -> tuple[ScriptedCamera, UsbVisionCamera]:
    device = ScriptedCamera(SteppedClock(), xml)
    prepare(device)
    camera = UsbVisionCamera.open(spec, device, device.clock)
    return device, camera


def configured(settings: CameraSettings = SETTINGS) -> tuple[ScriptedCamera, UsbVisionCamera]:
    device, camera = opened(lambda device: device.needs(settings.width_px * settings.height_px))
    camera.configure(settings)
    device.log.clear()
    return device, camera


def streaming() -> tuple[ScriptedCamera, UsbVisionCamera]:
    device, camera = configured()
    camera.start()
    device.log.clear()
    return device, camera


HALTED = [("AcquisitionStop", 1), ("SIRM control", 0), ("TLParamsLocked", 0)]
STARTED = [("TLParamsLocked", 1), ("SIRM control", 1), ("latch", 1), ("AcquisitionStart", 1)]
PREPARED = [
    *(("SIRM leader", 52), ("SIRM trailer", 32), ("SIRM transfer", 3072), ("SIRM transfers", 1)),
    *(("SIRM final 1", 0), ("SIRM final 2", 0), ("clear halt", 0x82)),
]


# ------------------------------------------------------------------------------------------- opening


def test_who_the_camera_is_stands_in_its_registers() -> None:
    _, camera = opened()
    who = camera.identity
    assert (who.vendor, who.model, who.serial, who.firmware) == ("Reef", "Eye", "KF-CAM-L", "1.2")
    assert who.link_speed_mbps == 5000


def test_a_camera_that_was_left_streaming_is_stopped_when_it_is_opened() -> None:
    device, _ = opened()
    assert device.log == HALTED
    assert device.claimed == [0, 1]


@pytest.mark.parametrize(
    ("host", "sbrm", "mbps", "fast"),
    [
        (4, 4, 5000, True),
        (3, 8, 480, False),
        (5, 8, 10000, True),
        (None, 8, 5000, True),
        (None, 4, 480, False),
        (None, 2, 12, False),
        (None, 1, 2, False),
        (None, 16, 10000, True),
        (None, 0, None, None),
        (0, 4, 480, False),
    ],
)
def test_the_host_knows_the_link_best_and_the_camera_where_the_host_does_not_say(
    host: int | None, sbrm: int, mbps: int | None, fast: bool | None
) -> None:
    def prepare(device: ScriptedCamera) -> None:
        device.speed = host
        device.set(SBRM + 0x40, struct.pack("<I", sbrm))

    _, camera = opened(prepare)
    assert (camera.identity.link_speed_mbps, camera.link_is_fast) == (mbps, fast)
    slow = f"the link runs at {mbps} Mbit/s; SuperSpeed (5000) is needed"
    assert camera.slow_link == (slow if fast is False else None)
    assert camera.health().details["link"] == ("unknown" if mbps is None else f"{mbps} Mbit/s")
    assert camera.health().ok == (fast is not False)


def test_packets_are_as_long_as_the_camera_says_it_can_take_and_give() -> None:
    device, _ = opened()
    assert device.longest_read == 256 - 12
    small, _ = opened(lambda device: device.set(SBRM + 0x18, struct.pack("<I", 100)))
    assert small.longest_read == 88


@pytest.mark.parametrize(
    ("prepare", "said"),
    [
        (lambda device: device.set(SBRM + 0x1C, struct.pack("<I", 0)), "the camera has no image stream"),
        (lambda device: device.set(MANIFEST, struct.pack("<Q", 0)), "the manifest claims 0 files"),
        (lambda device: device.set(MANIFEST, struct.pack("<Q", 65)), "the manifest claims 65 files; 1 to 64"),
        (lambda device: device.set(MANIFEST + 12, struct.pack("<I", 5 << 10)), "no readable description"),
        (lambda device: device.set(MANIFEST + 32, b"\1" * 20), "does not match its SHA-1"),
        (lambda device: device.set(0x1D8, struct.pack("<Q", (1 << 64) - 0x20)), "outside 64 bits"),
        (lambda device: device.refusing.update({SIRM + 0x04: 0x8006}), "ACCESS_DENIED"),
    ],
)
def test_a_camera_that_cannot_be_used_says_why_and_is_let_go(
    prepare: Callable[[ScriptedCamera], None], said: str
) -> None:
    device = ScriptedCamera(SteppedClock())
    prepare(device)
    with pytest.raises(DeviceRefused, match=said) as caught:
        UsbVisionCamera.open(SPEC, device, device.clock)
    assert caught.value.device == "camera.left"
    assert (device.is_open, device.claimed) == (False, [])


def test_a_zipped_description_serves_as_well() -> None:
    device = ScriptedCamera(SteppedClock(), zipped=True)
    UsbVisionCamera.open(SPEC, device, device.clock).configure(SETTINGS)
    assert device.feature("Width") == 64


# ------------------------------------------------------------------------------------------- settings


def test_every_setting_that_decides_about_an_image_is_made() -> None:
    device, camera = opened()
    device.set_feature("OffsetX", 16)
    device.set_feature("OffsetY", 8)
    assert camera.configure(SETTINGS) == SETTINGS
    wanted = {
        "AcquisitionMode": "Continuous", "PixelFormat": "Mono8", "OffsetX": 0, "OffsetY": 0, "Width": 64, "Height": 48,
        "TriggerSelector": "FrameStart", "TriggerSource": "Line1", "TriggerActivation": "RisingEdge", "TriggerMode": "On",
        "ExposureAuto": "Off", "GainAuto": "Off", "ExposureMode": "Timed", "GainSelector": "All",
        "ExposureTime": 8000.0, "Gain": 3.0,
    }  # fmt: skip
    assert {name: device.feature(name) for name in wanted} == wanted
    order = [name for name, _ in device.log if name in wanted]
    for before, behind in (
        ("OffsetX", "Width"), ("OffsetY", "Height"), ("TriggerSelector", "TriggerSource"),
        ("TriggerSource", "TriggerMode"), ("ExposureAuto", "ExposureTime"), ("GainAuto", "Gain"), ("GainSelector", "Gain"),
    ):  # fmt: skip
        assert order.index(before) < order.index(behind), f"{before} comes before {behind}"


def test_what_a_camera_made_of_its_settings_is_what_is_returned() -> None:
    _, camera = opened()
    got = camera.configure(CameraSettings(64, 48, 8000.3, 3.3))
    assert got.exposure_us == struct.unpack("<f", struct.pack("<f", 8000.3))[0]
    assert got.gain_db == struct.unpack("<f", struct.pack("<f", 3.3))[0]


def test_a_size_that_the_camera_rounds_is_refused_with_both_numbers() -> None:
    device, camera = opened(lambda device: device.rounding.update(Height=46))
    with pytest.raises(DeviceRefused, match="Height: asked for 48 px, got 46 px"):
        camera.configure(SETTINGS)
    assert device.feature("Width") == 64


def test_the_trigger_comes_from_the_line_that_the_rig_file_names_or_the_first_there_is() -> None:
    device, camera = opened(spec=CameraSpec("camera.left", "KF-CAM-L", "Line2"))
    camera.configure(SETTINGS)
    assert device.feature("TriggerSource") == "Line2"
    _, camera = opened(xml=description(choices={"TriggerSource": ("Software", "Counter0End")}))
    with pytest.raises(DeviceRefused, match="offers no line as trigger source"):
        camera.configure(SETTINGS)


def test_a_camera_without_the_optional_features_is_configured_all_the_same() -> None:
    optional = (
        *("AcquisitionMode", "OffsetX", "OffsetY", "TriggerSelector", "TriggerActivation", "ExposureAuto"),
        *("GainAuto", "ExposureMode", "GainSelector", "TLParamsLocked"),
    )
    device, camera = opened(xml=description(lacking=optional))
    assert camera.configure(SETTINGS) == SETTINGS
    camera.start()
    assert ("AcquisitionStart", 1) in device.log
    assert not {name for name, _ in device.log} & set(optional)


def test_a_choice_that_a_camera_does_not_offer_is_left_as_it_is() -> None:
    device, camera = opened(xml=description(choices={"ExposureMode": ("TriggerWidth",)}))
    camera.configure(SETTINGS)
    assert "ExposureMode" not in [name for name, _ in device.log]


def test_without_a_gain_none_can_be_asked_for() -> None:
    _, camera = opened(xml=description(lacking=("Gain", "GainSelector", "GainAuto")))
    with pytest.raises(DeviceRefused, match=r"has no gain to set.*gain_db = 0"):
        camera.configure(SETTINGS)
    assert camera.configure(CameraSettings(64, 48, 8000.0, 0.0)).gain_db == 0.0


# ------------------------------------------------------------------------------------------- the stream


def test_a_stream_is_prepared_while_it_is_disabled_and_the_acquisition_begins_last() -> None:
    device, camera = configured()
    camera.start()
    assert device.log == [*HALTED, *PREPARED, *STARTED]


def test_a_second_start_begins_with_a_stop() -> None:
    device, camera = streaming()
    camera.start()
    assert device.log == [*HALTED, *PREPARED, *STARTED]


@pytest.mark.parametrize(
    ("size", "alignment_bits", "transfer"),
    [((64, 48), 10, 3072), ((40, 30), 10, 2048), ((40, 30), 4, 1200), ((40, 30), 0, 1200), ((24, 42), 5, 1024)],
)
def test_an_image_is_one_transfer_of_whole_units(size: tuple[int, int], alignment_bits: int, transfer: int) -> None:
    width, height = size
    device, camera = opened(lambda device: device.needs(width * height, alignment_bits))
    camera.configure(CameraSettings(width, height, 8000.0, 0.0))
    camera.start()
    assert ("SIRM transfer", transfer) in device.log


@pytest.mark.parametrize(
    ("leader", "trailer", "buffer"),
    [(52, 32, 1024), (1024, 32, 1024), (1025, 32, 2048), (52, 2049, 3072), (20, 20, 1024)],
)
def test_there_is_room_for_the_longest_leader_and_trailer_in_whole_packets(
    leader: int, trailer: int, buffer: int
) -> None:
    device, camera = opened(lambda device: device.needs(leader=leader, trailer=trailer))
    camera.configure(SETTINGS)
    camera.start()
    assert ("SIRM leader", leader) in device.log
    assert ("SIRM trailer", trailer) in device.log
    device.stream_buffers.clear()
    camera.next_frame(np.zeros((48, 64), np.uint8), 0.1)
    assert device.stream_buffers == [buffer]


@pytest.mark.parametrize("payload", [64 * 48 - 1, 64 * 48 + 16])
def test_more_than_the_pixels_or_less_is_refused_before_anything_streams(payload: int) -> None:
    device, camera = opened(lambda device: device.needs(payload))
    camera.configure(SETTINGS)
    with pytest.raises(DeviceRefused, match=f"wants to send {payload} bytes for an image of 3072"):
        camera.start()
    assert not any(entry in device.log for entry in STARTED)


def frame_of(pixels: bytes, block: int = 9, stamp_ns: int = 10**15) -> list[bytes]:
    leader = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, block, 0, 1, stamp_ns, 0x01080001, 64, 48, 0, 0, 0, 0)
    return [leader, pixels, struct.pack("<4sHHQHHQI", b"U3VT", 0, 32, block, 0, 0, 3072, 48)]


def test_frames_are_counted_from_each_start_on() -> None:
    device, camera = streaming()
    slot = np.zeros((48, 64), np.uint8)
    device.stream = frame_of(bytes(range(256)) * 12)
    frame = camera.next_frame(slot, 0.1)
    assert (frame.status, frame.block_id, frame.camera_time_ns) == (FrameStatus.COMPLETE, 9, 10**15)
    assert slot.tobytes() == bytes(range(256)) * 12
    assert camera.next_frame(slot, 0.1).status is FrameStatus.TIMEOUT
    assert camera.stream_counters == StreamCounters(frames=2, timeouts=1)
    camera.start()
    assert camera.stream_counters == StreamCounters()
    camera.next_frame(slot, 0.1)
    camera.stop()
    assert camera.stream_counters == StreamCounters()


def test_what_lay_in_the_pipe_is_thrown_away_by_a_start() -> None:
    device, camera = configured()
    device.stream = frame_of(bytes(3072))
    camera.start()
    assert camera.next_frame(np.zeros((48, 64), np.uint8), 0.1).status is FrameStatus.TIMEOUT


def test_a_frame_of_before_that_arrives_once_the_stream_is_open_is_none_of_the_new_acquisition() -> None:
    device, camera = configured()
    camera.start()
    begun_ns = device.clock.now_ns() - 500_000_000
    late = frame_of(bytes([1]) * 3072, 14, begun_ns - 12_000_000)
    device.stream = [*late, *frame_of(bytes([2]) * 3072, 0, begun_ns + 20_000_000)]
    slot = np.zeros((48, 64), np.uint8)
    frame = camera.next_frame(slot, 0.1)
    assert (frame.status, frame.block_id) == (FrameStatus.COMPLETE, 0)
    assert (slot == 2).all()
    assert camera.stream_counters == StreamCounters(frames=1, stale_frames=1)


def test_where_the_camera_has_no_clock_to_latch_every_frame_counts() -> None:
    device, camera = configured()
    device.refusing[0x1F8] = 0x8006
    camera.start()
    device.stream = frame_of(bytes(3072), 14, 1)
    assert camera.next_frame(np.zeros((48, 64), np.uint8), 0.1).block_id == 14


def test_a_stopped_camera_gives_no_frame_and_one_without_settings_does_not_start() -> None:
    device, camera = opened()
    slot = np.zeros((48, 64), np.uint8)
    with pytest.raises(DeviceRefused, match="started before it was configured"):
        camera.start()
    with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
        camera.next_frame(slot, 0.1)
    camera.configure(SETTINGS)
    assert ("AcquisitionStart", 1) not in device.log
    camera.start()
    device.log.clear()
    camera.stop()
    assert device.log == HALTED
    with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
        camera.next_frame(slot, 0.1)


def test_a_stream_that_runs_is_stopped_for_new_settings_and_begun_anew() -> None:
    device, camera = streaming()
    camera.configure(CameraSettings(64, 48, 4000.0, 0.0))
    assert device.log[: len(HALTED)] == HALTED
    assert device.log[-len(STARTED) :] == STARTED
    assert ("ExposureTime", 4000.0) in device.log
    device, camera = configured()
    camera.configure(SETTINGS)
    assert not any(entry in device.log for entry in (*HALTED[:2], *STARTED)), "it did not stream"


# ------------------------------------------------------------------------------------------- temperature, clock, health


def test_a_temperature_that_cannot_be_read_is_unknown_not_zero() -> None:
    device, camera = opened()
    assert camera.temperature_c() == 41.5
    assert camera.health().details["temperature"] == "41.5 °C"
    device.refusing[ADDRESS["DeviceTemperature"]] = 0x8006
    assert camera.temperature_c() is None
    _, without = opened(xml=description(lacking=("DeviceTemperature",)))
    assert without.temperature_c() is None
    assert without.health().details["temperature"] == "unknown"


def test_the_clock_is_read_four_times_and_the_reading_in_which_least_time_passed_counts() -> None:
    device, camera = opened()
    device.log.clear()
    device.latches_take_s = [0.02, 0.004, 0.001, 0.009]
    begin_ns = device.clock.now_ns()
    reading = camera.read_clock()
    assert device.log == [("latch", 1)] * 4
    assert reading == ClockReading(begin_ns + 25_000_000 - 500_000_000, begin_ns + 24_000_000, begin_ns + 25_000_000)
    assert reading.bracket_ns == 1_000_000
    assert reading.offset_ns == 500_000_000 - 500_000


def test_a_camera_without_a_clock_to_latch_has_none() -> None:
    device, camera = opened()
    device.refusing[0x1F8] = 0x8003
    assert camera.read_clock() is None
    device.plugged = False
    with pytest.raises(DeviceGone):
        camera.read_clock()


def test_health_says_what_the_camera_is_and_how_its_link_does() -> None:
    device, camera = opened()
    health = camera.health()
    assert (health.device, health.ok, health.summary) == ("camera.left", True, "Reef Eye")
    assert health.details == {
        "model": "Reef Eye", "serial": "KF-CAM-L", "firmware": "1.2", "link": "5000 Mbit/s",
        "temperature": "41.5 °C", "control retries": "0",
    }  # fmt: skip
    assert camera.control_counters.retries == 0
    device.plugged = False
    lost = camera.health()
    assert not lost.ok
    assert "unplugged" in lost.summary
    _, slow = opened(lambda device: setattr(device, "speed", 3))
    assert (slow.health().device, slow.health().ok) == ("camera.left", False)
    assert "480 Mbit/s; 5000 are needed" in slow.health().summary


# ------------------------------------------------------------------------------------------- closing


def test_closing_stops_a_stream_and_lets_the_camera_go_once() -> None:
    device, camera = streaming()
    with camera:
        pass
    assert device.log == HALTED
    assert (device.is_open, device.claimed) == (False, [])
    camera.close()
    assert device.log == HALTED


def test_a_camera_that_is_gone_closes_silently_and_its_stream_is_over() -> None:
    device, camera = streaming()
    device.plugged = False
    camera.close()
    assert not device.is_open
    with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
        camera.next_frame(np.zeros((48, 64), np.uint8), 0.1)


def test_closing_a_camera_that_does_not_stream_asks_it_nothing() -> None:
    device, camera = configured()
    camera.close()
    assert device.log == []
