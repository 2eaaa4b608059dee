"""A scan in a moving hand: the judges' verdict comes first, the motion is taken out of the points, and both are told."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from appliance.measure import procedure
from appliance.measure.bracket import ProcessedSequence
from appliance.measure.fault import FaultCode
from appliance.measure.judges import JUDGES
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.patterns import RISING_STEPS, STEPS, Direction, build_sequence
from appliance.measure.motion.attempt import Attempt
from appliance.measure.news import CoarseCloud, FullCloud, PatternIdentity, SequenceFact, Verdicts, WorkProgress
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor, _compensation
from appliance.measure.verdict import Verdict
from hw_sim.objects.motion import Motion
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import draw_truth
from tests.support.rendered import FRAME_S, RenderedScan, exposed, judge, pictures, reconstruct, render_scan
from tests.support.truth import WATER, true_calibration

HAND = Motion((0.0, 30.0, 0.0))
"""Velocity of the instrument, in mm/s of the rig frame."""


@dataclass(frozen=True)
class Worked:
    steps: list[SequenceFact]
    held: ProcessedSequence


@cache
def scan_in_a_hand() -> RenderedScan:
    scene = Scene("shell", texture="slight", motion=HAND)
    return render_scan(scene, "nominal", 1, 240, 16, exposure_s=0.008, frame_s=FRAME_S)


@pytest.fixture(scope="module")
def in_a_hand() -> Worked:
    scan = scan_in_a_hand()
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        processor.begin(AcquisitionSettings())
        for _ in processor.push_all(scan.frames):
            pass
        steps, held = list(processor.steps()), processor.hold()
        processor.begin(AcquisitionSettings())
        assert (processor.finished, processor._moved, processor._compensated) == (False, False, False), "another scan"
        return Worked(steps, held)


def test_it_is_told_that_motion_is_being_undone_and_again_what_came_of_it(in_a_hand: Worked) -> None:
    kinds = [type(step) for step in in_a_hand.steps]
    assert kinds == [PatternIdentity, CoarseCloud, *[WorkProgress] * len(JUDGES), Verdicts, Verdicts, FullCloud]
    before, after = (step for step in in_a_hand.steps if isinstance(step, Verdicts))
    assert (before.compensating, after.compensating) == (True, False)
    said = {one.verdict.name: one for one in before.judgements}
    assert said["motion"].fault is not None
    assert said["motion"].fault.code is FaultCode.MOVED
    for told in (before, after):
        assert told.judgements[0].verdict.name == "identity"


def test_motion_that_was_undone_is_no_fault_of_the_points(in_a_hand: Worked) -> None:
    last = in_a_hand.steps[-1]
    assert isinstance(last, FullCloud)
    said = {one.verdict.name: one for one in last.judgements}
    motion = said["motion"]
    assert motion.fault is not None
    assert (motion.fault.code, motion.fault.detail) == (FaultCode.COMPENSATED, motion.verdict.text)
    assert said["compensation"].verdict.passed
    added = motion.verdict.numbers["added_noise_percent"]
    assert said["compensation"].verdict.numbers["error_before"] == pytest.approx(1.0 + 0.01 * (added or 0.0))
    assert "windows" not in said, "what moves is soft in one camera and not in the other"
    assert (in_a_hand.held.moved, in_a_hand.held.spoilt) == (True, False)


def test_where_something_moved_no_pixel_is_masked_as_a_speck(
    in_a_hand: Worked, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(procedure, "WORTH_MASKING_PERCENT", -1.0)
    scan, calibration = scan_in_a_hand(), true_calibration(scan_in_a_hand().renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        full = SequenceProcessor(pipeline, calibration, WATER).process(scan.frames, AcquisitionSettings())
    last = in_a_hand.steps[-1]
    assert isinstance(last, FullCloud)
    assert full.cloud.summary == last.cloud.summary


def test_no_frame_is_read_before_it_arrives(in_a_hand: Worked) -> None:
    scan, arrived = scan_in_a_hand(), {side: np.zeros_like(frames) for side, frames in scan_in_a_hand().frames.items()}
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        processor.begin(AcquisitionSettings())
        for side, frames in scan.frames.items():
            for k, frame in enumerate(frames):
                arrived[side][k] = frame
                processor.push(side, arrived[side], k)
        before = next(step for step in processor.steps() if isinstance(step, Verdicts))
    assert before.judgements == next(step for step in in_a_hand.steps if isinstance(step, Verdicts)).judgements


def test_where_no_motion_could_be_told_the_verdict_says_why() -> None:
    verdict = _compensation(Attempt(None, None, "Motion was not estimated: too few points."), FRAME_S)
    assert verdict == Verdict("compensation", False, {}, "Motion was not estimated: too few points.")


@pytest.mark.parametrize(("steps", "least", "most"), [(STEPS, 0.9, 1.2), (RISING_STEPS, 2.0, 6.0)])
def test_a_hand_along_the_line_of_sight_adds_next_to_nothing_in_our_order(
    steps: tuple[int, ...], least: float, most: float
) -> None:
    sequence = build_sequence(16, steps=steps)
    rms_mm = []
    for away_mm_s in (0.0, 20.0):
        scene = Scene("shell", imaging=Imaging("linear"), motion=Motion((0.0, 0.0, away_mm_s)))
        renderer = Renderer(draw_truth("nominal", 1, 160, 120, scene.water.index), scene)
        scan = RenderedScan(renderer, sequence, exposed(renderer, pictures(sequence), 0.008, FRAME_S))
        _, cloud = reconstruct(scan)
        rms_mm.append(judge(scan, cloud, FRAME_S * float(np.mean(sequence.axis(Direction.X).sine))).rms_mm)
    assert least < rms_mm[1] / rms_mm[0] < most
