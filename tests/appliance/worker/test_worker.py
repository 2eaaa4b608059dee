"""The worker gives the cloud the pipeline gives, and a killed worker is back for the next scan."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.capture.store import FrameStore
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.sides import SIDES
from appliance.worker.order import WorkLimits, WorkOrder
from appliance.worker.process import (
    CloudReady,
    ReconstructionWorker,
    ScanJudged,
    SequenceIdentified,
    WorkerFailed,
    WorkerReady,
)
from tests.support import synthetic

PATIENCE_S = 120.0
"""Longest wait for what is going to come: a busy computer takes half a minute to start a process."""
NORMAL = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)


class RealClock:
    """Real time; for a while, time as it is for a process that gets a share of a processor."""

    def __init__(self) -> None:
        self._before_ns = 0
        """How much of it there was more than of real time."""
        self._slow: Callable[[], int] | None = None

    def now_ns(self) -> int:
        return time.monotonic_ns() + self._before_ns if self._slow is None else self._slow()

    @contextmanager
    def throttled(self, pid: int, share: float) -> Iterator[None]:
        """As on a processor that is too hot: whatever this machine does beside, the process computes for ``share`` of the time."""
        clock = (~pid << 3) | 2  # the processor time of another process: clock_getcpuclockid(3)
        begun_ns, used_ns = self.now_ns(), time.clock_gettime_ns(clock)
        latest_ns = begun_ns

        def slow() -> int:
            nonlocal latest_ns
            with suppress(OSError):  # it has ended, and was the last that time was measured by
                latest_ns = begun_ns + int((time.clock_gettime_ns(clock) - used_ns) / share)
            return latest_ns

        self._slow = slow
        try:
            yield
        finally:
            self._slow, self._before_ns = None, latest_ns - time.monotonic_ns()

    def sleep_s(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return condition.wait_for(predicate, timeout_s)


@pytest.fixture(scope="module")
def store() -> Iterator[FrameStore]:
    cal = synthetic.calibration()
    sequence = build_sequence(16)
    index = synthetic.WATER.index
    offset = float(NORMAL @ cal.rig.volume_centre_mm(index))
    with FrameStore(len(sequence), 300, 400) as filled:
        for side, camera in (("left", cal.rig.left), ("right", cal.rig.right)):
            pq = synthetic.projector(cal).project(synthetic.plane_points(camera, NORMAL, offset), index)
            filled.frames(side)[...] = np.rint(synthetic.frames(sequence, pq)).astype(np.uint8)
        yield filled


GOOD = WorkLimits(cloud_s=4.0, alive_s=3.0)


@pytest.fixture(scope="module")
def clock() -> RealClock:
    return RealClock()


@pytest.fixture(scope="module")
def lasting(store: FrameStore, clock: RealClock) -> Iterator[ReconstructionWorker]:
    """One worker for all that need none of their own: starting the process is most of what a test here takes."""
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, clock, GOOD) as made:
        assert made.wait(PATIENCE_S) == WorkerReady()
        yield made


@pytest.fixture
def worker(lasting: ReconstructionWorker) -> ReconstructionWorker:
    """Ready, idle and never started again, whatever the test before has done to it: it has just made a whole cloud."""
    lasting.limits = GOOD
    if lasting.pid is not None:
        signal_worker(lasting, signal.SIGCONT)
    lasting.reprocess(0)
    ready, failed = clouds(lasting)
    assert [(event.scan, event.full) for event in ready] == [(0, False), (0, True)]
    assert not failed
    lasting.restarts = 0
    return lasting


def test_same_points_in_the_worker(worker: ReconstructionWorker, store: FrameStore) -> None:
    cal = synthetic.calibration()
    sequence = build_sequence(16)
    pipeline = Pipeline(cal, synthetic.WATER, sequence)
    for side in SIDES:
        for k in range(len(sequence)):
            pipeline.push(side, store.frames(side), k)
    pipeline.coarse()
    expected = pipeline.full()
    worker.reprocess(1)
    assert worker.wait(PATIENCE_S) == SequenceIdentified(1)
    coarse, judged, whole, full = (worker.wait(PATIENCE_S) for _ in range(4))
    assert isinstance(judged, ScanJudged)
    assert isinstance(whole, ScanJudged)
    assert "holes" in [one.verdict.name for one in whole.judgements]
    assert isinstance(coarse, CloudReady)
    assert not coarse.full
    assert isinstance(full, CloudReady)
    np.testing.assert_array_equal(full.cloud.points_mm, expected.points_mm)
    np.testing.assert_array_equal(full.cloud.pixel, expected.pixel)
    assert full.cloud.summary == expected.summary


def test_after_a_change_points_are_those_of_the_new_calibration(store: FrameStore) -> None:
    old, sequence = synthetic.calibration(), build_sequence(16)
    left = old.rig.left
    farther = replace(left.port, distance_mm=left.port.distance_mm + 0.05)
    new = replace(old, rig=replace(old.rig, left=replace(left, port=farther)))
    with Pipeline(new, synthetic.WATER, sequence) as pipeline:
        for side in SIDES:
            for k in range(len(sequence)):
                pipeline.push(side, store.frames(side), k)
        pipeline.coarse()
        expected = pipeline.full()
    order = WorkOrder(old, synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock()) as worker:
        assert worker.wait(PATIENCE_S) == WorkerReady()
        before = worker.pid
        worker.reprocess(1)  # in work when the calibration changes: its cloud would be of the old one
        worker.change(replace(order, calibration=new))
        assert worker.pid not in (before, None)
        assert worker.wait(PATIENCE_S) == WorkerReady()
        assert worker.poll() is None
        worker.reprocess(2)
        assert worker.wait(PATIENCE_S) == SequenceIdentified(2)
        coarse, judged, whole, full = (worker.wait(PATIENCE_S) for _ in range(4))
        assert isinstance(judged, ScanJudged)
        assert isinstance(whole, ScanJudged)
        assert isinstance(coarse, CloudReady)
        assert isinstance(full, CloudReady)
        assert (coarse.scan, full.scan) == (2, 2)
        np.testing.assert_array_equal(full.cloud.points_mm, expected.points_mm)
        assert worker.restarts == 0, "a change is no failure"


def test_frames_that_are_not_a_sequence_fail_and_the_next_scan_works(worker: ReconstructionWorker) -> None:
    worker.begin(1)
    worker.frame("left", 3)
    failed = worker.wait(PATIENCE_S)
    assert isinstance(failed, WorkerFailed)
    assert "frame 3 was pushed; frame 0 is next" in failed.fault.detail
    worker.reprocess(2)
    assert worker.wait(PATIENCE_S) == SequenceIdentified(2)
    assert isinstance(worker.wait(PATIENCE_S), CloudReady)


def signal_worker(worker: ReconstructionWorker, number: signal.Signals) -> None:
    assert worker.pid is not None
    os.kill(worker.pid, number)


def hold(worker: ReconstructionWorker) -> None:
    """Stop the process where it is; return when it stands."""
    signal_worker(worker, signal.SIGSTOP)
    path = Path(f"/proc/{worker.pid}/stat")
    end_s = time.monotonic() + 5.0
    while path.read_text().rpartition(")")[2].split()[0] != "T":
        assert time.monotonic() < end_s
        time.sleep(0.001)


def spoil(worker: ReconstructionWorker, how: str) -> None:
    match how:
        case "killed":
            signal_worker(worker, signal.SIGKILL)
        case "hung":
            signal_worker(worker, signal.SIGSTOP)
        case "grown":
            hold(worker)  # it might be done before anybody measures
            worker.limits = replace(GOOD, memory_mb=20.0, start_memory_mb=20.0)  # whether it still loads or not
        case "raises":
            worker.frame("middle", 0)
        case _:
            raise AssertionError(how)


SAID = {
    "killed": "ended with code -9",
    "hung": "did not answer in time|no sign of life",
    "grown": "allowed are 20 MB",
    "raises": "KeyError",
}


def clouds(worker: ReconstructionWorker) -> tuple[list[CloudReady], list[WorkerFailed]]:
    """What comes until the full cloud, a loss or a silence."""
    ready: list[CloudReady] = []
    failed: list[WorkerFailed] = []
    while True:
        event = worker.wait(PATIENCE_S)
        if isinstance(event, CloudReady):
            ready.append(event)
            if event.full:
                return ready, failed
        elif isinstance(event, WorkerFailed):
            worker.limits = GOOD
            failed.append(event)
            if event.scan is not None:
                return ready, failed
        elif event is None:
            return ready, failed


def tell(worker: ReconstructionWorker, first: int, stop: int) -> None:
    for index in range(first, stop):
        for side in SIDES:
            worker.frame(side, index)


def hold_before_full(worker: ReconstructionWorker) -> CloudReady:
    """The coarse cloud; the process stands still before the full one."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        hold(worker)
        coarse: CloudReady | None = None
        while (event := worker.poll()) is not None:
            if isinstance(event, CloudReady):
                coarse = None if event.full else event
                if event.full:  # it was held too late: once more
                    worker.reprocess(event.scan)
            else:
                assert isinstance(event, SequenceIdentified | ScanJudged)
        if coarse is not None:
            return coarse
        assert time.monotonic() < end_s
        signal_worker(worker, signal.SIGCONT)
        time.sleep(0.001)


