"""Two exposures of one object with a hand's movement in between become one cloud, none of whose points has the movement in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.procedure import SequenceProcessor
from hw_sim.scene import Scene
from tests.support.rendered import judge, render_scan
from tests.support.truth import WATER, true_calibration

SCENE = Scene(object="frustum", texture="checker")
BY = (1.5, -1.0, 2.0, 0.3, -0.4, 0.5)
"""What a hand moves while it waits: mm and degrees."""
MOVED = replace(SCENE, pose=tuple(a + b for a, b in zip(SCENE.start_pose, BY, strict=True)))  # type: ignore[arg-type]


def test_after_a_small_movement_the_clouds_are_laid_against_each_other() -> None:
    exposures = Exposure(3_000), Exposure(14_000)
    short, later = (
        render_scan(scene, "realistic", 5, 400, 16, exposure_s=exposure.time_us / 1e6)
        for scene, exposure in zip((SCENE, MOVED), exposures, strict=True)
    )
    calibration, alone = true_calibration(short.renderer.truth), list[Cloud]()
    with Pipeline(calibration, WATER, short.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        for one, exposure in zip((short, later), exposures, strict=True):
            held = processor.hold() if alone else None
            alone.append(pipeline.table.cloud(processor.process(one.frames, AcquisitionSettings(exposure)).cloud))
        assert held is not None
        merged = processor.merge_with(held)
        assert merged.cloud is not None
        cloud = pipeline.table.cloud(merged.cloud)
    together, apart = judge(short, cloud), (judge(short, alone[0]), judge(later, alone[1]))
    assert together.completeness_percent > max(97.0, 8.0 + max(one.completeness_percent for one in apart))
    assert together.rms_mm < max(one.rms_mm for one in apart), "none of the movement is in it"
    assert together.outliers_ppm < 100.0
    assert len(np.unique(cloud.pixel)) == len(cloud.pixel), "a pixel has one point"
    before = dict(zip(alone[0].pixel.tolist(), alone[0].sigma_mm.tolist(), strict=True))
    both = zip(cloud.pixel.tolist(), cloud.sigma_mm.tolist(), strict=True)
    ratio = np.array([sigma_mm / before[pixel] for pixel, sigma_mm in both if pixel in before])
    assert ratio.max() <= 1.0001, "what both have is not worse than what the first had"
    assert (ratio < 0.8).mean() > 0.5
    numbers = merged.pair.verdict.numbers
    assert numbers["moved_mm"] == pytest.approx(float(np.linalg.norm(BY[:3])), abs=0.5)
    assert numbers["turned_deg"] == pytest.approx(float(np.linalg.norm(BY[3:])), abs=0.06)
