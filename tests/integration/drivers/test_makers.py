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
MAKERS = ("usual", "blackfly", "ace", "alvium")
LEFT_BEHIND: dict[str, dict[str, Any]] = {
    "blackfly": {
        "ReverseX": True, "BinningHorizontal": 2, "Gamma": 0.5, "LUTEnable": True, "PixelFormat": "Mono12p",
        "TestPattern": "GreyHorizontalRamp", "ChunkModeActive": True, "DeviceLinkThroughputLimit": 1_000_000,
        "AcquisitionFrameRate": 20.0, "AcquisitionFrameRateEnable": True, "TriggerMode[AcquisitionStart]": "On",
    },
    "ace": {
        "OverlapMode": "Off", "ReverseY": True, "DecimationVertical": 2, "DeviceLinkThroughputLimit": 1_000_000,
        "TriggerMode[FrameBurstStart]": "On", "ExposureMode": "TriggerWidth", "GainAuto": "Continuous",
    },
    "alvium": {
        "OffsetX": 40, "ExposureAuto": "Continuous", "LineMode[Line0]": "Output", "TriggerMode[ExposureActive]": "On",
    },
}  # fmt: skip
"""All that an owner may have saved in such a camera, at once."""
STREAM_LEFT: dict[str, dict[str, Any]] = {"blackfly": {"left_halted": True}, "ace": {"needs_lock": True}, "alvium": {}}
"""What a program before left of a stream."""
WAYWARD = {
    "trigger_activation": "FallingEdge", "trigger_source": "Software", "exposure_mode": "TriggerWidth", "exposure_auto": "Continuous",
    "gain_auto": "Continuous", "acquisition_mode": "SingleFrame", "offset_x_px": 16, "offset_y_px": 8, "keeps_stale": True,
}  # fmt: skip
"""The same of the usual camera, which keeps frames of an earlier stream besides."""


@contextmanager
def opened(
    name: str, power_on: dict[str, Any], size_px: tuple[int, int] = (WIDTH, HEIGHT), **spec: Any
) -> Iterator[tuple[UsbVisionCamera, Any, Any]]:
    options = WorldOptions(
        world=name, width_px=size_px[0], height_px=size_px[1], noise=False, ambient=0.2, cameras={"left": power_on}
    )
    with World(options), open_wires("hw_sim.wires:open", {"world": name}) as wires, ExitStack() as stack:
        wanted = CameraSpec("camera.left", "KF-CAM-L", **spec)
        camera = stack.enter_context(UsbVisionCamera.open(wanted, wires.usb_backend, wires.clock))
        board = stack.enter_context(open_board(BoardSpec(f"kfsim://{name}/board"), wires))
        yield camera, board, wires.clock


def recorded(camera: UsbVisionCamera, board: Any, clock: Any) -> tuple[NDArray[np.uint8], list[int | None]]:
    """Return the last of some frames at 60 Hz, and the block ids of all; the camera's clock is asked for none."""
    camera.configure(SETTINGS)
    camera.start()
    clock.sleep_s(0.05)
    board.live(1, *PULSE_US)
    image = np.zeros((HEIGHT, WIDTH), np.uint8)
    frames = [camera.next_frame(image, 1.0) for _ in range(FRAMES)]
    board.stop()
    camera.stop()
    assert [frame.status for frame in frames] == [FrameStatus.COMPLETE] * FRAMES, frames
    # Frames that are lost need not leave a gap in the ids.
    apart_ms = np.diff([frame.camera_time_ns or 0 for frame in frames]) / 1e6
    assert np.all(np.abs(apart_ms - 1000 / 60) < 2.0), apart_ms
    return image, [frame.block_id for frame in frames]


@pytest.fixture(scope="module")
def usual() -> NDArray[np.uint8]:
    """The picture that the usual camera takes: light on a thing with a texture, not two alike in the row or the column."""
    with opened("makers-usual", {}) as parts:
        image, _ = recorded(*parts)
    light = image.astype(float)
    for other in (light[:, ::-1], light[::-1], np.roll(light, 8, 1)):
        assert np.abs(light - other).mean() > 4.0, "a picture that would not tell"
    return image


@pytest.mark.parametrize(("maker", "used"), [(maker, used) for maker in MAKERS for used in (False, True)][1:])
def test_a_makers_camera_takes_the_usual_picture_at_the_usual_moments(
    maker: str, used: bool, usual: NDArray[np.uint8]
) -> None:
    # Without the maker's own way back to its defaults each of the settings must be undone by itself.
    power_on: dict[str, Any] = {"personality": maker}
    if used and maker == "usual":
        power_on = WAYWARD
    elif used:
        power_on |= {"saved": LEFT_BEHIND[maker], "lacks": ["UserSetLoad"], **STREAM_LEFT[maker]}
    with opened(f"makers-{maker}-{used}", power_on, trigger_source="Line1" if maker == "ace" else None) as parts:
        image, ids = recorded(*parts)
        assert ("no user sets" in parts[0].health().details.get("not offered", "")) == used
    assert ids == list(range(FRAMES))
    # Black levels differ by two grey values.
    assert np.abs(image.astype(int) - usual.astype(int)).max() <= 4


@pytest.mark.parametrize("pixel_format", ["Mono10p", "Mono12"])
def test_more_bits_are_the_same_picture(pixel_format: str, usual: NDArray[np.uint8]) -> None:
    with opened(f"makers-{pixel_format}", {"personality": "alvium"}, pixel_format=pixel_format) as parts:
        image, _ = recorded(*parts)
    assert np.abs(image.astype(int) - usual.astype(int)).max() <= 4


def test_images_that_a_host_refuses_whole_come_in_pieces_from_the_next_start_on() -> None:
    size_px = 1200, 900  # a little more than the MiB that the host takes
    statuses = []
    with opened("pieces", {"largest_transfer_bytes": 1 << 20}, size_px) as (camera, board, _):
        camera.configure(CameraSettings(*size_px, 2000.0, 0.0))
        for _start in range(2):
            camera.start()
            board.live(6, *PULSE_US)
            image = np.zeros(size_px[::-1], np.uint8)
            statuses.append([camera.next_frame(image, 1.0).status for _ in range(3)])
            board.stop()
    assert FrameStatus.COMPLETE not in statuses[0]
    assert statuses[1] == [FrameStatus.COMPLETE] * 3
