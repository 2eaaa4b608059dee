"""Cameras in the manner of three makers under the shipped driver: whatever their owners left in them, they take the same pictures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.api import CameraSettings, CameraSpec, FrameStatus
from drivers.camera import UsbVisionCamera
from drivers.rig import BoardSpec, open_board, open_wires
from hw_sim.world import World, WorldOptions

WIDTH, HEIGHT = 192, 128
SETTINGS = CameraSettings(WIDTH, HEIGHT, 12_000.0, 0.0)
PULSE_US = (500, 6000)
FRAMES = 6
MAKERS = ("blackfly", "ace", "alvium")
LEFT_BEHIND: dict[str, tuple[dict[str, Any], ...]] = {
    "blackfly": (
        {"ReverseX": True},
        {"BinningHorizontal": 2},
        {"Gamma": 0.5},
        {"LUTEnable": True},
        {"PixelFormat": "Mono12p"},
        {"TestPattern": "GreyHorizontalRamp"},
        {"ChunkModeActive": True},
        {"DeviceLinkThroughputLimit": 1_000_000},
        {"AcquisitionFrameRate": 20.0, "AcquisitionFrameRateEnable": True},
        {"TriggerMode[AcquisitionStart]": "On"},
    ),
    "ace": (
        {"OverlapMode": "Off"},
        {"ReverseY": True},
        {"DecimationVertical": 2},
        {"DeviceLinkThroughputLimit": 1_000_000},
        {"TriggerMode[FrameBurstStart]": "On"},
        {"ExposureMode": "TriggerWidth"},
        {"GainAuto": "Continuous"},
    ),
    "alvium": (
        {"OffsetX": 40},
        {"ExposureAuto": "Continuous"},
        {"LineMode[Line0]": "Output"},
        {"TriggerMode[ExposureActive]": "On"},
    ),
}
NAMED_LINE = {"blackfly": None, "ace": "Line1", "alvium": None}


@contextmanager
def opened(name: str, power_on: dict[str, Any], **spec: Any) -> Iterator[tuple[UsbVisionCamera, Any, Any]]:
    options = WorldOptions(
        world=name, width_px=WIDTH, height_px=HEIGHT, noise=False, ambient=0.2, cameras={"left": power_on}
    )
    with World(options), open_wires("hw_sim.wires:open", {"world": name}) as wires, ExitStack() as stack:
        camera = stack.enter_context(
            UsbVisionCamera.open(CameraSpec("camera.left", "KF-CAM-L", **spec), wires.usb_backend, wires.clock)
        )
        board = stack.enter_context(open_board(BoardSpec(f"kfsim://{name}/board"), wires))
        yield camera, board, wires.clock


def recorded(camera: UsbVisionCamera, board: Any, clock: Any) -> tuple[NDArray[np.uint8], list[int]]:
    """Return the last of some frames at 60 Hz, and the block ids of all; the camera's clock is asked for none."""
    camera.start()
    clock.sleep_s(0.05)
    board.live(1, *PULSE_US)
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    ids: list[int] = []
    stamps_ns: list[int] = []
    for _ in range(FRAMES):
        frame = camera.next_frame(image, 1.0)
        assert frame.status is FrameStatus.COMPLETE, frame.detail
        assert frame.block_id is not None
        assert frame.camera_time_ns is not None
        ids.append(frame.block_id)
        stamps_ns.append(frame.camera_time_ns)
    board.stop()
    camera.stop()
    # Frames that are lost need not leave a gap in the ids.
    apart_ms = np.diff(stamps_ns) / 1e6
    assert np.all(np.abs(apart_ms - 1000 / 60) < 2.0), apart_ms
    return image.copy(), ids


@pytest.fixture(scope="module")
def usual() -> NDArray[np.uint8]:
    """The picture that the usual camera takes: light on a thing with a texture, not two alike in the row or the column."""
    with opened("makers-usual", {}) as (camera, board, clock):
        camera.configure(SETTINGS)
        image, _ = recorded(camera, board, clock)
    light = image.astype(float)
    for other in (light[:, ::-1], light[::-1], np.roll(light, 8, 1)):
        assert np.abs(light - other).mean() > 4.0, "a picture that would not tell"
    return image


@pytest.mark.parametrize(
    ("maker", "left_behind"),
    [
        pytest.param(maker, left, marks=[pytest.mark.devices] if left else [])
        for maker in MAKERS
        for left in ({}, *LEFT_BEHIND[maker])
    ],
    ids=lambda value: "-".join(value) or "factory" if isinstance(value, dict) else value,
)
def test_a_makers_camera_takes_the_usual_picture_at_the_usual_moments(
    maker: str, left_behind: dict[str, Any], usual: NDArray[np.uint8]
) -> None:
    # Without the maker's own way back to its defaults each of the settings must be undone by itself.
    power_on = {"personality": maker, "saved": left_behind, "lacks": ["UserSetLoad"] if left_behind else []}
    name = "-".join(("makers", maker, *left_behind)).replace("[", "-").replace("]", "")
    with opened(name, power_on, trigger_source=NAMED_LINE[maker]) as parts:
        camera, board, clock = parts
        camera.configure(SETTINGS)
        assert ("no user sets" in camera.health().details.get("not offered", "")) == bool(left_behind)
        image, ids = recorded(camera, board, clock)
    assert ids == list(range(ids[0], ids[0] + FRAMES))
    # Black levels differ by two grey values.
    assert np.abs(image.astype(int) - usual.astype(int)).max() <= 4


@pytest.mark.devices
@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("trouble", [{"left_halted": True}, {"needs_lock": True}], ids=lambda one: next(iter(one)))
def test_what_a_program_before_left_of_a_stream_is_no_obstacle(
    maker: str, trouble: dict[str, Any], usual: NDArray[np.uint8]
) -> None:
    name = f"makers-{maker}-{next(iter(trouble))}"
    with opened(name, {"personality": maker, **trouble}, trigger_source=NAMED_LINE[maker]) as parts:
        camera, board, clock = parts
        camera.configure(SETTINGS)
        image, _ = recorded(camera, board, clock)
    assert np.abs(image.astype(int) - usual.astype(int)).max() <= 4


@pytest.mark.devices
@pytest.mark.parametrize("pixel_format", ["Mono10", "Mono10p", "Mono12", "Mono12p"])
def test_more_bits_are_the_same_picture(pixel_format: str, usual: NDArray[np.uint8]) -> None:
    with opened(f"makers-{pixel_format}", {"personality": "alvium"}, pixel_format=pixel_format) as parts:
        camera, board, clock = parts
        camera.configure(SETTINGS)
        image, _ = recorded(camera, board, clock)
    assert np.abs(image.astype(int) - usual.astype(int)).max() <= 4
