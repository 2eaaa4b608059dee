"""Marks of two scans: which are the same, where the points below them lie, and which pairs of scans and poses they vote for."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.optics.rotation import rotation_matrix
from appliance.optics.volume import STANDARD
from appliance.reconstruct.organised import OrganisedCloud
from appliance.registration.candidates import by_features, by_time
from appliance.registration.coarse import (
    _spread_over_normals,
    _starts,
    guess_by_features,
    in_common,
    matches,
    same,
    turn_error_mm,
)
from appliance.registration.features import Features, features_of, marks_of, points_below
from appliance.registration.rigid import Rigid
from tests.support.views import Array

HERE = Rigid(np.eye(3), np.zeros(3))
ASIDE = Rigid(rotation_matrix(np.array([0.1, -0.2, 0.4])), np.array([30.0, -20.0, 10.0]))


def unit(*of: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """A descriptor that begins with these numbers."""
    made = np.zeros(128, np.float32)
    made[: len(of)] = of
    return made


def looks(count: int, seed: int = 0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Descriptors (count, 128) that do not resemble each other."""
    made = np.random.default_rng(seed).normal(size=(count, 128)).astype(np.float32)
    return np.asarray(made / np.linalg.norm(made, axis=1, keepdims=True))


def of_look(descriptors: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> Features:
    n = len(descriptors)
    return Features(np.zeros((n, 3)), descriptors, np.ones(n))


def beside(of: np.ndarray[tuple[int, ...], np.dtype[np.float32]], cosine: float) -> Features:
    """Marks of this cosine with those of ``of``, which lie in the first 64 dimensions."""
    return of_look((cosine * of + np.sqrt(1.0 - cosine**2) * np.roll(of, 64, axis=1)).astype(np.float32))


FEW = np.eye(8, 128, dtype=np.float32)


# ------------------------------------------------------------------------------------- pairs worth comparing


def test_each_scan_is_compared_with_the_next() -> None:
    assert by_time(4) == [(0, 1), (1, 2), (2, 3)]


@pytest.mark.parametrize(("cosine", "count", "voted"), [(0.89, 8, True), (0.87, 8, False), (0.89, 7, False)])
def test_a_pair_is_compared_where_eight_marks_look_alike(cosine: float, count: int, voted: bool) -> None:
    pairs = by_features([of_look(FEW[:count]), beside(FEW[:count], cosine), of_look(looks(0))])
    assert pairs == ([(0, 1)] if voted else [])


@pytest.mark.parametrize(("cosine", "voted"), [(0.975, True), (0.965, False)])
def test_a_scan_that_shows_a_mark_nearly_as_well_as_the_best_gets_its_vote(cosine: float, voted: bool) -> None:
    near = beside(FEW, cosine)
    pairs = by_features([of_look(FEW), of_look(FEW), near, near])
    assert pairs == ([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] if voted else [(0, 1), (2, 3)])


def test_a_scan_is_compared_with_four_others_for_its_marks() -> None:
    pairs = by_features([of_look(FEW)] * 6)
    assert sorted({(i, j) for i in range(6) for j in range(i + 1, 6)} - set(pairs)) == [(4, 5)]


@pytest.mark.parametrize(("first", "voted"), [(392, True), (393, False)])
def test_the_four_hundred_strongest_marks_vote(first: int, voted: bool) -> None:
    one, other = looks(450, 1), looks(450, 2)
    other[first:] = one[first:]
    assert by_features([of_look(one), of_look(other)]) == ([(0, 1)] if voted else [])


# -------------------------------------------------------------------------------------------------- matches


@pytest.mark.parametrize(("distance", "matched"), [(0.84, True), (0.86, False)])
def test_a_match_is_clearly_nearer_than_the_second_best(distance: float, matched: bool) -> None:
    # Of unit vectors the squared distance is 2 − 2 cosine: the second best lies 1 away.
    cosine = 1.0 - 0.5 * distance**2
    b = np.stack([unit(0.5, np.sqrt(0.75)), unit(cosine, 0.0, np.sqrt(1.0 - cosine**2)), unit(*[0.0] * 9, 1.0)])
    a = np.stack([unit(1.0), unit(*[0.0] * 20, 1.0), unit(*[0.0] * 21, 1.0)])
    assert ([0, 1] in matches(a, b).tolist()) is matched


def test_two_marks_cannot_both_match_a_third() -> None:
    b = np.stack([unit(1.0), unit(0.0, 1.0), unit(0.0, 0.0, 1.0)])
    a = np.stack([unit(0.99, 0.0, 0.0, np.sqrt(1.0 - 0.99**2)), unit(1.0), unit(0.0, 1.0)])
    assert matches(a, b).tolist() == [[1, 0], [2, 1]]
    assert matches(a[:2], b).shape == matches(a, b[:2]).shape == (0, 2)
    assert len(matches(a[:3], b)) == 2


# ---------------------------------------------------------------------------------------------------- poses


def seen_by_both(count: int, off_mm: float = 0.0, pose: Rigid = ASIDE, seed: int = 3) -> tuple[Features, Features]:
    """As many marks, each as seen by A and by B at ``pose``; every other one off by ``off_mm`` along z, to either side."""
    at = np.random.default_rng(seed).uniform(-80.0, 80.0, (count, 3)) + np.array([0.0, 0.0, 540.0])
    b = pose.inverse.of(at)
    at[::2, 2] += off_mm
    return Features(at, looks(count, seed), np.ones(count)), Features(b, looks(count, seed), np.ones(count))


@pytest.mark.parametrize(
    ("count", "off_mm", "found"), [(10, 0.0, True), (9, 0.0, False), (14, 1.2, True), (14, 3.0, False)]
)
def test_ten_marks_that_agree_within_a_millimetre_give_a_pose(count: int, off_mm: float, found: bool) -> None:
    guesses = guess_by_features(*seen_by_both(count, off_mm))
    assert bool(guesses) is found
    if found:
        assert same(guesses[0].pose, ASIDE, 0.1 + 2.0 * off_mm)
        assert guesses[0].by_features
        assert guesses[0].support == count or off_mm


def test_marks_at_one_place_are_one_witness_and_small_triangles_tell_no_turn() -> None:
    a, b = seen_by_both(10)
    for features in (a, b):
        features.points_mm[1] = features.points_mm[0]
    assert guess_by_features(a, b) == []
    for scale, found in ((0.02, False), (1.0, True)):
        points = scale * np.random.default_rng(3).uniform(-80.0, 80.0, (30, 3)) + np.array([0.0, 0.0, 540.0])
        of_b = ASIDE.inverse.of(points)
        assert (
            bool(guess_by_features(Features(points, looks(30), np.ones(30)), Features(of_b, looks(30), np.ones(30))))
            is found
        )


def test_distinct_poses_come_with_the_best_first_and_no_more_than_are_wanted() -> None:
    poses = [Rigid(np.eye(3), np.array([shift, 0.0, 0.0])) for shift in (0.0, 30.0, 60.0, 90.0)]
    parts = [seen_by_both(12 + 4 * k, pose=pose, seed=10 + k) for k, pose in enumerate(poses)]
    a, b = (
        Features(np.concatenate([part[s].points_mm for part in parts]), np.concatenate([part[s].descriptors for part in parts]), np.ones(72))
        for s in (0, 1)
    )  # fmt: skip
    found = guess_by_features(a, b)
    assert [one.support for one in found] == [24.0, 20.0, 16.0]
    assert [round(float(one.pose.translation_mm[0])) for one in found] == [90, 60, 30]
    assert len(guess_by_features(a, b, most=4)) == 4


@pytest.mark.parametrize(("off_mm", "count"), [(0.75, 12), (0.85, 0)])
def test_marks_are_in_common_where_the_pose_lays_them_within_eight_tenths(off_mm: float, count: int) -> None:
    a, b = seen_by_both(12)
    aside = Rigid(ASIDE.rotation, ASIDE.translation_mm + np.array([off_mm, 0.0, 0.0]))
    common = in_common(a, b, aside)
    assert len(common) == count
    assert np.isin(common, a.points_mm).all()


def test_the_turn_about_a_line_is_as_uncertain_as_marks_lie_near_to_it() -> None:
    cross = np.array([[50.0, 0, 0], [-50.0, 0, 0], [0, 10.0, 0], [0, -10.0, 0]]) + 500.0
    # Half of 0.8 mm, over the root of the squares beside the line (√2 · 10 mm), 100 mm away.
    assert turn_error_mm(cross, 100.0) == pytest.approx(0.4 * 100.0 / (np.sqrt(2.0) * 10.0))
    assert turn_error_mm(cross[:2], 100.0) > 1e6


@pytest.mark.parametrize(
    ("pose", "alike"),
    [
        (Rigid(np.eye(3), np.array([3.9, 0.0, 0.0])), True),
        (Rigid(np.eye(3), np.array([0.0, 0.0, -4.1])), False),
        # Eighty millimetres aside and as much down: 113 mm from the axis.
        (Rigid(rotation_matrix(np.array([0.0, 0.0, 0.0348])), np.zeros(3)), True),
        (Rigid(rotation_matrix(np.array([0.0, 0.0, 0.0359])), np.zeros(3)), False),
        # 546 mm before the camera.
        (Rigid(rotation_matrix(np.array([0.0072, 0.0, 0.0])), np.zeros(3)), True),
        (Rigid(rotation_matrix(np.array([0.0, 0.0075, 0.0])), np.zeros(3)), False),
    ],
)  # fmt: skip
def test_poses_are_the_same_where_they_put_the_volumes_middle_within_four_millimetres(pose: Rigid, alike: bool) -> None:
    assert same(pose, HERE) is alike


def test_a_search_starts_all_over_the_view_and_near_a_place_close_by_it() -> None:
    a, b = np.array([5.0, -3.0, 530.0]), np.array([-8.0, 2.0, 545.0])
    for near, to, shifts, rolls in (
        (None, a, (-110.0, -55.0, 0.0, 55.0, 110.0), 12),
        (ASIDE, ASIDE.of(b), (-30.0, 0.0, 30.0), 3),
    ):
        turns, moved = _starts(a, b, near, STANDARD)
        assert len(turns) == rolls * len(shifts) ** 2
        off = np.round(np.einsum("kij,j->ki", turns, b) + moved - to, 6)
        assert {tuple(one) for one in off.tolist()} == {(x, y, 0.0) for x in shifts for y in shifts}
    first = turns @ ASIDE.rotation.T
    degrees = np.degrees(np.arctan2(first[:, 1, 0], first[:, 0, 0]))
    assert sorted({round(one) for one in degrees.tolist()}) == [-12, 0, 12]


def test_rare_directions_of_a_surface_are_led_by_more_than_their_share() -> None:
    normal = np.tile([0.0, 0.0, -1.0], (4100, 1))
    normal[4000:] = (0.6, 0.0, -0.8)
    valid = np.arange(0, 4100)
    chosen = _spread_over_normals(normal, valid)
    assert len(chosen) == 260
    assert (np.diff(chosen) > 0).all()
    # By the roots of their numbers √4000 : √100, that is a seventh; by their numbers it were a fortieth.
    assert 0.08 < np.mean(chosen >= 4000) < 0.2
    assert len(_spread_over_normals(normal, valid[:100])) == 100


# -------------------------------------------------------------------------------------------- points below


def grid(step_mm: float = 0.0) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """(6, 8, 3): x and y are column and row; from column 4 on, depth is ``step_mm`` larger."""
    v, u = np.mgrid[0:6, 0:8].astype(np.float32)
    return np.stack([u, v, np.where(u >= 4, np.float32(500.0 + step_mm), np.float32(500.0))], axis=-1)


def test_the_point_below_a_mark_lies_between_its_four_pixels() -> None:
    uv = np.array([[2.25, 3.75], [0.0, 0.0], [6.9, 4.9], [7.0, 2.0], [3.0, 5.0], [-0.1, 2.0], [2.0, -0.1]])
    found = points_below(grid(), uv)
    np.testing.assert_allclose(found[:3, :2], uv[:3], atol=1e-6)
    assert np.isnan(found[3:]).all(), "beyond the border there is nothing"
    holed = grid()
    holed[2, 2] = np.nan
    assert np.isnan(points_below(holed, np.array([[1.5, 1.5], [2.5, 2.5]]))).all()


@pytest.mark.parametrize(("step_mm", "known"), [(1.9, True), (2.1, False), (-2.1, False)])
def test_a_mark_at_a_step_lies_on_two_surfaces(step_mm: float, known: bool) -> None:
    found = points_below(grid(step_mm), np.array([[3.25, 2.0]]))
    assert bool(np.isfinite(found).all()) is known
    if known:
        assert found[0, 2] == pytest.approx(500.0 + 0.25 * step_mm, abs=1e-4)


def dotted(
    width_px: int, height_px: int, dots: Array, radius_px: float
) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    v, u = np.mgrid[0:height_px, 0:width_px].astype(float)
    picture = np.full((height_px, width_px), 60.0)
    for x, y in dots:
        picture += 150.0 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2.0 * radius_px**2))
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


