"""The note that switches the machine off, the signals that end the service, and devices that boards are recorded with."""

from __future__ import annotations

import json
import os
import signal
from contextlib import AbstractContextManager, nullcontext
from multiprocessing import resource_tracker, spawn
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from appliance.instrument.machine.states import Device
from appliance.instrument.service.air_live import open_devices
from appliance.instrument.service.app import (
    _signals,
    ask_power_off,
    installation,
    recovery_news,
    run,
    take_back_power_off,
    this_run,
)
from appliance.instrument.service.devices import DeviceSupervisor
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.store.library import Library
from appliance.store.lock import holder
from appliance.workshop.bench import TRIES, LightBench, Shot
from appliance.workshop.finding import BringupError
from drivers import rig as drivers_rig
from drivers.api import Board, Clock, DeviceError, DeviceGone, LaserState
from drivers.native import MonotonicClock
from drivers.wall_clock import KernelCalendar
from tests.appliance.instrument.capture.test_course_of_a_scan import N
from tests.appliance.instrument.service.scripted import Desk, small_rig
from tests.appliance.store.scenes import ORIGIN, frames, record
from tests.drivers.clock import SteppedClock


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


def test_a_device_that_does_not_come_is_named_after_twenty_seconds(desk: Desk) -> None:
    clock = SteppedClock()
    desk.devices.board.lose("unplugged")
    desk.devices.board = DeviceSupervisor(Device.BOARD, _refuse, desk.script.clock, None)
    begun_ns = clock.now_ns()
    with pytest.raises(DeviceError) as caught:
        open_devices(desk.devices, clock)
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
    desk.until(lambda: len(desk.script.said) >= 2)
    assert sorted(desk.said()) == ["left 8000 us 6 dB", "right 16000 us 9 dB"]


class EndingClock(MonotonicClock):
    pauses = 0

    def sleep_s(self, seconds: float) -> None:
        self.pauses += 1
        if self.pauses == 10:  # of the heartbeat
            os.kill(os.getpid(), signal.SIGTERM)
        super().sleep_s(seconds)


def no_card(path: str) -> None:
    raise DeviceGone(path, "does not exist", "Check")


def nothing(clock: Clock) -> AbstractContextManager[Any]:
    usb, hidraw = SimpleNamespace(enumerate_devices=list), SimpleNamespace(enumerate=lambda *_: [])
    more = {"calendar": KernelCalendar(), "cards": tuple, "open_card": no_card}
    return nullcontext(SimpleNamespace(usb_backend=usb, hidraw=hidraw, clock=clock, **more))


def test_a_service_that_finds_no_device_runs_until_it_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "runtime").mkdir()
    (tmp_path / "runtime" / "power-off").touch()  # of a run before
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "runtime"))
    monkeypatch.setattr(drivers_rig, "open_wires", lambda *_: nothing(EndingClock()))
    resource_tracker.ensure_running()  # the memory of frames wants it; the process for points cannot live
    monkeypatch.setattr(spawn, "_python_exe", b"/bin/false")
    assert run(small_rig(tmp_path)) == 0
    told = json.loads((tmp_path / "run" / "status.json").read_text())
    assert (told["state"], told["pid"]) == ("SHUTDOWN", os.getpid())
    assert list((tmp_path / "runtime").iterdir()) == [], (
        "neither a note to switch off nor the mark of a run that goes on"
    )
    assert holder(tmp_path) is None


def test_the_bench_plays_pictures_in_any_order_and_a_fault_only_thrice(desk: Desk) -> None:
    wires: Any = SimpleNamespace(clock=desk.script.clock)
    bench = LightBench(desk.rig, wires, desk.parts.scans.store)
    bench._devices, bench._all_channels = open_devices(desk.devices, SteppedClock()), False
    bench.load([np.zeros((2, 2), np.uint8)] * 3, all_channels=False)
    assert desk.said() == ["load 4"], "dark behind them"
    images = bench.take([k % 3 for k in range(N)], Shot(500, 8_000, 6.0))
    assert [images[side][:, 1, 2].tolist() for side in ("left", "right")] == 2 * [list(range(1, N + 1))]
    assert {"left 8000 us 6 dB", "right 8000 us 6 dB", f"arm {N} delay 500 width 8000"} <= set(desk.said())
    desk.script.lasers = LaserState(True, False)
    with pytest.raises(BringupError, match=r"3 recordings in a row failed: .*LASER_ON"):
        bench.take(range(N), Shot(500, 8_000))
    assert desk.said().count("lasers False False") == TRIES


def told(runtime: Path | None, prefix: Path, *, ends_well: bool = True) -> list[FaultCode]:
    environment = {} if runtime is None else {"RUNTIME_DIRECTORY": str(runtime)}
    try:
        with this_run(environment, prefix) as news:
            if not ends_well:
                raise RuntimeError("as every error that ends the service")
    except RuntimeError:
        pass
    return [fault.code for fault in news]


def test_a_run_that_did_not_end_well_is_told_by_the_next_one_only_and_never_at_a_desk(tmp_path: Path) -> None:
    source = tmp_path / "venv"
    assert told(tmp_path, source, ends_well=False) == []  # the first since power-on
    assert told(tmp_path, source) == [FaultCode.RESTARTED]
    assert told(tmp_path, source) == []
    assert told(None, source, ends_well=False) == told(None, source) == []


UNDONE = {"version": "new", "accepted": False, "reason": "it ended 2 times", "now": "old"}


@pytest.mark.parametrize(
    "outcome",
    [UNDONE, UNDONE | {"now": "older"}, UNDONE | {"version": "old", "accepted": True}, {"accepted": False}, []],
)
def test_an_update_that_was_taken_back_is_told(tmp_path: Path, outcome: object) -> None:
    prefix = tmp_path / "versions" / "old"
    prefix.mkdir(parents=True)
    (tmp_path / "outcome.json").write_text(json.dumps(outcome))
    assert told(tmp_path, prefix) == [FaultCode.UPDATE_UNDONE] * (outcome is UNDONE)
    assert installation(prefix) == "old"


def test_a_scan_that_was_cut_off_while_being_saved_is_told_once(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    begun = library.begin(frames(), record(), ORIGIN)  # whole on the disk, never published: here the power goes
    news = recovery_news(Library(tmp_path).recover().recovered)
    assert [(fault.code, begun.scan_id in fault.detail) for fault in news] == [(FaultCode.SCAN_RECOVERED, True)]
    assert recovery_news(Library(tmp_path).recover().recovered) == (), "at the next start it is a scan like any other"