@pytest.mark.parametrize(
    ("how", "when"),
    [
        *((how, when) for how in ("killed", "hung", "grown") for when in ("idle", "recording", "coarse", "full")),
        *(("raises", when) for when in ("idle", "recording")),
    ],
)
def test_whatever_becomes_of_a_worker_no_scan_is_lost(
    worker: ReconstructionWorker, store: FrameStore, how: str, when: str
) -> None:
    before = {side: store.frames(side).copy() for side in SIDES}
    failed: list[WorkerFailed] = []
    if when == "idle":
        spoil(worker, how)
        noticed = worker.wait(PATIENCE_S)
        worker.limits = GOOD
        assert isinstance(noticed, WorkerFailed), "noticed although nobody wanted anything of it"
        failed.append(noticed)
    worker.begin(7)
    tell(worker, 0, 10)
    if when == "recording":  # nobody polls while a sequence is recorded
        spoil(worker, how)
    tell(worker, 10, store.shape[0])
    if when == "coarse":
        hold(worker)
    worker.finish()
    if when == "coarse":
        spoil(worker, how)
    if when == "full":
        assert hold_before_full(worker).scan == 7
        spoil(worker, how)
    ready, more = clouds(worker)
    failed += more
    assert [(event.scan, event.full) for event in ready] == [(7, False), (7, True)]
    assert [event.scan for event in failed] == [None], "said once, and the scan was not given up"
    assert re.search(SAID[how], failed[0].fault.detail)
    assert worker.restarts == 1
    for side in SIDES:
        np.testing.assert_array_equal(store.frames(side), before[side])
    worker.reprocess(8)
    assert clouds(worker)[0][-1].scan == 8


