"""The worker gives the clouds the pipeline gives, of one sequence and of two, and one that is lost is back for the same scan."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.worker.messages import Ready, WorkOrder
from appliance.instrument.worker.process import ReconstructionWorker, WorkerEvent
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.news import Bracket, CoarseCloud, FullCloud, News, PatternIdentity, Verdicts, WorkerFailure
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from drivers.native import MonotonicClock
from tests.support import synthetic

PATIENCE_S = 120.0
"""Longest wait for what is going to come: a busy computer takes half a minute to start a process."""
SIZE_PX = (240, 180)
SEQUENCE, CALIBRATION = build_sequence(16), synthetic.calibration(*SIZE_PX)
FIRST, SECOND = AcquisitionSettings(Exposure(12_000)), AcquisitionSettings(Exposure(7_200))


@pytest.fixture(scope="module")
def store() -> Iterator[FrameStore]:
    """A wall, and the same with three fifths of the light."""
    with FrameStore(len(SEQUENCE), SIZE_PX[1], SIZE_PX[0], sequences=2) as filled:
        for side, frames in synthetic.wall(CALIBRATION, SEQUENCE).items():
            filled.frames(side)[...] = frames
            filled.frames(side, second=True)[...] = np.rint(0.6 * frames)
        yield filled


@pytest.fixture(scope="module")
def worker(store: FrameStore) -> Iterator[ReconstructionWorker]:
    """One for all: starting the process is most of what a test here takes."""
    with ReconstructionWorker(WorkOrder(CALIBRATION, synthetic.WATER, SEQUENCE), store, MonotonicClock()) as made:
        assert made.wait(PATIENCE_S) == Ready()
        yield made


def tell(worker: ReconstructionWorker, first: int = 0, stop: int = len(SEQUENCE)) -> None:
    for index in range(first, stop):
        for side in SIDES:
            worker.frame(side, index)


def fact_of(event: WorkerEvent | None) -> object:
    """The fact of news about scan 1."""
    assert isinstance(event, News)
    assert event.number == 1
    return event.fact


def test_same_points_in_the_worker_of_one_sequence_and_of_two(worker: ReconstructionWorker, store: FrameStore) -> None:
    with Pipeline(CALIBRATION, synthetic.WATER, SEQUENCE) as pipeline:
        processor = SequenceProcessor(pipeline, CALIBRATION, synthetic.WATER)
        expected = pipeline.table.cloud(processor.process({side: store.frames(side) for side in SIDES}, FIRST).cloud)
        held = processor.hold()
        processor.process({side: store.frames(side, second=True) for side in SIDES}, SECOND)
        merged = processor.merge_with(held).cloud
        assert merged is not None
        both = pipeline.table.cloud(merged)
    worker.reprocess(1, FIRST)
    facts = [fact_of(worker.wait(PATIENCE_S)) for _ in range(4)]
    assert [type(one) for one in facts] == [PatternIdentity, CoarseCloud, Verdicts, FullCloud]
    full = worker.full
    assert full is not None
    assert full.summary == expected.summary
    worker.begin_second(1, SECOND)
    tell(worker)
    worker.finish()
    while not isinstance(pair := fact_of(worker.wait(PATIENCE_S)), Bracket):
        assert pair is not None
    assert pair.cloud is not None
    assert worker.full is not None
    assert [one.verdict.name for one in pair.second][:1] == ["identity"]
    for found, wanted in ((full, expected), (worker.full, both)):
        np.testing.assert_array_equal(found.points_mm, wanted.points_mm)
        np.testing.assert_array_equal(found.pixel, wanted.pixel)
    maps = Path(f"/proc/{worker.pid}/maps").read_text()
    assert ("numba" in maps, "/scipy/linalg/" in maps) == (True, False), "no linear algebra that it does not need"


@pytest.mark.parametrize(("how", "said"), [("killed", "code -9"), ("raises", "KeyError")])
def test_whatever_becomes_of_a_worker_no_scan_is_lost(
    worker: ReconstructionWorker, store: FrameStore, how: str, said: str
) -> None:
    before, restarts = {side: store.frames(side).copy() for side in SIDES}, worker.restarts
    worker.begin(7)
    tell(worker, 0, 10)
    if how == "raises":
        worker.frame("middle", 0)
    else:
        assert worker.pid is not None
        os.kill(worker.pid, signal.SIGKILL)
    tell(worker, 10)
    worker.finish()
    events = [worker.wait(PATIENCE_S)]
    while not (isinstance(events[-1], News) and isinstance(events[-1].fact, FullCloud)):
        assert events[-1] is not None
        events.append(worker.wait(PATIENCE_S))
    (failed,) = (one for one in events if isinstance(one, WorkerFailure))
    assert said in failed.text
    clouds = [one for one in events if isinstance(one, News) and isinstance(one.fact, CoarseCloud | FullCloud)]
    assert [one.number for one in clouds] == [7, 7], "said once, and the scan was not given up"
    assert worker.restarts == restarts + 1
    for side in SIDES:
        np.testing.assert_array_equal(store.frames(side), before[side])
