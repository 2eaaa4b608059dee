"""Spheres and planes out of made-up points whose truth is known exactly: no bias, honest sigmas, few rejections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.evaluation.ball_bar import find_ball_bar
from appliance.evaluation.flatness import flatness
from appliance.evaluation.plane import PlaneFit, fit_plane
from appliance.evaluation.points import NotFound
from appliance.evaluation.sphere import algebraic_sphere, fit_sphere

Array = NDArray[np.float64]
CENTRE = np.array([20.0, -15.0, 510.0])
RADIUS_MM = 15.0
SIGMA_MM = 0.05


@dataclass(frozen=True)
class Points:
    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]

    @classmethod
    def of(cls, points: Array, sigma_mm: float = SIGMA_MM) -> Points:
        n = len(points)
        return cls(points.astype(np.float32), np.full(n, sigma_mm, np.float32), np.arange(n, dtype=np.uint32) + 7)


def cap(centre: Array, half_angle_deg: float, step_mm: float, sigma_mm: float, rng: np.random.Generator) -> Array:
    """What a camera sees of a ball within a cone of normals: exact rays, errors of depth."""
    x, y = np.meshgrid(np.arange(-17.0, 17.0, step_mm), np.arange(-17.0, 17.0, step_mm))
    at = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) + centre
    view = at / np.linalg.norm(at, axis=1)[:, None]
    towards = view @ centre
    square = towards**2 - centre @ centre + RADIUS_MM**2
    view, towards, root = view[square > 0], towards[square > 0], np.sqrt(square[square > 0])
    steep = root / RADIUS_MM > np.cos(np.radians(half_angle_deg))
    depth = (towards - root)[steep] + rng.normal(0.0, sigma_mm, int(steep.sum()))
    return np.asarray(view[steep] * depth[:, None])


@pytest.mark.parametrize("half_angle_deg", [25.0, 50.0])
def test_the_radius_of_a_cap_is_unbiased_and_its_sigma_honest(half_angle_deg: float) -> None:
    """Coarse points and much noise, so that a bias of the method would be many times its standard error."""
    rng = np.random.default_rng(1)
    errors, stated, algebraic = [], [], []
    for _ in range(200):
        points = cap(CENTRE, half_angle_deg, 0.8, SIGMA_MM, rng)
        solution = fit_sphere(points, np.full(len(points), SIGMA_MM))
        assert solution is not None
        errors.append(solution.sphere.radius_mm - RADIUS_MM)
        stated.append(solution.sphere.covariance_mm2[3, 3] ** 0.5)
        start = algebraic_sphere(points)
        assert start is not None
        algebraic.append(start[1] - RADIUS_MM)
    standard_error = np.std(errors) / np.sqrt(len(errors))
    assert abs(np.mean(errors)) < 4.0 * standard_error
    assert np.std(errors) == pytest.approx(np.mean(stated), rel=0.2)
    if half_angle_deg < 30.0:  # the noise is enough to show a bias: the closed form alone has one
        assert abs(np.mean(algebraic)) > 5.0 * np.std(algebraic) / np.sqrt(len(algebraic))


def test_a_ball_bar_is_found_among_other_things() -> None:
    rng = np.random.default_rng(2)
    other = CENTRE + np.array([-120.0, 60.0, 30.0])
    wall = np.column_stack([rng.uniform(-120, 120, 20000), rng.uniform(-90, 90, 20000), rng.normal(580, 0.03, 20000)])
    dust = rng.uniform([-100, -80, 450], [100, 80, 570], (40, 3))
    points = np.vstack([wall, cap(CENTRE, 75.0, 0.4, 0.03, rng), dust, cap(other, 75.0, 0.4, 0.03, rng)])
    bar = find_ball_bar(Points.of(points, 0.03))
    assert not isinstance(bar, NotFound)
    assert bar.length_mm == pytest.approx(float(np.linalg.norm(other - CENTRE)), abs=4.0 * bar.sigma_length_mm)
    assert bar.sigma_length_mm < 0.01
    assert np.allclose(bar.first.sphere.centre_mm, other, atol=0.02)
    for ball in (bar.first, bar.second):
        used = ball.used
        assert used.count > 500
        assert used.rejected_count <= 0.003 * (used.count + used.rejected_count)
        assert np.array_equal(used.pixel, used.indices + 7)
        away = np.linalg.norm(points[used.indices] - ball.sphere.centre_mm, axis=1) - ball.sphere.radius_mm
        assert np.allclose(away, used.residual_mm, atol=1e-3)


def test_one_ball_is_not_a_bar() -> None:
    points = cap(CENTRE, 75.0, 0.4, 0.03, np.random.default_rng(3))
    found = find_ball_bar(Points.of(points))
    assert isinstance(found, NotFound)
    assert found.reason == "only one ball was found; turn the bar so that both are lit"


@pytest.mark.parametrize("count", [0, 50, 20000])
def test_no_ball_is_said_in_words(count: int) -> None:
    rng = np.random.default_rng(4)
    flat = np.column_stack([rng.uniform(-100, 100, (count, 2)), rng.normal(500, 0.05, count)])
    found = find_ball_bar(Points.of(flat))
    assert isinstance(found, NotFound)
    assert "ball" in found.reason


def board(bow_mm: float, sigma_mm: float, outliers: int, n: int = 40000) -> Array:
    """A board tilted by 0.2 mm/mm: bowl-shaped by ``bow_mm``, noisy, the first points off it by 2 mm."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-100, 100, n), rng.uniform(-80, 80, n)
    z = 520.0 + 0.2 * x + bow_mm * (x / 100.0) ** 2 + rng.normal(0.0, sigma_mm, n)
    z[:outliers] += 2.0
    return np.column_stack([x, y, z])


