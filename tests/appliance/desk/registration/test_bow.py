"""A depth error that both scans share: how it turns their pose, and what the pair tells of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.desk.registration.bow import PRIOR_MM2, bow_score, prior_covariance
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS, POWERS, along_ray, shapes
from appliance.measure.light.rotation import rotation_vector
from appliance.measure.overlap.fine import Fit, refine
from tests.support.views import SeenView, between, view

POSES = (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), (30.0, -20.0, 520.0, -4.0, 6.0, 75.0)
SHARED_MM = np.zeros(DEPTH_ERROR_TERMS)
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
    fit = refine(first.ready().fine, second.ready().fine, between(first, second), max_distance_mm=1.0)
    assert fit is not None
    return fit


def test_a_pair_states_by_how_much_a_shared_error_turns_it(seen: tuple[SeenView, SeenView]) -> None:
    straight, wrong = fitted(*seen), fitted(bent(seen[0]), bent(seen[1]))
    off = straight.pose.inverse.then(wrong.pose)
    middle = straight.middle_mm
    change = np.concatenate([straight.lever_mm * rotation_vector(off.rotation), off.of(middle) - middle])
    expected = straight.depth_error.response @ SHARED_MM
    assert np.linalg.norm(expected) > 0.01, "else it would be no test"
    assert np.linalg.norm(change - expected) < 0.15 * np.linalg.norm(expected)


def test_what_was_known_is_the_calibrations_word_and_a_little_more_or_what_is_usual() -> None:
    assert prior_covariance(None) is PRIOR_MM2
    np.testing.assert_allclose(np.diag(prior_covariance(np.diag(np.full(DEPTH_ERROR_TERMS, 1e-4)))), 1e-4 + 0.006**2)
    usual = dict(zip(POWERS, np.sqrt(np.diag(PRIOR_MM2)), strict=True))
    powers = (2, 0, 0), (1, 2, 0), (2, 2, 0), (0, 5, 0), (1, 0, 1), (0, 3, 1)
    assert [usual[one] for one in powers] == pytest.approx([0.030, 0.020, 0.010, 0.007, 0.2 * 0.030, 0.2 * 0.020])


@pytest.mark.parametrize(("share", "told"), [(0.49, False), (0.51, True)])
def test_a_direction_counts_where_overlaps_take_away_half_of_its_variance(share: float, told: bool) -> None:
    found = np.sqrt(share * np.diag(PRIOR_MM2))
    score = bow_score(found, PRIOR_MM2, (1.0 - share) * PRIOR_MM2)
    assert score == (pytest.approx(1.0) if told else None)
