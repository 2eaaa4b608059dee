"""Two views of an object: placed as closely as is stated, or refused in words."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.registration.fine import refine
from appliance.registration.pair import PairRefusal, RegisteredPair, register
from appliance.registration.rigid import Rigid
from tests.support.views import SeenView, between, displacement_mm, view

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


@pytest.mark.parametrize(("name", "poses"), [("main", SMOOTH_MAIN), ("plane", PLANE)])
def test_what_slides_is_refused_though_its_planes_fit_as_well_as_any(
    name: str, poses: tuple[tuple[float, ...], tuple[float, ...]]
) -> None:
    pair = registered(name, "none", poses)
    assert pair.refusal is PairRefusal.SLIDES
    assert "without resistance" in pair.text
    assert pair.fit is not None
    assert pair.fit.rms_mm < 0.030, "the residual tells nothing"


def test_a_pipe_is_said_to_slide_along_its_axis_or_to_turn_about_it() -> None:
    pair = registered("main", "none", SMOOTH_MAIN)
    assert pair.fit is not None
    soft = pair.fit.directions[:, :2]
    axis = np.array([np.cos(np.radians(10.0)), np.sin(np.radians(10.0)), 0.0])
    # The two softest directions span a shift along the axis and a turn about it.
    along = np.concatenate([np.zeros(3), axis])
    assert np.linalg.norm(soft.T @ along) > 0.9


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


def test_a_start_some_way_off_leads_to_the_same_pose() -> None:
    first, second = seen("shell", "slight", SHELL)
    a, b, true = first.ready().fine, second.ready().fine, between(first, second)
    for offset in ((0.6, 0.0, 0.0), (0.0, -0.6, 0.4)):
        fit = refine(a, b, Rigid(true.rotation, true.translation_mm + np.array(offset)))
        assert fit is not None
        assert displacement_mm(fit.pose, true, second) < 0.005
