"""One scan with devices that follow a script: what is armed, what a report says, and which of several troubles comes first."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.instrument.capture.grabber import Grabber, SideRecording
from appliance.instrument.capture.ledger import audit
from appliance.instrument.capture.scan import Arming, CaptureReport, ScanRecorder, ScanSettings, device_fault
from appliance.instrument.capture.store import FrameStore
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.patterns import build_sequence
from drivers import api
from drivers.native import MonotonicClock

SEQUENCE = build_sequence(16, 64, 64)
N = len(SEQUENCE)
HZ, DELAY_US, EXPOSURE_US = 60.0, 500, 8000
PERIOD_NS = 1e9 / HZ
SIDES = ("left", "right")
HEIGHT_PX, WIDTH_PX = 2, 3
IDLE_SEQUENCE, IDLE_VSYNC, IDLE_US = 1000, 200, 5_000_000
"""The blank of the flip that the sequence is planned by: the display's number, the board's, and the board's time."""
BEAT = api.Telemetry(0, 0, 0, api.LaserState(False, False))


@dataclass
class Script:
    damaged: dict[str, tuple[int, api.FrameStatus]] = field(default_factory=dict)
    lost_at: dict[str, int] = field(default_factory=dict)
    too_many: str | None = None
    slow: tuple[str, str] | None = None
    starting: bool = False
    go_on: threading.Event = field(default_factory=threading.Event)
    lasers: api.LaserState = BEAT.lasers
    pulses: Callable[[list[api.BoardEvent]], list[api.BoardEvent]] = list
    before: list[api.BoardEvent] = field(default_factory=list)
    projector_gone: bool = False
    counted: bool = True
    late_at: int | None = None
    clocks: dict[str, api.ClockReading] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    cameras: dict[str, list[str]] = field(default_factory=lambda: {"left": [], "right": []})
    waits_s: dict[str, list[float]] = field(default_factory=lambda: {"left": [], "right": []})
    clock: MonotonicClock = field(default_factory=MonotonicClock)
    blank: threading.Condition = field(default_factory=threading.Condition)
    shown: int = 0
    idle_ns: int = 0

    def show(self, patterns: int) -> None:
        """As if so many patterns had been shown: whoever waits for one of them gets its frame."""
        with self.blank:
            self.shown = patterns
            self.blank.notify_all()

    def until(self, happened: Callable[[], object], timeout_s: float = 10.0) -> None:
        end_ns = self.clock.now_ns() + round(1e9 * timeout_s)
        while not happened():
            assert self.clock.now_ns() < end_ns
            self.clock.sleep_s(0.001)


class ScriptedCamera:
    """Gives the k-th frame once the k-th pattern is shown."""

    def __init__(self, side: str, script: Script) -> None:
        self._side, self._script = side, script
        self._next = 0

    def configure(self, settings: api.CameraSettings) -> api.CameraSettings:
        self._script.said.append(f"{self._side} {settings.exposure_us:g} us {settings.gain_db:g} dB")
        return settings

    def start(self) -> None:
        self._script.cameras[self._side].append("start")
        self._script.waits_s[self._side].clear()
        if self._script.slow == (self._side, "start"):
            self._script.starting = True
            self._script.go_on.wait(10.0)
        self._next = 0

    def stop(self) -> None:
        self._script.cameras[self._side].append("stop")
        if self._script.slow == (self._side, "stop"):
            self._script.go_on.wait(10.0)

    def temperature_c(self) -> float | None:
        return 30.5

    def read_clock(self) -> api.ClockReading | None:
        return self._script.clocks.get(self._side)

    def next_frame(self, slot: NDArray[np.uint8], timeout_s: float) -> api.Frame:
        k, script = self._next, self._script
        script.waits_s[self._side].append(timeout_s)
        last = N + (1 if script.too_many == self._side else 0)
        with script.blank:
            if k >= last or not script.blank.wait_for(lambda: script.shown > min(k, N - 1), timeout_s):
                return api.Frame(api.FrameStatus.TIMEOUT, None, None, 0)
        if script.lost_at.get(self._side) == k:
            script.cameras[self._side].append("lost")
            raise api.DeviceGone(f"camera.{self._side}", "unplugged", "plug it in")
        self._next = k + 1
        slot[:] = k + 1
        at, status = script.damaged.get(self._side, (-1, api.FrameStatus.COMPLETE))
        return api.Frame(
            status if at == k else api.FrameStatus.COMPLETE, k, 77 + round(k * PERIOD_NS), 0, "as scripted"
        )


