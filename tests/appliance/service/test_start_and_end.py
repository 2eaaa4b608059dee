"""The note that switches the machine off, the signals that end the service, and devices that boards are recorded with."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from appliance.machine.states import Device
from appliance.scan.exposure import Exposure
from appliance.service.air_live import opened
from appliance.service.app import _signals, ask_power_off, take_back_power_off
from appliance.service.device_supervisor import DeviceSupervisor
from drivers.api import Board, DeviceError
from tests.appliance.service.scripted import Desk, a_desk
from tests.drivers.clock import SteppedClock


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with a_desk(tmp_path) as made:
        yield made


def test_the_note_that_switches_off_is_in_the_units_own_folder_and_does_not_outlive_a_start(tmp_path: Path) -> None:
    environment = {"RUNTIME_DIRECTORY": f"{tmp_path}:/run/other"}
    ask_power_off(environment)
    assert [path.name for path in tmp_path.iterdir()] == ["power-off"]
    for _ in range(2):
        take_back_power_off(environment)
        assert list(tmp_path.iterdir()) == []
    for at_a_desk in ({}, {"RUNTIME_DIRECTORY": ""}):
        ask_power_off(at_a_desk)
        take_back_power_off(at_a_desk)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_is_the_reason_to_stop_and_means_what_it_did_afterwards(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with _signals() as stopping:
        assert [stopping.reason] == [None]
        os.kill(os.getpid(), number)
        assert stopping.reason == number.name
    assert signal.getsignal(number) is before


def test_devices_that_are_there_are_had_at_once(desk: Desk) -> None:
    clock = SteppedClock()
    grabbers, board, projector = opened(desk.devices, clock)
    assert (set(grabbers), board, projector) == (
        {"left", "right"}, desk.devices.board.value, desk.devices.projector.value,
    )  # fmt: skip
    assert clock.now_ns() == SteppedClock().now_ns()


def test_a_device_that_does_not_come_is_named_after_twenty_seconds(desk: Desk) -> None:
    clock = SteppedClock()
    desk.devices.board.lose("unplugged")
    desk.devices.board = DeviceSupervisor(Device.BOARD, _refuse, desk.script.clock, None)
    begun_ns = clock.now_ns()
    with pytest.raises(DeviceError) as caught:
        opened(desk.devices, clock)
    assert caught.value.device == "board"
    assert 20.0 <= (clock.now_ns() - begun_ns) / 1e9 <= 20.06


def _refuse() -> AbstractContextManager[Board]:
    raise DeviceError("board", "not found", "Plug it in")


def test_the_right_camera_keeps_its_difference_from_the_left(desk: Desk) -> None:
    left, right = desk.rig.camera.left, desk.rig.camera.right
    object.__setattr__(right, "exposure_ms", 2.0 * left.exposure_ms)
    object.__setattr__(right, "gain_db", left.gain_db + 3.0)
    desk.devices.expose(Exposure(8_000, 6.0))
    for camera in desk.devices.cameras.values():
        assert camera.value is not None
        camera.value.live()
    end_ns = desk.script.clock.now_ns() + 5_000_000_000
    while len(desk.script.said) < 2:
        assert desk.script.clock.now_ns() < end_ns
        desk.script.clock.sleep_s(0.002)
    assert sorted(desk.said()) == ["left 8000 us 6 dB", "right 16000 us 9 dB"]
