"""One camera from opening to closing: which registers are set to what, in which order, and what each failure tells."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.api import CameraSettings, DeviceRefused, FrameStatus
from drivers.camera import CameraSpec, UsbVisionCamera
from drivers.camera.stream import StreamCounters
from tests.drivers.camera.scripted import (
    MANIFEST,
    SBRM,
    Bus,
    ScriptedCamera,
    description,
    frame_of,
)
from tests.drivers.clock import SteppedClock

SPEC = CameraSpec("camera.left", "KF-CAM-L")
SETTINGS = CameraSettings(64, 48, 8000.0, 3.0)


def opened(
    prepare: Callable[[ScriptedCamera], object] = lambda device: None,
    xml: str | None = None,
    spec: CameraSpec = SPEC,
    settings: CameraSettings | None = None,
) -> tuple[ScriptedCamera, UsbVisionCamera]:
    """Return a camera, after its first configuration if it has ``settings``."""
    device = ScriptedCamera(SteppedClock(), xml)
    prepare(device)
    camera = UsbVisionCamera.open(spec, Bus(device), device.clock)
    if settings is not None:
        camera.configure(settings)
        device.log.clear()
    return device, camera


def set_up(
    prepare: Callable[[ScriptedCamera], object] = lambda device: None, xml: str | None = None, spec: CameraSpec = SPEC
) -> ScriptedCamera:
    """Return a camera after its first configuration, with all that was written."""
    device, camera = opened(prepare, xml, spec)
    camera.configure(SETTINGS)
    return device


def spec_with(**features: bool | float | str) -> CameraSpec:
    return CameraSpec("camera.left", "KF-CAM-L", features=tuple(features.items()))


def empty_slot() -> np.ndarray:
    return np.zeros((48, 64), np.uint8)


def streaming() -> tuple[ScriptedCamera, UsbVisionCamera]:
    device, camera = opened(settings=SETTINGS)
    camera.start()
    return device, camera


HALTED = [("AcquisitionStop", 1), ("SIRM control", 0), ("TLParamsLocked", 0)]
STARTED = [("TLParamsLocked", 1), ("SIRM control", 1), ("latch", 1), ("AcquisitionStart", 1)]
PREPARED = [
    *(("SIRM leader", 1024), ("SIRM trailer", 1024), ("SIRM transfer", 3072), ("SIRM transfers", 1)),
    *(("SIRM final 1", 0), ("SIRM final 2", 0), ("set halt", 0x83), ("clear halt", 0x83)),
]


LINKS_MBPS = {(4, 4): 5000, (3, 8): 480, (5, 8): 10000, (0, 4): 480, (None, 8): 5000, (None, 4): 480, (None, 2): 12}
LINKS_MBPS |= {(None, 1): 2, (None, 16): 10000}


@pytest.mark.parametrize(("host", "sbrm"), [*LINKS_MBPS, (None, 0)])
def test_the_host_knows_the_link_best_and_the_camera_where_the_host_does_not_say(host: int | None, sbrm: int) -> None:
    def prepare(device: ScriptedCamera) -> None:
        device.speed = host
        device.set(SBRM + 0x40, struct.pack("<I", sbrm))

    _, camera = opened(prepare)
    mbps = LINKS_MBPS.get((host, sbrm))
    fast = None if mbps is None else mbps >= 5000
    assert (camera.identity.link_speed_mbps, camera.link_is_fast) == (mbps, fast)
    assert (camera.slow_link is not None) == (fast is False) == (f"{mbps} Mbit/s" in str(camera.slow_link))
    health = camera.health()
    assert health.details["link"] == ("unknown" if mbps is None else f"{mbps} Mbit/s")
    assert health.ok == (fast is not False) == (f"{mbps} Mbit/s" not in health.summary)


@pytest.mark.parametrize(
    ("address", "data", "said"),
    [
        (SBRM + 0x1C, struct.pack("<I", 0), "no image stream"),
        (MANIFEST + 12, struct.pack("<I", 5 << 10), "no readable description"),
        (0x1D8, struct.pack("<Q", (1 << 64) - 0x20), "outside 64 bits"),
    ],
)
def test_a_camera_that_cannot_be_used_says_why_and_is_let_go(address: int, data: bytes, said: str) -> None:
    device = ScriptedCamera(SteppedClock())
    device.set(address, data)
    with pytest.raises(DeviceRefused, match=f"^camera.left: .*{said}"):
        UsbVisionCamera.open(SPEC, Bus(device), device.clock)
    assert (device.is_open, device.claimed) == (False, [])


def test_every_setting_that_decides_about_an_image_is_made_in_its_order() -> None:
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
    # Every other trigger is off, and the exposure's mode is written once the trigger is on.
    triggers = [entry for entry in device.log if entry[0] in ("TriggerSelector", "TriggerMode", "ExposureMode")]
    assert triggers[:4] == [("TriggerSelector", 0), ("TriggerMode", 0), ("TriggerSelector", 1), ("TriggerMode", 0)]
    assert triggers[4:7] == [("TriggerSelector", 1), ("TriggerMode", 1), ("ExposureMode", 1)]
    assert camera.health().details["not offered"] == (
        "no DecimationHorizontal, no DecimationVertical, no ChunkModeActive, no TestImageSelector, no OverlapMode, "
        "no BlackLevelAuto, no LUTEnable"
    )


@pytest.mark.parametrize(
    ("lacking", "feature", "value"),
    [
        ("DeviceLinkThroughputLimitMode", "DeviceLinkThroughputLimit", 450_000_000),
        ("GammaEnable", "Gamma", 1.0),
        ("TestPattern", "Gamma", 0.5),
    ],
    ids=["the highest limit of the link", "gamma without a switch", "gamma that is switched off"],
)
def test_what_has_no_switch_is_set_to_what_does_not_matter(lacking: str, feature: str, value: float) -> None:
    assert set_up(xml=description(lacking=(lacking,))).feature(feature) == value


@pytest.mark.parametrize(
    ("how", "name", "value", "said"),
    [
        ("rounds", "ReverseX", 1, "ReverseX is True .* False"),
        ("rounds", "BinningVertical", 2, r"BinningVertical is 2\.0 .* 1"),
        ("rounds", "TriggerOverlap", 0, "TriggerOverlap is Off .* ReadOut"),
        ("rounds", "OffsetX", 8, "OffsetX: asked for 400 px, got 8 px"),
        ("rounds", "Height", 46, "Height: asked for 48 px, got 46 px"),
        ("rounds", "BlackLevel", 0, r"BlackLevel is 0\.0 .* 1\.5"),
        ("changes", "ReverseY", 1, "ReverseY is True .* False"),
        ("changes", "PixelFormat", 0, "PixelFormat is Mono16 .* Mono8"),
        ("changes", "TriggerSource", 2, "TriggerSource is Line2 .* Line1"),
        ("changes", "TriggerMode", 0, "TriggerMode is Off .* On"),
        ("changes", "Height", 46, r"Height is 46\.0 .* 48"),
        ("changes", "OffsetX", 0, r"OffsetX is 0\.0 .* 400"),
        ("is asked for", "Sharpening", 1.0, "no feature Sharpening"),
        ("is asked for", "Gain", 3.0, r"Gain = 3\.0 .*gain_db"),
        ("is asked for", "?Width", 64, r"Width = 64 .*width_px"),
        ("is asked for", "TriggerOverlap", 2, "TriggerOverlap = 2: it must be a name"),
        ("is asked for", "ReverseX", "yes", "ReverseX = 'yes': it must be true or false"),
        ("is asked for", "BlackLevel", True, "BlackLevel = True: it must be a number"),
        ("is asked for", "BlackLevel", 17.0, r"BlackLevel: 17 .*0\.\.16"),
    ],
)
def test_what_a_camera_does_not_have_take_or_keep_is_refused_with_name_and_values(
    how: str, name: str, value: Any, said: str
) -> None:
    def prepare(device: ScriptedCamera) -> None:
        if how == "rounds":
            device.rounding[name] = value
        elif how == "changes":
            device.when["GammaEnable"] = lambda: device.set_feature(name, value)

    with pytest.raises(DeviceRefused, match=said):
        set_up(prepare, spec=spec_with(**({name: value} if how == "is asked for" else {"BlackLevel": 1.5})))


def test_a_rig_files_features_take_the_place_of_built_in_ones_or_follow_them_in_order() -> None:
    device = set_up(spec=spec_with(TriggerOverlap="PreviousFrame", BlackLevel=1.5, Gamma=1.0))
    assert (device.feature("TriggerOverlap"), device.feature("BlackLevel")) == ("PreviousFrame", 1.5)
    assert device.feature("Gamma") == 1.0, "also where gamma is off, and nobody would have set it"
    names = [name for name, _ in device.log]
    assert names.index("TriggerOverlap") < names.index("ExposureTime") < names.index("BlackLevel")
    assert names.count("TriggerOverlap") == 1
    # Behind a selector of the table a feature belongs to it.
    device = set_up(spec=spec_with(LineSelector="Line2", LineMode="Output"))
    assert [value for name, value in device.log if name == "LineMode"] == [1.0, 0.0]
    # Whatever was selected, the frames' trigger is in the end.
    device = set_up(spec=spec_with(TriggerSelector="AcquisitionStart", TriggerDelay=0.0))
    assert [value for name, value in device.log if name == "TriggerSelector"][-2:] == [0, 1]


@pytest.mark.parametrize(
    ("name", "value"), [("Sharpening", 1.0), ("GammaEnable", False), ("TriggerOverlap", "ReadOut")]
)
def test_a_marked_feature_may_be_missing(name: str, value: bool | float | str) -> None:
    """One of the maker's own, and those that the order sets by itself."""
    _, camera = opened(xml=description(lacking=(name,)), spec=spec_with(**{f"?{name}": value}), settings=SETTINGS)
    assert f"no {name}" in camera.health().details["not offered"]
    with pytest.raises(DeviceRefused, match=f"has no feature {name}"):
        set_up(xml=description(lacking=(name,)), spec=spec_with(**{name: value}))


