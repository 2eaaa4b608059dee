"""What the thread of a camera does and waits for, how a sequence is made ready, and which witness is believed first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import cast

import numpy as np
import pytest

from appliance.capture.grabber import Grabber, SideRecording
from appliance.capture.scan import Arming, ScanSettings
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.verdict import Verdict
from drivers.api import Board, Camera, CameraSettings, ClockReading, Frame, FrameStatus, LaserState
from drivers.native import MonotonicClock
from tests.appliance.capture.test_course_of_a_scan import (
    DELAY_US,
    EXPOSURE_US,
    HEIGHT_PX,
    HZ,
    PERIOD_NS,
    SEQUENCE,
    WIDTH_PX,
    Bench,
    N,
    Script,
    ScriptedBoard,
    ScriptedCamera,
    a_bench,
)

SIDES = ("left", "right")


@pytest.fixture
def bench() -> Iterator[Bench]:
    with a_bench() as one:
        yield one


def frame(status: FrameStatus = FrameStatus.COMPLETE) -> Frame:
    return Frame(status, 0, 0, 0)


@pytest.mark.parametrize(
    ("frames", "done", "complete"),
    [
        ([frame()] * 3, True, True),
        ([frame()] * 3, False, False),
        ([frame()] * 2, True, False),
        ([frame()] * 4, True, False),
        ([frame(), frame(), frame(FrameStatus.TIMEOUT)], True, False),
        ([], True, False),
    ],
)
def test_a_recording_is_complete_when_all_its_frames_arrived_whole(
    frames: list[Frame], done: bool, complete: bool
) -> None:
    slots = np.zeros((3, 2, 2), np.uint8)
    assert SideRecording(slots, lambda k: None, done=done, frames=frames).complete == complete


def test_a_camera_waits_long_for_the_first_frame_less_for_the_others_and_two_blanks_for_none(bench: Bench) -> None:
    assert bench.record().fault is None
    for side in SIDES:
        assert bench.script.waits_s[side] == pytest.approx([2.0, *(N - 1) * [0.15], 0.035])


def test_a_camera_runs_only_as_long_as_it_is_wanted() -> None:
    with a_bench() as bench:
        assert bench.record().fault is None
        for side in SIDES:
            assert bench.script.cameras[side] == ["start", "stop"]
        bench.show(3)
        grabber = bench.grabbers["left"]
        grabber.live()
        bench.wait_for(lambda: grabber.latest(0) is not None)
        assert grabber.idle(10.0)
        assert bench.script.cameras["left"] == ["start", "stop", "start", "stop"]
    assert bench.script.cameras["left"][-1] == "stop", "whatever it was doing"
    assert bench.script.cameras["right"] == ["start", "stop", "stop"]


def test_a_live_image_that_is_not_whole_is_not_shown(bench: Bench) -> None:
    bench.script.damaged = {"left": (1, FrameStatus.TRUNCATED)}
    grabber = bench.grabbers["left"]
    bench.show(3)
    grabber.live()
    bench.wait_for(lambda: grabber.latest(1) is not None)
    found = grabber.latest(1)
    assert found is not None
    assert found[0] == 2, "of three images two are whole"
    assert np.all(found[1] == 3)
    assert grabber.idle(10.0)


class Hurried(MonotonicClock):
    """Waits a fiftieth as long."""

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return super().wait_for(condition, predicate, 0.02 * timeout_s)


def test_a_camera_at_rest_tells_its_temperature() -> None:
    script = Script()
    settings = CameraSettings(WIDTH_PX, HEIGHT_PX, float(EXPOSURE_US), 0.0)
    timeouts = ScanSettings(HZ, EXPOSURE_US, DELAY_US).timeouts
    with Grabber("left", cast("Camera", ScriptedCamera("left", script)), Hurried(), settings, timeouts) as grabber:
        for _ in range(2000):
            if grabber.temperature_c is not None:
                break
            script.clock.sleep_s(0.005)
        assert grabber.temperature_c == 30.5
        assert (grabber.side, grabber.lost) == ("left", None)


def test_the_clocks_that_were_read_before_the_sequence_are_evidence(bench: Bench) -> None:
    """Here they say that the right camera's exposures are all 3 ms late."""
    sent_ns = 1_000_000_000
    bench.script.clocks = {
        "left": ClockReading(0, sent_ns, sent_ns),
        "right": ClockReading(-3_000_000, sent_ns, sent_ns),
    }
    report = bench.record()
    assert dict(report.ledger.clocks) == bench.script.clocks
    assert report.fault is not None
    assert (report.fault.code, report.fault.device) == (FaultCode.SYNC_LOST, "camera.right")


def test_the_second_sequence_has_its_own_place_and_the_first_one_stays() -> None:
    with a_bench(sequences=2) as bench:
        assert bench.record().fault is None
        bench.script.shown = 0
        recorder = bench.recorder()
        for side in SIDES:
            bench.store.frames(side)[:] = 99
        arming = recorder.arm(SEQUENCE, bench.store, lambda side, k: None, second=True)
        bench.wait_for(arming.poll)
        assert recorder.play(SEQUENCE, arming, lambda: None).fault is None
        for side in SIDES:
            assert np.all(bench.store.frames(side) == 99)
            assert bench.store.frames(side, second=True)[:, 0, 0].tolist() == list(range(1, N + 1))


