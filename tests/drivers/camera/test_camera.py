"""One camera from opening to closing: which registers are set to what, in which order, and what each failure tells."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.api import CameraSettings, ClockReading, DeviceGone, DeviceRefused, FrameStatus, Health
from drivers.camera import CameraSpec, UsbVisionCamera
from drivers.camera.stream import StreamCounters
from tests.drivers.camera.scripted import (
    ADDRESS,
    CHOICES,
    FLAGS,
    FLOATS,
    MANIFEST,
    SBRM,
    SIRM,
    WHOLE,
    ScriptedCamera,
    description,
)
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


def spec_with(**features: bool | float | str) -> CameraSpec:
    return CameraSpec("camera.left", "KF-CAM-L", features=tuple(features.items()))


def expect_refused(camera: UsbVisionCamera, said: str) -> None:
    with pytest.raises(DeviceRefused, match=said):
        camera.configure(SETTINGS)


def empty_slot() -> np.ndarray:
    return np.zeros((48, 64), np.uint8)


def streaming() -> tuple[ScriptedCamera, UsbVisionCamera]:
    device, camera = configured()
    camera.start()
    device.log.clear()
    return device, camera


HALTED = [("AcquisitionStop", 1), ("SIRM control", 0), ("TLParamsLocked", 0)]
STARTED = [("TLParamsLocked", 1), ("SIRM control", 1), ("latch", 1), ("AcquisitionStart", 1)]
PREPARED = [
    *(("SIRM leader", 1024), ("SIRM trailer", 1024), ("SIRM transfer", 3072), ("SIRM transfers", 1)),
    *(("SIRM final 1", 0), ("SIRM final 2", 0), ("set halt", 0x82), ("clear halt", 0x82)),
]


# ------------------------------------------------------------------------------------------- opening


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
    health = camera.health()
    assert health.details["link"] == ("unknown" if mbps is None else f"{mbps} Mbit/s")
    assert health.ok == (fast is not False)
    assert (f"{mbps} Mbit/s; 5000 are needed" in health.summary) == (fast is False)


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
        "AcquisitionMode": "Continuous", "PixelFormat": "Mono8", "OffsetX": 400, "OffsetY": 300, "Width": 64, "Height": 48,
        "TriggerSelector": "FrameStart", "TriggerSource": "Line1", "TriggerActivation": "RisingEdge", "TriggerMode": "On",
        "ExposureAuto": "Off", "GainAuto": "Off", "ExposureMode": "Timed", "GainSelector": "All",
        "ExposureTime": 8000.0, "Gain": 3.0, "UserSetSelector": "Default", "DeviceLinkThroughputLimitMode": "Off",
        "BinningHorizontal": 1, "BinningVertical": 1, "ReverseX": False, "ReverseY": False, "TestPattern": "Off",
        "AcquisitionFrameRateEnable": False, "LineSelector": "Line1", "LineMode": "Input", "TriggerOverlap": "ReadOut",
        "TriggerDelay": 0.0, "GammaEnable": False, "LineInverter": False,
    }  # fmt: skip
    assert {name: device.feature(name) for name in wanted} == wanted
    order = [name for name, _ in device.log if name in wanted or name == "UserSetLoad"]
    for before, behind in (
        ("UserSetSelector", "UserSetLoad"), ("UserSetLoad", "DeviceLinkThroughputLimitMode"), ("BinningHorizontal", "Width"),
        ("PixelFormat", "Width"), ("OffsetX", "Width"), ("OffsetY", "Height"), ("TriggerSelector", "TriggerSource"),
        ("LineSelector", "LineMode"), ("TriggerSource", "TriggerOverlap"), ("ExposureAuto", "ExposureTime"),
        ("GainAuto", "Gain"), ("GainSelector", "Gain"),
    ):  # fmt: skip
        assert order.index(before) < order.index(behind), f"{before} comes before {behind}"
    # The image lies in the sensor's middle only once its size is known.
    assert device.log.index(("Width", 64)) < device.log.index(("OffsetX", 400))
    assert camera.health().details["not offered"] == (
        "no DecimationHorizontal, no DecimationVertical, no ChunkModeActive, no TestImageSelector, no OverlapMode, "
        "no BlackLevelAuto, no LUTEnable"
    )


def test_every_other_trigger_is_switched_off_and_the_exposures_mode_is_written_once_the_trigger_is_on() -> None:
    device, camera = opened()
    camera.configure(SETTINGS)
    told = [(name, value) for name, value in device.log if name in ("TriggerSelector", "TriggerMode", "ExposureMode")]
    frame_start, other, off, on, timed = 1, 0, 0, 1, 1
    assert told[:4] == [
        ("TriggerSelector", other), ("TriggerMode", off), ("TriggerSelector", frame_start), ("TriggerMode", off),
    ]  # fmt: skip
    assert told[4:7] == [("TriggerSelector", frame_start), ("TriggerMode", on), ("ExposureMode", timed)]


def test_what_was_saved_in_the_camera_is_unloaded_once_and_an_exposure_alone_sets_nothing_else() -> None:
    device, camera = opened()
    camera.configure(SETTINGS)
    assert [name for name, _ in device.log].count("UserSetLoad") == 1
    device.log.clear()
    camera.configure(CameraSettings(64, 48, 4000.0, 1.0))
    assert {name for name, _ in device.log} == {
        *("ExposureMode", "ExposureAuto", "ExposureTime", "GainAuto", "GainSelector", "Gain"),
    }  # fmt: skip
    device.log.clear()
    camera.configure(CameraSettings(128, 48, 4000.0, 1.0))
    assert "TriggerOverlap" in [name for name, _ in device.log]
    assert "UserSetLoad" not in [name for name, _ in device.log]


def test_a_link_that_has_only_a_limit_gets_the_highest() -> None:
    device, camera = opened(xml=description(lacking=("DeviceLinkThroughputLimitMode",)))
    camera.configure(SETTINGS)
    assert device.feature("DeviceLinkThroughputLimit") == 450_000_000


def test_without_a_switch_for_gamma_it_is_set_to_one() -> None:
    device, camera = opened(xml=description(lacking=("GammaEnable",)))
    camera.configure(SETTINGS)
    assert device.feature("Gamma") == 1.0
    device, camera = opened()
    camera.configure(SETTINGS)
    assert device.feature("Gamma") == 0.5


@pytest.mark.parametrize(
    ("name", "held", "said"),
    [
        ("ReverseX", 1, "ReverseX is True after it was set to False"),
        ("BinningVertical", 2, "BinningVertical is 2.0 after it was set to 1"),
        ("TriggerOverlap", 0, "TriggerOverlap is Off after it was set to ReadOut"),
        ("OffsetX", 8, "OffsetX: asked for 400 px, got 8 px"),
        ("Height", 46, "Height: asked for 48 px, got 46 px"),
        ("BlackLevel", 0, "BlackLevel is 0.0 after it was set to 1.5"),
    ],
)
def test_what_a_camera_does_not_take_is_refused_with_name_and_values(name: str, held: int, said: str) -> None:
    _, camera = opened(lambda device: device.rounding.update({name: held}), spec=spec_with(BlackLevel=1.5))
    expect_refused(camera, said)
    with pytest.raises(DeviceRefused, match=r"before it was configured"):
        camera.start()


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("ReverseY", 1, "ReverseY is True after it was set to False"),
        ("PixelFormat", 0, "PixelFormat is Mono16 after it was set to Mono8"),
        ("TriggerSource", 2, "TriggerSource is Line2 after it was set to Line1"),
        ("TriggerMode", 0, "TriggerMode is Off after it was set to On"),
        ("Height", 46, "Height is 46.0 after it was set to 48"),
        ("OffsetX", 0, "OffsetX is 0.0 after it was set to 400"),
    ],
)
def test_a_setting_that_a_later_one_changed_is_noticed(name: str, value: int, said: str) -> None:
    device, camera = opened()
    device.when["GammaEnable"] = lambda: device.set_feature(name, value)
    expect_refused(camera, said)


def test_a_rig_files_features_take_the_place_of_built_in_ones_or_follow_them_in_order() -> None:
    device, camera = opened(spec=spec_with(TriggerOverlap="PreviousFrame", BlackLevel=1.5, Gamma=1.0))
    camera.configure(SETTINGS)
    assert (device.feature("TriggerOverlap"), device.feature("BlackLevel")) == ("PreviousFrame", 1.5)
    assert device.feature("Gamma") == 1.0, "also where gamma is off, and nobody would have set it"
    names = [name for name, _ in device.log]
    assert names.index("TriggerOverlap") < names.index("ExposureTime") < names.index("BlackLevel")
    assert names.count("TriggerOverlap") == 1
    # Behind a selector of the table a feature belongs to it.
    device, camera = opened(spec=spec_with(LineSelector="Line2", LineMode="Output"))
    camera.configure(SETTINGS)
    assert [value for name, value in device.log if name == "LineMode"] == [1.0, 0.0]


@pytest.mark.parametrize(
    ("features", "said"),
    [
        ({"Sharpening": 1.0}, "has no feature Sharpening"),
        ({"Gain": 3.0}, r"Gain = 3.0 stands under features.*Use the key gain_db"),
        ({"?Width": 64}, r"Width = 64 stands under features.*Use the key width_px"),
        ({"TriggerOverlap": 2}, "TriggerOverlap = 2: it must be a name"),
        ({"ReverseX": "yes"}, "ReverseX = 'yes': it must be true or false"),
        ({"BlackLevel": True}, "BlackLevel = True: it must be a number"),
        ({"BlackLevel": 17.0}, "BlackLevel: 17 refused, allowed 0..16"),
    ],
)
def test_features_that_a_camera_does_not_have_or_take_are_refused(
    features: dict[str, bool | float | str], said: str
) -> None:
    with pytest.raises(DeviceRefused, match=said):
        opened(spec=spec_with(**features))[1].configure(SETTINGS)


@pytest.mark.parametrize(
    ("name", "value"), [("Sharpening", 1.0), ("GammaEnable", False), ("TriggerOverlap", "ReadOut")]
)
def test_a_marked_feature_may_be_missing(name: str, value: bool | float | str) -> None:
    """One of the maker's own, and those that the order sets by itself."""
    _, camera = opened(xml=description(lacking=(name,)), spec=spec_with(**{f"?{name}": value}))
    camera.configure(SETTINGS)
    assert f"no {name}" in camera.health().details["not offered"]
    _, camera = opened(xml=description(lacking=(name,)), spec=spec_with(**{name: value}))
    expect_refused(camera, f"has no feature {name}")


