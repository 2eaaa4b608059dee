"""One procedure for every sequence: its order, where it ends, and that it can be left and gone on with."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from appliance.measure.fault import FaultCode
from appliance.measure.judges import JUDGES
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.patterns import build_sequence
from appliance.measure.news import Bracket, CoarseCloud, FullCloud, PatternIdentity, Verdicts, WorkProgress
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor, _specks_count
from appliance.measure.verdict import Judgement, Verdict
from hw_sim.scene import Scene
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

PERIOD_PX = 32
N = len(build_sequence(PERIOD_PX))


@pytest.fixture(scope="module")
def still() -> RenderedScan:
    """A wall at rest."""
    return render_scan(Scene("plane", texture="slight"), "nominal", 1, 200, PERIOD_PX)


@pytest.fixture(scope="module")
def pipeline(still: RenderedScan) -> Iterator[Pipeline]:
    with Pipeline(true_calibration(still.renderer.truth), WATER, still.sequence) as made:
        yield made


@pytest.fixture
def processor(pipeline: Pipeline, still: RenderedScan) -> SequenceProcessor:
    """The wall's frames are pushed; no step is taken."""
    made = SequenceProcessor(pipeline, true_calibration(still.renderer.truth), WATER)
    made.begin(AcquisitionSettings())
    assert list(made.push_all(still.frames)) == list(range(N))
    return made


def test_identity_comes_before_any_cloud_and_the_judges_between_the_two(processor: SequenceProcessor) -> None:
    with pytest.raises(ValueError, match="no full cloud yet"):
        processor.hold()
    begun_s = time.process_time()
    steps = list(processor.steps())
    took_s = time.process_time() - begun_s
    kinds = [type(step) for step in steps]
    assert kinds == [PatternIdentity, CoarseCloud, *[WorkProgress] * len(JUDGES), Verdicts, FullCloud]
    coarse, full = steps[1], steps[-1]
    assert isinstance(coarse, CoarseCloud)
    assert isinstance(full, FullCloud)
    assert 0 < coarse.cloud.summary.points < 1.01 * full.cloud.summary.points
    assert coarse.cloud.gaps is None
    assert full.cloud.gaps is not None, "the ray gaps are sampled from the full cloud's pixels"
    assert len(processor.hold().cloud.pixel) == full.cloud.summary.points
    costs_s = [one.cpu_s for one in steps if isinstance(one, CoarseCloud | Verdicts | FullCloud)]
    assert min(costs_s) > 0.0
    assert 0.8 * took_s < sum(costs_s) <= took_s + 0.001, "each part of the work is told once"


def test_exchanged_cameras_are_the_only_cause(processor: SequenceProcessor, still: RenderedScan) -> None:
    """Too few points, at mirrored depths and with gaps, all follow from it."""
    full = processor.process({"left": still.frames["right"], "right": still.frames["left"]}, AcquisitionSettings())
    faults = [one.fault.code for one in full.judgements if one.fault is not None]
    assert faults == [FaultCode.SIDES_EXCHANGED]
    assert [one.verdict.passed for one in full.judgements if one.verdict.name == "sides"] == [False]


def test_who_needs_another_judge_needs_one_that_needs_none() -> None:
    needs = {judge.name: judge.needs for judge in JUDGES}
    assert len(needs) == len(JUDGES), "every name once"
    assert all(needs[other] == () for others in needs.values() for other in others)


def test_wrong_patterns_end_it_unless_wanted_all_the_same(processor: SequenceProcessor, still: RenderedScan) -> None:
    swapped = {side: frames.copy() for side, frames in still.frames.items()}
    swapped["left"][[4, 9]] = swapped["left"][[9, 4]]
    processor.begin(AcquisitionSettings())
    assert len(list(processor.push_all(swapped))) == N
    (only,) = processor.steps()
    assert isinstance(only, PatternIdentity)
    assert only.judgement.fault is not None
    assert only.judgement.fault.code in {FaultCode.PATTERN_WRONG, FaultCode.PROJECTOR_TIMING}
    assert not processor.finished
    all_the_same = processor.process(swapped, AcquisitionSettings())
    assert all_the_same.judgements[0].fault == only.judgement.fault
    assert processor.finished


def test_a_second_exposure_gives_one_bracket_or_the_fault_of_its_frames(
    processor: SequenceProcessor, still: RenderedScan
) -> None:
    processor.run()
    first = processor.hold()
    swapped = {side: frames.copy() for side, frames in still.frames.items()}
    swapped["right"][[4, 9]] = swapped["right"][[9, 4]]
    for frames, right in ((still.frames, True), (swapped, False)):
        processor.begin(AcquisitionSettings())
        assert len(list(processor.push_all(frames))) == N
        *others, bracket = processor.bracket_steps(first)
        assert {type(one) for one in others} == {WorkProgress}
        assert isinstance(bracket, Bracket)
        assert bracket.cpu_s > 0.0
        assert (bracket.cloud is not None, bracket.pair.verdict.passed) == (right, right)
        assert bracket.second[0].verdict.name == "identity"
        assert (len(bracket.second) > 1) == right
        if not right:
            assert bracket.fault == bracket.second[0].fault


def test_frames_that_are_missing_are_refused(processor: SequenceProcessor, still: RenderedScan) -> None:
    processor.begin(AcquisitionSettings())
    processor.push("left", still.frames["left"], 0)
    with pytest.raises(ValueError, match="frames"):
        processor.run()


@pytest.mark.parametrize(("speck_percent", "count"), [(0.019, False), (0.021, True), (None, False)])
def test_specks_are_looked_for_from_one_pixel_in_five_thousand_on(speck_percent: float | None, count: bool) -> None:
    assert _specks_count(Judgement(Verdict("water", True, {"speck_percent": speck_percent}))) is count
    assert not _specks_count(None)


def said_of(full: FullCloud | None) -> list[tuple[str, bool | None, Mapping[str, float | None], object]]:
    assert full is not None
    return [(one.verdict.name, one.verdict.passed, one.verdict.numbers, one.fault) for one in full.judgements]


def test_judges_are_told_the_same_while_frames_still_come(processor: SequenceProcessor, still: RenderedScan) -> None:
    """While a scan is recorded, the frames that are still to come hold the ones of the scan before."""
    alone = processor.run()
    stored = {side: np.full_like(frames, 99) for side, frames in still.frames.items()}
    processor.begin(AcquisitionSettings())
    for index in range(N):
        for side, frames in still.frames.items():
            stored[side][index] = frames[index]
            processor.push(side, stored[side], index)
    assert said_of(processor.run()) == said_of(alone)