def test_what_cannot_be_written_or_chosen_is_left_alone_where_that_is_right() -> None:
    fixed = description(choices={"TriggerSelector": ("FrameStart",)}, fixed=("TriggerSelector", "ReverseX"))
    with pytest.raises(DeviceRefused, match="ReverseX is True and cannot be written; it must be False"):
        set_up(xml=fixed)
    device = set_up(lambda device: device.set_feature("ReverseX", 0), fixed)
    assert ("TriggerMode", 1) in device.log
    assert "TriggerSelector" not in [name for name, _ in device.log], "nothing to select"
    device = set_up(xml=description(choices={"ExposureMode": ("TriggerWidth",)}))
    assert "ExposureMode" not in [name for name, _ in device.log], "the wanted one is not offered"
    _, camera = opened(xml=description(lacking=("Gain", "GainSelector", "GainAuto")))
    with pytest.raises(DeviceRefused, match=r"has no gain to set.*gain_db = 0"):
        camera.configure(SETTINGS)
    assert camera.configure(CameraSettings(64, 48, 8000.0, 0.0)).gain_db == 0.0


def test_place_and_trigger_line_are_the_rig_files_where_it_names_them() -> None:
    device = set_up(spec=replace(SPEC, offset_x_px=24, offset_y_px=0))
    assert (device.feature("OffsetX"), device.feature("OffsetY")) == (24, 0)
    for spec in (replace(SPEC, trigger_source="Line2"), spec_with(TriggerSource="Line2")):
        device, camera = opened(spec=spec)
        for _ in range(2):
            camera.configure(SETTINGS)
            assert device.feature("TriggerSource") == "Line2"
    set_up(spec=replace(spec_with(TriggerSource="Line2"), trigger_source="Line2"))
    without_lines = description(choices={"TriggerSource": ("Software", "Counter0End")})
    for spec, xml, said in (
        (replace(SPEC, offset_x_px=804), None, r"OffsetX: 804 .*0\.\.808 in steps of 8"),
        (replace(spec_with(TriggerSource="Line2"), trigger_source="Line1"), None, r"'Line2' .*'Line1'"),
        (SPEC, without_lines, "no line"),
    ):
        with pytest.raises(DeviceRefused, match=said):
            set_up(xml=xml, spec=spec)