def test_a_selector_with_nothing_to_select_is_left_alone() -> None:
    xml = description(choices={"TriggerSelector": ("FrameStart",)}, fixed=("TriggerSelector",))
    device, camera = opened(xml=xml)
    camera.configure(SETTINGS)
    assert ("TriggerMode", 1) in device.log
    assert "TriggerSelector" not in [name for name, _ in device.log]


def test_whatever_a_rig_file_selected_the_frames_trigger_is_selected_in_the_end() -> None:
    device, camera = opened(spec=spec_with(TriggerSelector="AcquisitionStart", TriggerDelay=0.0))
    camera.configure(SETTINGS)
    assert device.feature("TriggerSelector") == "FrameStart"
    assert [value for name, value in device.log if name == "TriggerSelector"][-2:] == [0, 1]


def test_what_cannot_be_written_is_taken_where_it_is_right_and_refused_where_it_is_not() -> None:
    device, camera = opened(xml=description(fixed=("ReverseX",)))
    expect_refused(camera, "ReverseX is True and cannot be written; it must be False")
    device.set_feature("ReverseX", 0)
    camera.configure(SETTINGS)


def test_a_place_on_the_sensor_is_the_rig_files_or_the_middle() -> None:
    device, camera = opened(spec=CameraSpec("camera.left", "KF-CAM-L", offset_x_px=24, offset_y_px=0))
    camera.configure(SETTINGS)
    assert (device.feature("OffsetX"), device.feature("OffsetY")) == (24, 0)
    _, camera = opened(spec=CameraSpec("camera.left", "KF-CAM-L", offset_x_px=804))
    expect_refused(camera, r"OffsetX: 804 refused, allowed 0\.\.800 in steps of 8")


