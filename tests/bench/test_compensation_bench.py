"""The judge of compensation: what a calibration is off is no error of the scan, and tables stand where they belong."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from appliance.optics.model import HousedCamera, StereoRig
from appliance.patterns.sequence import build_sequence
from appliance.reconstruct.pipeline import Cloud
from appliance.reconstruct.quality import CloudSummary
from bench.verdict.calibrations import TrueScene, calibration_of
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth
from tests.support.rendered import RenderedScan
from tests.support.truth import WATER

ERROR_MM, SIGMA_MM = 0.05, 0.1


@pytest.fixture(scope="module")
def truth() -> TrueRig:
    return draw_truth("realistic", 3, 200, 150, WATER.index)


def turned(rig: StereoRig, angle_rad: float) -> StereoRig:
    """The same rig, said in a frame that is turned about y."""
    R = np.asarray(cv2.Rodrigues(np.array([0.0, angle_rad, 0.0]))[0])

    def moved(camera: HousedCamera) -> HousedCamera:
        a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in R @ np.asarray(camera.rotation))
        x, y, z = (float(v) for v in R @ np.asarray(camera.translation_mm))
        return replace(camera, rotation=(a, b, c), translation_mm=(x, y, z))

    return StereoRig(moved(rig.left), moved(rig.right))


@pytest.mark.parametrize("angle", [0.0, 0.01])
def test_only_the_scan_s_own_error_counts(truth: TrueRig, angle: float) -> None:
    """Also where the calibration turns the world by ten times what any tolerance allows."""
    scan = RenderedScan(Renderer(truth, Scene("plane")), build_sequence(16), {})
    rig = turned(calibration_of("exact", truth).rig, angle)
    true = TrueScene(scan, rig, 0.0)
    v, u = np.nonzero(true.view.seen_by_all)
    uv = np.stack([u, v], -1).astype(np.float64)
    points = true.calibrated_points(uv, true.view.points_rig_mm[v, u])
    _, direction = rig.left.rays(uv, WATER.index)
    n = len(u)
    cloud = Cloud(
        points_mm=(points + ERROR_MM * direction).astype(np.float32), pixel=(v * 200 + u).astype(np.uint32),
        intensity=np.full(n, 100, np.uint8), modulation_dn=np.full(n, 50.0, np.float32),
        ray_gap_mm=np.zeros(n, np.float32), sigma_mm=np.full(n, SIGMA_MM, np.float32),
        summary=CloudSummary(n, None, None, None, None),
    )  # fmt: skip
    own = true.judge(cloud)
    assert own.own_rms_mm == pytest.approx(ERROR_MM, rel=0.01)
    assert own.residuals == pytest.approx(np.full(n, ERROR_MM / SIGMA_MM), rel=0.02)
    assert own.accuracy.completeness_percent == pytest.approx(100.0)
    # Along the ray, so less across the leaning plane; the same wherever the calibration points.
    assert 0.8 * ERROR_MM < own.accuracy.rms_mm < 1.02 * ERROR_MM