class ScriptedProjector:
    """Shows a pattern at every blank from the planned one on."""

    def __init__(self, script: Script) -> None:
        self._script = script

    def play(
        self, indices: Sequence[int], idle: int, start: Callable[[api.Flip], int | None], abort: Callable[[], bool]
    ) -> list[api.Flip]:
        script = self._script
        script.idle_ns = script.clock.now_ns()
        first = start(api.Flip(idle, IDLE_SEQUENCE if script.counted else None, script.idle_ns))
        assert first is not None
        first += 0 if script.counted else IDLE_SEQUENCE
        passed = round((script.clock.now_ns() - script.idle_ns) / PERIOD_NS)
        assert 3 <= first - IDLE_SEQUENCE <= 3 + passed, (
            "three blanks from now, and no pattern is shown later than that"
        )
        flips: list[api.Flip] = []
        for k, index in enumerate(indices):
            if abort():
                break
            if script.projector_gone and k == 3:
                raise api.DeviceGone("projector", "no signal", "plug it in")
            sequence = first + k + (1 if script.late_at is not None and k >= script.late_at else 0)
            shown_ns = script.idle_ns + round((sequence - IDLE_SEQUENCE) * PERIOD_NS)
            flips.append(api.Flip(index, sequence if script.counted else None, shown_ns))
            script.show(script.shown + 1)
            self._wait_for_cameras(k, abort)
        return flips

    def _wait_for_cameras(self, k: int, abort: Callable[[], bool]) -> None:
        """Until both have taken the k-th frame, or one has ended before its last and whoever plays knows: so that what is
        recorded does not depend on which thread the machine lets run."""
        script = self._script

        def settled() -> bool:
            ended = [said[-1:] in (["stop"], ["lost"]) for said in script.cameras.values()]
            taken = [len(waits) > k + 1 for waits in script.waits_s.values()]
            if (any(ended) and k < N - 1 and abort()) or (all(taken) and not any(ended)):
                return True
            return k == N - 1 and all(a or b for a, b in zip(ended, taken, strict=True))

        script.until(settled)


class ScriptedBoard:
    def __init__(self, script: Script) -> None:
        self._script = script
        self._events: list[api.BoardEvent] = list(script.before)

    def stop(self) -> None:
        self._script.said.append("stop")

    def set_lasers(self, left_on: bool, right_on: bool) -> api.LaserState:
        self._script.said.append(f"lasers {left_on} {right_on}")
        return self._script.lasers

    def vsync(self) -> api.Vsync:
        asked_ns = self._script.idle_ns + 100_000
        return api.Vsync(IDLE_VSYNC, IDLE_US, IDLE_US + 100, asked_ns, asked_ns)

    def arm(self, pulses: int, at_vsync: int, delay_us: int, width_us: int) -> None:
        self._script.said.append(f"arm {pulses} delay {delay_us} width {width_us}")
        first_us = IDLE_US + (at_vsync - IDLE_VSYNC) * PERIOD_NS / 1000 + delay_us
        fired = [api.Pulse(k, at_vsync + k, round(first_us + k * PERIOD_NS / 1000)) for k in range(pulses)]
        self._events += self._script.pulses([*fired, api.PulsesDone(pulses)])

    def next_event(self, timeout_s: float) -> api.BoardEvent | None:
        return self._events.pop(0) if self._events else None


