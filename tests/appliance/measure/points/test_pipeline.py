"""Frames of a tilted plane come back as that plane; noise grows as the theory says; shadows stay empty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.measure.decode.decoder import Mask
from appliance.measure.light.patterns import build_sequence
from appliance.measure.points.pipeline import Pipeline
from tests.support import synthetic

NORMAL = np.array([0.25, -0.1, 1.0]) / np.linalg.norm([0.25, -0.1, 1.0])


def record(period_px: int) -> tuple[Pipeline, np.ndarray, float]:
    """A pipeline that has had the exact images of a plane, the plane's coordinates (h, w, 2) in the left one, and its offset."""
    cal = synthetic.calibration()
    pipeline = Pipeline(cal, synthetic.WATER, build_sequence(period_px))
    synthetic.push_all(pipeline, synthetic.wall(cal, pipeline.sequence, NORMAL))
    offset = float(NORMAL @ cal.rig.volume_centre_mm(synthetic.WATER.index))
    return pipeline, synthetic.wall_px(cal, NORMAL)["left"], offset


@pytest.mark.parametrize("period_px", [16, 64])
def test_a_plane_is_measured_as_a_plane(period_px: int) -> None:
    pipeline, truth, offset = record(period_px)
    coarse = pipeline.coarse()
    left = pipeline.decoded("left")
    error_px = (np.stack([left.p_px, left.q_px], -1) - truth)[left.mask == Mask.VALID]
    assert np.abs(error_px).max() < 0.024 * period_px / 16
    full = pipeline.full()
    lit = np.all((truth > 1) & (truth < np.array([1022, 766])), axis=-1)
    assert len(full.points_mm) > 0.97 * np.count_nonzero(lit[2:-2, 2:-2])
    residual = full.points_mm @ NORMAL - offset
    assert np.abs(residual).max() < 0.12 * period_px / 16, "quantisation to 8 bit alone"
    assert abs(residual.mean()) < 0.002 * period_px / 16
    assert np.median(full.ray_gap_mm) < 0.02 * period_px / 16
    assert len(set(coarse.pixel) - set(full.pixel)) < 0.02 * len(coarse.pixel)


def test_without_projector_light_there_is_no_point() -> None:
    pipeline = Pipeline(synthetic.calibration(), synthetic.WATER, build_sequence(16))
    dark = np.random.default_rng(3).integers(10, 14, (24, 300, 400)).astype(np.uint8)
    synthetic.push_all(pipeline, {"left": dark, "right": dark})
    assert len(pipeline.coarse().points_mm) == 0
    cloud = pipeline.full()
    assert (len(cloud.points_mm), cloud.summary.noise_mm) == (0, None)


def test_a_frame_out_of_order_is_refused() -> None:
    pipeline = Pipeline(synthetic.calibration(), synthetic.WATER, build_sequence(16))
    stack = np.zeros((24, 300, 400), np.uint8)
    pipeline.push("left", stack, 0)
    with pytest.raises(ValueError, match="frame 2 was pushed; frame 1 is next"):
        pipeline.push("left", stack, 2)


def test_a_decoded_scan_can_be_reconstructed_with_another_calibration() -> None:
    pipeline, _, _ = record(16)
    pipeline.coarse()
    before = pipeline.full()
    cal = synthetic.calibration()
    nearer = replace(cal.rig.right, port=replace(cal.rig.right.port, distance_mm=28.0))
    pipeline.recalibrate(replace(cal, rig=replace(cal.rig, right=nearer)), synthetic.WATER)
    changed = pipeline.full()
    common, mine, theirs = np.intersect1d(before.pixel, changed.pixel, return_indices=True)
    assert len(common) > 1000
    assert np.median(np.linalg.norm(changed.points_mm[theirs] - before.points_mm[mine], axis=1)) > 0.05
    pipeline.recalibrate(cal, synthetic.WATER)
    assert np.array_equal(pipeline.full().points_mm, before.points_mm)
    with pytest.raises(ValueError, match="left camera has 800 x 600 px, this pipeline's 400 x 300 px"):
        pipeline.recalibrate(synthetic.calibration(800, 600), synthetic.WATER)
