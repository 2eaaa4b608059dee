"""What of a cloud is taken for the balls of a bar, and what is not: dust, the stem, other radii, half-seen faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.evaluation.ball_bar import BallBar, find_ball_bar
from appliance.evaluation.points import NotFound

Array = NDArray[np.float64]
LEFT, RIGHT = np.array([-70.0, 10.0, 520.0]), np.array([80.0, -20.0, 500.0])
LENGTH_MM = float(np.linalg.norm(RIGHT - LEFT))


@dataclass(frozen=True)
class Points:
    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    pixel: NDArray[np.uint32]


def cloud(*parts: Array) -> Points:
    points = np.vstack(parts)
    n = len(points)
    return Points(points.astype(np.float32), np.full(n, 0.03, np.float32), np.arange(n, dtype=np.uint32) + 3)


def ball(centre: Array, radius_mm: float = 15.0, cover: float = 1.0, seed: int = 0, n: int = 4000) -> Array:
    """Points of the face towards the instrument, with errors of 0.03 mm along the view; ``cover``: share of it, a sector."""
    rng = np.random.default_rng(seed)
    away = -centre / np.linalg.norm(centre)
    across = np.cross(away, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    down = np.cross(away, across)
    cos, turn = rng.uniform(0.3, 1.0, n), rng.uniform(0.0, 2.0 * np.pi * cover, n)
    sin = np.sqrt(1.0 - cos**2)
    normal = np.outer(cos, away) + np.outer(sin * np.cos(turn), across) + np.outer(sin * np.sin(turn), down)
    points = centre + radius_mm * normal
    depth = np.linalg.norm(points, axis=1)[:, None]
    return np.asarray(points * (1.0 + 0.03 * rng.standard_normal((n, 1)) / depth))


def bar(*parts: Array) -> BallBar:
    found = find_ball_bar(cloud(*parts))
    assert isinstance(found, BallBar), found
    return found


def refused(*parts: Array) -> str:
    found = find_ball_bar(cloud(*parts))
    assert isinstance(found, NotFound)
    return found.reason


def test_the_ball_with_the_smaller_x_is_the_first_and_the_length_has_an_honest_uncertainty() -> None:
    off = []
    for seed in range(6):
        found = bar(ball(RIGHT, seed=seed), ball(LEFT, seed=seed + 50))
        assert found.first.sphere.centre_mm[0] < found.second.sphere.centre_mm[0]
        assert 0.0005 < found.sigma_length_mm < 0.01
        off.append((found.length_mm - LENGTH_MM) / found.sigma_length_mm)
    assert 0.3 < np.std(off) < 2.5
    assert np.abs(off).max() < 4.0


def test_the_uncertainty_of_the_length_is_that_of_both_centres_along_the_bar() -> None:
    found = bar(ball(LEFT), ball(RIGHT, seed=1))
    along = (RIGHT - LEFT) / LENGTH_MM
    wanted = sum(along @ one.sphere.covariance_mm2[:3, :3] @ along for one in (found.first, found.second))
    assert found.sigma_length_mm**2 == pytest.approx(float(wanted), rel=1e-3)


@pytest.mark.parametrize(("off_mm", "taken"), [(0.8, True), (1.3, False), (1.8, False)])
def test_what_floats_a_millimetre_off_a_ball_is_not_the_balls(off_mm: float, taken: bool) -> None:
    """Nearer than that it is the ball's, and no more of it is left out than any outlier."""
    dust = ball(LEFT, 15.0 + off_mm, seed=9, n=60)
    used = bar(ball(LEFT), ball(RIGHT, seed=1), dust).first.used
    near = np.isin(np.arange(8000, 8060), np.concatenate([used.indices, used.rejected]))
    # Seen flatter than 55 degrees, nothing is used: about two in five of what lies on the face down to a cosine of 0.3.
    assert bool(near.sum() > 20) is taken
    assert taken or not near.any()
    assert used.rejected_count <= 0.003 * (used.count + used.rejected_count)


def test_nothing_within_35_degrees_of_the_other_ball_is_used() -> None:
    found = bar(ball(LEFT), ball(RIGHT, seed=1))
    source = cloud(ball(LEFT), ball(RIGHT, seed=1)).points_mm.astype(np.float64)
    for one, other in ((found.first, found.second), (found.second, found.first)):
        centre = np.array(one.sphere.centre_mm)
        towards = (np.array(other.sphere.centre_mm) - centre) / LENGTH_MM
        away = source[one.used.indices] - centre
        cos = away @ towards / np.linalg.norm(away, axis=1)
        assert np.cos(np.radians(38.0)) < cos.max() < np.cos(np.radians(34.5))


@pytest.mark.parametrize(
    ("radii", "words"),
    [
        ((15.0, 16.5), ""),
        ((15.0, 18.5), "only one ball was found"),
        ((15.0, 12.0), "only one ball was found"),
        ((6.0, 6.0), ""),
        ((38.0, 38.0), ""),
        ((44.0, 44.0), "no ball was found"),
    ],
)
def test_balls_are_as_large_as_each_other_and_as_balls_of_a_bar_are(radii: tuple[float, float], words: str) -> None:
    parts = ball(LEFT, radii[0]), ball(RIGHT, radii[1], seed=1)
    if words:
        assert words in refused(*parts)
    else:
        assert bar(*parts).length_mm == pytest.approx(LENGTH_MM, abs=0.05)


def test_a_sector_of_a_ball_is_too_little_of_its_face() -> None:
    whole = ball(RIGHT, seed=1)
    assert bar(ball(LEFT, cover=0.5), whole).length_mm == pytest.approx(LENGTH_MM, abs=0.1)
    assert "only one ball was found" in refused(ball(LEFT, cover=0.05), whole)


def test_a_shard_of_a_bowl_around_a_ball_is_no_ball_however_much_lies_inside_of_it() -> None:
    """A bowl of 36 mm about the left ball's centre, a few degrees of it: all of the ball is nearer to the centre."""
    rng = np.random.default_rng(8)
    away = np.array([0.0, -0.9, -0.44])
    normal = away / np.linalg.norm(away) + rng.uniform(-0.17, 0.17, (900, 3))
    shard = LEFT + 36.0 * normal / np.linalg.norm(normal, axis=1, keepdims=True)
    found = bar(ball(LEFT), ball(RIGHT, seed=1), shard)
    assert found.length_mm == pytest.approx(LENGTH_MM, abs=0.05)
    assert found.first.sphere.radius_mm == pytest.approx(15.0, abs=0.02)


def test_a_cloud_of_less_than_a_hundred_points_is_not_searched() -> None:
    whole = ball(LEFT)
    assert "the cloud has only 99 points" in refused(whole[:99])
    assert "the cloud has only" not in refused(whole[:100])
    broken = ball(LEFT)
    broken[:3950, 1] = np.nan
    assert "the cloud has only 50 points" in refused(broken)


def test_rows_and_pixels_are_those_of_the_cloud_that_was_given() -> None:
    left = ball(LEFT)
    left[::5, 0] = np.nan
    source = cloud(left, ball(RIGHT, seed=1))
    found = find_ball_bar(source)
    assert isinstance(found, BallBar)
    used = found.first.used
    assert not (used.indices % 5 == 0).any()
    assert used.indices.max() < 4000
    np.testing.assert_array_equal(used.pixel, source.pixel[used.indices])
    away = np.linalg.norm(source.points_mm[used.indices] - np.array(found.first.sphere.centre_mm), axis=1)
    np.testing.assert_allclose(used.residual_mm, away - found.first.sphere.radius_mm, atol=1e-3)