def test_what_a_camera_made_of_its_settings_is_what_is_returned() -> None:
    _, camera = opened()
    got = camera.configure(CameraSettings(64, 48, 8000.3, 3.3))
    assert got.exposure_us == struct.unpack("<f", struct.pack("<f", 8000.3))[0]
    assert got.gain_db == struct.unpack("<f", struct.pack("<f", 3.3))[0]


def test_the_trigger_comes_from_the_line_that_the_rig_file_names_or_the_first_there_is() -> None:
    device, camera = opened(spec=CameraSpec("camera.left", "KF-CAM-L", "Line2"))
    camera.configure(SETTINGS)
    assert device.feature("TriggerSource") == "Line2"
    _, camera = opened(xml=description(choices={"TriggerSource": ("Software", "Counter0End")}))
    expect_refused(camera, "offers no line as trigger source")


def test_the_boards_line_may_stand_under_features_but_not_as_another_one() -> None:
    device, camera = opened(spec=spec_with(TriggerSource="Line2"))
    for _ in range(2):
        camera.configure(SETTINGS)
        assert device.feature("TriggerSource") == "Line2"
    twice = replace(spec_with(TriggerSource="Line2"), trigger_source="Line1")
    expect_refused(
        opened(spec=twice)[1], r"'Line2' under features and trigger_source is 'Line1'.*Leave one of them out"
    )
    opened(spec=replace(twice, trigger_source="Line2"))[1].configure(SETTINGS)


