"""From the wish for a sequence to its frames: what must be there first, what is told, and what is let go."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.service.inputs import Inputs
from appliance.service.recording import DrawnPatterns, SequenceRecorder
from drivers.api import FrameStatus, LaserState, Projector
from drivers.output.gl import open_gl
from tests.appliance.capture.test_course_of_a_scan import BEAT, SEQUENCE, N
from tests.appliance.service.scripted import Desk, Lamp, a_desk, small_rig

EXPOSURE = Exposure(8_000, 0.0)
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


def test_a_board_whose_laser_still_conducts_is_told_and_memory_is_free_again(
    desk: Desk, patterns: DrawnPatterns
) -> None:
    one = recorder(desk, patterns)
    desk.script.lasers = LaserState(True, False)
    one.want(WANTED)
    (failed,) = answered(desk, one)
    assert isinstance(failed, on.CaptureFailed)
    assert (failed.number, failed.fault.code) == (7, FaultCode.LASER_ON)
    assert desk.parts.scans.scan is None
    assert one.go_on() == []


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


def test_a_frame_that_was_lost_fails_the_scan_and_frees_its_memory(desk: Desk, patterns: DrawnPatterns) -> None:
    one = recorder(desk, patterns)
    desk.script.damaged["left"] = (N - 1, FrameStatus.TRUNCATED)
    one.want(WANTED)
    answered(desk, one)
    failed = one.play(7, nothing, nothing)
    assert isinstance(failed, on.CaptureFailed)
    assert failed.fault.code is not FaultCode.INTERNAL
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


def test_the_live_light_lies_behind_the_dark_behind_the_patterns(desk: Desk, patterns: DrawnPatterns) -> None:
    class Memory(Lamp):
        def load(self, frames: object) -> None:
            self.loaded = frames

    memory = Memory(desk.script)
    patterns.load(cast("Projector", memory))
    *drawn, dark, live = cast("list[np.ndarray]", memory.loaded)
    assert len(drawn) == len(patterns.sequence)
    assert dark.shape == live.shape == (desk.rig.projector.height_px, desk.rig.projector.width_px)
    assert (dark.max(), live.max() > 0) == (0, True)
