"""Two views of an object: placed as closely as is stated, or refused in words."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from appliance.measure.overlap.fine import Fit, refine
from appliance.measure.overlap.pair import HELD, PairRefusal, RegisteredPair, _as_good, freedom, refusal_of, register
from appliance.measure.overlap.rigid import Rigid
from tests.appliance.desk.registration.test_graph import edge
from tests.support.views import SeenView, between, displacement_mm, view

SHELL = (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), (40.0, -25.0, 550.0, -4.0, 6.0, 25.0)
SMOOTH_MAIN = (300.0, 0.0, 580.0, 0.0, 6.0, 10.0), (240.0, 0.0, 575.0, 10.0, 0.0, 5.0)
HALF_ABOUT = (0.0, 0.0, 530.0, 3.0, -5.0, 10.0), (4.0, 2.0, 535.0, -3.0, 2.0, 190.0)
PLANE = (0.0, 0.0, 522.0, 8.0, 12.0, 0.0), (30.0, 20.0, 530.0, 0.0, 2.0, 10.0)


@cache
def seen(name: str, paint: str, poses: tuple[tuple[float, ...], tuple[float, ...]]) -> tuple[SeenView, SeenView]:
    return view(name, poses[0], paint, 1), view(name, poses[1], paint, 2)


@cache
def registered(name: str, paint: str, poses: tuple[tuple[float, ...], tuple[float, ...]]) -> RegisteredPair:
    first, second = seen(name, paint, poses)
    return register(first.ready(), second.ready())


def test_what_paint_holds_is_placed_within_what_is_stated() -> None:
    pair = registered("plane", "slight", PLANE)
    assert pair.accepted, pair.text
    assert pair.fit is not None
    first, second = seen("plane", "slight", PLANE)
    error_mm = displacement_mm(pair.fit.pose, between(first, second), second)
    assert error_mm < 3.0 * pair.fit.sigma_mm + 0.010
    assert error_mm < 0.060
    assert pair.fit.sigma_mm < 0.1
    # By the nearest neighbours of all points, at the true poses.
    points = between(first, second).of(second.cloud.points_mm[second.cloud.mask][::40].astype(np.float64))
    near, _ = cKDTree(first.cloud.points_mm[first.cloud.mask][::3]).query(points, distance_upper_bound=2.0)
    assert pair.fit.overlap == pytest.approx(np.isfinite(near).mean(), abs=0.07), "but for steep flanks"


def test_what_slides_is_refused_though_its_planes_fit_as_well_as_any() -> None:
    first, second = (one.ready() for one in seen("main", "none", SMOOTH_MAIN))
    pair = register(first, second)
    assert pair.refusal is PairRefusal.SLIDES
    assert pair.fit is None, "nothing is searched that the scan's own shape says cannot be found"
    assert "by shape alone the first can turn about its own axis left-right" in pair.text
    fit = refine(first.fine, second.fine, between(*seen("main", "none", SMOOTH_MAIN)), max_distance_mm=1.0)
    assert fit is not None
    assert fit.rms_mm < 0.030, "the residual tells nothing"
    assert fit.significance.min() < HELD
    loose = first.resistance.directions[:3, int(np.argmin(first.resistance.significance))]
    axis = np.array([np.cos(np.radians(10.0)), np.sin(np.radians(10.0)), 0.0])
    assert abs(loose @ axis) > 0.95 * np.linalg.norm(loose) > 0.4


def motions(*of: tuple[float, ...]) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.float64]], ...]:
    """All directions of motion, of which those of ``of`` (ω mm, τ mm) are loose, mixed and in the middle, with how each is held."""
    loose = np.linalg.qr(np.array(of).T)[0] @ np.linalg.qr(np.random.default_rng(1).normal(size=(len(of), len(of))))[0]
    rest = np.linalg.svd(loose)[0][:, len(of) :]
    held = np.concatenate([[80.0], np.full(len(of), 1.0), np.full(5 - len(of), 50.0)])
    return np.concatenate([rest[:, :1], loose, rest[:, 1:]], axis=1), held


@pytest.mark.parametrize(
    ("loose", "said"),
    [
        ([(0, 0, 0, 1, -0.4, 0)], "slide left-right"),
        ([(0, 0, 0, 1, -0.43, 0)], "slide from lower left to upper right"),
        ([(0, 0, 0, 1, 2.35, 0)], "slide from upper left to lower right"),
        ([(0, 0, 0, 1, 2.5, 0)], "slide up-down"),
        ([(0, 0, 0, 1, 0, 0.9)], "slide left-right"),
        ([(0, 0, 0, 1, 0, 1.1)], "slide to and from the instrument"),
        # Turns by 0.39 and 0.41 of a motion of length 1.
        ([(0.39, 0, 0, 0, 0.921, 0)], "slide up-down"),
        ([(0.41, 0, 0, 0, 0.912, 0)], "turn about its own axis left-right"),
        ([(1, 0, 0, 0, 0.14, 0)], "turn about an axis left-right"),
        ([(1, 0, 0, 0, 0.16, 0)], "turn about its own axis left-right"),
        # A pipe of 50 mm radius, its middle in front, with a lever of 80 mm.
        ([(0, 0, 0, 1, 0, 0), (1, 0, 0, 0, 0.625, 0)], "slide left-right and turn about its own axis left-right"),
        ([(1, 0, 0, 0, 0, 0)], "turn about an axis left-right"),
        (
            [(0, 0, 0, 1, 0, 0), (0, 0, 0, 0, 1, 0), (0, 0, 1, 0, 0, 0)],
            "slide any way along the surface and turn about the line of sight",
        ),
        ([(1, 0, 0, 0, 0.5, 0), (0, 1, 0, -0.5, 0, 0), (0, 0, 1, 0, 0, 0)], "turn any way"),
    ],
)
def test_how_a_scan_can_move_is_said_of_what_nothing_holds(loose: list[tuple[float, ...]], said: str) -> None:
    assert freedom(*motions(*loose)) == said


GOOD = edge(0, 1).fit
"""Nothing speaks against it, and shape holds it."""


@pytest.mark.parametrize(
    ("fit", "refusal"),
    [
        (replace(GOOD, overlap=0.081), None),
        (replace(GOOD, overlap=0.079), PairRefusal.TOO_LITTLE),
        (replace(GOOD, outliers=0.049), None),
        (replace(GOOD, outliers=0.051), PairRefusal.CONTRADICTS),
        (replace(GOOD, significance=np.array([5.1, 9, 9, 9, 9, 9])), None),
        (replace(GOOD, significance=np.array([4.9, 9, 9, 9, 9, 9]), front=0.1), PairRefusal.SLIDES),
        (replace(GOOD, front=0.019), None),
        (replace(GOOD, front=0.021), PairRefusal.CONTRADICTS),
        (replace(GOOD, texture_correlation=None, texture_share=0.49), None),
        (replace(GOOD, texture_correlation=None, texture_share=0.51), PairRefusal.SLIDES),
        (replace(GOOD, texture_correlation=0.31), None),
        (replace(GOOD, texture_correlation=0.29), PairRefusal.CONTRADICTS),
        (replace(GOOD, texture_correlation=0.61, texture_share=0.51), None),
        (replace(GOOD, texture_correlation=0.59, texture_share=0.51), PairRefusal.CONTRADICTS),
        (replace(GOOD, covariance=np.eye(6) * 0.39**2 / 6.0), None),
        (replace(GOOD, covariance=np.eye(6) * 0.41**2 / 6.0), PairRefusal.UNCERTAIN),
    ],
)
def test_each_limit_of_a_pose_is_where_it_is_said_to_be(fit: Fit, refusal: PairRefusal | None) -> None:
    assert refusal_of(fit) is refusal


def aside(fit: Fit, by_mm: float) -> Fit:
    return replace(fit, pose=Rigid(fit.pose.rotation, fit.pose.translation_mm + np.array([by_mm, 0.0, 0.0])))


SLIDING = aside(replace(GOOD, significance=np.zeros(6)), 9.0)


@pytest.mark.parametrize(
    ("other", "best", "repeats", "as_good"),
    [
        (aside(GOOD, 9.0), GOOD, False, True),
        # The same pose: 1 mm and five standard deviations of 0.02 mm.
        (aside(GOOD, 1.05), GOOD, False, False),
        (aside(GOOD, 1.15), GOOD, False, True),
        (replace(aside(GOOD, 9.0), overlap=0.31), GOOD, False, True),
        (replace(aside(GOOD, 9.0), overlap=0.29), GOOD, False, False),
        (replace(aside(GOOD, 9.0), texture_correlation=0.85), GOOD, False, True),
        (replace(aside(GOOD, 9.0), texture_correlation=0.83), GOOD, False, False),
        (replace(aside(GOOD, 9.0), outliers=0.015, front=0.015, missing=0.009), GOOD, False, True),
        (replace(aside(GOOD, 9.0), outliers=0.015, front=0.015, missing=0.011), GOOD, False, False),
        (replace(aside(GOOD, 9.0), outliers=0.03, front=0.015, missing=0.05), replace(GOOD, missing=0.06), False, True),
        (replace(aside(GOOD, 9.0), overlap=0.01), GOOD, False, False),
        (SLIDING, GOOD, False, False),
        (SLIDING, GOOD, True, True),
        (replace(SLIDING, texture_correlation=0.1), GOOD, True, True),
        (SLIDING, replace(GOOD, texture_correlation=None), False, True),
    ],
)
def test_another_pose_is_as_good_as_the_best_by_limits(other: Fit, best: Fit, repeats: bool, as_good: bool) -> None:
    assert _as_good(other, best, repeats=repeats) is as_good


def test_a_ball_bar_with_printed_squares_is_not_taken_for_itself_turned_half_about() -> None:
    pair = registered("ballbar", "checker", HALF_ABOUT)
    assert pair.refusal is PairRefusal.AMBIGUOUS
    assert pair.fit is not None
    assert (pair.fit.texture_correlation or 0.0) > 0.9, "the paint tells nothing"


def test_different_things_have_nothing_in_common() -> None:
    first, second = view("shell", SHELL[0], "slight", 1), view("stones", SHELL[1], "strong", 2)
    refusal = register(first.ready(), second.ready()).refusal
    assert refusal in (PairRefusal.NOTHING_IN_COMMON, PairRefusal.CONTRADICTS, PairRefusal.TOO_LITTLE)