def test_the_worker_loads_no_linear_algebra_that_it_does_not_need(worker: ReconstructionWorker) -> None:
    maps = Path(f"/proc/{worker.pid}/maps").read_text()
    assert "numba" in maps
    assert "/scipy/linalg/" not in maps


def test_the_heartbeat_does_not_wait_for_a_worker_that_hangs(worker: ReconstructionWorker) -> None:
    hold(worker)
    end_s = time.monotonic() + PATIENCE_S
    longest_s, failed = 0.0, None
    while failed is None and time.monotonic() < end_s:
        begun_s = time.monotonic()
        failed = worker.poll()
        longest_s = max(longest_s, time.monotonic() - begun_s)
        time.sleep(0.016)
    assert isinstance(failed, WorkerFailed)
    assert "no sign of life for 3 s" in failed.fault.detail
    assert longest_s < 1.0, "the screen stood still"


def test_a_worker_that_is_left_alone_is_not_started_again(worker: ReconstructionWorker) -> None:
    worker.limits = replace(GOOD, alive_s=1.0)
    assert worker.wait(4.0) is None
    assert worker.restarts == 0


def test_the_next_scan_does_not_wait_for_the_one_that_was_dropped(worker: ReconstructionWorker) -> None:
    worker.reprocess(1)
    hold_before_full(worker)
    worker.drop()
    worker.begin(2)
    tell(worker, 0, 24)
    signal_worker(worker, signal.SIGCONT)
    time.sleep(0.5)  # as long as a sequence is recorded, nobody polls
    worker.finish()
    ready, failed = clouds(worker)
    assert [(event.scan, event.full) for event in ready] == [(2, False), (2, True)]
    assert not failed
    assert ready[-1].cloud.summary.points > 1000


def test_a_scan_that_was_given_up_while_it_was_recorded_is_said_to_be_lost_when_it_is_whole(
    worker: ReconstructionWorker,
) -> None:
    worker.begin(3)
    worker.frame("left", 5)
    told = [worker.wait(PATIENCE_S)]
    worker.finish()
    told.append(worker.poll())
    assert [one.scan for one in told if isinstance(one, WorkerFailed)] == [None, 3]
    assert worker.wait(GOOD.cloud_s + 1.0) is None
    assert worker.restarts == 0