@dataclass
class Bench:
    script: Script
    grabbers: dict[str, Grabber]
    store: FrameStore
    arrived: list[tuple[str, int]] = field(default_factory=list)

    def record(self, abort: Callable[[], Fault | None] = lambda: None, latency_blanks: int = 0) -> CaptureReport:
        recorder = self.recorder(latency_blanks)
        return recorder.record(SEQUENCE, self.store, lambda side, k: self.arrived.append((side, k)), abort)

    def fault(self) -> Fault:
        fault = self.record().fault
        assert fault is not None
        return fault

    def recorder(self, latency_blanks: int = 0) -> ScanRecorder:
        board, projector = (
            cast("api.Board", ScriptedBoard(self.script)),
            cast("api.Projector", ScriptedProjector(self.script)),
        )
        settings = ScanSettings(HZ, EXPOSURE_US, DELAY_US, latency_blanks)
        return ScanRecorder(self.grabbers, board, projector, self.script.clock, settings)

    def arming(self, clock: MonotonicClock, ready_s: float = 2.0) -> Arming:
        slots = {side: self.store.frames(side) for side in SIDES}
        board = cast("api.Board", ScriptedBoard(self.script))
        return Arming(self.grabbers, board, clock, slots, lambda side, k: None, ready_s)

    def live(self) -> None:
        self.script.show(N)
        for grabber in self.grabbers.values():
            grabber.live()
        self.script.until(lambda: all(grabber.latest(0) is not None for grabber in self.grabbers.values()))


@pytest.fixture
def bench() -> Iterator[Bench]:
    with a_bench() as one:
        yield one


@contextmanager
def a_bench(sequences: int = 1, clock: MonotonicClock | None = None) -> Iterator[Bench]:
    """Two cameras that follow a script, each in its thread, and memory for so many sequences."""
    script = Script(clock=clock or MonotonicClock())
    settings = api.CameraSettings(WIDTH_PX, HEIGHT_PX, float(EXPOSURE_US), 0.0)
    timeouts = ScanSettings(HZ, EXPOSURE_US, DELAY_US).timeouts
    with ExitStack() as stack:
        store = stack.enter_context(FrameStore(N, HEIGHT_PX, WIDTH_PX, sequences=sequences))
        cameras = {side: cast("api.Camera", ScriptedCamera(side, script)) for side in SIDES}
        made = {side: Grabber(side, camera, script.clock, settings, timeouts) for side, camera in cameras.items()}
        yield Bench(script, {side: stack.enter_context(one) for side, one in made.items()}, store)


def test_a_scan_in_which_nothing_goes_wrong(bench: Bench) -> None:
    bench.script.before = [api.Pulse(7, 8, 9), api.PulsesDone(8), BEAT]
    begun_ns = bench.script.clock.now_ns()
    report = bench.record()
    assert report.fault is None
    assert bench.script.said == ["stop", "lasers False False", f"arm {N} delay {DELAY_US} width {EXPOSURE_US}"]
    assert sorted(bench.arrived) == sorted((side, k) for side in SIDES for k in range(N))
    ledger = report.ledger
    assert (ledger.expected, ledger.period_ns, ledger.delay_us) == (N, PERIOD_NS, DELAY_US)
    assert ledger.start_sequence is not None
    assert ledger.start_vsync is not None
    assert ledger.start_sequence - IDLE_SEQUENCE == ledger.start_vsync - IDLE_VSYNC >= 3
    assert (len(ledger.flips), len(ledger.pulses)) == (N, N), "a pulse of before does not count"
    for side in SIDES:
        assert bench.store.frames(side)[:, 1, 2].tolist() == list(range(1, N + 1))
        assert len(ledger.frames[side]) == N
        assert bench.script.cameras[side] == ["start", "stop"], "it runs only as long as it is wanted"
        # Long for the first frame, less for the others, and two blanks for none.
        assert bench.script.waits_s[side] == pytest.approx([2.0, *(N - 1) * [0.15], 0.035])
    assert report.board_events == (BEAT,), "kept for whoever watches the board"
    assert N * 0.001 <= report.recording_s <= (bench.script.clock.now_ns() - begun_ns) / 1e9