def test_a_camera_without_the_optional_features_is_configured_all_the_same() -> None:
    needed = {"Width", "Height", "PixelFormat", "TriggerSource", "TriggerMode", "ExposureTime", "Gain"}
    optional = tuple(sorted({*CHOICES, *WHOLE, *FLOATS, *FLAGS, "UserSetLoad"} - needed))
    device, camera = opened(xml=description(lacking=optional))
    assert camera.configure(SETTINGS) == SETTINGS
    camera.start()
    assert ("AcquisitionStart", 1) in device.log
    assert not {name for name, _ in device.log} & set(optional)


def test_what_a_camera_holds_now_is_read_back_beside_what_was_asked_for() -> None:
    device, camera = opened(xml=description(lacking=("ReverseX",)))
    camera.configure(SETTINGS)
    device.set_feature("GammaEnable", 1)
    held = {one.feature: (one.wanted, one.held) for one in camera.read_back()}
    assert held["TriggerMode"] == ("On", "On")
    assert held["Width"] == (SETTINGS.width_px, SETTINGS.width_px)
    # Changed behind our back: what it is now counts, not what it was when it was set.
    assert held["GammaEnable"] == (False, True)
    assert held["ExposureTime"] == (None, SETTINGS.exposure_us)
    assert held["ReverseX"] == (None, None)


def test_a_choice_that_a_camera_does_not_offer_is_left_as_it_is() -> None:
    device, camera = opened(xml=description(choices={"ExposureMode": ("TriggerWidth",)}))
    camera.configure(SETTINGS)
    assert "ExposureMode" not in [name for name, _ in device.log]


def test_without_a_gain_none_can_be_asked_for() -> None:
    _, camera = opened(xml=description(lacking=("Gain", "GainSelector", "GainAuto")))
    expect_refused(camera, r"has no gain to set.*gain_db = 0")
    assert camera.configure(CameraSettings(64, 48, 8000.0, 0.0)).gain_db == 0.0


# ------------------------------------------------------------------------------------------- the stream