def plane_of(points: Array) -> PlaneFit:
    fit = fit_plane(Points.of(points))
    assert isinstance(fit, PlaneFit)
    return fit


def test_a_plane_is_where_it_is() -> None:
    fit = plane_of(board(0.0, 0.03, 0))
    true = np.array([-0.2, 0.0, 1.0]) / np.sqrt(1.04)
    slope = np.linalg.norm(np.cross(fit.plane.normal, true))
    assert slope < 4.0 * np.sqrt(np.trace(fit.plane.covariance[1:, 1:]))
    offset = float(fit.plane.distance_mm(np.array([[0.0, 0.0, 520.0]]))[0])
    assert abs(offset) < 5.0 * np.sqrt(fit.plane.covariance[0, 0])
    assert fit.used.rejected_count == 120
    assert fit.elsewhere == 0


def test_at_most_three_in_a_thousand_are_removed() -> None:
    """100 outliers of 40 000 are within the rule and vanish; of 400, 280 remain and show in E_F."""
    assert plane_of(board(0.0, 0.03, 100)).used.range_mm < 0.3
    many = plane_of(board(0.0, 0.03, 400))
    assert many.used.rejected_count == 120
    assert many.used.range_mm > 1.9


def test_flatness_tells_shape_from_noise() -> None:
    quiet, bowed = flatness(plane_of(board(0.0, 0.03, 0))), flatness(plane_of(board(0.5, 0.03, 0)))
    assert quiet.noise_mm == pytest.approx(0.03 / np.sqrt(1.04), rel=0.02)
    assert bowed.noise_mm == pytest.approx(0.03 / np.sqrt(1.04), rel=0.03)
    assert quiet.e_f_sys < 0.02 / 250.0
    assert bowed.e_f_sys == pytest.approx(0.5 / np.sqrt(1.04) / 250.0, rel=0.05)
    assert 5.0 * 0.03 / 250.0 < quiet.e_f < 7.0 * 0.03 / 250.0
    assert bowed.e_f > bowed.e_f_sys


def test_two_walls_are_not_a_plane() -> None:
    half = board(0.0, 0.03, 0)
    half[: len(half) * 6 // 10, 2] += np.linspace(30.0, 60.0, len(half) * 6 // 10)
    found = fit_plane(Points.of(half))
    assert isinstance(found, NotFound)
    assert "let nothing but the plane" in found.reason
