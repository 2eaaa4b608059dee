"""Each way a camera may see: pixels and rays agree, corrections are smooth, and water is answered as it should."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.measure.calibration.design import design_calibration
from appliance.measure.light import pinhole
from appliance.measure.light.correction import CORRECTION_INTERVALS, ImageCorrection, SplineGrid, node_count
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.ray_shift import INTERVALS as SHIFT_INTERVALS
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.light.water import Water
from tests.support.calibrating import DESIGN
from tests.support.truth import WATER

FRESH, SALT = WATER.index, Water(20.0, 35.0, 530.0).index
RIG = design_calibration(DESIGN, "KF", 1600, 1200, WATER).rig
SHIFT = RayShift(1600, 1200, (4, 3), tuple(np.random.default_rng(3).normal(0.0, 0.05, 84)))
MODELS = {
    "ray field": replace(
        RIG.right,
        correction=ImageCorrection(1600, 1200, (6, 5), tuple(np.random.default_rng(4).normal(0.0, 0.1, 144))),
        ray_shift=SHIFT,
    ),
    "lens in water": replace(
        RIG.right, lens=Lens((3400.0, 3400.0), RIG.right.lens.c_px, (0.2, 0.1, 1e-4, 1e-4, 0.0)), lens_in_water=True
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_point_on_a_ray_is_seen_at_its_pixel_and_only_a_lens_calibrated_in_water_ignores_the_water(name: str) -> None:
    camera = MODELS[name]
    v, u = np.mgrid[0:1200:97, 0:1600:97].astype(float)
    uv = np.stack([u, v], -1)
    origin, direction = camera.rays(uv, FRESH)
    for depth_mm in (420.0, 650.0):
        np.testing.assert_allclose(np.linalg.norm(direction, axis=-1), 1.0, atol=1e-12)
        np.testing.assert_allclose(camera.project(origin + depth_mm * direction, FRESH), uv, atol=1e-6)
    behind = np.asarray(camera.translation_mm) - 100.0 * np.asarray(camera.rotation)[:, 2]
    assert np.isnan(camera.project(behind[None], FRESH)).all()
    change = np.abs(camera.rays(uv, SALT)[1] - direction).max()
    assert (change == 0.0) == (name == "lens in water")


def test_a_ray_shift_moves_rays_without_turning_them_and_has_as_many_nodes_as_its_grid() -> None:
    uv = np.array([[100.0, 100.0], [1500.0, 700.0]])
    (o, d), (o2, d2) = RIG.right.rays(uv, FRESH), replace(RIG.right, ray_shift=SHIFT).rays(uv, FRESH)
    np.testing.assert_array_equal(d, d2)
    assert 0.001 < np.linalg.norm(o2 - o, axis=1).min() < 0.2
    for count in (83, 85, 42):
        with pytest.raises(ValueError, match=f"ray shift with {count} coefficients; 4 × 3 intervals need 84"):
            RayShift(1600, 1200, (4, 3), (0.0,) * count)


def test_the_middle_of_the_volume_is_where_the_two_central_rays_come_nearest() -> None:
    rig = replace(RIG, right=replace(RIG.right, translation_mm=(226.0, 7.0, 51.0)))
    centre = rig.volume_centre_mm(FRESH)
    gaps = []
    for camera in (rig.left, rig.right):
        origin, direction = camera.rays(np.array([799.5, 599.5]), FRESH)
        gaps.append(origin + direction * float((centre - origin) @ direction) - centre)
        assert abs(float(gaps[-1] @ direction)) < 1e-9
    np.testing.assert_allclose(gaps[0], -gaps[1], atol=1e-9)  # half-way between the feet, which lie opposite each other
    assert 1.0 < np.linalg.norm(gaps[0]) < 10.0
    assert 300.0 < centre[2] < 900.0


def test_axes_within_a_milliradian_of_each_other_are_parallel() -> None:
    """Two hundred metres away they would meet."""
    left = HousedCamera(1600, 1200, Lens((2500.0, 2500.0), (799.5, 599.5)), RIG.right.port, lens_in_water=True)
    for angle_rad, parallel in ((0.0, True), (0.9e-3, True), (1.1e-3, False)):
        c, s = float(np.cos(angle_rad)), float(np.sin(angle_rad))
        turned = (c, 0.0, -s), (0.0, 1.0, 0.0), (s, 0.0, c)
        rig = StereoRig(left, replace(left, rotation=turned, translation_mm=(230.0, 0.0, 0.0)))
        with pytest.raises(ValueError, match="parallel; check the calibration") if parallel else nullcontext():
            assert rig.volume_centre_mm(FRESH)[2] == pytest.approx(230.0 / angle_rad, rel=1e-3)


def test_distortion_is_opencvs() -> None:
    """Against OpenCV's projection, one coefficient at a time and all together."""
    at = np.random.default_rng(2).uniform(-0.3, 0.3, (40, 2))
    points = np.column_stack([at, np.ones(40)])
    for bends in (*0.1 * np.eye(5), np.array([-0.1, 0.05, 2e-3, -1e-3, 0.02])):
        lens = Lens((1000.0, 900.0), (10.0, 20.0), tuple(bends.tolist()))
        matrix = np.array([[1000.0, 0.0, 10.0], [0.0, 900.0, 20.0], [0.0, 0.0, 1.0]])
        seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, bends)
        expected = np.asarray(seen, np.float64).reshape(-1, 2)
        np.testing.assert_allclose(lens.to_pixels(at), expected, atol=1e-9)
        np.testing.assert_allclose(lens.to_normalised(expected), at, atol=1e-12)