@pytest.mark.parametrize("before", [configured, streaming])
def test_a_start_stops_prepares_the_stream_while_it_is_disabled_and_begins_the_acquisition_last(
    before: Callable[[], tuple[ScriptedCamera, UsbVisionCamera]],
) -> None:
    device, camera = before()
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
    ("leader", "trailer", "bits", "told", "buffer"),
    [
        (52, 32, 10, (1024, 1024), 1024),
        (52, 32, 6, (64, 64), 1024),
        (1025, 32, 10, (2048, 1024), 2048),
        (0, 0, 0, (1024, 1024), 1024),
        (0, 0, 11, (2048, 2048), 2048),
        (1024, 32, 0, (1024, 32), 1024),
        (1025, 32, 0, (1025, 32), 2048),
        (52, 2049, 0, (52, 2049), 3072),
        (20, 20, 0, (20, 20), 1024),
    ],
)
def test_leader_and_trailer_are_told_in_whole_units_and_have_room_in_whole_packets(
    leader: int, trailer: int, bits: int, told: tuple[int, int], buffer: int
) -> None:
    """Also where the camera does not know their lengths yet, and says 0."""
    device, camera = opened(lambda device: device.needs(leader=leader, trailer=trailer, alignment_bits=bits))
    camera.configure(SETTINGS)
    camera.start()
    assert [dict(device.log)[name] for name in ("SIRM leader", "SIRM trailer")] == list(told)
    device.stream_buffers.clear()
    camera.next_frame(empty_slot(), 0.1)
    assert device.stream_buffers == [buffer]


def test_images_that_never_come_whole_in_one_transfer_come_in_pieces_from_the_next_start_on() -> None:
    size = CameraSettings(1600, 1200, 8000.0, 0.0)
    device, camera = opened(lambda device: device.needs(1600 * 1200))
    camera.configure(size)
    camera.start()
    pixels = np.random.default_rng(3).integers(0, 256, (1200, 1600), np.uint8)
    leader, payload, trailer = frame_of(pixels.tobytes(), size=(1600, 1200))
    device.stream = [leader, payload[: 1 << 20], payload[1 << 20 :], trailer]
    slot = np.zeros((1200, 1600), np.uint8)
    assert camera.next_frame(slot, 0.1).status is not FrameStatus.COMPLETE
    device.log.clear()
    camera.start()
    transfers = [("SIRM transfer", 1 << 20), ("SIRM transfers", 1), ("SIRM final 1", 871_424), ("SIRM final 2", 0)]
    assert [entry for entry in device.log if entry in transfers] == transfers
    device.stream = [leader, payload[: 1 << 20], payload[1 << 20 :], trailer]
    assert camera.next_frame(slot, 0.1).status is FrameStatus.COMPLETE
    np.testing.assert_array_equal(slot, pixels)
    assert "pieces" in camera.health().details["transfers"]


def test_one_frame_that_was_whole_keeps_whole_transfers() -> None:
    device, camera = streaming()
    slot = empty_slot()
    device.stream = [*frame_of(bytes(3072)), *frame_of(bytes(100), 10)]
    assert camera.next_frame(slot, 0.1).status is FrameStatus.COMPLETE
    assert camera.next_frame(slot, 0.1).status is FrameStatus.TRUNCATED
    camera.start()
    assert "transfers" not in camera.health().details


@pytest.mark.parametrize("payload", [64 * 48 - 1, 64 * 48 + 16])
def test_more_than_the_pixels_or_less_is_refused_before_anything_streams(payload: int) -> None:
    device, camera = opened(lambda device: device.needs(payload))
    camera.configure(SETTINGS)
    with pytest.raises(DeviceRefused, match=f"wants to send {payload} bytes for an image of 3072"):
        camera.start()
    assert not any(entry in device.log for entry in STARTED)


def frame_of(
    pixels: bytes,
    block: int = 9,
    stamp_ns: int = 10**15,
    size: tuple[int, int] = (64, 48),
    code: int = 0x01080001,
    valid: int | None = None,
) -> list[bytes]:
    leader = struct.pack("<4sHHQHHQIIIIIHH", b"U3VL", 0, 52, block, 0, 1, stamp_ns, code, *size, 0, 0, 0, 0)
    count = size[0] * size[1] if valid is None else valid
    return [leader, pixels, struct.pack("<4sHHQHHQI", b"U3VT", 0, 32, block, 0, 0, count, size[1])]


def test_frames_are_counted_from_each_start_on() -> None:
    device, camera = streaming()
    slot = empty_slot()
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
    assert camera.next_frame(empty_slot(), 0.1).status is FrameStatus.TIMEOUT