def test_what_a_camera_holds_now_is_read_back_beside_what_was_asked_for() -> None:
    device, camera = opened(xml=description(lacking=("ReverseX",)), settings=SETTINGS)
    device.set_feature("GammaEnable", 1)  # behind our back: what it is now counts
    held = {one.feature: (one.requested, one.held) for one in camera.read_back()}
    expected = {"TriggerMode": ("On", "On"), "Width": (64, 64), "GammaEnable": (False, True)}
    expected |= {"ExposureTime": (None, 8000.0), "ReverseX": (None, None)}
    assert {name: held[name] for name in expected} == expected


def test_a_start_stops_prepares_the_stream_while_it_is_disabled_and_begins_the_acquisition_last() -> None:
    device, camera = opened(settings=SETTINGS)
    device.stream = frame_of(bytes(3072))  # what lies in the pipe is thrown away
    camera.start()
    assert device.log == [*HALTED, *PREPARED, *STARTED]
    assert camera.next_frame(empty_slot(), 0.1).status is FrameStatus.TIMEOUT


@pytest.mark.parametrize(
    ("size", "alignment_bits", "transfer"),
    [((64, 48), 10, 3072), ((40, 30), 10, 2048), ((40, 30), 4, 1200), ((40, 30), 0, 1200), ((24, 42), 5, 1024)],
)
def test_an_image_is_one_transfer_of_whole_units(size: tuple[int, int], alignment_bits: int, transfer: int) -> None:
    needs = lambda device: device.needs(size[0] * size[1], alignment_bits)  # noqa: E731
    device, camera = opened(needs, settings=CameraSettings(*size, 8000.0, 0.0))
    camera.start()
    assert ("SIRM transfer", transfer) in device.log


