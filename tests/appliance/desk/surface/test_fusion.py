"""Many scans become one surface: as good as their sigma says, one skin, and both sides of a plate."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from appliance.desk.surface.fusion import FusedCloud, PlacedScan, PointsOfScan, _Surface, fuse, with_places
from tests.support.solids import Ball, Box, Pose, looking, seen

BALL = Ball((0.0, 0.0, 0.0), 30.0)


def placed(
    pose: Pose, solids: list[Ball | Box], seed: int, size_px: tuple[int, int], steepest: float = 80.0
) -> PlacedScan:
    return PlacedScan(seen(solids, pose, seed, size_px, steepest=steepest), pose.rotation, pose.translation_mm, 0.0)


def test_the_more_scans_saw_a_point_the_better_it_is_and_sigma_says_so() -> None:
    # Ten scans from one place: every point is seen ten times, by about one pixel of each scan.
    scans = [placed(looking((0.0, 0.0, 500.0)), [BALL], seed, (80, 80), steepest=60.0) for seed in range(10)]
    one, ten = (fuse(some, spacing_mm=0.12) for some in (scans[:1], scans))
    for cloud in (one, ten):
        error = BALL.off(cloud.points_mm.astype(float)) / cloud.sigma_mm
        # A little less than 1: a disc that holds two pixels of a scan is better than sigma promises.
        assert 0.8 < np.sqrt(np.mean(error**2)) < 1.05
        assert abs(error.mean()) < 0.1, "a bent surface is not moved inwards"
    assert np.median(one.sigma_mm) / np.median(ten.sigma_mm) == pytest.approx(np.sqrt(10.0), rel=0.02)
    assert np.median(ten.views) == 10


@pytest.mark.parametrize("thickness_mm", [0.05, 0.5])
def test_both_sides_of_a_thin_plate_stay_two(thickness_mm: float) -> None:
    plate: list[Ball | Box] = [Box((-20.0, -20.0, 0.0), (20.0, 20.0, thickness_mm))]
    scans = [placed(looking((0.0, 30.0, z)), plate, k, (150, 150)) for k, z in enumerate((-500.0, 500.0))]
    cloud = fuse([replace(scan, pose_sigma_mm=0.03) for scan in scans])
    for side, z_mm in ((1.0, thickness_mm), (-1.0, 0.0)):
        seen_mm = cloud.points_mm[side * cloud.normals[:, 2] > 0.9, 2]
        assert len(seen_mm) > 5000
        assert seen_mm.mean() == pytest.approx(z_mm, abs=0.001)


@pytest.mark.parametrize(
    ("change", "spacing_mm", "words"),
    [
        ({"rotation": 1.01 * np.eye(3)}, 0.25, "orthonormal"),
        ({"rotation": np.diag([1.0, 1.0, -1.0])}, 0.25, "orthonormal"),
        ({"translation_mm": np.array([0.0, np.nan, 0.0])}, 0.25, "100 m"),
        ({"translation_mm": np.array([0.0, 100_100.0, 0.0])}, 0.25, "100 m"),
        ({"translation_mm": np.array([0.0, 99_900.0, 0.0])}, 0.25, ""),
        ({}, 0.019, r"allowed are 0\.02\.\.20"),
        ({}, 20.1, r"allowed are 0\.02\.\.20"),
        ({}, 0.02, ""),
        ({}, 20.0, ""),
    ],
)
def test_placements_and_spacings_of_no_use_are_refused(change: dict[str, Any], spacing_mm: float, words: str) -> None:
    scan = replace(placed(looking((0.0, 0.0, 500.0)), [BALL], 1, (20, 20)), **change)
    with pytest.raises(ValueError, match=words) if words else nullcontext():
        assert len(fuse([scan], spacing_mm=spacing_mm).grey) > 0


def point(
    at_mm: tuple[float, float, float],
    tilt_deg: float = 0.0,
    sigma_mm: float = 0.02,
    ray: tuple[float, float, float] = (0.0, 0.0, -1.0),
    grey: int = 100,
) -> PointsOfScan:
    """A scan of one point, seen along ``ray`` from half a metre away, whose normal is tilted from z about y."""
    tilt = np.radians(tilt_deg)
    way = np.array(ray) / np.linalg.norm(ray)
    return PointsOfScan(
        np.array([at_mm], np.float32), np.array([[np.sin(tilt), 0.0, np.cos(tilt)]], np.float32), np.array([sigma_mm**2], np.float32),
        np.array([grey], np.uint8), np.array(at_mm) - 500.0 * way,
    )  # fmt: skip


def joined(points: list[PointsOfScan], spacing_mm: float = 0.25) -> FusedCloud:
    surface = _Surface(spacing_mm)
    for one in points:
        surface.add(one)
    return surface.cloud(0)


HERE = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("other", "spacing_mm", "one"),
    [
        (point((0.24, 0.0, 0.0)), 0.25, True),
        (point((0.26, 0.0, 0.0)), 0.25, False),
        # Four standard deviations of both, √2 · 0.02 mm.
        (point((0.0, 0.0, 0.11)), 0.25, True),
        (point((0.0, 0.0, -0.116)), 0.25, False),
        # However uncertain, not beyond 0.4 mm, or a spacing where that is more.
        (point((0.0, 0.0, 0.39), sigma_mm=0.5), 0.25, True),
        (point((0.0, 0.0, 0.41), sigma_mm=0.5), 0.25, False),
        (point((0.0, 0.0, 0.98), sigma_mm=0.5), 1.0, True),
        (point((0.0, 0.0, 1.02), sigma_mm=0.5), 1.0, False),
        # Facing the same way.
        (point(HERE, tilt_deg=59.0), 0.25, True),
        (point(HERE, tilt_deg=61.0), 0.25, False),
        # Along a ray at a cosine of 0.1, as if it were 0.2: 0.2 mm aside, and 0.3 mm.
        (point((0.0, 0.0, 0.04), ray=(1.0, 0.0, -0.1)), 0.25, True),
        (point((0.0, 0.0, 0.06), ray=(1.0, 0.0, -0.1)), 0.25, False),
        (point((0.0, 0.0, 0.04), ray=(1.0, 0.0, -0.5)), 0.25, True),
    ],
)
def test_two_points_are_one_of_the_surface_within_its_limits(other: PointsOfScan, spacing_mm: float, one: bool) -> None:
    assert len(joined([point(HERE), other], spacing_mm).grey) == (1 if one else 2)


@pytest.mark.parametrize(("younger_mm", "views"), [(0.197, [2, 1]), (0.194, [1, 2])])
def test_of_two_discs_about_equally_far_the_older_one_gets_the_point(younger_mm: float, views: list[int]) -> None:
    cloud = joined([point((-0.2, 0.0, 0.0)), point((younger_mm, 0.0, 0.0)), point(HERE)])
    assert cloud.views.tolist() == views
    assert cloud.first_scan is not None
    assert cloud.first_scan.tolist() == [0, 1]


def test_a_table_that_grows_forgets_no_disc() -> None:
    """Far more cells than it begins with: each point is found again by the second scan."""
    x, y = (2.0 * one.ravel() for one in np.mgrid[:210, :210])
    n = len(x)
    at, up = (
        np.stack([x, y, 0.0 * x], axis=1).astype(np.float32),
        np.tile(np.array([0.0, 0.0, 1.0], np.float32), (n, 1)),
    )
    scan = PointsOfScan(
        at, up, np.full(n, 4e-4, np.float32), np.full(n, 9, np.uint8), np.array([200.0, 200.0, 50_000.0])
    )
    cloud = joined([scan, scan])
    assert len(cloud.grey) == n
    assert (cloud.views == 2).all()


def test_shares_of_sigma_add_up_by_their_squares_and_the_own_one_stays() -> None:
    cloud = joined([point(HERE, sigma_mm=0.03)])
    once = with_places(cloud, np.array([0.04]), np.array([0.12]))
    np.testing.assert_allclose(once.sigma_mm, 0.13, rtol=1e-5)
    twice = with_places(once, np.array([0.04]), np.array([0.0]))
    np.testing.assert_allclose(twice.sigma_mm, 0.05, rtol=1e-5)
    np.testing.assert_allclose(twice.beside_mm, cloud.sigma_mm)
