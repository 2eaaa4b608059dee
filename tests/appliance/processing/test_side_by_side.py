"""Two threads after the last frame: whoever does what, the same steps, points and verdicts come out; and nobody is at work on a scan
that was left."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from appliance.processing import judges, procedure
from appliance.processing.judges import JUDGES, Earlier, Judge, JudgeInput
from appliance.processing.procedure import AllJudged, CoarseFound, FullFound, OneJudged, SequenceProcessor, Step
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Judgement
from hw_sim.objects.motion import Motion
from hw_sim.scene import Imaging, Scene
from tests.support.rendered import FRAME_S, RenderedScan, render_scan
from tests.support.specks import add_specks
from tests.support.truth import WATER, true_calibration

TIMEOUT_S = 60.0
SETTINGS = AcquisitionSettings()


@pytest.fixture(scope="module")
def straight() -> RenderedScan:
    """A wall before a projector without a bend: the full cloud waits for no judge but that of water."""
    scene = Scene("plane", texture="slight", imaging=Imaging(response="linear"))
    return render_scan(scene, "nominal", 1, 240, 16)


@pytest.fixture(scope="module")
def scans(straight: RenderedScan) -> dict[str, RenderedScan]:
    rng = np.random.default_rng(1)
    dirty = {side: add_specks(straight.frames[side], straight.sequence, 60, rng) for side in SIDES}
    bent = Scene("plane", texture="slight")
    hand = Scene("shell", texture="slight", motion=Motion((0.0, 20.0, 0.0)), imaging=Imaging(response="linear"))
    return {
        "straight": straight,
        "dirty": RenderedScan(straight.renderer, straight.sequence, dirty),
        "bent": render_scan(bent, "nominal", 1, 240, 16),
        "moved": render_scan(hand, "nominal", 1, 240, 16, exposure_s=0.008, frame_s=FRAME_S),
    }


@pytest.fixture
def made() -> Iterator[Callable[[RenderedScan, int], tuple[Pipeline, SequenceProcessor]]]:
    with ExitStack() as stack:

        def make(scan: RenderedScan, helpers: int = 1) -> tuple[Pipeline, SequenceProcessor]:
            calibration = true_calibration(scan.renderer.truth)
            pipeline = stack.enter_context(Pipeline(calibration, WATER, scan.sequence, helpers=helpers))
            return pipeline, SequenceProcessor(pipeline, calibration, WATER)

        yield make


Make = Callable[..., tuple[Pipeline, SequenceProcessor]]


def begun(processor: SequenceProcessor, scan: RenderedScan) -> Iterator[Step]:
    """All frames pushed, no step taken."""
    processor.begin(SETTINGS)
    for _ in processor.push_all(scan.frames):
        pass
    return processor.steps()


def told(pipeline: Pipeline, steps: Iterator[Step], pause_s: float = 0.0) -> list[object]:
    """Everything that is told of a scan, but for processor times, its points as bytes; ``pause_s`` is waited at each step."""
    heard: list[object] = []
    for step in steps:
        match step:
            case CoarseFound(found) | FullFound(found):
                cloud = pipeline.table.cloud(found)
                columns = (
                    cloud.points_mm,
                    cloud.intensity,
                    cloud.modulation_dn,
                    cloud.ray_gap_mm,
                    cloud.sigma_mm,
                    cloud.pixel,
                )
                heard.append(
                    (type(step).__name__, *(column.tobytes() for column in columns), cloud.summary, repr(cloud.gaps))
                )
        match step:
            case AllJudged(judgements) | FullFound(judgements=judgements):
                heard.append([repr((one.verdict, one.fault, one.proposal, one.second)) for one in judgements])
            case _:
                heard.append(repr(step)[:40])
        time.sleep(pause_s)
    return heard


@pytest.mark.parametrize("name", ["straight", "dirty", "bent", "moved", "moved in clear water"])
def test_points_and_verdicts_are_the_same_whoever_does_what(
    name: str, scans: dict[str, RenderedScan], made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone, the caller does everything in the order in which it is told. One that dawdles at each step finds everything done by helpers."""
    name, _, clear = name.partition(" in ")
    if clear:
        # What moves at its own pace looks like specks here and there; without them, the plain cloud is begun beside the judges.
        monkeypatch.setattr(procedure, "WORTH_MASKING_PERCENT", 100.0)
    scan = scans[name]
    expected: list[object] | None = None
    shared = ((1, 0.05),) if name == "moved" else ((1, 0.0), (1, 0.1), (4, 0.0))
    for helpers, pause_s in ((0, 0.0), *shared):
        pipeline, processor = made(scan, helpers)
        heard = told(pipeline, begun(processor, scan), pause_s)
        expected = expected or heard
        assert heard == expected, f"{helpers} helpers, {pause_s} s at each step"
    assert expected is not None
    assert ("name='compensation'" in str(expected[-1])) == (name == "moved")


