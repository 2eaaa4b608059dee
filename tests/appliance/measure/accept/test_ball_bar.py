"""Spheres without bias and with honest sigmas, and what of a cloud is taken for the balls of a bar: no dust, stem, other radii."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.accept.ball_bar import BallBar, find_ball_bar
from appliance.measure.accept.points import NotFound
from appliance.measure.accept.sphere import algebraic_sphere, fit_sphere
from tests.appliance.measure.accept.made_points import CENTRE, LENGTH_MM, OTHER, RADIUS_MM, Array, Points, cap


def test_the_radius_of_a_cap_is_unbiased_and_its_sigma_honest() -> None:
    """Coarse points and much noise, so that a bias of the method would be many times its standard error: the closed form has one."""
    rng = np.random.default_rng(1)
    errors, stated, algebraic = [], [], []
    for _ in range(200):
        points = cap(CENTRE, 25.0, 0.8, 0.05, rng)
        solution, start = fit_sphere(points, np.full(len(points), 0.05)), algebraic_sphere(points)
        assert solution is not None
        assert start is not None
        errors.append(solution.sphere.radius_mm - RADIUS_MM)
        stated.append(solution.sphere.covariance_mm2[3, 3] ** 0.5)
        algebraic.append(start[1] - RADIUS_MM)
    assert abs(np.mean(errors)) < 4.0 * np.std(errors) / np.sqrt(len(errors))
    assert np.std(errors) == pytest.approx(np.mean(stated), rel=0.2)
    assert abs(np.mean(algebraic)) > 5.0 * np.std(algebraic) / np.sqrt(len(algebraic))


def test_a_sphere_needs_thirty_points_and_points_on_a_plane_make_none() -> None:
    points = cap(CENTRE, 50.0, 1.5, 0.0, np.random.default_rng(6))
    for n, found in ((29, False), (30, True)):
        solution = fit_sphere(points[:n], np.full(n, 0.03), (CENTRE + 0.5, 15.3))
        assert (solution is not None) is found
        if solution is not None:
            np.testing.assert_allclose(solution.sphere.centre_mm, CENTRE, atol=1e-6)
            assert solution.sphere.radius_mm == pytest.approx(15.0, abs=1e-6)
            assert solution.used.all()
    flat = points * [1.0, 1.0, 0.0] + [0.0, 0.0, 500.0]
    assert algebraic_sphere(flat) is None
    assert fit_sphere(flat, np.full(len(flat), 0.03)) is None


def test_where_the_view_is_flatter_than_55_degrees_a_point_is_not_used_however_it_errs() -> None:
    points = cap(CENTRE, 72.0, 0.4, 0.0, np.random.default_rng(7))
    solution = fit_sphere(points, np.full(len(points), 0.03), (CENTRE, 15.0))
    assert solution is not None
    view = points / np.linalg.norm(points, axis=1, keepdims=True)
    met = -np.sum(view * (points - CENTRE), 1) / 15.0
    chosen = solution.used | solution.outlier
    assert [met[chosen].min(), met[~chosen].max()] == pytest.approx([np.cos(np.radians(55.0))] * 2, abs=0.01)
    assert solution.outlier.sum() == int(0.003 * chosen.sum())


LEFT, RIGHT = np.array([-70.0, 10.0, 520.0]), np.array([80.0, -20.0, 500.0])


def ball(centre: Array, radius_mm: float = 15.0, cover: float = 1.0, seed: int = 0, n: int = 4000) -> Array:
    """Points of the face towards the instrument, with errors of 0.03 mm along the view; ``cover``: share of it, a sector."""
    rng = np.random.default_rng(seed)
    away = -centre / np.linalg.norm(centre)
    across = np.cross(away, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    cos, turn = rng.uniform(0.3, 1.0, n), rng.uniform(0.0, 2.0 * np.pi * cover, n)
    beside = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), np.cross(away, across))
    points = centre + radius_mm * (np.outer(cos, away) + np.sqrt(1.0 - cos**2)[:, None] * beside)
    depth = np.linalg.norm(points, axis=1)[:, None]
    return np.asarray(points * (1.0 + 0.03 * rng.standard_normal((n, 1)) / depth))


def bar(*parts: Array) -> BallBar:
    found = find_ball_bar(Points.of(np.vstack(parts)))
    assert isinstance(found, BallBar), found
    return found


def refused(*parts: Array) -> str:
    found = find_ball_bar(Points.of(np.vstack(parts)))
    assert isinstance(found, NotFound)
    return found.reason


def test_a_ball_bar_is_found_among_other_things_and_the_ball_with_the_smaller_x_is_the_first() -> None:
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.uniform(-120, 120, 20000), rng.uniform(-90, 90, 20000), rng.normal(580, 0.03, 20000)])
    dust = rng.uniform([-100, -80, 450], [100, 80, 570], (40, 3))
    missing = np.full((50, 3), np.nan)
    points = np.vstack([missing, wall, cap(CENTRE, 75.0, 0.4, 0.03, rng), dust, cap(OTHER, 75.0, 0.4, 0.03, rng)])
    found = bar(points)
    assert found.length_mm == pytest.approx(LENGTH_MM, abs=4.0 * found.sigma_length_mm)
    assert np.allclose(found.first.sphere.centre_mm, OTHER, atol=0.02)
    along = (CENTRE - OTHER) / LENGTH_MM
    wanted = sum(along @ one.sphere.covariance_mm2[:3, :3] @ along for one in (found.first, found.second))
    assert found.sigma_length_mm**2 == pytest.approx(float(wanted), rel=1e-3), "of both centres along the bar"
    assert found.sigma_length_mm < 0.01
    for one in (found.first, found.second):
        used = one.used
        assert used.count > 500
        assert used.rejected_count <= 0.003 * (used.count + used.rejected_count)
        assert np.array_equal(used.pixel, used.indices + 7)
        distance = np.linalg.norm(points[used.indices] - one.sphere.centre_mm, axis=1)
        assert np.allclose(distance - one.sphere.radius_mm, used.residual_mm, atol=1e-3)


def test_nothing_within_35_degrees_of_the_other_ball_is_used() -> None:
    points = np.vstack([ball(LEFT), ball(RIGHT, seed=1)])
    found = bar(points)
    for one, other in ((found.first, found.second), (found.second, found.first)):
        towards, away = (
            np.subtract(at, one.sphere.centre_mm) for at in (other.sphere.centre_mm, points[one.used.indices])
        )
        cos = away @ towards / np.linalg.norm(away, axis=1) / np.linalg.norm(towards)
        assert np.cos(np.radians(38.0)) < cos.max() < np.cos(np.radians(34.5)), "the stem is there"


@pytest.mark.parametrize(("off_mm", "taken"), [(0.8, True), (1.3, False)])
def test_what_floats_a_millimetre_off_a_ball_is_not_the_balls(off_mm: float, taken: bool) -> None:
    """Nearer than that it is the ball's, and no more of it is left out than any outlier."""
    used = bar(ball(LEFT), ball(RIGHT, seed=1), ball(LEFT, 15.0 + off_mm, seed=9, n=60)).first.used
    near = np.isin(np.arange(8000, 8060), np.concatenate([used.indices, used.rejected]))
    # Seen flatter than 55 degrees, nothing is used: about two in five of what lies on the face down to a cosine of 0.3.
    assert bool(near.sum() > 20) is taken
    assert taken or not near.any()


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((ball(LEFT, 15.0), ball(RIGHT, 16.5, seed=1)), ""),
        ((ball(LEFT, 15.0), ball(RIGHT, 18.5, seed=1)), "only one ball was found; turn the bar so that both are lit"),
        ((ball(LEFT, 6.0), ball(RIGHT, 6.0, seed=1)), ""),
        ((ball(LEFT, 38.0), ball(RIGHT, 38.0, seed=1)), ""),
        ((ball(LEFT, 44.0), ball(RIGHT, 44.0, seed=1)), "no ball was found"),
        ((ball(LEFT, cover=0.5), ball(RIGHT, seed=1)), ""),
        ((ball(LEFT, cover=0.05), ball(RIGHT, seed=1)), "only one ball was found"),
        ((ball(LEFT)[:99],), "the cloud has only 99 points"),
        ((ball(LEFT)[:100],), "ball was found"),
    ],
)
def test_balls_are_as_large_as_each_other_and_seen_enough(parts: tuple[Array, ...], words: str) -> None:
    if words:
        assert words in refused(*parts)
    else:
        assert bar(*parts).length_mm == pytest.approx(np.linalg.norm(RIGHT - LEFT), abs=0.1)


def test_a_shard_of_a_bowl_around_a_ball_is_no_ball_however_much_lies_inside_of_it() -> None:
    """A bowl of 36 mm about the left ball's centre, a few degrees of it: all of the ball is nearer to the centre."""
    rng = np.random.default_rng(8)
    normal = np.array([0.0, -0.9, -0.44]) + rng.uniform(-0.17, 0.17, (900, 3))
    shard = LEFT + 36.0 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    found = bar(ball(LEFT), ball(RIGHT, seed=1), shard)
    assert found.length_mm == pytest.approx(np.linalg.norm(RIGHT - LEFT), abs=0.05)
    assert found.first.sphere.radius_mm == pytest.approx(15.0, abs=0.02)
