"""Marks of two scans: which are the same, where the points below them lie, and which pairs of scans and poses they vote for."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.desk.registration.solve import by_features
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.coarse import guess_by_features, in_common, matches, same
from appliance.measure.overlap.features import Features, points_below
from appliance.measure.overlap.rigid import Rigid

ASIDE = Rigid(rotation_matrix(np.array([0.1, -0.2, 0.4])), np.array([30.0, -20.0, 10.0]))


def unit(*of: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """A descriptor that begins with these numbers."""
    made = np.zeros(128, np.float32)
    made[: len(of)] = of
    return made


def looks(count: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Descriptors (count, 128) that do not resemble each other."""
    made = np.random.default_rng(3).normal(size=(count, 128)).astype(np.float32)
    return np.asarray(made / np.linalg.norm(made, axis=1, keepdims=True))


def of_look(descriptors: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> Features:
    n = len(descriptors)
    return Features(np.zeros((n, 3)), descriptors, np.ones(n))


def beside(of: np.ndarray[tuple[int, ...], np.dtype[np.float32]], cosine: float) -> Features:
    """Marks of this cosine with those of ``of``, which lie in the first 64 dimensions."""
    return of_look((cosine * of + np.sqrt(1.0 - cosine**2) * np.roll(of, 64, axis=1)).astype(np.float32))


FEW = np.eye(8, 128, dtype=np.float32)


# ------------------------------------------------------------------------------------- pairs worth comparing


@pytest.mark.parametrize(("cosine", "count", "voted"), [(0.89, 8, True), (0.87, 8, False), (0.89, 7, False)])
def test_a_pair_is_compared_where_eight_marks_look_alike(cosine: float, count: int, voted: bool) -> None:
    pairs = by_features([FEW[:count], beside(FEW[:count], cosine).descriptors, looks(0)])
    assert pairs == ([(0, 1)] if voted else [])


@pytest.mark.parametrize(("cosine", "voted"), [(0.975, True), (0.965, False)])
def test_a_scan_that_shows_a_mark_nearly_as_well_as_the_best_gets_its_vote(cosine: float, voted: bool) -> None:
    near = beside(FEW, cosine).descriptors
    pairs = by_features([FEW, FEW, near, near])
    assert pairs == ([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] if voted else [(0, 1), (2, 3)])


def test_a_scan_is_compared_with_four_others_for_its_marks() -> None:
    pairs = by_features([FEW] * 6)
    assert sorted({(i, j) for i in range(6) for j in range(i + 1, 6)} - set(pairs)) == [(4, 5)]


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


# ---------------------------------------------------------------------------------------------------- poses


def seen_by_both(count: int, off_mm: float = 0.0) -> tuple[Features, Features]:
    """As many marks, each as seen by A and by B at ``ASIDE``; every other one off by ``off_mm`` along z, to either side."""
    at = np.random.default_rng(3).uniform(-80.0, 80.0, (count, 3)) + np.array([0.0, 0.0, 540.0])
    b = ASIDE.inverse.of(at)
    at[::2, 2] += off_mm
    return Features(at, looks(count), np.ones(count)), Features(b, looks(count), np.ones(count))


@pytest.mark.parametrize(
    ("count", "off_mm", "found"), [(10, 0.0, True), (9, 0.0, False), (14, 1.2, True), (14, 3.0, False)]
)
def test_ten_marks_that_agree_within_a_millimetre_give_a_pose(count: int, off_mm: float, found: bool) -> None:
    guesses = guess_by_features(*seen_by_both(count, off_mm))
    assert bool(guesses) is found
    assert all(same(one.pose, ASIDE, 0.1 + 2.0 * off_mm) and one.by_features for one in guesses[:1])


@pytest.mark.parametrize(("off_mm", "count"), [(0.75, 12), (0.85, 0)])
def test_marks_are_in_common_where_the_pose_lays_them_within_eight_tenths(off_mm: float, count: int) -> None:
    a, b = seen_by_both(12)
    common = in_common(a, b, Rigid(ASIDE.rotation, ASIDE.translation_mm + np.array([off_mm, 0.0, 0.0])))
    assert len(common) == count
    assert np.isin(common, a.points_mm).all()


@pytest.mark.parametrize(
    ("turn", "shift_mm", "alike"),
    [
        ((0.0, 0.0, 0.0), (3.9, 0.0, 0.0), True), ((0.0, 0.0, 0.0), (0.0, 0.0, -4.1), False),
        # Eighty millimetres aside and as much down: 113 mm from the axis.
        ((0.0, 0.0, 0.0348), (0.0, 0.0, 0.0), True), ((0.0, 0.0, 0.0359), (0.0, 0.0, 0.0), False),
        # 546 mm before the camera.
        ((0.0072, 0.0, 0.0), (0.0, 0.0, 0.0), True), ((0.0, 0.0075, 0.0), (0.0, 0.0, 0.0), False),
    ],
)  # fmt: skip
def test_poses_are_the_same_where_they_put_the_volumes_middle_within_four_millimetres(
    turn: tuple[float, ...], shift_mm: tuple[float, ...], alike: bool
) -> None:
    pose = Rigid(rotation_matrix(np.array(turn)), np.array(shift_mm))
    assert same(pose, Rigid(np.eye(3), np.zeros(3))) is alike


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