def test_pulses_wait_for_a_projector_that_throws_its_light_later_than_the_flip(bench: Bench) -> None:
    report = bench.record(latency_blanks=2)
    assert report.fault is None
    ledger = report.ledger
    assert (ledger.start_vsync or 0) - IDLE_VSYNC == (ledger.start_sequence or 0) - IDLE_SEQUENCE + 2
    # The same pulses for a projector that is said to have no latency are two blanks from their flips.
    fault = audit(replace(ledger, latency_blanks=0))
    assert fault is not None
    assert (fault.code, fault.numbers["shift_frames"]) == (FaultCode.PROJECTOR_TIMING, 2)


@pytest.mark.parametrize(
    ("changes", "code", "device", "numbers"),
    [
        *(({"lost_at": {side: at}}, FaultCode.CAMERA_LOST, f"camera.{side}", {}) for side, at in (("left", 0), ("right", 5))),
        ({"damaged": {"left": (4, api.FrameStatus.TRUNCATED)}}, FaultCode.FRAME_TRUNCATED, "camera.left", {"frame": 4}),
        ({"damaged": {"right": (4, api.FrameStatus.CORRUPT)}}, FaultCode.FRAME_CORRUPT, "camera.right", {"frame": 4}),
        ({"damaged": {"right": (1, api.FrameStatus.CORRUPT)}, "counted": False}, FaultCode.FRAME_CORRUPT, "camera.right", {"frame": 1}),
        ({"damaged": {"left": (4, api.FrameStatus.TRUNCATED)}, "late_at": 2}, FaultCode.LATE_FLIP, "projector", {"frame": 2}),
        ({"too_many": "right"}, FaultCode.FRAME_MISSING, "camera.right", {}),
        *(({"pulses": lambda events, said=said: [*events[:6], said]}, code, "board", {}) for said, code in (
            (api.BoardBooted("1.0", "B1", "brown-out"), FaultCode.BOARD_RESET), (api.BoardLost("silent for 2 s"), FaultCode.BOARD_LOST),
            (api.VsyncLost(), FaultCode.VSYNC_LOST))),
        ({"pulses": lambda events: [*events[:6], *events[7:]]}, FaultCode.PULSE_MISSING, "board", {"received": N - 1}),
        ({"projector_gone": True}, FaultCode.PROJECTOR_LOST, "projector", {}),
        # Clocks that were read before say that the right camera's exposures are all 3 ms late.
        ({"clocks": {"left": api.ClockReading(0, 10**9, 10**9), "right": api.ClockReading(-3_000_000, 10**9, 10**9)}},
         FaultCode.SYNC_LOST, "camera.right", {}),
    ],
)  # fmt: skip
def test_of_several_troubles_the_cause_is_named_and_what_was_armed_is_called_off(
    bench: Bench, changes: dict[str, Any], code: FaultCode, device: str, numbers: dict[str, float]
) -> None:
    for name, value in changes.items():
        setattr(bench.script, name, value)
    report = bench.record()
    fault = report.fault
    assert fault is not None
    assert (fault.code, fault.device) == (code, device)
    assert {name: fault.numbers[name] for name in numbers} == numbers
    for at, _ in changes.get("damaged", {}).values():
        assert len(report.ledger.flips) == at + 1, "and the rest of the sequence is not shown"
    if code not in (FaultCode.FRAME_MISSING, FaultCode.SYNC_LOST):
        assert bench.script.said[-1] == "stop", "no more light for nothing"
    if code is FaultCode.CAMERA_LOST:
        assert bench.grabbers[device.removeprefix("camera.")].lost == fault.detail == "unplugged"
        assert bench.fault().code is code, "and the next scan says so too"


@pytest.mark.parametrize(
    ("left", "right", "which"), [(True, False, "left"), (False, True, "right"), (True, True, "left and right")]
)
def test_no_scan_with_a_laser_that_conducts(bench: Bench, left: bool, right: bool, which: str) -> None:
    bench.script.lasers = api.LaserState(left, right)
    fault = bench.fault()
    assert (fault.code, fault.device, f"the {which} laser" in fault.detail) == (FaultCode.LASER_ON, "board", True)
    assert not any(said.startswith("arm") for said in bench.script.said)
    assert (bench.script.shown, bench.script.cameras) == (0, {"left": [], "right": []}), "and no camera is started"


