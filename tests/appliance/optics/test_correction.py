"""An image correction is a smooth surface, and a camera with one projects where its own rays come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.calibration.file import decode, encode
from appliance.optics.correction import ImageCorrection, basis_matrix, node_count
from appliance.optics.model import StereoRig
from appliance.optics.water import Water

WATER = Water(20.0, 0.0, 530.0)
DESIGN = design_calibration(Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77), "KF-0001", 1600, 1200, WATER)
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
    matrix = basis_matrix(uv, (1600, 1200), (6, 5))
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


def test_a_corrected_camera_projects_onto_the_pixels_its_rays_come_from_also_out_of_a_file() -> None:
    camera = replace(DESIGN.rig.right, correction=CORRECTION)
    corrected = replace(DESIGN, rig=StereoRig(DESIGN.rig.left, camera))
    assert decode(encode(corrected)) == corrected
    origin, direction = camera.rays(UV, WATER.index)
    assert np.abs(camera.project(origin + 500.0 * direction, WATER.index) - UV).max() < 1e-8
    plain, _ = DESIGN.rig.right.rays(UV, WATER.index)
    assert np.abs(origin - plain).max() > 1e-4, "the correction changes rays"


def test_a_wrong_number_of_nodes_is_refused() -> None:
    with pytest.raises(ValueError, match="6 × 5 intervals need 144"):
        ImageCorrection(1600, 1200, (6, 5), (0.0,) * 10)
