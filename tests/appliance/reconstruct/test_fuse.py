"""Two clouds of one plane become one: their mean by expected error, what only one has, and what contradicts.

A camera of 80 px principal distance sees the plane z = 500 + 0.2 x + 0.1 y; distances along its normal are worked out by hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.reconstruct.fuse import Fused, fuse
from appliance.reconstruct.quality import CloudSummary
from appliance.reconstruct.register import Registration
from appliance.reconstruct.surface import surface_of
from appliance.reconstruct.table import Cloud

Array = NDArray[np.float64]
SHAPE = HEIGHT_PX, WIDTH_PX = 24, 32
FOCAL_PX = 80.0
NORMAL = np.array([-0.2, -0.1, 1.0]) / np.sqrt(1.05)
MIDDLE = 12 * WIDTH_PX + 16
AT_REST = Registration(np.eye(3), np.zeros(3), 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)


def seen(pixel: NDArray[np.int64] | None = None, sigma_mm: float = 0.03, apart_mm: float | Array = 0.0) -> Cloud:
    """The plane in some pixels (all, if not told), each point moved along the plane's normal."""
    pixel = np.arange(HEIGHT_PX * WIDTH_PX) if pixel is None else pixel
    v, u = np.divmod(pixel, WIDTH_PX)
    ray = np.stack([(u - 15.5) / FOCAL_PX, (v - 11.5) / FOCAL_PX, np.ones(len(pixel))], -1)
    depth = 500.0 / (1.0 - 0.2 * ray[:, 0] - 0.1 * ray[:, 1])
    points = ray * depth[:, None] + np.multiply.outer(np.broadcast_to(apart_mm, pixel.shape), NORMAL)
    n = len(pixel)
    return Cloud(
        points_mm=points.astype(np.float32),
        intensity=np.full(n, 100, np.uint8),
        modulation_dn=np.full(n, 50.0, np.float32),
        ray_gap_mm=np.full(n, 0.01, np.float32),
        sigma_mm=np.full(n, sigma_mm, np.float32),
        pixel=pixel.astype(np.uint32),
        summary=CloudSummary(n, 100.0 * n / (HEIGHT_PX * WIDTH_PX), None, None, None),
    )


def fused(first: Cloud, second: Cloud, found: Registration = AT_REST, grey: tuple[float, float] = (1.0, 1.0)) -> Fused:
    return fuse(surface_of(first, second, SHAPE), first, second, found, grey)


def apart_mm(cloud: Cloud) -> Array:
    """Distance of every point from the plane, along its normal."""
    return np.asarray((cloud.points_mm.astype(np.float64) - [0.0, 0.0, 500.0]) @ NORMAL)


def without(*pixels: int) -> NDArray[np.int64]:
    return np.setdiff1d(np.arange(HEIGHT_PX * WIDTH_PX), pixels)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_both_have_lies_between_them_nearer_to_the_better_one_and_is_better_than_either(sign: float) -> None:
    first, second = seen(sigma_mm=0.03), seen(sigma_mm=0.04, apart_mm=sign * 0.1)
    found = fused(first, second)
    # 0.03² + 0.04² = 0.05²: the first counts 16 / 25, the second 9 / 25.
    np.testing.assert_allclose(apart_mm(found.cloud), sign * 0.036, atol=2e-4)
    np.testing.assert_allclose(found.cloud.sigma_mm, 0.03 * 0.04 / 0.05, rtol=1e-5)
    assert (found.second, found.both, found.masked) == (0.0, 1.0, 0.0)
    across = found.cloud.points_mm - first.points_mm
    assert np.abs(across - np.outer(across @ NORMAL, NORMAL)).max() < 2e-4, "along the normal, not along the ray"
    np.testing.assert_array_equal(found.cloud.pixel, first.pixel)


@pytest.mark.parametrize(
    ("sigmas", "sigma_mm", "fate"),
    [
        (4.9, 0.03, "mean"),
        (-4.9, 0.03, "mean"),
        (5.1, 0.03, "masked"),
        (-5.1, 0.03, "masked"),
        (0.98 / 0.05, 0.03, "masked"),
        (1.02 / 0.05, 0.03, "first"),
        (-1.02 / 0.05, 0.03, "first"),
    ],
)
def test_beyond_five_sigmas_two_points_contradict_and_beyond_a_millimetre_one_of_them_is_past_an_edge(
    sigmas: float, sigma_mm: float, fate: str
) -> None:
    moved = np.zeros(HEIGHT_PX * WIDTH_PX)
    moved[MIDDLE] = sigmas * 0.05
    found = fused(seen(sigma_mm=sigma_mm), seen(sigma_mm=0.04, apart_mm=moved))
    there = np.flatnonzero(found.cloud.pixel == MIDDLE)
    n = HEIGHT_PX * WIDTH_PX
    if fate == "masked":
        assert len(there) == 0
        assert found.masked == pytest.approx(1.0 / n)
        assert (found.cloud.summary.points, found.both) == (n - 1, 1.0)
    else:
        wanted = moved[MIDDLE] * 9.0 / 25.0 if fate == "mean" else 0.0
        assert apart_mm(found.cloud)[there] == pytest.approx([wanted], abs=3e-4)
        assert found.masked == 0.0
        assert found.both == pytest.approx(1.0 if fate == "mean" else (n - 1) / n)
        assert found.cloud.sigma_mm[there] == pytest.approx([0.024 if fate == "mean" else 0.03], rel=1e-4)


