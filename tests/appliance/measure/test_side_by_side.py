"""Two threads after the last frame: whoever does what, the same steps, points and verdicts come out; and nobody is at work on a scan
that was left."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from appliance.measure import judges, procedure
from appliance.measure.judges import JUDGES, Earlier, Judge, JudgeInput
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.news import CoarseCloud, FullCloud, SequenceFact, Verdicts, WorkProgress
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdict import Judgement
from hw_sim.scene import Imaging, Scene
from tests.appliance.measure.test_moved import scan_in_a_hand
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

TIMEOUT_S = 60.0
SETTINGS = AcquisitionSettings()


Make = Callable[..., tuple[Pipeline, SequenceProcessor]]


@pytest.fixture(scope="module")
def straight() -> RenderedScan:
    """A wall before a projector without a bend: the full cloud waits for no judge but that of water."""
    scene = Scene("plane", texture="slight", imaging=Imaging(response="linear"))
    return render_scan(scene, "nominal", 1, 160, 16)


@pytest.fixture
def made() -> Iterator[Make]:
    with ExitStack() as stack:

        def make(scan: RenderedScan, helpers: int = 1) -> tuple[Pipeline, SequenceProcessor]:
            calibration = true_calibration(scan.renderer.truth)
            pipeline = stack.enter_context(Pipeline(calibration, WATER, scan.sequence, helpers=helpers))
            return pipeline, SequenceProcessor(pipeline, calibration, WATER)

        yield make


def begun(processor: SequenceProcessor, scan: RenderedScan) -> Iterator[SequenceFact]:
    """All frames pushed, no step taken."""
    processor.begin(SETTINGS)
    for _ in processor.push_all(scan.frames):
        pass
    return processor.steps()


def told(pipeline: Pipeline, steps: Iterator[SequenceFact], pause_s: float = 0.0) -> list[object]:
    """Everything that is told of a scan, but for processor times, its points as bytes; ``pause_s`` is waited at each step."""
    heard: list[object] = []
    for step in steps:
        heard.append(type(step).__name__)
        if isinstance(step, CoarseCloud | FullCloud):
            cloud = pipeline.table.cloud(step.cloud)
            columns = (
                cloud.points_mm,
                cloud.intensity,
                cloud.modulation_dn,
                cloud.ray_gap_mm,
                cloud.sigma_mm,
                cloud.pixel,
            )
            heard += [*(column.tobytes() for column in columns), cloud.summary, repr(cloud.gaps)]
        if isinstance(step, Verdicts | FullCloud):
            heard += [repr((one.verdict, one.fault, one.proposal, one.second)) for one in step.judgements]
        time.sleep(pause_s)
    return heard


@pytest.fixture(scope="module")
def alone(straight: RenderedScan) -> list[object]:
    """What is told of the wall where the caller does everything, in the order in which it is told."""
    calibration = true_calibration(straight.renderer.truth)
    with Pipeline(calibration, WATER, straight.sequence, helpers=0) as pipeline:
        return told(pipeline, begun(SequenceProcessor(pipeline, calibration, WATER), straight))


def test_points_and_verdicts_are_the_same_whoever_does_what(
    straight: RenderedScan, alone: list[object], made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A caller that dawdles at each step finds everything done by helpers."""
    pipeline, processor = made(straight)
    assert told(pipeline, begun(processor, straight), 0.05) == alone
    # What moves at its own pace looks like specks here and there; without them, the plain cloud is begun beside the judges.
    monkeypatch.setattr(procedure, "WORTH_MASKING_PERCENT", 100.0)
    scan = scan_in_a_hand()
    by_caller, by_helpers = (
        told(pipeline, begun(processor, scan), pause_s)
        for (pipeline, processor), pause_s in ((made(scan, 0), 0.0), (made(scan, 1), 0.05))
    )
    assert by_helpers == by_caller
    assert "compensation" in str(by_caller[-1:-20:-1])


class Slow:
    """A judge that says when it has begun and ended, and speaks when it is let."""

    def __init__(self) -> None:
        self.begun, self.let, self.ended = threading.Event(), threading.Event(), threading.Event()

    def judge(self, _: JudgeInput, __: Earlier) -> Judgement | None:
        self.begun.set()
        assert self.let.wait(TIMEOUT_S)
        self.ended.set()
        return None


@pytest.mark.parametrize("left_by", ["closing the steps", "beginning another scan"])
def test_nobody_is_at_work_on_a_scan_that_was_left(
    left_by: str, straight: RenderedScan, alone: list[object], made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its frames and maps are the next scan's from then on."""
    pipeline, processor = made(straight)
    slow = Slow()
    # The last of the table is what a helper begins with.
    monkeypatch.setattr(judges, "JUDGES", (*JUDGES, Judge("slow", slow.judge)))
    steps = begun(processor, straight)
    assert any(isinstance(step, CoarseCloud) for step in steps)
    assert slow.begun.wait(TIMEOUT_S), "a judge is at work while the coarse cloud is shown"
    timer = threading.Timer(0.2, slow.let.set)
    timer.start()
    if left_by == "closing the steps":
        steps.close()  # type: ignore[attr-defined]  # steps are a generator
    else:
        processor.begin(SETTINGS)
    assert slow.ended.is_set()
    timer.join(TIMEOUT_S)
    monkeypatch.setattr(judges, "JUDGES", JUDGES)
    assert told(pipeline, begun(processor, straight)) == alone


@pytest.mark.parametrize("helpers", [0, 1])
def test_a_judge_that_fails_is_told_where_its_word_was_awaited(
    helpers: int, straight: RenderedScan, made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: JudgeInput, __: Earlier) -> Judgement | None:
        raise ValueError("a judge is at a loss")

    _, processor = made(straight, helpers)
    names = [judge.name for judge in JUDGES]
    table = tuple(Judge(judge.name, fail) if judge.name == "sight" else judge for judge in JUDGES)
    monkeypatch.setattr(judges, "JUDGES", table)
    heard: list[str] = []
    steps = begun(processor, straight)

    def hear() -> None:
        for step in steps:
            heard.extend([step.step] if isinstance(step, WorkProgress) else [])

    with pytest.raises(ValueError, match="at a loss"):
        hear()
    assert heard == names[: names.index("sight")]
    assert not processor.finished
