"""Planes, their flatness and what may be left out of them, on points whose place is known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.accept.flatness import cubic_of, flatness, local_noise_mm
from appliance.measure.accept.plane import PlaneFit, fit_plane, orthogonal_plane
from appliance.measure.accept.points import FitPoints, NotFound, finite_rows, thinned, without_outliers
from tests.appliance.measure.accept.made_points import Array, Points, board


def wall(n: int, z_mm: float = 500.0, noise_mm: float = 0.02, seed: int = 1) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-80, 80, n), rng.uniform(-60, 60, n), rng.normal(z_mm, noise_mm, n)])


def fitted(points: Array) -> PlaneFit:
    found = fit_plane(Points.of(points))
    assert isinstance(found, PlaneFit), found
    return found


def refused(points: Array) -> str:
    found = fit_plane(Points.of(points))
    assert isinstance(found, NotFound)
    return found.reason


def test_a_planes_axes_are_right_and_down_as_the_instrument_sees_it_and_behind_it_is_positive() -> None:
    plane = orthogonal_plane(wall(2000))
    np.testing.assert_allclose([plane.axis_x, plane.axis_y, plane.normal], np.eye(3), atol=1e-3)
    at = np.array(plane.centre_mm)
    np.testing.assert_allclose(plane.distance_mm(np.stack([at, np.add(at, [0.0, 0.0, 2.0])])), [0.0, 2.0], atol=1e-3)
    np.testing.assert_allclose(plane.coordinates_mm(np.add(at, [3.0, -4.0, 0.0])[None]), [[3.0, -4.0]], atol=1e-3)
    # Of a floor the normal is the instrument's down, with which no axis to the right can be made: x itself is taken.
    floor = orthogonal_plane(wall(500)[:, [0, 2, 1]] + [0.0, 0.0, 600.0])
    np.testing.assert_allclose([floor.axis_x, floor.normal], np.eye(3)[:2], atol=1e-3)
    assert abs(np.dot(floor.axis_y, floor.normal)) < 1e-9


def test_what_is_stated_of_offset_and_slope_is_what_the_noise_makes_of_them() -> None:
    """0.5 mm over the root of 40, and over 40 places that scatter by 160 / sqrt(12) mm."""
    covariance = np.mean([orthogonal_plane(wall(40, 500.0, 0.5, seed)).covariance for seed in range(50)], axis=0)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(0.5 / np.sqrt(40), rel=0.05)
    assert np.sqrt(covariance[1, 1]) == pytest.approx(0.5 / np.sqrt(40) / (160 / np.sqrt(12)), rel=0.08)


def test_less_than_five_hundred_points_are_no_plane_and_most_must_lie_on_it() -> None:
    assert "the cloud has only 499 points" in refused(wall(499))
    assert fitted(wall(500)).used.count == 499
    broken = wall(600)
    broken[:150, 2] = np.nan
    assert "the cloud has only 450 points" in refused(broken)
    other = wall(1000, seed=2) + np.outer(np.linspace(20.0, 90.0, 1000), [0.0, 0.0, 1.0])
    assert fitted(np.vstack([wall(1200), other])).elsewhere == pytest.approx(1000, abs=1)
    assert "only 45 % of the points lie on one plane" in refused(np.vstack([wall(818), other]))


@pytest.mark.parametrize(("off_mm", "elsewhere"), [(4.5, 0), (-4.5, 0), (5.5, 40), (-5.5, 40)])
def test_what_is_more_than_five_millimetres_off_is_another_things(off_mm: float, elsewhere: int) -> None:
    points = wall(20000)
    points[:40, 2] += off_mm
    found = fitted(points)
    assert found.elsewhere == elsewhere
    assert found.used.rejected_count == int(0.003 * (20000 - elsewhere))
    assert len(found.coordinates_mm) == found.used.count
    assert found.used.range_mm < 0.3, "the sixty worst are out, those forty among them"
    np.testing.assert_array_equal(found.used.pixel, found.used.indices + 7)


def test_of_each_cube_the_first_finite_point_stays() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.9, 1.9, 1.9], [2.1, 0.0, 0.0], [0.0, 2.1, 0.0], [0.0, 0.0, 2.1]])
    assert thinned(points, 2.0).tolist() == [0, 2, 3, 4]
    assert thinned(points[::-1], 2.0).tolist() == [0, 1, 2, 3]
    grid = np.stack(np.meshgrid(*[np.arange(0.5, 6.0)] * 3), -1).reshape(-1, 3)
    assert len(thinned(grid, 2.0)) == 27
    assert finite_rows(np.array([[1, 2, 3], [1, np.nan, 3], [np.inf, 2, 3], [4, 5, 6]], np.float32)).tolist() == [0, 3]


def test_residuals_are_told_by_rms_and_range_and_the_worst_three_in_a_thousand_may_go() -> None:
    for n, gone in ((333, 0), (334, 1), (999, 2), (1000, 3)):
        badness = np.random.default_rng(n).permutation(n).astype(np.float64)
        assert set(badness[~without_outliers(badness)].tolist()) == set(range(n - gone, n))
    used = FitPoints(np.arange(4), np.arange(4, dtype=np.uint32), np.array([3.0, -1.0, 1.0, 1.0]), np.arange(2))
    assert (used.count, used.rejected_count, used.range_mm) == (4, 2, 4.0)
    assert used.rms_mm == pytest.approx(np.sqrt(3.0))


def test_the_smooth_part_is_a_cubic_and_nothing_finer() -> None:
    rng = np.random.default_rng(3)
    xy = rng.uniform([-90.0, -50.0], [60.0, 70.0], (4000, 2))
    x, y = xy.T / 50.0
    terms = np.stack([x**0, x, y, x * y, x**2, y**2, x**3, x**2 * y, x * y**2, y**3])
    cubic = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.3, 0.05, -0.1, 0.2, -1.0]) @ terms
    np.testing.assert_allclose(cubic_of(xy, cubic), cubic, atol=1e-9)
    for finer in (x**4, x**2 * y**2):
        assert np.std(cubic_of(xy, finer) - finer) > 0.05
    assert np.std(cubic_of(xy, rng.standard_normal(4000))) == pytest.approx(np.sqrt(10 / 4000), rel=0.6)


@pytest.mark.parametrize("per_cell", [12, 40])
def test_local_noise_is_unbiased_also_where_a_cell_has_few_points_and_slopes_are_no_noise(per_cell: int) -> None:
    """Twelve points less the three parameters of a plane: without these nine, it would be 13 % too little."""
    rng = np.random.default_rng(4)
    corner = np.stack(np.meshgrid(np.arange(40), np.arange(30)), -1).reshape(-1, 2) * 6.0
    xy = (corner[:, None] + rng.uniform(0.01, 5.99, (1200, per_cell, 2))).reshape(-1, 2)
    xy[0] = 0.0
    residual = 0.2 * rng.standard_normal(len(xy)) + 0.05 * xy[:, 0] - 0.03 * xy[:, 1]
    assert local_noise_mm(xy, residual) == pytest.approx(0.2, rel=0.02)


def test_cells_of_eleven_points_and_points_in_a_line_say_nothing_of_noise() -> None:
    rng = np.random.default_rng(5)
    quiet = np.column_stack([rng.uniform(0.0, 5.9, 40), rng.uniform(0.0, 5.9, 40)])
    quiet[0] = 0.0
    loud = np.column_stack([rng.uniform(12.1, 17.9, 11), rng.uniform(0.1, 5.9, 11)])
    residual = np.concatenate([0.01 * rng.standard_normal(40), 5.0 * rng.standard_normal(11)])
    said = local_noise_mm(np.vstack([quiet, loud]), residual)
    assert said is not None
    assert said < 0.02
    line = np.column_stack([np.linspace(0.0, 5.9, 50), np.zeros(50)])
    for wide_mm, enough in (
        (0.0, False),
        (0.1, False),
        (0.3, True),
    ):  # a thousandth of the cell's area, squared: 0.19 mm
        band = line + np.outer(wide_mm * rng.standard_normal(50), [0.0, 1.0]) + [0.0, 1.0]
        assert (local_noise_mm(band, rng.standard_normal(50)) is not None) is enough


def test_flatness_tells_shape_from_noise_by_the_reference_length() -> None:
    along_ray = np.sqrt(1.04)
    for bow_mm in (0.0, 0.5):
        fit = fitted(board(bow_mm, 0.03))
        said = flatness(fit)
        assert said.noise_mm == pytest.approx(0.03 / along_ray, rel=0.03)
        assert said.e_f_sys == pytest.approx(bow_mm / along_ray / 250.0, rel=0.05, abs=0.02 / 250.0)
        assert said.e_f == pytest.approx(fit.used.range_mm / 250.0)
        assert said.e_f > 5.0 * 0.03 / 250.0
        assert flatness(fit, 100.0).e_f_sys == pytest.approx(2.5 * said.e_f_sys)
