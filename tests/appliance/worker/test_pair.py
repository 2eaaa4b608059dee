"""Two exposures of one object, with and without a hand's movement in between: one cloud, or the reason why not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.file import Calibration
from appliance.capture.store import FrameStore
from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import Cloud
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.scan.noise import TYPICAL_PAIR
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement
from appliance.worker.order import WorkOrder
from appliance.worker.process import (
    CloudReady,
    PairJudged,
    ReconstructionWorker,
    ScanJudged,
    SequenceIdentified,
    WorkerReady,
)
from hw_sim.scene import Scene
from tests.appliance.worker.test_worker import RealClock
from tests.support.rendered import RenderedScan, judge, render_scan
from tests.support.truth import WATER, true_calibration

SCENE = Scene(object="frustum", texture="checker")
BY = (1.5, -1.0, 2.0, 0.3, -0.4, 0.5)
"""What a hand moves while it waits: mm and degrees."""
SHORT, LONG = Exposure(3_000), Exposure(14_000)


def scan(scene: Scene, exposure: Exposure) -> RenderedScan:
    return render_scan(scene, "realistic", 5, 400, 16, exposure_s=exposure.time_us / 1e6)


@pytest.fixture(scope="module")
def short() -> RenderedScan:
    return scan(SCENE, SHORT)


def moved(by: tuple[float, ...]) -> RenderedScan:
    pose = tuple(a + b for a, b in zip(SCENE.start_pose, by, strict=True))
    return scan(replace(SCENE, pose=pose), LONG)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def later() -> RenderedScan:
    return moved(BY)


@dataclass(frozen=True)
class Paired:
    alone: tuple[Cloud, Cloud]
    cloud: Cloud | None
    pair: Judgement


def paired(first: RenderedScan, second: RenderedScan, calibration: Calibration) -> Paired:
    alone: list[Cloud] = []
    with Pipeline(calibration, WATER, first.sequence) as pipeline:
        processor, held = SequenceProcessor(pipeline, calibration, WATER), None
        for one, exposure in ((first, SHORT), (second, LONG)):
            held = processor.hold() if alone else None
            alone.append(pipeline.table.cloud(processor.process(one.frames, AcquisitionSettings(exposure)).found))
        assert held is not None
        merged = processor.merge_with(held)
        cloud = None if merged.found is None else pipeline.table.cloud(merged.found)
        return Paired((alone[0], alone[1]), cloud, merged.judgement)


@pytest.fixture(scope="module")
def laid(short: RenderedScan, later: RenderedScan) -> Paired:
    return paired(short, later, true_calibration(short.renderer.truth))


def test_after_a_small_movement_the_clouds_are_laid_against_each_other(
    short: RenderedScan, later: RenderedScan, laid: Paired
) -> None:
    assert laid.cloud is not None
    together, alone = judge(short, laid.cloud), (judge(short, laid.alone[0]), judge(later, laid.alone[1]))
    assert together.completeness_percent > 97.0
    assert together.completeness_percent > max(one.completeness_percent for one in alone) + 8.0
    assert together.rms_mm < max(one.rms_mm for one in alone), "none of the movement is in it"
    assert together.outliers_ppm < 100.0
    assert len(np.unique(laid.cloud.pixel)) == len(laid.cloud.pixel), "a pixel has one point"
    before = dict(zip(laid.alone[0].pixel.tolist(), laid.alone[0].sigma_mm.tolist(), strict=True))
    both = zip(laid.cloud.pixel.tolist(), laid.cloud.sigma_mm.tolist(), strict=True)
    ratio = np.array([sigma_mm / before[pixel] for pixel, sigma_mm in both if pixel in before])
    assert ratio.max() <= 1.0001, "what both have is not worse than what the first had"
    assert (ratio < 0.8).mean() > 0.5
    numbers = laid.pair.verdict.numbers
    assert numbers["moved_mm"] == pytest.approx(float(np.linalg.norm(BY[:3])), abs=0.5)
    assert numbers["turned_deg"] == pytest.approx(float(np.linalg.norm(BY[3:])), abs=0.06)


def test_after_a_large_movement_the_pair_is_refused(short: RenderedScan) -> None:
    found = paired(short, moved((25.0, 0.0, 10.0, 0.0, 9.0, 0.0)), true_calibration(short.renderer.truth))
    assert found.cloud is None
    assert found.pair.fault is not None
    assert found.pair.fault.code is FaultCode.MOVED
    assert found.pair.verdict.passed is False


@pytest.fixture
def store(short: RenderedScan, later: RenderedScan) -> Iterator[FrameStore]:
    with FrameStore(len(short.sequence), 300, 400, sequences=2) as filled:
        for side in SIDES:
            filled.frames(side)[...] = short.frames[side]
            filled.frames(side, second=True)[...] = later.frames[side]
        yield filled


def points_of_pair(worker: ReconstructionWorker, frames: int) -> NDArray[np.float32]:
    for k in range(frames):
        for side in SIDES:
            worker.frame(side, k)
    worker.finish()
    for _ in range(10):
        event = worker.wait(30)
        if isinstance(event, PairJudged):
            assert event.scan == 7
            assert event.cloud is not None
            assert event.second[0].verdict.name == "identity"
            return event.cloud.points_mm
    raise AssertionError("no pair")


@pytest.mark.dive
def test_the_worker_makes_the_same_points(short: RenderedScan, store: FrameStore, laid: Paired) -> None:
    assert laid.cloud is not None
    order = WorkOrder(true_calibration(short.renderer.truth), WATER, 16, 1024, 768, TYPICAL_PAIR)
    with ReconstructionWorker(order, store, RealClock()) as worker:
        assert worker.wait(240) == WorkerReady()
        worker.reprocess(7, AcquisitionSettings(SHORT))
        events = [worker.wait(30) for _ in range(5)]
        assert [type(one) for one in events] == [SequenceIdentified, CloudReady, ScanJudged, ScanJudged, CloudReady]
        worker.begin_second(7, AcquisitionSettings(LONG))
        np.testing.assert_array_equal(points_of_pair(worker, len(short.sequence)), laid.cloud.points_mm)