def test_a_display_that_does_not_count_its_blanks_is_planned_by_the_boards_number(bench: Bench) -> None:
    bench.script.counted = False
    report = bench.record()
    assert report.fault is None
    assert report.ledger.start_sequence is None
    assert report.ledger.start_vsync is not None
    assert report.ledger.start_vsync == report.ledger.pulses[0].vsync


def test_a_late_flip_is_the_cause_and_the_frames_that_are_damaged_after_it_are_not(bench: Bench) -> None:
    bench.script.late_at = 2
    bench.script.damaged = {"left": (4, FrameStatus.TRUNCATED)}
    report = bench.record()
    assert report.fault is not None
    assert (report.fault.code, report.fault.numbers["frame"]) == (FaultCode.LATE_FLIP, 2)


def test_without_a_count_of_blanks_a_damaged_frame_is_still_named(bench: Bench) -> None:
    bench.script.counted = False
    bench.script.damaged = {"right": (1, FrameStatus.CORRUPT)}
    report = bench.record()
    assert report.fault is not None
    assert (report.fault.code, report.fault.device) == (FaultCode.FRAME_CORRUPT, "camera.right")


# --------------------------------------------------------------------------------------------- making ready


class SetClock(MonotonicClock):
    """Shows what it was set to."""

    def __init__(self) -> None:
        self.time_s = 100.0

    def now_ns(self) -> int:
        return round(self.time_s * 1e9)


def arming_of(bench: Bench, clock: SetClock) -> Arming:
    slots = {side: bench.store.frames(side) for side in SIDES}
    board = cast("Board", ScriptedBoard(bench.script))
    return Arming(bench.grabbers, board, clock, slots, lambda side, k: None, 2.0)


def test_each_half_of_making_ready_has_its_own_time(bench: Bench) -> None:
    """1.9 s to leave the live view, 1.9 s to start again: both are in time, and 2 s are not."""
    clock, script = SetClock(), bench.script
    script.slow = ("right", "stop")
    bench.show(N)
    for grabber in bench.grabbers.values():
        grabber.live()
    bench.wait_for(lambda: all(grabber.latest(0) is not None for grabber in bench.grabbers.values()))
    arming = arming_of(bench, clock)
    clock.time_s += 1.9
    assert not arming.poll(), "still in its live view"
    assert not arming.recordings
    script.go_on.set()
    bench.wait_for(lambda: all(grabber.idle(0.01) for grabber in bench.grabbers.values()))
    script.go_on.clear()
    script.slow = ("left", "start")
    bench.show(0)
    assert not arming.poll()
    assert set(arming.recordings) == set(SIDES)
    clock.time_s += 1.9
    assert not arming.poll()
    clock.time_s += 0.2
    assert arming.poll()
    assert arming.fault is not None
    assert arming.fault.detail == "camera.left did not start in 2 s"
    script.go_on.set()
    arming.let_go()


class Watched(MonotonicClock):
    """Notes for how long the first thread has waited for something."""

    def __init__(self) -> None:
        self.waits_s: list[float] = []

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        if threading.current_thread() is threading.main_thread():
            self.waits_s.append(timeout_s)
        return super().wait_for(condition, predicate, timeout_s)


def test_making_ready_waits_for_nothing() -> None:
    """A heartbeat goes on meanwhile."""
    clock = Watched()
    with a_bench(clock=clock) as bench:
        arming = arming_of(bench, SetClock())
        bench.wait_for(arming.poll)
        assert arming.fault is None
        assert len(clock.waits_s) >= 4
        assert set(clock.waits_s) == {0.0}
        arming.let_go()
        bench.show(1)


def test_what_was_armed_is_let_go_when_no_sequence_follows(bench: Bench) -> None:
    arming = arming_of(bench, SetClock())
    bench.wait_for(arming.poll)
    assert arming.fault is None
    arming.let_go()
    for side in SIDES:
        assert arming.recordings[side].cancelled
    bench.show(1)  # what comes now ends the recording
    for side in SIDES:
        assert bench.grabbers[side].wait(arming.recordings[side], "done", 10.0)
        assert len(arming.recordings[side].frames) == 1
        assert bench.grabbers[side].idle(10.0)


def test_no_camera_is_started_while_a_laser_conducts(bench: Bench) -> None:
    bench.script.lasers = LaserState(True, False)
    arming = arming_of(bench, SetClock())
    assert arming.poll()
    assert not arming.recordings
    assert bench.script.cameras == {"left": [], "right": []}
    arming.let_go()


def test_a_fault_stands_for_a_verdict_that_says_its_code_its_words_and_its_numbers() -> None:
    verdict = Verdict.failed("motion", Fault(FaultCode.MOVED, "axial", {"shift_px": 1.8}))
    assert verdict == Verdict("motion", False, {"shift_px": 1.8}, "MOVED: axial")
    assert Verdict.failed("motion", Fault(FaultCode.MOVED)).text == "MOVED"


def test_how_long_a_sequence_took_is_told(bench: Bench) -> None:
    begun_ns = bench.script.clock.now_ns()
    report = bench.record()
    assert N * 0.001 <= report.recording_s <= (bench.script.clock.now_ns() - begun_ns) / 1e9
    assert report.ledger.period_ns == PERIOD_NS