def test_whoever_ends_a_scan_says_why(bench: Bench) -> None:
    leak = Fault(FaultCode.LEAK, "water")
    report = bench.record(lambda: leak if bench.script.shown >= 5 else None)
    assert (report.fault, len(report.ledger.flips), bench.script.said[-1]) == (leak, 5, "stop")


def test_a_display_that_does_not_count_its_blanks_is_planned_by_the_boards_number(bench: Bench) -> None:
    bench.script.counted = False
    report = bench.record()
    assert (report.fault, report.ledger.start_sequence) == (None, None)
    assert report.ledger.start_vsync == report.ledger.pulses[0].vsync


def test_the_second_sequence_has_its_own_place_and_the_first_one_stays() -> None:
    with a_bench(sequences=2) as bench:
        for side in SIDES:
            bench.store.frames(side)[:] = 99
        recorder = bench.recorder()
        arming = recorder.arm(SEQUENCE, bench.store, lambda side, k: None, second=True)
        bench.script.until(arming.poll)
        assert recorder.play(SEQUENCE, arming, lambda: None).fault is None
        for side in SIDES:
            assert np.all(bench.store.frames(side) == 99)
            assert bench.store.frames(side, second=True)[:, 0, 0].tolist() == list(range(1, N + 1))


class OddClock(MonotonicClock):
    """Shows what it was set to, waits for a part of the time, and notes for how long the first thread waited."""

    def __init__(self, time_s: float | None = None, part: float = 1.0) -> None:
        self.time_s, self._part = time_s, part
        self.waits_s: list[float] = []

    def now_ns(self) -> int:
        return super().now_ns() if self.time_s is None else round(self.time_s * 1e9)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        if threading.current_thread() is threading.main_thread():
            self.waits_s.append(timeout_s)
        return super().wait_for(condition, predicate, self._part * timeout_s)


@pytest.mark.parametrize(("side", "slow"), [("left", "stop"), ("right", "start")])
def test_a_camera_that_is_not_ready_in_time_is_named_and_the_next_scan_works(
    bench: Bench, side: str, slow: str
) -> None:
    script = bench.script
    script.slow = (side, slow)
    if slow == "stop":
        bench.live()
    arming = bench.arming(script.clock, 0.2)
    try:
        script.until(arming.poll)
        assert arming.fault is not None
        assert (arming.fault.code, arming.fault.device) == (FaultCode.CAMERA_REFUSED, f"camera.{side}")
        assert arming.poll(), "and stays so"
        arming.let_go()
        assert not bench.grabbers[side].idle(0.01), "it has not come to rest before it answered"
    finally:
        script.show(N)
        script.go_on.set()
    assert all(grabber.idle() for grabber in bench.grabbers.values()), "they come to rest"
    script.show(0)
    assert bench.record().fault is None


def test_each_half_of_making_ready_has_its_own_time(bench: Bench) -> None:
    """1.9 s to leave the live view, 1.9 s to start again: both are in time, and 2 s are not."""
    clock, script = OddClock(100.0), bench.script
    script.slow = ("right", "stop")
    bench.live()
    arming = bench.arming(clock)
    clock.time_s = 101.9
    assert not arming.poll(), "still in its live view"
    assert not arming.recordings
    script.go_on.set()
    bench.script.until(lambda: all(grabber.idle(0.01) for grabber in bench.grabbers.values()))
    script.go_on.clear()
    script.slow = ("left", "start")
    bench.script.show(0)
    assert not arming.poll()
    assert set(arming.recordings) == set(SIDES)
    for clock.time_s, ready in ((103.8, False), (104.0, True)):
        assert arming.poll() == ready
    assert arming.fault is not None
    assert arming.fault.device == "camera.left"
    script.go_on.set()
    arming.let_go()


