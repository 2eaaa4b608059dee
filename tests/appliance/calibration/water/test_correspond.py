"""Matched pixels are those that show the same pattern coordinates, to a fraction of what one pixel's noise allows."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.water.correspond import matched_right_px

WIDTH, HEIGHT = 200, 150
NOISE_PX = 0.03


def maps_of(shift: float, noise_px: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pattern coordinates of a bent surface, seen with a shift that grows across the image."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    p, q = pattern_at(u + shift * (1.0 + 1e-3 * u), v + 0.3 * shift)
    rng = np.random.default_rng(seed)
    return tuple((m + rng.normal(0.0, noise_px, m.shape)).astype(np.float32) for m in (p, q))  # type: ignore[return-value]


def pattern_at(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return 0.63 * x + 2e-4 * x**2 + 1e-4 * x * y + 40.0, 0.64 * y - 1e-4 * y**2 + 0.02 * x + 30.0


def true_right(left: np.ndarray) -> np.ndarray:
    """The right map has shift 7, the left one 0: x + 7 (1 + 1e-3 x) = u."""
    return np.stack([(left[:, 0] - 7.0) / 1.007, left[:, 1] - 2.1], -1)


@pytest.fixture
def left_px() -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.integers([20, 10], [WIDTH - 10, HEIGHT - 10], (400, 2)).astype(np.intp)


def test_exact_maps_give_exact_pixels(left_px: np.ndarray) -> None:
    start = true_right(left_px) + np.array([1.2, -0.9])
    right, good = matched_right_px(maps_of(0.0, 0.0, 1), maps_of(7.0, 0.0, 2), left_px, start)
    assert good.mean() > 0.99
    assert np.abs(right[good] - true_right(left_px)[good]).max() < 2e-3


@pytest.mark.parametrize("away", [(0.0, 18.0), (-15.0, -12.0)])
def test_a_start_far_beside_the_match_leads_to_the_same_pixel(left_px: np.ndarray, away: tuple[float, float]) -> None:
    left, right = maps_of(0.0, NOISE_PX, 1), maps_of(7.0, NOISE_PX, 2)
    near, found_near = matched_right_px(left, right, left_px, true_right(left_px))
    start = true_right(left_px) + away
    inside = np.all((start > 5.0) & (start < [WIDTH - 6.0, HEIGHT - 6.0]), axis=1)
    far, found_far = matched_right_px(left, right, left_px, start)
    assert inside.mean() > 0.7
    assert found_far[inside & found_near].mean() > 0.99
    both = found_near & found_far
    # Windows around neighbouring pixels may be taken; they share nearly all of their pixels.
    assert np.abs(far[both] - near[both]).max() < NOISE_PX


def test_windows_average_the_noise(left_px: np.ndarray) -> None:
    right, good = matched_right_px(maps_of(0.0, NOISE_PX, 1), maps_of(7.0, NOISE_PX, 2), left_px, true_right(left_px))
    sd = float((right[good] - true_right(left_px)[good]).std())
    one_pixel = NOISE_PX * np.sqrt(2.0) / 0.65
    assert sd < 0.6 * one_pixel


def test_holes_and_edges_are_not_matched(left_px: np.ndarray) -> None:
    left, right = maps_of(0.0, 0.0, 1), maps_of(7.0, 0.0, 2)
    left[0][:, 100:] = np.nan
    right[0][:75] += 30.0
    found, good = matched_right_px(left, right, left_px, true_right(left_px))
    assert not good[left_px[:, 0] >= 98].any()
    near_step = np.abs(true_right(left_px)[:, 1] - 74.5) < 1.5
    assert near_step.any()
    assert not good[near_step].any()
    assert np.isnan(found[~good]).all()
