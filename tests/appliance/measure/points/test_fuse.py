"""Two clouds of one plane become one: their mean by expected error, what only one has, and what contradicts.

A camera of 80 px principal distance sees the plane z = 500 + 0.2 x + 0.1 y; distances along its normal are worked out by hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.points.fuse import FusionResult, fuse
from appliance.measure.points.register import Registration
from appliance.measure.points.surface import surface_of
from appliance.measure.points.table import Cloud

Array = NDArray[np.float64]
SHAPE = HEIGHT_PX, WIDTH_PX = 24, 32
FOCAL_PX = 80.0
NORMAL = np.array([-0.2, -0.1, 1.0]) / np.sqrt(1.05)
N, MIDDLE = HEIGHT_PX * WIDTH_PX, 12 * WIDTH_PX + 16
EVERY = np.arange(N)
AT_REST = Registration(np.eye(3), np.zeros(3), 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)


def seen(pixel: NDArray[np.int64] = EVERY, sigma_mm: float = 0.03, apart_mm: float | Array = 0.0) -> Cloud:
    """The plane in some pixels, each point moved along the plane's normal."""
    v, u = np.divmod(pixel, WIDTH_PX)
    ray = np.stack([(u - 15.5) / FOCAL_PX, (v - 11.5) / FOCAL_PX, np.ones(len(pixel))], -1)
    depth = 500.0 / (1.0 - 0.2 * ray[:, 0] - 0.1 * ray[:, 1])
    points = ray * depth[:, None] + np.multiply.outer(np.broadcast_to(apart_mm, pixel.shape), NORMAL)
    n = len(pixel)
    points, intensity, pixels = points.astype(np.float32), np.full(n, 100, np.uint8), pixel.astype(np.uint32)
    modulation, gap, sigma = (np.full(n, value, np.float32) for value in (50.0, 0.01, sigma_mm))
    return Cloud(points, intensity, modulation, gap, sigma, pixels, CloudSummary(n, 100.0 * n / N, None, None, None))


def fused(
    first: Cloud, second: Cloud, found: Registration = AT_REST, grey: tuple[float, float] = (1.0, 1.0)
) -> FusionResult:
    return fuse(surface_of(first, second, SHAPE), first, second, found, grey)


def apart_mm(cloud: Cloud) -> Array:
    """Distance of every point from the plane, along its normal."""
    return np.asarray((cloud.points_mm.astype(np.float64) - [0.0, 0.0, 500.0]) @ NORMAL)


def without(*pixels: int) -> NDArray[np.int64]:
    return np.setdiff1d(EVERY, pixels)


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
    ("apart", "fate"),
    [
        (4.9 * 0.05, "mean"), (-4.9 * 0.05, "mean"), (5.1 * 0.05, "masked"), (-5.1 * 0.05, "masked"), (0.98, "masked"), (1.02, "first"),
        (-1.02, "first"),
    ],
)  # fmt: skip
def test_points_contradict_beyond_five_sigmas_and_up_to_a_millimetre(apart: float, fate: str) -> None:
    moved = np.where(EVERY == MIDDLE, apart, 0.0)
    found = fused(seen(), seen(sigma_mm=0.04, apart_mm=moved))
    there = np.flatnonzero(found.cloud.pixel == MIDDLE)
    if fate == "masked":
        assert (len(there), found.cloud.summary.points) == (0, N - 1)
        assert (found.masked, found.both) == pytest.approx((1.0 / N, 1.0))
        return
    mean = fate == "mean"
    assert apart_mm(found.cloud)[there] == pytest.approx([apart * 9.0 / 25.0 if mean else 0.0], abs=3e-4)
    assert found.cloud.sigma_mm[there] == pytest.approx([0.024 if mean else 0.03], rel=1e-4)
    assert (found.masked, found.both) == pytest.approx((0.0, 1.0 if mean else (N - 1) / N))


def test_what_only_the_second_has_is_taken_at_its_pixel_in_the_order_of_the_pixels() -> None:
    holes = [3, MIDDLE, MIDDLE + 1, N - 72]
    second = replace(seen(sigma_mm=0.04), modulation_dn=np.full(N, 70.0, np.float32))
    found = fused(seen(without(*holes)), second)
    np.testing.assert_array_equal(found.cloud.pixel, EVERY)
    np.testing.assert_allclose(found.cloud.points_mm, seen().points_mm, atol=1e-3)
    np.testing.assert_array_equal(np.flatnonzero(found.cloud.modulation_dn == 70.0), holes)
    np.testing.assert_allclose(found.cloud.sigma_mm[holes], 0.04, rtol=1e-6)
    assert (found.second, found.both) == pytest.approx((4 / N, (N - 4) / N))


def test_the_second_cloud_is_moved_before_it_is_laid_over_the_first_and_what_leaves_the_picture_is_lost() -> None:
    """A shift within the plane by four pixels, to the right and down: four rows and columns of it are outside."""
    pitch_mm = 500.0 / FOCAL_PX
    along = 4.0 * pitch_mm * np.array([1.0, 1.0, 0.3])
    found = fused(seen(without(MIDDLE, 0, 1)), seen(apart_mm=0.05), replace(AT_REST, translation_mm=along))
    assert 0 not in found.cloud.pixel, "nothing came from beyond the picture's edge"
    (at,) = np.flatnonzero(found.cloud.pixel == MIDDLE)
    assert apart_mm(found.cloud)[at] == pytest.approx(0.05, abs=2e-3)
    v, u = divmod(MIDDLE, WIDTH_PX)
    x, y, z = found.cloud.points_mm[at]
    assert [FOCAL_PX * x / z + 15.5, FOCAL_PX * y / z + 11.5] == pytest.approx([u, v], abs=0.51)
    assert 0.6 < found.both < (HEIGHT_PX - 3) * (WIDTH_PX - 3) / N


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
def test_grey_values_mean_the_same_light_and_end_at_white(grey: tuple[float, float], wanted: tuple[int, int]) -> None:
    cloud = fused(seen(without(MIDDLE)), seen(), grey=grey).cloud
    np.testing.assert_array_equal(
        cloud.intensity, np.where(EVERY == MIDDLE, *wanted[::-1]).astype(np.uint8), strict=True
    )


def test_the_fused_clouds_numbers_are_its_own() -> None:
    """Coverage is over the larger lit part, which each cloud tells by its points and its own coverage."""

    def covered(first_percent: float | None, second_percent: float | None) -> CloudSummary:
        clouds = zip((seen(without(MIDDLE)), seen()), (first_percent, second_percent), strict=True)
        first, second = (replace(one, summary=replace(one.summary, coverage_percent=share)) for one, share in clouds)
        return fused(first, second).cloud.summary

    said = covered(80.0, 50.0)
    assert (said.points, said.coverage_percent, said.gap_mm) == pytest.approx((N, 50.0, 0.01))
    assert said.distance_mm == pytest.approx(float(np.median(seen().points_mm[:, 2])), abs=0.01)
    assert said.noise_mm == pytest.approx(0.03 / np.sqrt(2.0), rel=1e-4)
    assert covered(None, None).coverage_percent is None
