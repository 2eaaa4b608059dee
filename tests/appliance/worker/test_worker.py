"""The worker gives the cloud the pipeline gives, and a killed worker is back for the next scan."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
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
SIZE_PX = (240, 180)
NORMAL = np.array([0.1, 0.0, 1.0]) / np.hypot(0.1, 1.0)
GOOD = WorkLimits(cloud_s=4.0, alive_s=3.0)


class RealClock:
    """Real time."""

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def sleep_s(self, duration_s: float) -> None:
        time.sleep(duration_s)

    def wait_for(self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float) -> bool:
        return condition.wait_for(predicate, timeout_s)


@pytest.fixture(scope="module")
def store() -> Iterator[FrameStore]:
    cal = synthetic.calibration(*SIZE_PX)
    sequence = build_sequence(16)
    index = synthetic.WATER.index
    offset = float(NORMAL @ cal.rig.volume_centre_mm(index))
    with FrameStore(len(sequence), SIZE_PX[1], SIZE_PX[0]) as filled:
        for side, camera in (("left", cal.rig.left), ("right", cal.rig.right)):
            pq = synthetic.projector(cal).project(synthetic.plane_points(camera, NORMAL, offset), index)
            filled.frames(side)[...] = np.rint(synthetic.frames(sequence, pq)).astype(np.uint8)
        yield filled


@pytest.fixture(scope="module")
def lasting(store: FrameStore) -> Iterator[ReconstructionWorker]:
    """One worker for all: starting the process is most of what a test here takes."""
    order = WorkOrder(synthetic.calibration(*SIZE_PX), synthetic.WATER, 16, 1024, 768)
    with ReconstructionWorker(order, store, RealClock(), GOOD) as made:
        assert made.wait(PATIENCE_S) == WorkerReady()
        yield made


@pytest.fixture
def worker(lasting: ReconstructionWorker) -> ReconstructionWorker:
    """Ready, idle and never started again, whatever the test before has done to it: it has just made a whole cloud."""
    lasting.limits = GOOD
    if lasting.pid is not None:
        os.kill(lasting.pid, signal.SIGCONT)
    lasting.reprocess(0)
    ready, failed = clouds(lasting)
    assert ([(event.scan, event.full) for event in ready], failed) == ([(0, False), (0, True)], [])
    lasting.restarts = 0
    return lasting


def clouds(worker: ReconstructionWorker) -> tuple[list[CloudReady], list[WorkerFailed]]:
    """What comes until the full cloud, a loss or a silence."""
    ready: list[CloudReady] = []
    failed: list[WorkerFailed] = []
    while (event := worker.wait(PATIENCE_S)) is not None:
        if isinstance(event, CloudReady):
            ready.append(event)
            if event.full:
                break
        elif isinstance(event, WorkerFailed):
            worker.limits = GOOD
            failed.append(event)
            if event.scan is not None:
                break
    return ready, failed


def tell(worker: ReconstructionWorker, first: int, stop: int) -> None:
    for index in range(first, stop):
        for side in SIDES:
            worker.frame(side, index)


def hold(worker: ReconstructionWorker) -> None:
    """Stop the process where it is; return when it stands."""
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGSTOP)
    end_s = time.monotonic() + 5.0
    while Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        assert time.monotonic() < end_s
        time.sleep(0.001)


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
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGCONT)
        time.sleep(0.001)


def test_same_points_in_the_worker(worker: ReconstructionWorker, store: FrameStore) -> None:
    sequence = build_sequence(16)
    pipeline = Pipeline(synthetic.calibration(*SIZE_PX), synthetic.WATER, sequence)
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
    assert isinstance(full, CloudReady)
    assert (coarse.full, full.full) == (False, True)
    np.testing.assert_array_equal(full.cloud.points_mm, expected.points_mm)
    np.testing.assert_array_equal(full.cloud.pixel, expected.pixel)
    assert full.cloud.summary == expected.summary
    maps = Path(f"/proc/{worker.pid}/maps").read_text()
    assert ("numba" in maps, "/scipy/linalg/" in maps) == (True, False), (
        "it loads no linear algebra that it does not need"
    )


def spoil(worker: ReconstructionWorker, how: str) -> None:
    if how == "raises":
        worker.frame("middle", 0)
        return
    hold(worker)  # it might be done before anybody measures
    if how == "grown":
        worker.limits = replace(GOOD, memory_mb=20.0, start_memory_mb=20.0)  # whether it still loads or not
    if how == "killed":
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)


@pytest.mark.parametrize(
    ("how", "when", "said"),
    [
        ("killed", "full", "code -9"),
        ("hung", "coarse", "in time"),
        ("grown", "idle", "20 MB"),
        ("raises", "recording", "KeyError"),
    ],
)
def test_whatever_becomes_of_a_worker_no_scan_is_lost(
    worker: ReconstructionWorker, store: FrameStore, how: str, when: str, said: str
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
    if when == "full":
        assert hold_before_full(worker).scan == 7
        spoil(worker, how)
    ready, more = clouds(worker)
    failed += more
    assert [(event.scan, event.full) for event in ready] == [(7, False), (7, True)]
    assert [event.scan for event in failed] == [None], "said once, and the scan was not given up"
    assert said in failed[0].fault.detail
    assert worker.restarts == 1
    for side in SIDES:
        np.testing.assert_array_equal(store.frames(side), before[side])


def test_the_next_scan_does_not_wait_for_the_one_that_was_dropped(worker: ReconstructionWorker) -> None:
    worker.reprocess(1)
    hold_before_full(worker)
    worker.drop()
    worker.begin(2)
    tell(worker, 0, 24)
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGCONT)
    worker.finish()
    ready, failed = clouds(worker)
    assert ([(event.scan, event.full) for event in ready], failed) == ([(2, False), (2, True)], [])
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
    assert worker.restarts == 0