def test_the_scans_take_the_ways_that_they_are_meant_to(scans: dict[str, RenderedScan], made: Make) -> None:
    """Else the comparison would not see the full cloud begun beside the judges, nor what forbids that."""
    bends, masked = {}, {}
    for name in ("straight", "dirty", "bent"):
        pipeline, processor = made(scans[name])
        for step in begun(processor, scans[name]):
            if isinstance(step, AllJudged):
                bends[name] = pipeline.bend().counts
                (water,) = [one for one in step.judgements if one.verdict.name == "water"]
                masked[name] = (water.verdict.numbers["speck_percent"] or 0.0) > 0.02
    assert bends == {"straight": False, "dirty": False, "bent": True}
    assert masked == {"straight": False, "dirty": True, "bent": False}


@pytest.mark.parametrize("name", ["straight", "bent"])
def test_the_full_cloud_is_that_of_the_pipeline_alone(name: str, scans: dict[str, RenderedScan], made: Make) -> None:
    """Also where a bend is taken out of the coordinates first: then it is not begun before the judges have read them."""
    scan = scans[name]
    pipeline, processor = made(scan)
    *_, last = begun(processor, scan)
    assert isinstance(last, FullFound)
    points_mm = pipeline.table.cloud(last.found).points_mm
    for index in range(len(scan.sequence)):
        for side in SIDES:
            pipeline.push(side, scan.frames[side], index)
    pipeline.coarse()
    np.testing.assert_array_equal(points_mm, pipeline.full().points_mm)


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
    left_by: str, straight: RenderedScan, made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its frames and maps are the next scan's from then on."""
    pipeline, processor = made(straight)
    alone = told(pipeline, begun(processor, straight))
    slow = Slow()
    # The last of the table is what a helper begins with.
    monkeypatch.setattr(judges, "JUDGES", (*JUDGES, Judge("slow", slow.judge)))
    steps = begun(processor, straight)
    assert any(isinstance(step, CoarseFound) for step in steps)
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


def test_it_may_be_left_at_any_step_and_the_next_scan_is_the_same(straight: RenderedScan, made: Make) -> None:
    pipeline, processor = made(straight)
    alone = told(pipeline, begun(processor, straight))
    rng = np.random.default_rng(3)
    noise = {side: rng.integers(0, 255, frames.shape, np.uint8) for side, frames in straight.frames.items()}
    # Behind identity, the coarse cloud, some judges, the verdict.
    for taken in (1, 2, 5, 9):
        steps = begun(processor, straight)
        for _ in range(taken):
            next(steps)
        # Still there, as in a worker whose parent wants something else by now.
        processor.begin(SETTINGS)
        for side in SIDES:
            processor.push(side, noise[side], 0)
        assert told(pipeline, begun(processor, straight)) == alone, f"after {taken} steps of the one before"


@pytest.mark.parametrize("helpers", [0, 1])
def test_a_judge_that_fails_is_told_where_its_word_was_awaited(
    helpers: int, straight: RenderedScan, made: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: JudgeInput, __: Earlier) -> Judgement | None:
        raise ValueError("a judge is at a loss")

    pipeline, processor = made(straight, helpers)
    alone = told(pipeline, begun(processor, straight))
    at = [judge.name for judge in JUDGES].index("sight")
    table = tuple(Judge(judge.name, fail) if judge.name == "sight" else judge for judge in JUDGES)
    monkeypatch.setattr(judges, "JUDGES", table)
    heard: list[str] = []

    def hear() -> None:
        for step in begun(processor, straight):
            heard.extend([step.name] if isinstance(step, OneJudged) else [])

    with pytest.raises(ValueError, match="at a loss"):
        hear()
    assert heard == [judge.name for judge in JUDGES][:at]
    assert not processor.finished
    monkeypatch.setattr(judges, "JUDGES", JUDGES)
    assert told(pipeline, begun(processor, straight)) == alone


@pytest.mark.parametrize("helpers", [0, 1])
def test_what_is_wrong_with_the_last_frame_is_told_with_the_first_step(
    helpers: int, straight: RenderedScan, made: Make
) -> None:
    _, processor = made(straight, helpers)
    processor.begin(SETTINGS)
    last = len(straight.sequence) - 1

    def push_and_run() -> None:
        processor.push("left", straight.frames["left"], last)
        processor.run()

    with pytest.raises(ValueError, match=f"frame {last} was pushed; frame 0 is next"):
        push_and_run()
