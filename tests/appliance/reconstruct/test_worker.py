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
from appliance.reconstruct.worker import CloudReady, ReconstructionWorker, WorkerFailed, WorkerReady, WorkOrder
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


def test_same_points_in_the_worker_and_again_after_it_was_killed(store: FrameStore) -> None:
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

        process = worker._process
        assert process is not None
        worker.begin(2)
        os.kill(process.pid or 0, signal.SIGKILL)
        failed = worker.wait(20)
        assert isinstance(failed, WorkerFailed)
        assert failed.scan == 2
        assert worker.wait(60) == WorkerReady()
        worker.reprocess(3)
        coarse, full = worker.wait(20), worker.wait(20)
        assert isinstance(full, CloudReady)
        assert (full.scan, len(full.cloud.points_mm)) == (3, len(expected.points_mm))


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
