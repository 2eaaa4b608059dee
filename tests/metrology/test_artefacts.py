"""Artefacts in simulated scans are found without help, and are where and as large as they truly are."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.evaluation.ball_bar import BallBar, find_ball_bar
from appliance.evaluation.flatness import flatness
from appliance.evaluation.plane import PlaneFit, fit_plane
from hw_sim.motion import pose_matrix
from hw_sim.objects.shapes import BALL_RADIUS_MM
from hw_sim.scene import Scene
from tests.support.rendered import reconstruct, render_scan
from tests.support.truth import rig_to_left

Pose = tuple[float, float, float, float, float, float]
WIDTH_PX = 400
MEAN_OF_A_PIXEL_MM = 0.03
"""A pixel of 0.64 mm sees a curved piece of the ball and returns its mean, which lies behind the surface; at full
resolution this is a sixteenth."""


@pytest.mark.parametrize(
    "pose",
    [
        (0.0, 0.0, 522.5, 0.0, 10.0, 15.0),
        (0.0, -30.0, 480.0, 0.0, -20.0, -10.0),
        (10.0, 30.0, 560.0, 0.0, 30.0, 60.0),
        (0.0, 0.0, 522.0, 5.0, -30.0, 90.0),
    ],
)
def test_a_ball_bar_in_any_pose(pose: Pose) -> None:
    scan = render_scan(Scene(object="ballbar", pose=pose), "modelled", 3, WIDTH_PX, 16)
    _, cloud = reconstruct(scan)
    bar = find_ball_bar(cloud)
    assert isinstance(bar, BallBar)
    truth = scan.renderer.truth
    true_mm = truth.artefacts.ball_distance_mm
    assert bar.length_mm == pytest.approx(true_mm, abs=3.0 * bar.sigma_length_mm + 0.3 * MEAN_OF_A_PIXEL_MM)
    R, t = pose_matrix(pose)
    ends = rig_to_left(truth, np.array([[-0.5, 0, 0], [0.5, 0, 0]]) * true_mm @ R.T + t)
    ends = ends[np.argsort(ends[:, 0])]
    for ball, end in zip((bar.first, bar.second), ends, strict=True):
        sigma = np.sqrt(np.diag(ball.sphere.covariance_mm2))
        assert (np.abs(ball.sphere.centre_mm - end) < 4.0 * sigma[:3] + MEAN_OF_A_PIXEL_MM).all()
        assert abs(ball.sphere.radius_mm - BALL_RADIUS_MM) < 4.0 * sigma[3] + MEAN_OF_A_PIXEL_MM
        assert ball.used.count > 500


@pytest.mark.parametrize("pose", [(0.0, 0.0, 480.0, -10.0, 5.0, 5.0), (10.0, 5.0, 570.0, 0.0, -20.0, 0.0)])
def test_a_plane_in_any_pose(pose: Pose) -> None:
    scan = render_scan(Scene(object="plane", pose=pose), "modelled", 3, WIDTH_PX, 16)
    _, cloud = reconstruct(scan)
    fit = fit_plane(cloud)
    assert isinstance(fit, PlaneFit)
    truth = scan.renderer.truth
    R, t = pose_matrix(pose)
    assert abs(float(fit.plane.distance_mm(rig_to_left(truth, t[None, :]))[0])) < 0.005
    true_normal = np.array(truth.left.R).T @ R[:, 2]
    assert np.linalg.norm(np.cross(fit.plane.normal, true_normal)) < 3e-5
    result = flatness(fit)
    assert result.e_f_sys < 1e-4
    assert result.noise_mm == pytest.approx(float(np.median(cloud.sigma_mm)), rel=0.4)