def test_what_only_the_second_has_is_taken_at_its_pixel_in_the_order_of_the_pixels() -> None:
    holes = [3, MIDDLE, MIDDLE + 1, HEIGHT_PX * WIDTH_PX - 72]
    second = replace(seen(sigma_mm=0.04), modulation_dn=np.full(HEIGHT_PX * WIDTH_PX, 70.0, np.float32))
    found = fused(seen(without(*holes)), second)
    n = HEIGHT_PX * WIDTH_PX
    np.testing.assert_array_equal(found.cloud.pixel, np.arange(n))
    np.testing.assert_allclose(found.cloud.points_mm, seen().points_mm, atol=1e-3)
    np.testing.assert_array_equal(np.flatnonzero(found.cloud.modulation_dn == 70.0), holes)
    np.testing.assert_allclose(found.cloud.sigma_mm[holes], 0.04, rtol=1e-6)
    assert found.second == pytest.approx(4 / n)
    assert found.both == pytest.approx((n - 4) / n)


def test_the_second_cloud_is_moved_before_it_is_laid_over_the_first_and_what_leaves_the_picture_is_lost() -> None:
    """A shift within the plane by four pixels, to the right and down: four rows and columns of it are outside."""
    pitch_mm = 500.0 / FOCAL_PX
    along = np.array([4.0 * pitch_mm, 4.0 * pitch_mm, 0.3 * 4.0 * pitch_mm])
    hole = MIDDLE
    first = seen(without(hole, 0, 1))
    found = fused(first, seen(apart_mm=0.05), replace(AT_REST, translation_mm=along))
    assert hole in found.cloud.pixel, "another point of the moved cloud lies there"
    assert 0 not in found.cloud.pixel, "nothing came from beyond the picture's edge"
    at = np.flatnonzero(found.cloud.pixel == hole)
    assert apart_mm(found.cloud)[at] == pytest.approx([0.05], abs=2e-3)
    v, u = divmod(hole, WIDTH_PX)
    x, y, z = found.cloud.points_mm[at[0]]
    assert [FOCAL_PX * x / z + 15.5, FOCAL_PX * y / z + 11.5] == pytest.approx([u, v], abs=0.51)
    assert 0.6 < found.both < (HEIGHT_PX - 3) * (WIDTH_PX - 3) / (HEIGHT_PX * WIDTH_PX)


@pytest.mark.parametrize("across", [-1, 0, 1])
@pytest.mark.parametrize("down", [-1, 0, 1])
def test_a_pixel_reaches_to_half_way_to_the_next_also_at_the_pictures_four_edges(across: int, down: int) -> None:
    """Moved by four tenths of a pixel everything is still seen; by six tenths one row or column of it is outside."""
    pitch_mm = 500.0 / FOCAL_PX
    for px, lost in ((0.42, 0), (0.6, 1)):
        x, y = px * pitch_mm * across, px * pitch_mm * down
        found = fused(seen(), seen(), replace(AT_REST, translation_mm=np.array([x, y, 0.2 * x + 0.1 * y])))
        shared = (WIDTH_PX - lost * abs(across)) * (HEIGHT_PX - lost * abs(down))
        assert found.both == pytest.approx(shared / (WIDTH_PX * HEIGHT_PX), abs=1e-9)


@pytest.mark.parametrize(
    ("grey", "wanted"), [((1.0, 1.0), (100, 100)), ((2.0, 0.505), (200, 50)), ((3.0, 0.0), (255, 0))]
)
def test_grey_values_of_both_mean_the_same_light_and_end_at_white(
    grey: tuple[float, float], wanted: tuple[int, int]
) -> None:
    found = fused(seen(without(MIDDLE)), seen(), grey=grey)
    own = found.cloud.pixel != MIDDLE
    assert found.cloud.intensity.dtype == np.uint8
    assert set(found.cloud.intensity[own].tolist()) == {wanted[0]}
    assert found.cloud.intensity[~own].tolist() == [wanted[1]]


def test_the_fused_clouds_numbers_are_its_own() -> None:
    """Coverage is over the larger lit part, which each cloud tells by its points and its own coverage."""
    first, second = seen(without(MIDDLE)), seen()
    first = replace(first, summary=replace(first.summary, coverage_percent=80.0))
    second = replace(second, summary=replace(second.summary, coverage_percent=50.0))
    said = fused(first, second).cloud.summary
    assert said.points == HEIGHT_PX * WIDTH_PX
    assert said.coverage_percent == pytest.approx(50.0)
    assert said.distance_mm == pytest.approx(float(np.median(seen().points_mm[:, 2])), abs=0.01)
    assert said.noise_mm == pytest.approx(0.03 / np.sqrt(2.0), rel=1e-4)
    assert said.gap_mm == pytest.approx(0.01)
    first = replace(first, summary=replace(first.summary, coverage_percent=None))
    second = replace(second, summary=replace(second.summary, coverage_percent=None))
    assert fused(first, second).cloud.summary.coverage_percent is None
