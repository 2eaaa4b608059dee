"""What key pad and board report becomes the machine's news: keys first, and a flood of reports stops no heartbeat."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import pytest

from appliance.machine import events as on
from appliance.machine.states import Device
from appliance.service.inputs import Inputs
from appliance.service.keys import QUEUE_SIZE, KeyReader
from drivers.api import (
    BoardBooted,
    BoardLost,
    DeviceGone,
    Key,
    KeyEvent,
    KeyFreed,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    Keys,
    KeysLost,
    KeyStuck,
    LaserState,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)
from tests.appliance.capture.test_course_of_a_scan import BEAT
from tests.appliance.service.scripted import Desk, KeyPad, a_desk

WARM = Telemetry(0, 0, 0, LaserState(False, False), 41.0, 36.5, 30.0)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with a_desk(tmp_path) as made:
        yield made


def test_each_report_of_the_board_means_what_it_says(desk: Desk, caplog: pytest.LogCaptureFixture) -> None:
    inputs = Inputs(desk.devices, desk.parts.ranging)
    assert [inputs.telemetry] == [None]
    assert inputs.board_event(WARM) == [on.TelemetryArrived(WARM)]
    assert inputs.telemetry is WARM
    assert inputs.board_event(BoardBooted("1.0", "B1", "BROWNOUT")) == [on.BoardReset("BROWNOUT")]
    assert inputs.board_event(Pulse(1, 2, 3)) == inputs.board_event(PulsesDone(4)) == []
    assert caplog.text == ""
    assert inputs.board_event(VsyncLost()) == []
    assert "no vertical sync" in caplog.text
    assert inputs.board_event(BoardLost("unplugged")) == [on.DeviceDown(Device.BOARD, "unplugged")]
    assert inputs.board_event(BoardLost("unplugged")) == [], "it is known"
    assert inputs.poll() == [], "there is no board to ask"


def test_temperatures_are_told_by_whoever_measures_them(desk: Desk) -> None:
    inputs = Inputs(desk.devices, desk.parts.ranging)
    for camera in desk.devices.cameras.values():
        assert camera.value is not None
        camera.value.live()
        assert camera.value.idle()
    until_s = time.monotonic() + 5.0
    while None in (inputs.temperatures_c()["camera_left"], inputs.temperatures_c()["camera_right"]):
        assert time.monotonic() < until_s
    unknown = {"projector": None, "case": None, "board": None}
    assert inputs.temperatures_c() == {**unknown, "camera_left": 30.5, "camera_right": 30.5}
    inputs.board_event(WARM)
    desk.devices.cameras["left"].lose("unplugged")
    measured = {"projector": 41.0, "case": 36.5, "board": 30.0}
    assert inputs.temperatures_c() == {**measured, "camera_left": None, "camera_right": 30.5}


def test_keys_come_before_the_board_and_a_flood_is_read_bit_by_bit(desk: Desk) -> None:
    inputs = Inputs(desk.devices, desk.parts.ranging)
    board = desk.devices.board.value
    desk.pad.waiting.append(KeyPress(Key.SCAN, 0))
    time.sleep(0.05)
    board._events += [BEAT] * 250  # type: ignore[union-attr]  # the script's
    events = inputs.poll()
    assert events[0] == on.KeyPressed(Key.SCAN)
    assert events[1:] == [on.TelemetryArrived(BEAT)] * 200
    assert inputs.poll() == [on.TelemetryArrived(BEAT)] * 50


class Pad(KeyPad):
    """Is unplugged when all was read."""

    def next_event(self, timeout_s: float) -> KeyEvent | None:
        if not self.waiting:
            raise DeviceGone("keys", "unplugged", "plug it in")
        return super().next_event(timeout_s)


def test_every_key_event_is_heard_and_a_pad_that_is_gone_is_told_once(desk: Desk) -> None:
    inputs = Inputs(desk.devices, desk.parts.ranging)
    pressed: list[KeyEvent] = [KeyPress(Key.UP, 0), KeyLongPress(Key.UP, 0), KeyStuck(Key.UP), KeyFreed(Key.UP)]
    desk.pad.waiting += [*pressed, KeyRelease(Key.UP, 0, 0.1), KeysLost("unplugged")]
    told: list[on.Event] = []
    until_s = time.monotonic() + 5.0
    while len(told) < 5:
        assert time.monotonic() < until_s
        told += inputs.keys()
    assert told == [
        on.KeyPressed(Key.UP), on.KeyHeld(Key.UP), on.KeyJammed(Key.UP), on.KeyFreed(Key.UP),
        on.DeviceDown(Device.KEYS, "unplugged"),
    ]  # fmt: skip
    assert inputs.keys() == [], "nobody is there to ask"


@pytest.mark.parametrize("pressed", [3, QUEUE_SIZE + 20])
def test_what_nobody_reads_is_dropped_and_the_end_of_the_pad_is_told(pressed: int) -> None:
    pad = Pad([KeyPress(Key.UP, k) for k in range(pressed)])
    with KeyReader(cast("Keys", pad)) as reader:
        until_s = time.monotonic() + 5.0
        while pad.waiting:
            assert time.monotonic() < until_s
            time.sleep(0.001)
        time.sleep(0.02)
        told = reader.take()
    whole = [*(KeyPress(Key.UP, k) for k in range(pressed)), KeysLost("unplugged")]
    assert told == whole[:64]
    assert reader.take() == []
