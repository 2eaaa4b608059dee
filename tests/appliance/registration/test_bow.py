"""A depth error that both scans share: how it turns their pose, and what the pair tells of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.depth_error import COUNT, POWERS, along_ray, shapes
from appliance.optics.rotation import rotation_matrix, rotation_vector
from appliance.registration.bow import PRIOR_MM2, bow_score, corrected, derivatives, known_before, spread_mm
from appliance.registration.fine import Fit, refine
from appliance.registration.patches import patches_of
from tests.support.views import PROJECTION, SeenView, between, view

POSES = (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), (30.0, -20.0, 520.0, -4.0, 6.0, 75.0)
SHARED_MM = np.zeros(COUNT)
SHARED_MM[[0, 2]] = 0.06, -0.03


@pytest.fixture(scope="module")
def seen() -> tuple[SeenView, SeenView]:
    return view("shell", POSES[0], "slight", 1), view("shell", POSES[1], "slight", 2)


def bent(one: SeenView) -> SeenView:
    points = one.cloud.points_mm.astype(np.float64)
    with np.errstate(invalid="ignore"):
        moved = points + along_ray(points) * (shapes(points) @ SHARED_MM)[..., None]
    return replace(one, cloud=replace(one.cloud, points_mm=moved.astype(np.float32)))


def fitted(first: SeenView, second: SeenView) -> Fit:
    fit = refine(first.ready().fine, second.ready().fine, between(first, second), gate_mm=1.0)
    assert fit is not None
    return fit


def test_correcting_undoes_a_shared_error() -> None:
    points = np.array([[50.0, -30.0, 500.0], [0.0, 0.0, 600.0], [-90.0, 60.0, 540.0]])
    wrong = points + along_ray(points) * (shapes(points) @ SHARED_MM)[:, None]
    # The shapes are read at the wrong point, a ten-thousandth away.
    np.testing.assert_allclose(corrected(wrong, SHARED_MM), points, atol=2e-5)
    assert np.abs(wrong - points).max() > 0.02


def test_a_pair_states_by_how_much_a_shared_error_turns_it(seen: tuple[SeenView, SeenView]) -> None:
    straight, wrong = fitted(*seen), fitted(bent(seen[0]), bent(seen[1]))
    off = straight.pose.inverse.then(wrong.pose)
    middle = straight.middle_mm
    change = np.concatenate([straight.lever_mm * rotation_vector(off.rotation), off.of(middle) - middle])
    expected = straight.bow.response @ SHARED_MM
    assert np.linalg.norm(expected) > 0.01, "else it would be no test"
    assert np.linalg.norm(change - expected) < 0.15 * np.linalg.norm(expected)


def test_two_turned_views_tell_what_they_share(seen: tuple[SeenView, SeenView]) -> None:
    def told(pair: tuple[SeenView, SeenView]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        news = fitted(*pair).bow
        # Of the two even shapes that were added; the others are taken for zero.
        even = np.ix_((0, 2), (0, 2))
        return np.asarray(-np.linalg.solve(news.information[even], news.gradient[[0, 2]]))

    np.testing.assert_allclose(told((bent(seen[0]), bent(seen[1]))), SHARED_MM[[0, 2]], atol=0.012)
    np.testing.assert_allclose(told(seen), 0.0, atol=0.012)


def test_patches_lie_on_a_bent_surface_and_not_inside_of_it() -> None:
    one = view("ballbar", (0.0, 0.0, 520.0, 0.0, 0.0, 0.0), "none", 3)
    patches = patches_of(one.cloud, PROJECTION, 4)
    at = one.place.of(patches.centre_mm[patches.valid])
    ball = np.abs(at[:, 0]) - 75.0
    away = np.sqrt(ball**2 + at[:, 1] ** 2 + at[:, 2] ** 2)
    # The middle of a ball, where its curvature is the same in both directions of the patch.
    on = (away < 16.0) & (at[:, 2] < -10.0)
    assert np.count_nonzero(on) > 100
    # Their means lie 1.7 mm squared over 12 radii, some 12 µm, inside.
    assert abs(float(np.mean(away[on] - 15.0))) < 0.004


def test_an_estimate_scores_one_where_what_was_known_is_right_and_more_where_it_is_not() -> None:
    rng = np.random.default_rng(2)
    half = rng.normal(0.0, 0.01, (COUNT, COUNT))
    known = known_before(half @ half.T)
    # Overlaps tell four directions well and the others not at all.
    told = np.linalg.inv(np.linalg.inv(known) + np.diag([1e6] * 4 + [0.0] * (COUNT - 4)))
    root = np.linalg.cholesky(known)

    def estimate(true: np.ndarray[tuple[int, ...], np.dtype[np.float64]], noise_mm: float) -> float | None:
        measured = np.zeros(COUNT)
        measured[:4] = true[:4] + noise_mm * rng.normal(size=4)
        return bow_score(told @ (1e6 * measured), known, told)

    scores = []
    for _ in range(200):
        score = estimate(root @ rng.normal(size=COUNT), 1e-3)
        assert score is not None
        scores.append(score)
    assert 0.85 < float(np.sqrt(np.mean(np.square(scores)))) < 1.15
    bent = estimate(8.0 * root @ np.ones(COUNT), 0.0)
    assert bent is not None
    assert bent > 5.0
    assert bow_score(np.zeros(COUNT), known, 0.999 * known) is None, "nothing was told"


def test_what_was_known_is_the_calibrations_word_and_a_little_more_or_what_is_usual() -> None:
    assert known_before(None) is PRIOR_MM2
    stated = np.diag(np.full(COUNT, 1e-4))
    np.testing.assert_allclose(np.diag(known_before(stated)), 1e-4 + 0.006**2)
    usual = dict(zip(POWERS, np.sqrt(np.diag(PRIOR_MM2)), strict=True))
    for powers, sigma_mm in (
        ((2, 0, 0), 0.030), ((1, 2, 0), 0.020), ((2, 2, 0), 0.010), ((0, 5, 0), 0.007), ((1, 0, 1), 0.2 * 0.030), ((0, 3, 1), 0.2 * 0.020),
    ):  # fmt: skip
        assert usual[powers] == pytest.approx(sigma_mm)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_bow_is_spread_over_the_view_by_its_mean_square(axis: int) -> None:
    """30 µm at the border of u² or of v², over nine places across and seven down, which is three quarters as high."""
    one = np.zeros((COUNT, COUNT))
    at = POWERS.index((2, 0, 0) if axis == 0 else (0, 2, 0))
    one[at, at] = 0.030**2
    places = np.arange(-4, 5) / 4.0 if axis == 0 else np.arange(-3, 4) / 4.0
    assert spread_mm(one) == pytest.approx(0.030 * np.sqrt(np.mean(places**4)))


@pytest.mark.parametrize(("share", "told"), [(0.49, False), (0.51, True)])
def test_a_direction_counts_where_overlaps_take_away_half_of_its_variance(share: float, told: bool) -> None:
    found = np.sqrt(share * np.diag(PRIOR_MM2))
    score = bow_score(found, PRIOR_MM2, (1.0 - share) * PRIOR_MM2)
    assert score == (pytest.approx(1.0) if told else None)


def test_planes_move_apart_with_the_shared_error_as_points_do() -> None:
    rng = np.random.default_rng(6)
    rotation, at_b = (
        rotation_matrix(np.array([0.1, -0.2, 0.3])),
        rng.uniform(-80.0, 80.0, (9, 3)) + np.array([0.0, 0.0, 540.0]),
    )
    shift = np.array([0.0, 0.0, 560.0]) - rotation @ np.array([0.0, 0.0, 540.0])
    at_a = at_b @ rotation.T + shift
    normal = rng.normal(size=(9, 3))

    def apart(
        coefficients: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        b = at_b + along_ray(at_b) * (shapes(at_b) @ coefficients)[:, None]
        a = at_a + along_ray(at_a) * (shapes(at_a) @ coefficients)[:, None]
        return np.asarray(((b @ rotation.T + shift - a) * normal).sum(axis=1))

    np.testing.assert_allclose(derivatives(normal, at_a, at_b, rotation) @ SHARED_MM, apart(SHARED_MM), atol=1e-12)
