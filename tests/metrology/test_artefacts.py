"""Artefacts in simulated scans are found without help, and are where and as large as they truly are."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.accept.ball_bar import BallBar, find_ball_bar
from appliance.measure.accept.flatness import flatness
from appliance.measure.accept.frustum import Frustum, find_frustum
from appliance.measure.accept.plane import PlaneFit, fit_plane
from appliance.measure.accept.points import NotFound
from hw_sim.objects.motion import pose_matrix
from hw_sim.objects.shapes import BALL_RADIUS_MM, FRUSTUM_BASE_MM, FRUSTUM_HEIGHT_MM, FRUSTUM_TOP_MM
from hw_sim.scene import Imaging, Scene
from tests.support.rendered import reconstruct, render_scan
from tests.support.truth import rig_to_left

WIDTH_PX = 400
MEAN_OF_A_PIXEL_MM = 0.03
"""A pixel of 0.64 mm sees a curved piece of the ball and returns its mean, which lies behind the surface; at full
resolution this is a sixteenth."""


def test_a_ball_bar_is_as_long_as_it_is_and_where() -> None:
    pose = (0.0, 0.0, 522.0, 5.0, -30.0, 90.0)
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


def test_a_plane_is_where_it_is_and_no_frustum() -> None:
    pose = (10.0, 5.0, 570.0, 0.0, -20.0, 0.0)
    # Of the projector's own response, images as small as these show more than noise: see test_response.
    scan = render_scan(Scene(object="plane", pose=pose, imaging=Imaging("linear")), "modelled", 3, WIDTH_PX, 16)
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
    assert result.noise_mm == pytest.approx(float(np.median(cloud.sigma_mm)), rel=0.2)
    assert isinstance(find_frustum(cloud), NotFound)


def test_a_frustum_is_as_large_as_it_is_and_where() -> None:
    pose = (10.0, 10.0, 560.0, -5.0, 12.0, 45.0)
    scan = render_scan(Scene(object="frustum", pose=pose), "modelled", 3, WIDTH_PX, 16)
    _, cloud = reconstruct(scan)
    frustum = find_frustum(cloud)
    assert isinstance(frustum, Frustum)
    slanted_mm = np.hypot((FRUSTUM_BASE_MM - FRUSTUM_TOP_MM) / np.sqrt(2.0), FRUSTUM_HEIGHT_MM)
    true_mm = {"top": FRUSTUM_TOP_MM, "base": FRUSTUM_BASE_MM, "height": FRUSTUM_HEIGHT_MM, "slanted": slanted_mm}
    for name, measured in frustum.lengths_mm.items():
        assert measured == pytest.approx([true_mm[name]] * len(measured), abs=0.02)
    R, t = pose_matrix(pose)
    half, base = FRUSTUM_TOP_MM / 2, FRUSTUM_BASE_MM / 2
    for found, size, z in ((frustum.top_corners_mm, half, -FRUSTUM_HEIGHT_MM), (frustum.base_corners_mm, base, 0.0)):
        corners = np.array([[a * size, b * size, z] for a in (-1, 1) for b in (-1, 1)]) @ R.T + t
        true = rig_to_left(scan.renderer.truth, corners)
        away = np.linalg.norm(true[:, None] - found[None], axis=2)
        assert away.min(axis=0).max() < 0.015
        assert len(set(away.argmin(axis=0))) == 4
