"""The motion of a hand, from its frames alone."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.compensation.estimate import estimate
from hw_sim.motion import Motion
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, recorded, true_motion_mm
from tests.support.rendered import reconstruct, render_scan
from tests.support.truth import WATER, true_calibration

HAND = Motion((6.0, 5.0, 6.2), (30.0, -20.0, 40.0), (0.2, 0.2, 0.2), 6.0, (1.0, -1.5, 1.0))


@pytest.mark.parametrize(("motion", "ripple"), [(HAND, 0.5), (Motion(), 0.0)], ids=["hand", "at rest"])
def test_the_hand_is_found(motion: Motion, ripple: float) -> None:
    scene = Scene("frustum", texture="strong", motion=motion)
    scan = render_scan(scene, "modelled", 10_007, 400, 16, frame_s=FRAME_S)
    pipeline, _ = reconstruct(scan)
    sample = pipeline.sample(3)
    found = estimate(
        recorded(scan, pipeline), true_calibration(scan.renderer.truth), WATER, sample.points_mm, sample.pixel
    )
    truth = true_motion_mm(scan, np.array(found.frames) * FRAME_S, found.reference_s, found.centre_mm)
    # Among the x-sines, which make the depth, to 1 % of a camera px (0.64 mm) a frame; the y-sines only choose rows.
    assert np.abs(found.motion_mm - truth)[:4].max() < 0.02
    assert np.abs(found.motion_mm - truth)[4:].max() < 0.3
    assert found.converged
    assert found.ripple_before >= ripple
    assert found.ripple_after < 0.5