def test_making_ready_waits_for_nothing_and_what_was_armed_is_let_go_when_no_sequence_follows() -> None:
    clock = OddClock()
    with a_bench(clock=clock) as bench:
        arming = bench.arming(OddClock(100.0))
        bench.script.until(arming.poll)
        assert arming.fault is None
        assert len(clock.waits_s) >= 4
        assert set(clock.waits_s) == {0.0}
        arming.let_go()
        assert all(recording.cancelled for recording in arming.recordings.values())
        bench.script.show(1)  # what comes now ends the recording
        for side in SIDES:
            assert bench.grabbers[side].wait(arming.recordings[side], "done", 10.0)
            assert len(arming.recordings[side].frames) == 1
            assert bench.grabbers[side].idle(10.0)


def test_a_recording_ordered_while_the_last_one_ends_is_made(bench: Bench) -> None:
    bench.script.slow = ("left", "start")
    grabber, slots = bench.grabbers["left"], bench.store.frames("left")
    first = grabber.record(slots, lambda k: None)
    bench.script.until(lambda: bench.script.starting)
    grabber.cancel(first)
    second = grabber.record(slots, lambda k: None)
    bench.script.show(N)
    bench.script.go_on.set()
    assert grabber.wait(first, "done", 5.0)
    assert grabber.wait(second, "done", 5.0), "not forgotten when the first one ended"
    assert len(second.frames) == N


@pytest.mark.parametrize(
    ("statuses", "done", "complete"),
    [("CCC", True, True), ("CCC", False, False), ("CC", True, False), ("CCCC", True, False), ("CCT", True, False), ("", True, False)],
)  # fmt: skip
def test_a_recording_is_complete_when_all_its_frames_arrived_whole(statuses: str, done: bool, complete: bool) -> None:
    of = {"C": api.FrameStatus.COMPLETE, "T": api.FrameStatus.TIMEOUT}
    frames = [api.Frame(of[letter], 0, 0, 0) for letter in statuses]
    recording = SideRecording(np.zeros((3, 2, 2), np.uint8), lambda k: None, done=done, frames=frames)
    assert recording.complete == complete


def test_a_live_image_is_shown_once_the_newest_first_and_one_that_is_not_whole_never() -> None:
    with a_bench() as bench:
        bench.script.damaged = {"left": (1, api.FrameStatus.TRUNCATED)}
        grabber = bench.grabbers["left"]
        assert grabber.latest(-1) is None
        bench.script.show(3)
        grabber.live()
        bench.script.until(lambda: grabber.latest(1) is not None)
        found = grabber.latest(0)
        assert found is not None
        number, image = found
        assert (number, image.shape) == (2, (HEIGHT_PX, WIDTH_PX)), "of three images two are whole"
        assert np.all(image == 3)
        assert grabber.latest(number) is None, "nothing newer"
        assert grabber.idle(10.0)
        assert set(bench.script.waits_s["left"]) == {0.15}, "an order to stop is followed after a seventh of a second"
        assert bench.script.cameras["left"] == ["start", "stop"]
    assert bench.script.cameras["left"][-1] == "stop", "whatever it was doing"


def test_a_camera_at_rest_tells_its_temperature() -> None:
    with a_bench(clock=OddClock(part=0.02)) as bench:
        grabber = bench.grabbers["left"]
        bench.script.until(lambda: grabber.temperature_c == 30.5)
        assert (grabber.side, grabber.lost) == ("left", None)


def test_another_exposure_counts_from_the_next_start_on(bench: Bench) -> None:
    bench.grabbers["left"].expose(4000.0, 6.0)
    assert bench.record().fault is None
    assert bench.script.said.count("left 4000 us 6 dB") == 1
    assert not any(said.startswith("right") for said in bench.script.said)


@pytest.mark.parametrize(
    ("device", "code"),
    [
        ("camera.right", FaultCode.CAMERA_LOST), ("projector", FaultCode.PROJECTOR_LOST), ("display", FaultCode.DISPLAY_LOST),
        ("board", FaultCode.BOARD_LOST), ("wires", FaultCode.INTERNAL),
    ],
)  # fmt: skip
def test_each_device_has_its_own_loss(device: str, code: FaultCode) -> None:
    assert device_fault(device, "gone") == Fault(code, "gone", {}, device)