def test_a_scan_that_kills_its_worker_every_time_is_given_up(worker: ReconstructionWorker) -> None:
    signal_worker(worker, signal.SIGSTOP)
    worker.reprocess(5)
    signal_worker(worker, signal.SIGKILL)
    first = worker.wait(PATIENCE_S)
    signal_worker(worker, signal.SIGKILL)
    failed = worker.wait(PATIENCE_S)
    assert isinstance(first, WorkerFailed)
    assert first.scan is None
    assert isinstance(failed, WorkerFailed)
    assert failed.scan == 5
    assert "ended with code -9" in failed.fault.detail
    worker.reprocess(6)
    assert clouds(worker)[0][-1].scan == 6


def test_too_much_memory_is_named_and_ends(worker: ReconstructionWorker) -> None:
    worker.limits = replace(GOOD, memory_mb=20.0)
    worker.begin(3)
    told = []
    while worker.pid is not None:
        event = worker.wait(PATIENCE_S)
        assert not isinstance(event, CloudReady)
        if isinstance(event, WorkerFailed):
            told.append(event)
    worker.finish()
    lost = worker.poll()
    assert isinstance(lost, WorkerFailed)
    assert "allowed are 20 MB" in lost.fault.detail
    assert (lost.scan, worker.poll()) == (3, None), "lost once, and said once"
    assert [event.scan for event in told] == [None] * 4


HUNGRY = """
import numpy as np
from multiprocessing.shared_memory import SharedMemory
from appliance.worker.own_memory import limit_memory
limit_memory(100.0)
shared = SharedMemory(create=True, size=300_000_000)
shared.buf[:10] = bytes(10)
shared.close()
shared.unlink()
some = np.ones(50_000_000, np.uint8)
try:
    np.ones(200_000_000, np.uint8)
except MemoryError:
    print("refused")
"""


def test_the_kernel_refuses_what_is_out_of_proportion_but_not_what_is_shared() -> None:
    ran = subprocess.run([sys.executable, "-c", HUNGRY], capture_output=True, text=True, timeout=100, check=True)
    assert ran.stdout.strip() == "refused", ran.stderr


def reprocessed_slowly(worker: ReconstructionWorker, clock: RealClock, share: float = 0.2) -> object:
    """How it ends on a ``share`` of a processor, with much to do before: late."""
    assert worker.pid is not None
    with clock.throttled(worker.pid, share):
        for _ in range(20):
            worker.begin(1)
            tell(worker, 0, 24)
        worker.reprocess(1)
        while not isinstance(event := worker.wait(PATIENCE_S), CloudReady | WorkerFailed):
            pass
    return event


def test_a_worker_that_is_slow_but_computes_is_waited_for(worker: ReconstructionWorker, clock: RealClock) -> None:
    worker.limits = replace(GOOD, cloud_s=0.1, computing_s=60.0)
    assert isinstance(reprocessed_slowly(worker, clock), CloudReady)
    assert worker.restarts == 0


def test_a_worker_that_computes_is_not_waited_for_for_ever(worker: ReconstructionWorker, clock: RealClock) -> None:
    worker.limits = replace(GOOD, cloud_s=0.1, computing_s=0.1)
    # Processor time is told in steps of 10 ms: a quick machine may do it within one of them, but not again and again.
    assert any(isinstance(reprocessed_slowly(worker, clock, 0.02), WorkerFailed) for _ in range(5))
    assert worker.restarts == 1


def test_a_start_that_gets_on_is_told_from_one_that_hangs(store: FrameStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("appliance.worker.process.PROGRESS_CHECK_S", 0.2)
    monkeypatch.setattr("appliance.worker.process.PROGRESS_CPU_S", 0.01)  # the same share of the time
    with ReconstructionWorker(
        WorkOrder(synthetic.calibration(), synthetic.WATER, 16, 1024, 768), store, RealClock()
    ) as made:
        begun_s = time.monotonic()
        while not made.gets_on():
            assert time.monotonic() < begun_s + 240.0  # a busy computer takes half a minute to import alone
            time.sleep(0.01)
        hold(made)
        time.sleep(0.3)
        made.gets_on()  # of what it took until it was held
        seen = []
        for _ in range(3):
            time.sleep(0.3)
            seen.append(made.gets_on())
        assert seen == [False] * 3
        signal_worker(made, signal.SIGCONT)
        assert made.wait(PATIENCE_S) == WorkerReady()
        time.sleep(0.3)
        assert not made.gets_on(), "it has started"