def test_a_frame_of_before_that_arrives_once_the_stream_is_open_is_none_of_the_new_acquisition() -> None:
    device, camera = configured()
    camera.start()
    begun_ns = device.clock.now_ns() - 500_000_000
    late = frame_of(bytes([1]) * 3072, 14, begun_ns - 12_000_000)
    device.stream = [*late, *frame_of(bytes([2]) * 3072, 0, begun_ns + 20_000_000)]
    slot = empty_slot()
    frame = camera.next_frame(slot, 0.1)
    assert (frame.status, frame.block_id) == (FrameStatus.COMPLETE, 0)
    assert (slot == 2).all()
    assert camera.stream_counters == StreamCounters(frames=1, stale_frames=1)


def test_where_the_camera_has_no_clock_to_latch_every_frame_counts() -> None:
    device, camera = configured()
    device.refusing[0x1F8] = 0x8006
    camera.start()
    device.stream = frame_of(bytes(3072), 14, 1)
    assert camera.next_frame(empty_slot(), 0.1).block_id == 14


def test_a_stopped_camera_gives_no_frame_and_one_without_settings_does_not_start() -> None:
    device, camera = opened()
    slot = empty_slot()
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


def test_identity_and_health_say_what_the_camera_is_and_health_that_it_is_gone() -> None:
    device, camera = opened()
    who = camera.identity
    assert (who.vendor, who.model, who.serial, who.firmware) == ("Reef", "Eye", "KF-CAM-L", "1.2")
    details = {
        "model": "Reef Eye", "serial": "KF-CAM-L", "firmware": "1.2", "link": "5000 Mbit/s",
        "temperature": "41.5 °C", "control retries": "0",
    }  # fmt: skip
    assert camera.health() == Health("camera.left", True, "Reef Eye", details)
    assert camera.control_counters.retries == 0
    device.plugged = False
    lost = camera.health()
    assert not lost.ok
    assert "unplugged" in lost.summary


# ------------------------------------------------------------------------------------------- closing


@pytest.mark.parametrize(("before", "asked"), [(streaming, HALTED), (configured, [])])
def test_closing_stops_a_stream_if_there_is_one_and_lets_the_camera_go_once(
    before: Callable[[], tuple[ScriptedCamera, UsbVisionCamera]], asked: list[tuple[str, float]]
) -> None:
    device, camera = before()
    with camera:
        pass
    assert device.log == asked
    assert (device.is_open, device.claimed) == (False, [])
    camera.close()
    assert device.log == asked


def test_a_camera_that_is_gone_closes_silently_and_its_stream_is_over() -> None:
    device, camera = streaming()
    device.plugged = False
    camera.close()
    assert not device.is_open
    with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
        camera.next_frame(empty_slot(), 0.1)


# ------------------------------------------------------------------------------------------- more than 8 bits


def test_twelve_packed_bits_become_eight_on_their_way_into_the_slot() -> None:
    device, camera = opened(
        lambda device: device.needs(64 * 48 * 3 // 2),
        xml=description(choices={"PixelFormat": ("Mono16", "Mono12p")}),
        spec=CameraSpec("camera.left", "KF-CAM-L", pixel_format="Mono12p"),
    )
    camera.configure(SETTINGS)
    camera.start()
    device.stream = frame_of(bytes((0x5A, 0x7C, 0xE1)) * (64 * 24), code=0x010C0047, valid=4608)
    slot = empty_slot()
    frame = camera.next_frame(slot, 0.1)
    assert frame.status is FrameStatus.COMPLETE, frame.detail
    assert slot[5, :4].tolist() == [0xC5, 0xE1, 0xC5, 0xE1]
    device.stream = frame_of(bytes(64 * 48), 10)
    assert "expected Mono12p" in camera.next_frame(slot, 0.1).detail


def test_a_format_that_is_no_grey_is_refused_before_anything_is_set() -> None:
    with pytest.raises(DeviceRefused, match=r"pixel_format 'BGR8' is none of Mono8, Mono10"):
        opened(spec=CameraSpec("camera.left", "KF-CAM-L", pixel_format="BGR8"))
