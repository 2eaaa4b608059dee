"""Cameras that wake up otherwise than ours: the driver leaves nothing to the state in which it finds one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.api import CameraSettings, DeviceRefused, FrameStatus, Wires
from drivers.camera import CameraSpec, UsbVisionCamera
from drivers.rig import BoardSpec, open_board, open_wires
from hw_sim.options import OptionError
from hw_sim.world import World, WorldOptions

WIDTH, HEIGHT = 96, 64
SERIALS = {"left": "KF-CAM-L", "right": "KF-CAM-R"}
SETTINGS = CameraSettings(WIDTH, HEIGHT, 2000.0, 3.0)
PULSE_US = (500, 6000)
WAYWARD = {
    "trigger_activation": "FallingEdge",
    "trigger_source": "Software",
    "exposure_mode": "TriggerWidth",
    "exposure_auto": "Continuous",
    "gain_auto": "Continuous",
    "acquisition_mode": "SingleFrame",
    "offset_x_px": 16,
    "offset_y_px": 8,
}


@contextmanager
def world(name: str, **cameras: Any) -> Iterator[tuple[Wires, ExitStack]]:
    options = WorldOptions(world=name, width_px=WIDTH, height_px=HEIGHT, noise=False, ambient=0.2, cameras=cameras)
    with World(options), open_wires("hw_sim.wires:open", {"world": name}) as wires, ExitStack() as stack:
        yield wires, stack


def opened(side: str, wires: Wires, stack: ExitStack) -> UsbVisionCamera:
    return stack.enter_context(
        UsbVisionCamera.open(CameraSpec(f"camera.{side}", SERIALS[side]), wires.usb_backend, wires.clock)
    )


def slot() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def test_a_camera_in_the_worst_state_takes_the_same_pictures_at_the_same_moments_as_a_polite_one() -> None:
    with world("wayward", right=WAYWARD) as (wires, stack):
        begins_ns, means = [], []
        board = stack.enter_context(open_board(BoardSpec("kfsim://wayward/board"), wires))
        cameras = [opened(side, wires, stack) for side in SERIALS]
        for camera in cameras:
            got = camera.configure(SETTINGS)
            assert (got.exposure_us, got.gain_db) == pytest.approx((2000.0, 3.0), abs=0.05)
            camera.start()
        wires.clock.sleep_s(0.05)
        board.live(2, *PULSE_US)
        for camera in cameras:
            image = slot()
            frames = [camera.next_frame(image, 1.0) for _ in range(3)]
            assert [frame.status for frame in frames] == [FrameStatus.COMPLETE] * 3, "more than a single frame"
            clock = camera.read_clock()
            assert clock is not None
            last_ns = frames[-1].camera_time_ns
            assert last_ns is not None
            begins_ns.append((clock.host_sent_ns + clock.host_received_ns) / 2 - (clock.camera_time_ns - last_ns))
            means.append(float(image.mean()))
        period_ns = 2e9 / 60
        apart_ns = (begins_ns[1] - begins_ns[0] + period_ns / 2) % period_ns - period_ns / 2
        assert abs(apart_ns) < 1e6, "exposed from the rising edge on, as the other"
        # Two windows onto one scene: 2 ms at 3 dB for both, not 6 ms of the pulse nor 14 ms at 12 dB of an automatic.
        assert means[0] > 5.0
        assert means[1] / means[0] == pytest.approx(1.0, abs=0.3)


def test_a_camera_that_rounds_the_width_is_refused_with_both_numbers() -> None:
    with world("rounds", left={"width_step_px": 64}) as (wires, stack):
        camera = opened("left", wires, stack)
        with pytest.raises(DeviceRefused, match="Width: asked for 96 px, got 64 px"):
            camera.configure(SETTINGS)


def test_what_an_earlier_stream_left_in_the_camera_is_not_taken_for_a_frame_of_the_next() -> None:
    with world("stale", left={"keeps_stale": True}) as (wires, stack):
        camera = opened("left", wires, stack)
        camera.configure(SETTINGS)
        board = stack.enter_context(open_board(BoardSpec("kfsim://stale/board"), wires))
        wires.clock.sleep_s(0.05)
        camera.start()
        board.live(2, *PULSE_US)
        wires.clock.sleep_s(0.2)
        board.stop()
        wires.clock.sleep_s(0.1)
        camera.stop()
        camera.start()
        assert camera.next_frame(slot(), 0.2).status is FrameStatus.TIMEOUT


def test_without_a_gain_only_no_gain_can_be_asked_for_and_without_a_thermometer_nothing_is_told() -> None:
    with world("bare", left={"lacks": ["Gain", "GainAuto", "ExposureAuto", "DeviceTemperature"]}) as (wires, stack):
        camera = opened("left", wires, stack)
        with pytest.raises(DeviceRefused, match=r"has no gain to set.*gain_db = 0"):
            camera.configure(SETTINGS)
        assert camera.configure(replace(SETTINGS, gain_db=0.0)).gain_db == 0.0
        assert camera.temperature_c() is None
        assert camera.health().details["temperature"] == "unknown"


def test_closing_a_camera_that_streams_stops_it_and_one_that_makes_no_sense_is_let_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = WorldOptions(world="closing", width_px=WIDTH, height_px=HEIGHT)
    with World(options) as true, open_wires("hw_sim.wires:open", {"world": "closing"}) as wires, ExitStack() as stack:
        with monkeypatch.context() as patched:
            patched.setattr("drivers.camera.camera.read_identification", _nonsense)
            with pytest.raises(DeviceRefused, match="registers make no sense"):
                opened("left", wires, stack)
        camera = opened("left", wires, stack)  # not "another program uses it"
        camera.configure(SETTINGS)
        camera.start()
        assert (true.cameras["left"].acquiring, true.cameras["left"].streaming) == (True, True)
        camera.close()
        camera.close()
        assert (true.cameras["left"].acquiring, true.cameras["left"].streaming) == (False, False)
        again = opened("left", wires, stack)
        with pytest.raises(DeviceRefused, match="asked for a frame while stopped"):
            again.next_frame(slot(), 0.1)
        with pytest.raises(DeviceRefused, match="started before it was configured"):
            again.start()


def _nonsense(*_: object) -> None:
    raise ValueError("a string register without an end")


def test_the_clock_is_read_in_the_moment_in_which_the_host_was_not_interrupted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with world("clock") as (wires, stack):
        camera = opened("left", wires, stack)
        write, calls = camera._control.write_u32, iter(range(100))

        def interrupted(address: int, value: int) -> None:
            write(address, value)
            if next(calls) % 4 != 2:
                wires.clock.sleep_s(0.005)

        monkeypatch.setattr(camera._control, "write_u32", interrupted)
        reading = camera.read_clock()
        assert reading is not None
        assert reading.bracket_ns < 5_000_000


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"left": {"trigger_activation": "Falling"}}, "allowed are RisingEdge, FallingEdge"),
        ({"left": {"offset_x_px": 3}}, "steps of 8"),
        ({"left": {"exposure": 1}}, "cameras left: unknown 'exposure'"),
        ({"middle": {}}, "cameras: unknown 'middle'"),
    ],
)
def test_a_state_that_no_camera_has_is_refused(table: dict[str, Any], said: str) -> None:
    with pytest.raises(OptionError, match=said):
        WorldOptions(cameras=table)
