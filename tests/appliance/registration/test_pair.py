"""Two views of an object: placed as closely as is stated, or refused in words."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from appliance.optics.volume import STANDARD
from appliance.registration.coarse import _starts
from appliance.registration.fine import Fit, refine
from appliance.registration.pair import (
    HELD,
    MAX_OUTLIERS,
    PairRefusal,
    RegisteredPair,
    _as_good,
    _contradiction,
    freedom,
    ready,
    refusal_of,
    register,
)
from appliance.registration.rigid import Rigid
from appliance.registration.solve import middle_of, solve
from tests.appliance.registration.test_graph import edge
from tests.support import synthetic
from tests.support.views import LIGHT_MM, SeenView, between, displacement_mm, view

SHELL = (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), (40.0, -25.0, 550.0, -4.0, 6.0, 25.0)
PIPE = (40.0, 0.0, 560.0, 0.0, 6.0, 20.0), (-30.0, 10.0, 570.0, 12.0, 0.0, 28.0)
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


@pytest.mark.parametrize(
    ("name", "paint", "poses"),
    [
        ("shell", "slight", SHELL),
        ("shell", "none", SHELL),
        ("pipe", "strong", PIPE),
        ("main", "slight", SMOOTH_MAIN),
        ("plane", "slight", PLANE),
    ],
)
def test_what_shape_or_paint_holds_is_placed_within_what_is_stated(
    name: str, paint: str, poses: tuple[tuple[float, ...], tuple[float, ...]]
) -> None:
    pair = registered(name, paint, poses)
    assert pair.accepted, pair.text
    assert pair.fit is not None
    first, second = seen(name, paint, poses)
    error_mm = displacement_mm(pair.fit.pose, between(first, second), second)
    assert error_mm < 3.0 * pair.fit.sigma_mm + 0.010
    assert error_mm < 0.060
    assert pair.fit.sigma_mm < 0.1
    # By the nearest neighbours of all points, at the true poses.
    points = between(first, second).of(second.cloud.points_mm[second.cloud.mask][::40].astype(np.float64))
    near, _ = cKDTree(first.cloud.points_mm[first.cloud.mask][::3]).query(points, distance_upper_bound=2.0)
    assert pair.fit.overlap == pytest.approx(np.isfinite(near).mean(), abs=0.07), "but for steep flanks"


@pytest.mark.parametrize(
    ("name", "poses", "way"),
    [
        ("main", SMOOTH_MAIN, "turn about its own axis left-right"),
        ("plane", PLANE, "slide any way along the surface and turn about the line of sight"),
    ],
)
def test_what_slides_is_refused_though_its_planes_fit_as_well_as_any(
    name: str, poses: tuple[tuple[float, ...], tuple[float, ...]], way: str
) -> None:
    first, second = (one.ready() for one in seen(name, "none", poses))
    pair = register(first, second)
    assert pair.refusal is PairRefusal.SLIDES
    assert pair.fit is None, "nothing is searched that the scan's own shape says cannot be found"
    assert f"by shape alone the first can {way}" in pair.text
    fit = refine(first.fine, second.fine, between(*seen(name, "none", poses)), gate_mm=1.0)
    assert fit is not None
    assert fit.rms_mm < 0.030, "the residual tells nothing"
    assert fit.held.min() < HELD


@pytest.mark.parametrize(
    ("name", "poses", "holds"), [("main", SMOOTH_MAIN, False), ("plane", PLANE, False), ("shell", SHELL, True)]
)
def test_a_scan_tells_by_itself_whether_its_shape_holds_it(
    name: str, poses: tuple[tuple[float, ...], tuple[float, ...]], holds: bool
) -> None:
    assert seen(name, "none", poses)[0].ready().holds is holds


def test_a_pipe_is_said_to_turn_about_its_axis() -> None:
    own = seen("main", "none", SMOOTH_MAIN)[0].ready().own
    loose = own.directions[:3, int(np.argmin(own.held))]
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
        ([(0, 0, 0, 1, 0.1, 0)], "slide left-right"),
        ([(0, 0, 0, 0.2, 1, 0)], "slide up-down"),
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
        ([(0, 0, 0, 1, -1, 0)], "slide from lower left to upper right"),
        ([(0, 0, 0, 0, 0, 1)], "slide to and from the instrument"),
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
        (replace(GOOD, held=np.array([5.1, 9, 9, 9, 9, 9])), None),
        (replace(GOOD, held=np.array([4.9, 9, 9, 9, 9, 9]), front=0.1), PairRefusal.SLIDES),
        (replace(GOOD, front=0.019), None),
        (replace(GOOD, front=0.021), PairRefusal.CONTRADICTS),
        (replace(GOOD, alike=None, paint_share=0.49), None),
        (replace(GOOD, alike=None, paint_share=0.51), PairRefusal.SLIDES),
        (replace(GOOD, alike=0.31), None),
        (replace(GOOD, alike=0.29), PairRefusal.CONTRADICTS),
        (replace(GOOD, alike=0.61, paint_share=0.51), None),
        (replace(GOOD, alike=0.59, paint_share=0.51), PairRefusal.CONTRADICTS),
        (replace(GOOD, covariance=np.eye(6) * 0.39**2 / 6.0), None),
        (replace(GOOD, covariance=np.eye(6) * 0.41**2 / 6.0), PairRefusal.UNCERTAIN),
    ],
)
def test_each_limit_of_a_pose_is_where_it_is_said_to_be(fit: Fit, refusal: PairRefusal | None) -> None:
    assert refusal_of(fit) is refusal


def aside(fit: Fit, by_mm: float) -> Fit:
    return replace(fit, pose=Rigid(fit.pose.rotation, fit.pose.translation_mm + np.array([by_mm, 0.0, 0.0])))


SLIDING = aside(replace(GOOD, held=np.zeros(6)), 9.0)


@pytest.mark.parametrize(
    ("other", "best", "repeats", "as_good"),
    [
        (aside(GOOD, 9.0), GOOD, False, True),
        # The same pose: 1 mm and five standard deviations of 0.02 mm.
        (aside(GOOD, 1.05), GOOD, False, False),
        (aside(GOOD, 1.15), GOOD, False, True),
        (replace(aside(GOOD, 9.0), overlap=0.31), GOOD, False, True),
        (replace(aside(GOOD, 9.0), overlap=0.29), GOOD, False, False),
        (replace(aside(GOOD, 9.0), alike=0.85), GOOD, False, True),
        (replace(aside(GOOD, 9.0), alike=0.83), GOOD, False, False),
        (replace(aside(GOOD, 9.0), outliers=0.015, front=0.015, unmet=0.009), GOOD, False, True),
        (replace(aside(GOOD, 9.0), outliers=0.015, front=0.015, unmet=0.011), GOOD, False, False),
        (replace(aside(GOOD, 9.0), outliers=0.03, front=0.015, unmet=0.05), replace(GOOD, unmet=0.06), False, True),
        (replace(aside(GOOD, 9.0), overlap=0.01), GOOD, False, False),
        (SLIDING, GOOD, False, False),
        (SLIDING, GOOD, True, True),
        (replace(SLIDING, alike=0.1), GOOD, True, True),
        (SLIDING, replace(GOOD, alike=None), False, True),
    ],
)
def test_another_pose_is_as_good_as_the_best_by_limits(other: Fit, best: Fit, repeats: bool, as_good: bool) -> None:
    assert _as_good(other, best, repeats=repeats) is as_good


def test_what_speaks_against_a_pose_is_what_misses_hovers_finds_nothing_or_differs() -> None:
    bad = replace(GOOD, outliers=0.01, front=0.02, unmet=0.03, alike=0.8, overlap=0.5)
    assert _contradiction(bad) == pytest.approx(0.01 + 2.0 * 0.02 + 0.03 + 0.3 * 0.2 - 0.1 * 0.5)
    assert _contradiction(replace(bad, alike=None, overlap=1.3)) == pytest.approx(0.01 + 0.04 + 0.03 - 0.1)


@pytest.mark.parametrize(("radius_px", "refusal"), [(19, None), (47, PairRefusal.CONTRADICTS)])
def test_a_surface_that_hovers_before_the_other_scan_is_not_joined(radius_px: int, refusal: PairRefusal | None) -> None:
    """A disc of the second scan lies 5 mm nearer to its camera than the first saw it: something was there that moved."""
    first, second = seen("shell", "none", SHELL)
    true = between(first, second)
    row, column = np.mgrid[0 : second.cloud.shape[0], 0 : second.cloud.shape[1]]
    disc = np.hypot(row - second.cloud.shape[0] / 2, column - second.cloud.shape[1] / 2) < radius_px
    points = second.cloud.points_mm.copy()
    points[disc] *= (1.0 - 5.0 / np.linalg.norm(points[disc], axis=-1))[:, None]
    hovering = SeenView(replace(second.cloud, points_mm=points), second.place).ready()
    fit = refine(first.ready().fine, hovering.fine, true, gate_mm=1.0)
    assert fit is not None
    assert refusal_of(fit) is refusal
    assert fit.outliers < MAX_OUTLIERS
    share = np.count_nonzero(disc & second.cloud.mask) / np.count_nonzero(second.cloud.mask)
    assert 0.6 * share < fit.front < 2.0 * share


@pytest.mark.dive
def test_printed_squares_are_not_believed_one_square_farther() -> None:
    assert not registered("plane", "checker", PLANE).accepted


@pytest.mark.parametrize("paint", ["checker", "labels"])
def test_a_ball_bar_with_printed_squares_is_not_taken_for_itself_turned_half_about(paint: str) -> None:
    pair = registered("ballbar", paint, HALF_ABOUT)
    assert pair.refusal is PairRefusal.AMBIGUOUS
    assert pair.fit is not None
    assert pair.fit.alike is not None
    assert pair.fit.alike > 0.9, "the paint tells nothing"


@pytest.mark.dive
def test_a_frustum_that_looks_the_same_turned_half_about_is_not_guessed() -> None:
    assert registered("frustum", "none", SHELL).refusal is PairRefusal.AMBIGUOUS


def test_different_things_have_nothing_in_common() -> None:
    first, second = seen("shell", "slight", SHELL)[0], view("stones", SHELL[1], "strong", 2)
    pair = register(first.ready(), second.ready())
    assert not pair.accepted
    assert pair.refusal in (PairRefusal.NOTHING_IN_COMMON, PairRefusal.CONTRADICTS, PairRefusal.TOO_LITTLE)


@pytest.mark.dive
def test_the_stated_covariance_is_that_of_the_errors() -> None:
    """Five draws of noise: the poses scatter about the truth by no more than stated."""
    squared = []
    for seed in range(5):
        first, second = (
            view("main", SMOOTH_MAIN[0], "strong", 10 + seed),
            view("main", SMOOTH_MAIN[1], "strong", 30 + seed),
        )
        true = between(first, second)
        start = Rigid(true.rotation, true.translation_mm + np.array([0.05, -0.05, 0.03]))
        fit = refine(first.ready().fine, second.ready().fine, start, gate_mm=1.0)
        assert fit is not None
        off = fit.pose.of(true.inverse.of(fit.middle_mm)) - fit.middle_mm
        squared.append(off @ np.linalg.inv(fit.covariance[3:, 3:] + 1e-6 * np.eye(3)) @ off / 3.0)
    assert 0.02 < float(np.mean(squared)) < 4.0


def test_however_a_scan_is_rolled_a_start_is_within_fifteen_degrees() -> None:
    turns, _ = _starts(np.zeros(3), np.zeros(3), None, STANDARD)
    starts_deg = np.degrees(np.arctan2(turns[:, 1, 0], turns[:, 0, 0]))
    off_deg = (np.arange(-180.0, 180.0)[:, None] - starts_deg + 180.0) % 360.0 - 180.0
    assert np.abs(off_deg).min(axis=1).max() == pytest.approx(15.0)


def test_a_start_some_way_off_leads_to_the_same_pose() -> None:
    first, second = seen("shell", "slight", SHELL)
    a, b, true = first.ready().fine, second.ready().fine, between(first, second)
    for offset in ((0.6, 0.0, 0.0), (0.0, -0.6, 0.4)):
        fit = refine(a, b, Rigid(true.rotation, true.translation_mm + np.array(offset)))
        assert fit is not None
        assert displacement_mm(fit.pose, true, second) < 0.005


def test_three_scans_become_one_object_with_the_shared_depth_error_as_it_is_wanted() -> None:
    calibration = synthetic.calibration(200, 150)
    views = [
        view("shell", pose, "strong", k, calibration)
        for k, pose in enumerate((*SHELL, (-30.0, 15.0, 545.0, 5.0, -2.0, -5.0)))
    ]
    scans = [ready(one.cloud, calibration.rig.left, synthetic.WATER.index, LIGHT_MM) for one in views]
    told: list[tuple[str, float]] = []
    plain = solve(scans, lambda doing, share: told.append((doing, share)))
    assert told == [(f"comparing pair {k + 1} of 3", k / 6.0) for k in range(3)] + [("closing loops", 1.0)]
    assert [(one.first, one.second) for one in plain.compared] == [(0, 1), (0, 2), (1, 2)]
    assert all((one.matches or 0) > 100 for one in plain.compared), "paint shows in both"
    assert plain.left_out == {}
    for k, one in enumerate(views):
        assert displacement_mm(plain.placed.poses[k], between(views[0], one), one) < 0.02
        np.testing.assert_allclose(middle_of(scans[k]), np.nanmedian(one.cloud.points_mm, axis=(0, 1)), atol=3.0)
    assert plain.placed.bending_mm == plain.placed.bending_unaided_mm
    assert plain.aided.bending_mm[1] < plain.aided.bending_unaided_mm[1]
    believed = solve(scans[:2], lambda *_: None, with_bow=True)
    assert believed.placed is believed.aided
    assert np.any(believed.placed.bow_mm)
    assert not np.any(plain.placed.bow_mm)
