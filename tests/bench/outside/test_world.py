"""The scenes of the world ``outside`` as the benchmark sees them: the rig that belongs to them, their frames, their true calibration."""

from __future__ import annotations

import numpy as np
import pytest

from bench.outside.stated import stated_truth
from bench.outside.world import world_of
from hw_sim.scene import Scene
from tests.support.truth import true_calibration

TINY_PX = 80, 60


def test_the_best_calibration_of_a_flawed_rig_follows_its_rays_to_a_micrometre() -> None:
    world = world_of(Scene(), 10_002, size_px=TINY_PX, case_c=40.0)
    stated = stated_truth(world.rig, world.scene)
    assert stated.left_um < 1.0
    assert stated.water.index == pytest.approx(world.scene.index, abs=1e-9)
    # What its formulas alone would say is hundreds of times worse.
    off_px = stated.calibration.rig.left.project(np.array([[0.0, 0.0, 520.0]]), stated.water.index)
    plain_px = true_calibration(world.rig).rig.left.project(np.array([[0.0, 0.0, 520.0]]), stated.water.index)
    assert np.abs(off_px - plain_px).max() > 0.001
