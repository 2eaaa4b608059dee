"""How much of a scan the one before has seen: a share that is right, none, or no word where nobody can tell."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from appliance.measure.cloud import CloudSummary
from appliance.measure.guidance import Overlap
from appliance.measure.overlap.features import Features, Keypoints
from appliance.measure.overlap.overlap import CoarseView, _again, _single, coarse_view, compare, share_on
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.table import Cloud
from tests.support.views import PROJECTION, SeenView, between, view

STRIDE_PX = 2
WITHIN = 0.04
"""A diver is told whole percents; a twentieth of a view changes nothing."""


@cache
def seen(name: str, paint: str, pose: tuple[float, ...], seed: int) -> SeenView:
    return view(name, pose, paint, seed)


@cache
def coarse(name: str, paint: str, pose: tuple[float, ...], seed: int) -> CoarseView:
    """What the worker keeps of a scan; the other picture is of the same place, with noise of its own."""
    cloud = seen(name, paint, pose, seed).cloud
    mask = np.zeros(cloud.shape, bool)
    mask[::STRIDE_PX, ::STRIDE_PX] = cloud.mask[::STRIDE_PX, ::STRIDE_PX]
    pixel = np.flatnonzero(mask)
    other = np.zeros(len(pixel), np.float32)
    points = Cloud(
        cloud.points_mm.reshape(-1, 3)[pixel], np.zeros(len(pixel), np.uint8), other, other, cloud.sigma_mm.ravel()[pixel],
        pixel.astype(np.uint32), CloudSummary(len(pixel), None, None, None, None),
    )  # fmt: skip
    noise = np.random.default_rng(seed).normal(size=cloud.shape)
    others = np.clip(np.rint(cloud.grey + noise), 0, 255).astype(np.uint8)[None]
    return coarse_view(points, STRIDE_PX, cloud.grey, others, PROJECTION)


def said(first: CoarseView, second: CoarseView) -> Overlap:
    *waits, overlap = compare(first, second)
    assert waits == [None] * len(waits), "nothing but the last word is an answer"
    assert overlap is not None
    return overlap


def true_share(first: SeenView, second: SeenView) -> float:
    """By the nearest neighbours of all points, at the true poses."""
    a = first.cloud.points_mm[first.cloud.mask]
    b = between(first, second).of(second.cloud.points_mm[second.cloud.mask][::20].astype(np.float64))
    distance, _ = cKDTree(a).query(b, distance_upper_bound=3.0)
    return float(np.isfinite(distance).mean())


def main_at(x_mm: float, turn: float = 0.0) -> tuple[float, ...]:
    return (x_mm, 4.0 * turn, 560.0 + 6.0 * turn, 2.0 * turn, -3.0 * turn, 3.0 * turn)


def test_along_a_painted_main_the_share_is_the_true_one_and_places_that_share_nothing_are_said_to() -> None:
    first, second = (("main", "slight", main_at(x, turn), seed) for x, turn, seed in ((-20.0, 0.0, 1), (85.0, 1.0, 2)))
    assert said(coarse(*first), coarse(*second)).share == pytest.approx(
        true_share(seen(*first), seen(*second)), abs=WITHIN
    )
    assert said(coarse(*first), coarse("main", "slight", main_at(-340.0, 1.0), 2)).none


def plane_with_marks(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> CoarseView:
    """A bare plane at 525 mm that has marks at ``points`` (n, 3); the k-th mark looks the same on every such plane."""
    made = coarse("plane", "none", (0.0, 0.0, 525.0, 0.0, 0.0, 0.0), 1)
    look = np.random.default_rng(3).normal(size=(len(points), 128)).astype(np.float32)
    look /= np.linalg.norm(look, axis=1, keepdims=True)
    nothing = Keypoints(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty(0))
    return replace(
        made, _marks=(nothing, nothing), _features=Features(points, look, np.ones(len(points))), _coverage=None
    )


@pytest.mark.parametrize(("elsewhere", "told"), [(10, True), (14, False)])
def test_marks_that_fit_in_two_places_give_no_number(elsewhere: int, told: bool) -> None:
    """Twenty-four marks say that nothing has moved, others that the second view lies 60 mm aside."""
    rng = np.random.default_rng(1)
    at = np.column_stack([rng.uniform(-90.0, 90.0, (24 + elsewhere, 2)), np.full(24 + elsewhere, 525.0)])
    aside = at + np.where(np.arange(len(at)) < 24, 0.0, 60.0)[:, None] * (1.0, 0.0, 0.0)
    share = said(plane_with_marks(at), plane_with_marks(aside)).share
    assert share == pytest.approx(1.0, abs=WITHIN) if told else share is None


@pytest.mark.parametrize(("beside_mm", "told"), [(0.5, False), (40.0, True)])
def test_marks_along_a_line_hold_no_pose_and_give_no_number(beside_mm: float, told: bool) -> None:
    rng = np.random.default_rng(2)
    at = np.column_stack([np.linspace(-90.0, 90.0, 16), rng.uniform(-beside_mm, beside_mm, 16), np.full(16, 525.0)])
    share = said(plane_with_marks(at), plane_with_marks(at + rng.normal(size=at.shape) * 0.1)).share
    assert share == pytest.approx(1.0, abs=WITHIN) if told else share is None


def looks(*cosines: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """Descriptors of these cosines with the first axis, and as unlike each other as that allows."""
    made = np.zeros((len(cosines), 128), np.float32)
    for k, cosine in enumerate(cosines):
        made[k, 0], made[k, 1 + k] = cosine, np.sqrt(1.0 - cosine**2)
    return made


@pytest.mark.parametrize(
    ("away_px", "cosine", "again"), [(1.4, 0.86, True), (1.6, 0.86, False), (1.4, 0.84, False), (0.0, 1.0, True)]
)
def test_a_mark_is_there_again_near_by_and_alike(away_px: float, cosine: float, again: bool) -> None:
    at = np.array([[10.0, 20.0]])
    found = _again(at, looks(1.0), np.concatenate([at + 50.0, at + np.array([away_px, 0.0])]), looks(1.0, cosine))
    assert found.tolist() == [again]
    assert _again(at, looks(1.0), at[:0], looks()).tolist() == [False]


@pytest.mark.parametrize(
    ("away_mm", "cosine", "single"), [(3.1, 0.91, True), (3.1, 0.93, False), (2.9, 0.93, True), (300.0, 0.93, False)]
)
def test_a_mark_that_looks_like_one_elsewhere_tells_no_place(away_mm: float, cosine: float, single: bool) -> None:
    points = np.array([[0.0, 0.0, 525.0], [away_mm, 0.0, 525.0]])
    assert _single(Features(points, looks(1.0, cosine), np.ones(2))).tolist() == [single] * 2


@pytest.mark.parametrize(("marks", "told"), [(5, True), (4, False)])
def test_five_marks_tell_of_twelve_millimetres_around(marks: int, told: bool) -> None:
    rng = np.random.default_rng(9)
    at = np.column_stack([rng.uniform(-0.4, 0.4, (marks, 2)), np.full(marks, 525.0)])
    plane = plane_with_marks(at)
    seen_mm = plane.points_mm[np.isfinite(plane.points_mm[..., 2])][:, :2]
    around = float((np.abs(seen_mm) < 12.0).all(axis=1).mean())
    assert plane.keypoint_coverage() == (pytest.approx(around, rel=0.25) if told else 0.0)


@pytest.mark.parametrize(("away_mm", "share"), [(2.9, 1.0), (-2.9, 1.0), (3.1, None)])
def test_two_surfaces_are_one_within_three_millimetres(away_mm: float, share: float | None) -> None:
    plane = plane_with_marks(np.zeros((0, 3)))
    found = share_on(plane, plane, Rigid(np.eye(3), np.array([0.0, 0.0, away_mm]))).share
    assert found == (share if share is None else pytest.approx(share, abs=0.03))