@pytest.mark.parametrize(
    ("leader", "trailer", "bits", "told", "buffer"),
    [
        *((52, 32, 10, (1024, 1024), 1024), (52, 32, 6, (64, 64), 1024), (1025, 32, 10, (2048, 1024), 2048)),
        *((0, 0, 0, (1024, 1024), 1024), (0, 0, 11, (2048, 2048), 2048), (1024, 32, 0, (1024, 32), 1024)),
        *((1025, 32, 0, (1025, 32), 2048), (52, 2049, 0, (52, 2049), 3072), (20, 20, 0, (20, 20), 1024)),
    ],
)
def test_leader_and_trailer_are_told_in_whole_units_and_have_room_in_whole_packets(
    leader: int, trailer: int, bits: int, told: tuple[int, int], buffer: int
) -> None:
    """Also where the camera does not know their lengths yet, and says 0."""
    needs = lambda device: device.needs(leader=leader, trailer=trailer, alignment_bits=bits)  # noqa: E731
    device, camera = opened(needs, settings=SETTINGS)
    camera.start()
    assert [dict(device.log)[name] for name in ("SIRM leader", "SIRM trailer")] == list(told)
    device.stream_buffers.clear()
    camera.next_frame(empty_slot(), 0.1)
    assert device.stream_buffers == [buffer]


def test_images_that_never_come_whole_in_one_transfer_come_in_pieces_from_the_next_start_on() -> None:
    big = CameraSettings(1600, 1200, 8000.0, 0.0)
    device, camera = opened(lambda device: device.needs(1600 * 1200), settings=big)
    camera.start()
    pixels = np.random.default_rng(3).integers(0, 256, (1200, 1600), np.uint8)
    leader, payload, trailer = frame_of(pixels.tobytes(), size=(1600, 1200))
    in_pieces = [leader, payload[: 1 << 20], payload[1 << 20 :], trailer]
    device.stream = [*in_pieces]
    slot = np.zeros((1200, 1600), np.uint8)
    assert camera.next_frame(slot, 0.1).status is not FrameStatus.COMPLETE
    device.log.clear()
    camera.start()
    transfers = [("SIRM transfer", 1 << 20), ("SIRM transfers", 1), ("SIRM final 1", 871_424), ("SIRM final 2", 0)]
    assert [entry for entry in device.log if entry in transfers] == transfers
    device.stream = in_pieces
    assert camera.next_frame(slot, 0.1).status is FrameStatus.COMPLETE
    np.testing.assert_array_equal(slot, pixels)
    assert "pieces" in camera.health().details["transfers"]
    device, camera = streaming()
    device.stream = [*frame_of(bytes(3072)), *frame_of(bytes(100), 10)]
    statuses = [camera.next_frame(empty_slot(), 0.1).status for _ in range(2)]
    assert statuses == [FrameStatus.COMPLETE, FrameStatus.TRUNCATED]
    camera.start()
    assert "transfers" not in camera.health().details, "one frame that was whole keeps whole transfers"


@pytest.mark.parametrize("payload", [64 * 48 - 1, 64 * 48 + 16])
def test_more_than_the_pixels_or_less_is_refused_before_anything_streams(payload: int) -> None:
    device, camera = opened(lambda device: device.needs(payload), settings=SETTINGS)
    with pytest.raises(DeviceRefused, match=f"sends {payload} bytes for an image of 3072"):
        camera.start()
    assert not any(entry in device.log for entry in STARTED)


def test_frames_are_counted_from_each_start_on() -> None:
    device, camera = streaming()
    assert device.longest_read == 256 - 12, "packets are as long as the camera says"
    device.stream = frame_of(bytes(range(256)) * 12)
    assert [camera.next_frame(empty_slot(), 0.1).block_id for _ in range(2)] == [9, None]
    assert camera.stream_counters == StreamCounters(frames=2, timeouts=1)
    camera.start()
    assert camera.stream_counters == StreamCounters()
