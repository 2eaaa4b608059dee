"""From the wish for a sequence to its frames: what must be there first, what is told, and what is let go."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Device
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.service.inputs import Inputs
from appliance.service.live import LiveViews
from appliance.service.recording import DrawnPatterns, SequenceRecorder
from drivers.api import (
    BoardBooted,
    BoardLost,
    Key,
    KeyEvent,
    KeyFreed,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    LaserState,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)
from drivers.output.gl import open_gl
from tests.appliance.capture.test_course_of_a_scan import BEAT, SEQUENCE, N
from tests.appliance.service.scripted import Desk, a_desk, small_rig

EXPOSURE = Exposure(8_000, 6.0)
WANTED = do.Arm(7, 16, EXPOSURE, object=5)


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with a_desk(tmp_path) as made:
        made.said()
        yield made


@pytest.fixture(scope="module")
def patterns(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DrawnPatterns]:
    with open_gl() as gl:
        yield DrawnPatterns(gl, small_rig(tmp_path_factory.mktemp("rig")), 64, None)


def recorder(desk: Desk, patterns: DrawnPatterns) -> SequenceRecorder:
    inputs = Inputs(desk.devices, desk.parts.ranging)
    return SequenceRecorder(desk.rig, desk.parts, patterns, inputs, desk.script.clock, desk.inbox)


def nothing() -> None:
    """Draw nothing, abort nothing."""


def answered(desk: Desk, one: SequenceRecorder, enough: Callable[[list[on.Event]], object] = bool) -> list[on.Event]:
    """What is told until it is enough."""
    end_ns, told = desk.script.clock.now_ns() + 5_000_000_000, one.go_on()
    while not enough(told):
        assert desk.script.clock.now_ns() < end_ns
        desk.script.clock.sleep_s(0.002)
        told += one.go_on()
    return told


def test_a_sequence_is_armed_played_and_taken_down(desk: Desk, patterns: DrawnPatterns) -> None:
    one, drawn = recorder(desk, patterns), list[str]()
    one.want(WANTED)
    assert answered(desk, one) == [on.Armed(7)]
    assert one.go_on() == [], "told once"
    desk.script.before = [BEAT]
    assert one.play(7, lambda: drawn.append("screen"), nothing) == on.CaptureFinished(7)
    assert drawn == ["screen"]
    scan = desk.parts.scans.scan
    assert scan is not None
    assert (scan.number, scan.belongs_to, scan.exposure) == (7, 5, EXPOSURE)
    assert scan.record is not None
    assert set(scan.record.temperatures_c) == {"projector", "case", "board", "camera_left", "camera_right"}
    assert desk.parts.scans.store.frames("right")[:, 1, 2].tolist() == list(range(1, N + 1))
    assert one.play(7, nothing, nothing) == on.CaptureFailed(7, Fault(FaultCode.INTERNAL, "nothing was armed"))


@pytest.mark.parametrize("device", ["board", "projector", "left", "right"])
def test_without_all_devices_nothing_is_armed(desk: Desk, patterns: DrawnPatterns, device: str) -> None:
    parts: dict[str, Any] = {"board": desk.devices.board, "projector": desk.devices.projector, **desk.devices.cameras}
    parts[device].lose("unplugged")
    one = recorder(desk, patterns)
    one.want(WANTED)
    assert one.go_on() == []
    (failed,) = desk.inbox
    assert isinstance(failed, on.CaptureFailed)
    assert (failed.number, failed.fault.code) == (7, FaultCode.INTERNAL)
    assert failed.fault.detail == "a capture was wanted without all devices"
    assert desk.parts.scans.scan is None


def test_nothing_is_begun_while_the_disk_is_busy(desk: Desk, patterns: DrawnPatterns) -> None:
    one, gate = recorder(desk, patterns), threading.Event()
    desk.parts.scans.submit(lambda: gate.wait(10.0))
    desk.parts.scans.count()
    one.want(WANTED)
    assert one.go_on() == []
    assert desk.parts.scans.scan is None
    one.want_period(64)
    assert one.go_on() == []
    assert desk.parts.scans.sequence is SEQUENCE
    gate.set()


def test_what_is_let_go_answers_nothing_and_frees_its_memory(desk: Desk, patterns: DrawnPatterns) -> None:
    one = recorder(desk, patterns)
    one.want(WANTED)
    one.go_on()
    assert [desk.parts.scans.scan is None] == [False]
    one.let_go()
    assert [desk.parts.scans.scan] == [None]
    assert one.go_on() == []


def test_patterns_of_another_period_are_drawn_loaded_and_recorded_with(desk: Desk, patterns: DrawnPatterns) -> None:
    one, before = recorder(desk, patterns), desk.parts.scans.store
    one.want_period(16)
    one.go_on()
    assert desk.parts.scans.store is before, "they are in use"
    one.want_period(64)
    one.go_on()
    sequence = desk.parts.scans.sequence
    assert (sequence.period_px, sequence.width_px) == (64, desk.rig.projector.width_px)
    assert desk.said() == [f"load {len(sequence) + 2}", f"show {len(sequence)}"], "behind them: dark, live light"
    assert len(desk.parts.scans.store.frames("left")) == len(sequence)


# ------------------------------------------------------------------------------------------------ live views

DARK, LIT = len(SEQUENCE), len(SEQUENCE) + 1


def until(desk: Desk, happened: Callable[[], object]) -> None:
    end_ns = desk.script.clock.now_ns() + 5_000_000_000
    while not happened():
        assert desk.script.clock.now_ns() < end_ns
        desk.script.clock.sleep_s(0.002)


@pytest.mark.parametrize(("light", "shown"), [(True, LIT), (False, DARK)])
def test_the_lasers_are_off_and_the_light_is_as_wanted_before_the_board_fires(
    desk: Desk, light: bool, shown: int
) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(light, True, EXPOSURE), aiming=True, belongs_to=3)
    board = desk.rig.board
    fired = f"live every {board.live_every_vsyncs} delay {board.trigger_delay_us} width 8000"
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {shown}", "stop", "lasers False False", fired]
    until(desk, lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    live.end()
    told = [said for said in desk.said() if not said.startswith(("left", "right"))]
    assert told == [f"show {DARK}", "lasers False False", "stop"]
    assert desk.inbox == []


def test_each_camera_is_exposed_as_wanted_and_shows_its_latest_image(desk: Desk) -> None:
    live = LiveViews(desk.rig, desk.parts, desk.inbox)
    live.begin(do.GoLive(True, False, EXPOSURE), aiming=False, belongs_to=None)
    until(desk, lambda: all(said == ["start"] for said in desk.script.cameras.values()))
    assert {"left 8000 us 6 dB", "right 8000 us 6 dB"} <= set(desk.said())
    for shown in (1, 2):
        show(desk, shown)

        def all_seen(value: int = shown) -> bool:
            live.take()
            return {side: int(image[0, 0]) for side, image in live.images.items()} == {"left": value, "right": value}

        until(desk, all_seen)
    desk.devices.cameras["left"].lose("unplugged")
    live.take()
    assert set(live.images) == {"right"}, "an old image is no live one"


def show(desk: Desk, patterns: int) -> None:
    with desk.script.blank:
        desk.script.shown = patterns
        desk.script.blank.notify_all()


WARM = Telemetry(0, 0, 0, LaserState(False, False), 41.0, 36.5, 30.0)


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
