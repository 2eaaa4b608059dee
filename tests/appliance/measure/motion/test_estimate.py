"""The motion of a hand from its frames alone, and the cloud that it would have been at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.measure.motion.attempt import Attempt, attempt
from appliance.measure.motion.estimate import MotionEstimate
from appliance.measure.motion.redecode import compensate
from appliance.measure.points.pipeline import Cloud, Pipeline
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, judge_at, recorded, true_motion_mm
from tests.support.rendered import RenderedScan, render_scan
from tests.support.synthetic import push_all
from tests.support.truth import WATER, true_calibration


@dataclass(frozen=True)
class Corrected:
    scan: RenderedScan
    plain: Cloud
    motion: MotionEstimate
    said: Attempt
    cloud: Cloud
    """Compensated, also where it is not needed."""


def corrected(motion: Motion) -> Corrected:
    scan = render_scan(Scene("frustum", texture="strong", motion=motion), "modelled", 10_007, 400, 16, frame_s=FRAME_S)
    calibration = true_calibration(scan.renderer.truth)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        push_all(pipeline, scan.frames)
        pipeline.find_coarse()
        found = pipeline.find_full(straightened=False)
        plain, taken = pipeline.table.cloud(found), recorded(scan, pipeline)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("appliance.measure.motion.attempt.MOST_ERROR", 0.1)
            refused = attempt(pipeline, found, taken, calibration, WATER)
            assert refused.found is None, "what errs more than is allowed is not shown"
        found = pipeline.find_full(straightened=False)
        said = attempt(pipeline, found, taken, calibration, WATER)
        assert said.motion is not None
        maps = compensate(taken, calibration, WATER, said.motion)
        again = pipeline.find_replaced(maps["left"], maps["right"])
        return Corrected(scan, plain, said.motion, said, pipeline.table.cloud(again))


HAND = Motion((6.0, 5.0, 6.2), tremor_mm=(0.2, 0.2, 0.2), rotation_deg_s=(1.0, -1.5, 1.0))


@pytest.fixture(scope="module")
def moved() -> Corrected:
    return corrected(HAND)


@pytest.fixture(scope="module")
def still() -> Corrected:
    return corrected(Motion())


def test_the_hand_is_found(moved: Corrected) -> None:
    found = moved.motion
    truth = true_motion_mm(moved.scan, np.array(found.frames) * FRAME_S, found.reference_s, found.centre_mm)
    # Among the x-sines, which make the depth, to 2 % of a camera px (0.64 mm) a frame; the y-sines only choose rows.
    assert np.abs(found.motion_mm - truth)[:4].max() < 0.04
    assert np.abs(found.motion_mm - truth)[4:].max() < 0.3
    assert found.converged
    first, last = np.argmin(found.frames[:4]), np.argmax(found.frames[:4])
    # 0.64 mm to a px, and a turn that hardly counts.
    assert found.texture_px == pytest.approx(np.hypot(*(truth[last] - truth[first])[:2]) / 0.64, rel=0.15)
    assert found.ripple_before > 2.0
    assert found.ripple_after < 0.6


def test_its_cloud_is_nearly_that_of_a_scan_at_rest(moved: Corrected, still: Corrected) -> None:
    at_rest = judge_at(still.scan, still.plain, 0.0)
    plain = judge_at(moved.scan, moved.plain, moved.motion.reference_s)
    after = judge_at(moved.scan, moved.cloud, moved.motion.reference_s)
    assert plain.rms_mm > 1.6 * at_rest.rms_mm
    assert after.rms_mm < 1.2 * at_rest.rms_mm
    assert after.completeness_percent > 0.9 * plain.completeness_percent


def test_a_scan_at_rest_is_not_made_worse(still: Corrected) -> None:
    before, after = judge_at(still.scan, still.plain, 0.0), judge_at(still.scan, still.cloud, 0.0)
    assert np.abs(still.motion.motion_mm)[:4].max() < 0.04
    assert still.motion.ripple_before < 0.5
    assert still.motion.step_deg == pytest.approx(90.0, abs=1.0)
    assert still.said.found is None
    assert after.rms_mm < 1.03 * before.rms_mm
    assert after.completeness_percent > before.completeness_percent - 1.0
