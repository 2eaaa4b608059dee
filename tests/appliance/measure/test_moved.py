"""A scan in a moving hand: the judges' verdict comes first, the motion is taken out of the points, and both are told."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import pytest

from appliance.measure.bracket import ProcessedSequence
from appliance.measure.fault import FaultCode
from appliance.measure.judges import JUDGES
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.motion.attempt import Attempt
from appliance.measure.news import CoarseCloud, FullCloud, PatternIdentity, SequenceFact, Verdicts, WorkProgress
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor, _compensation
from appliance.measure.verdict import Verdict
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from tests.support.rendered import FRAME_S, RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

HAND = Motion((0.0, 20.0, 0.0))
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
    assert "windows" not in said, "what moves is soft in one camera and not in the other"
    assert (in_a_hand.held.moved, in_a_hand.held.spoilt) == (True, False)


def test_where_no_motion_could_be_told_the_verdict_says_why() -> None:
    verdict = _compensation(Attempt(None, None, "Motion was not estimated: too few points."), FRAME_S)
    assert verdict == Verdict("compensation", False, {}, "Motion was not estimated: too few points.")
