"""The worker gives the cloud the pipeline gives, and a killed worker is back for the next scan."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from appliance.capture.store import SIDES, FrameStore
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.worker import (
    CloudReady,
    ReconstructionWorker,
    WorkerFailed,
    WorkerReady,
    WorkLimits,
    WorkOrder,
)
from tests.support import synthetic

NORMAL = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)


class RealClock:
    def now_ns(self) -> int:
        return time.monotonic_ns()

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


def test_same_points_in_the_worker(store: FrameStore) -> None:
    cal = synthetic.calibration()
    sequence = build_sequence(16)
    pipeline = Pipeline(cal, synthetic.WATER, sequence)
    for side in SIDES:
        for k in range(len(sequence)):
            pipeline.push(side, store.frames(side), k)
    pipeline.coarse()
    expected = pipeline.full()
    order = WorkOrder(cal, synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock()) as worker:
        assert worker.wait(60) == WorkerReady()
        worker.reprocess(1)
        coarse, full = worker.wait(20), worker.wait(20)
        assert isinstance(coarse, CloudReady)
        assert not coarse.full
        assert isinstance(full, CloudReady)
        np.testing.assert_array_equal(full.cloud.points_mm, expected.points_mm)
        np.testing.assert_array_equal(full.cloud.pixel, expected.pixel)
        assert full.cloud.summary == expected.summary


def test_frames_that_are_not_a_sequence_fail_and_the_next_scan_works(store: FrameStore) -> None:
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock()) as worker:
        assert worker.wait(60) == WorkerReady()
        worker.begin(1)
        worker.frame("left", 3)
        failed = worker.wait(20)
        assert isinstance(failed, WorkerFailed)
        assert "frame 3 was pushed; frame 0 is next" in failed.fault.detail
        worker.reprocess(2)
        assert isinstance(worker.wait(20), CloudReady)


@pytest.fixture
def worker(store: FrameStore) -> Iterator[ReconstructionWorker]:
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock(), WorkLimits(cloud_s=3.0)) as made:
        assert made.wait(60) == WorkerReady()
        yield made


def signal_worker(worker: ReconstructionWorker, number: signal.Signals) -> None:
    assert worker.pid is not None
    os.kill(worker.pid, number)


def clouds(worker: ReconstructionWorker) -> tuple[list[CloudReady], list[WorkerFailed]]:
    """What comes until the full cloud, a loss or a silence."""
    ready, failed = [], []
    while True:
        event = worker.wait(20)
        if isinstance(event, CloudReady):
            ready.append(event)
            if event.full:
                return ready, failed
        elif isinstance(event, WorkerFailed):
            failed.append(event)
            if event.scan is not None:
                return ready, failed
        elif event is None:
            return ready, failed


def tell(worker: ReconstructionWorker, first: int, stop: int) -> None:
    for index in range(first, stop):
        for side in SIDES:
            worker.frame(side, index)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hung"])
@pytest.mark.parametrize("when", ["idle", "recording", "finished"])
def test_a_worker_that_dies_or_hangs_loses_no_scan(
    worker: ReconstructionWorker, store: FrameStore, number: signal.Signals, when: str
) -> None:
    before = store.frames("left").copy()
    if when == "idle":
        signal_worker(worker, number)
        if number == signal.SIGKILL:
            assert isinstance(worker.wait(20), WorkerFailed)
    worker.begin(7)
    tell(worker, 0, 10)
    if when == "recording":
        signal_worker(worker, number)
        if number == signal.SIGKILL:
            assert isinstance(worker.wait(20), WorkerFailed)
    tell(worker, 10, store.shape[0])
    if when == "finished":
        signal_worker(worker, signal.SIGSTOP)
    worker.finish()
    if when == "finished" and number == signal.SIGKILL:
        signal_worker(worker, number)
    ready, failed = clouds(worker)
    assert [(event.scan, event.full) for event in ready] == [(7, False), (7, True)]
    assert all(event.scan is None for event in failed), "the scan was not given up"
    assert worker.restarts == 1
    np.testing.assert_array_equal(store.frames("left"), before)
    worker.reprocess(8)
    assert clouds(worker)[0][-1].scan == 8


def test_a_scan_that_kills_its_worker_every_time_is_given_up(worker: ReconstructionWorker) -> None:
    signal_worker(worker, signal.SIGSTOP)
    worker.reprocess(5)
    signal_worker(worker, signal.SIGKILL)
    first = worker.wait(20)
    signal_worker(worker, signal.SIGKILL)
    failed = worker.wait(20)
    assert isinstance(first, WorkerFailed)
    assert first.scan is None
    assert isinstance(failed, WorkerFailed)
    assert failed.scan == 5
    assert "ended with code -9" in failed.fault.detail
    worker.reprocess(6)
    assert clouds(worker)[0][-1].scan == 6


def test_too_much_memory_is_named_and_ends(store: FrameStore) -> None:
    order = WorkOrder(synthetic.calibration(), synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock(), WorkLimits(memory_mb=20.0)) as worker:
        worker.begin(3)
        told = []
        while worker.pid is not None:
            event = worker.wait(20)
            assert not isinstance(event, CloudReady)
            if isinstance(event, WorkerFailed):
                told.append(event)
        assert "allowed are 20 MB" in told[-1].fault.detail
        assert [event.scan for event in told if event.scan is not None] == [3], "lost once, and said once"
        assert len(told) == 4