@pytest.mark.parametrize("width_px", [400, 1200])
def test_marks_of_large_pictures_are_found_smaller_and_have_their_points(width_px: int) -> None:
    dots = np.random.default_rng(4).uniform(0.2, 0.8, (12, 2)) * (width_px, 0.25 * width_px)
    picture = dotted(width_px, width_px // 4, dots, width_px / 160.0)
    v, u = np.mgrid[0 : width_px // 4, 0:width_px].astype(np.float32)
    points = np.stack([u, v, np.full_like(u, 500.0)], axis=-1)
    points[:, : width_px // 2] = np.nan
    found = features_of(OrganisedCloud(points, u, u, u, picture), 4)
    assert len(found.points_mm) == len(found.descriptors) == 4
    assert (np.diff(found.strength) <= 0.0).all(), "the strongest first"
    np.testing.assert_allclose((found.descriptors**2).sum(axis=1), 1.0, atol=1e-4)
    near = np.linalg.norm(found.points_mm[:, None, :2] - dots[None], axis=-1).min(axis=1)
    assert near.max() < 1.0
    assert found.points_mm[:, 0].min() > width_px / 2 - 1, "where there is no point, there is no feature"


def test_a_picture_of_nothing_has_no_marks() -> None:
    found = marks_of(np.full((60, 80), 9, np.uint8), 10)
    assert (found.uv_px.shape, found.descriptors.shape, found.strength.shape) == ((0, 2), (0, 128), (0,))