def test_a_strongly_bent_lens_is_inverted_in_three_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method squares the error with each step, if its slopes are those of the lens."""
    monkeypatch.setattr(pinhole, "MAX_ITERATIONS", 3)
    lens = Lens((1000.0, 900.0), (10.0, 20.0), (-0.3, 0.12, 2e-2, -3e-2, 0.05))
    xy = np.random.default_rng(1).uniform(-0.45, 0.45, (300, 2))
    xy[0], xy[1], xy[2] = (0.0, 0.0), (0.3, 0.0), (0.0, 0.3)
    uv = lens.to_pixels(xy)
    uv[5] = np.nan  # spoils only itself
    found = lens.to_normalised(uv)
    assert np.flatnonzero(np.isnan(found).all(axis=1)).tolist() == [5]
    np.testing.assert_allclose(np.delete(found, 5, 0), np.delete(xy, 5, 0), atol=2e-10)


def test_a_lens_that_folds_over_is_refused_on_either_side_of_the_image() -> None:
    """x (1 - 0.5 r^2) is never more than 0.55."""
    lens = Lens((1000.0, 1000.0), (0.0, 0.0), (-0.5, 0.0, 0.0, 0.0, 0.0))
    for way in ([[1.0, 0.0]], [[-1.0, 0.0]], [[0.0, 1.0]], [[0.0, -1.0]]):
        uv = 200.0 * np.array(way)
        assert lens.to_pixels(lens.to_normalised(uv)) == pytest.approx(uv, abs=1e-8)
        with pytest.raises(ValueError, match="cannot be inverted within the image; recalibrate the camera in air"):
            lens.to_normalised(700.0 * np.array(way))


def test_the_free_fields_are_as_fine_as_the_documentation_says_and_the_shift_has_square_cells() -> None:
    """Depth shows less than an image, so that the ray shift is coarser."""
    (across, down), (shift_across, shift_down) = CORRECTION_INTERVALS, SHIFT_INTERVALS
    said = (Path(__file__).parents[4] / "docs" / "calibration.md").read_text(encoding="utf-8")
    assert f"image corrections of 16 × 12 intervals ({across} × {down} if the air calibration has none)" in said
    assert 1600 / shift_across == 1200 / shift_down, "square on a sensor of 4 : 3"
    assert 1 / 3 < shift_across * shift_down / (across * down) < 2 / 3


SMALL = WorkingVolume(264.0, 300.0, 336.0)


def test_lengths_of_the_standard_housing_stay_as_they_are_to_the_last_bit() -> None:
    lengths = np.random.default_rng(1).uniform(0.01, 2000.0, 1000).tolist()
    assert [STANDARD.scaled(mm) for mm in lengths] == lengths
    assert [SMALL.scaled(mm) for mm in (500.0, 440.0, 700.0)] == pytest.approx([300.0, 264.0, 420.0])


def test_a_range_without_order_is_refused_with_the_remedy() -> None:
    for wrong in ((500.0, 440.0, 560.0), (440.0, 600.0, 560.0), (-1.0, 500.0, 560.0)):
        with pytest.raises(ValueError, match=r"correct \[volume\] in the rig file"):
            WorkingVolume(*wrong)


CORRECTION = ImageCorrection(1600, 1200, (6, 5), tuple(np.random.default_rng(1).normal(0.0, 0.2, 144).tolist()))
UV = np.random.default_rng(3).uniform([0, 0], [1599, 1199], (500, 2))


def test_one_node_acts_where_it_is_and_on_the_component_that_is_its_own() -> None:
    """A cubic B-spline is 4/6 at its node, 1/6 one interval aside, and 0 two intervals aside."""
    columns, rows = 6, 5
    for component, expected in ((0, [1.0, 0.0]), (1, [0.0, 1.0])):
        nodes = np.zeros((rows + 3, columns + 3, 2))
        nodes[1 + 2, 1 + 4, component] = 1.0
        c = ImageCorrection(1600, 1200, (columns, rows), tuple(nodes.ravel()))
        u, v = 4 * 1600 / columns - 0.5, 2 * 1200 / rows - 0.5
        across, down = 1600 / columns, 1200 / rows
        at = [(u, v), (u + across, v), (u, v - down), (u - across, v + down), (u + 2 * across, v), (u, v + 2 * down)]
        weights = np.array([16, 4, 4, 1, 0, 0]) / 36
        np.testing.assert_allclose(c.shift_px(np.array(at)), weights[:, None] * expected, atol=1e-12)


def test_the_matrix_of_weights_is_the_surface_and_sums_to_one_also_beyond_the_image() -> None:
    uv = np.random.default_rng(5).uniform([-3, -3], [1602, 1202], (200, 2))
    matrix = SplineGrid((1600, 1200), (6, 5)).matrix(uv)
    nodes = np.reshape(CORRECTION.coefficients_px, (-1, 2))
    assert len(nodes) == node_count((6, 5))
    np.testing.assert_allclose(matrix @ nodes, CORRECTION.shift_px(uv), atol=1e-12)
    np.testing.assert_allclose(matrix.sum(axis=1), 1.0, atol=1e-12)


def test_real_and_ideal_pixels_invert_each_other() -> None:
    c = CORRECTION
    assert np.abs(c.to_real(c.to_ideal(UV)) - UV).max() < 1e-9
    some = np.array([[np.nan, 3.0], [700.0, 300.0], [2.0, np.nan]])
    assert np.isnan(c.to_real(some)).all(axis=1).tolist() == [True, False, True]
    assert np.abs(c.to_ideal(c.to_real(some[1])) - some[1]).max() < 1e-9
    assert c.to_real(np.zeros((0, 2))).shape == (0, 2)
    with pytest.raises(ValueError, match="6 × 5 intervals need 144"):
        ImageCorrection(1600, 1200, (6, 5), (0.0,) * 10)
