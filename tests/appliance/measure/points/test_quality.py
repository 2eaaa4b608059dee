"""The numbers of a cloud, and the limits of its points."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from appliance.measure.points.quality import SAMPLE, QualityLimits, summarise
from appliance.measure.points.select import Points


def points(depth_mm: np.ndarray) -> Points:
    """Sigma is a 1000th of the depth, the gap a 2000th."""
    n = len(depth_mm)
    depth = depth_mm.astype(np.float32)
    xyz = np.stack([np.full(n, 7.0), np.full(n, -9.0), depth], -1).astype(np.float32)
    byte = np.zeros(n, np.uint8)
    return Points(xyz, depth / np.float32(2000), depth / np.float32(1000), byte, np.zeros(n, np.uint32), byte)


def test_a_cloud_is_told_by_its_medians_and_by_its_share_of_the_lit_pixels() -> None:
    depth_mm = np.full(20, 9999.0)
    depth_mm[2:6], depth_mm[10:13] = [400.0, 410.0, 420.0, 430.0], [500.0, 510.0, 520.0]
    said = summarise(28, points(depth_mm), ((2, 6), (10, 13)))
    assert astuple(said) == pytest.approx((7, 25.0, 430.0, 0.430, 0.215))
    # Sampled medians err by a share of a percent of the spread; a sample of one part of the cloud would err by much more.
    n = 5 * SAMPLE
    many = summarise(n, points(np.linspace(400.0, 600.0, n)), ((0, n // 2), (n // 2, n)))
    assert many.points == n
    assert many.distance_mm == pytest.approx(500.0, abs=0.1)


def test_without_points_nothing_is_said_of_them_and_without_light_nothing_of_coverage() -> None:
    none = summarise(100, points(np.zeros(4)), ((0, 0), (2, 2)))
    assert (none.points, none.coverage_percent) == (0, 0.0)
    assert (none.distance_mm, none.noise_mm, none.gap_mm) == (None, None, None)
    dark = summarise(0, points(np.full(4, 500.0)), ((0, 1),))
    assert (dark.points, dark.coverage_percent, dark.distance_mm) == (1, None, 500.0)


def test_the_volume_is_530_mm_away_and_300_mm_deep_and_a_point_needs_more_than_half_of_its_neighbours() -> None:
    """docs/causes.md names the volume's ends to the diver; gaps of a good calibration are below a tenth of the limit."""
    limits = QualityLimits()
    assert 0.5 * (limits.min_depth_mm + limits.max_depth_mm) == 530.0
    assert limits.max_depth_mm - limits.min_depth_mm == 300.0
    assert 8 / 2 < limits.min_neighbours <= 8 / 2 + 1
    # 60 degrees at 0.16 mm per pixel, along the diagonal, is a step of 0.4 mm; a step of two millimetres is another surface.
    assert 0.16 * 2**0.5 * 3**0.5 < limits.max_step_mm < 2.0
    # Half a millimetre is no measurement any more, and rays that pass at half of that do not see the same point.
    assert (limits.max_sigma_mm, limits.max_gap_mm) == (0.5, 0.5 / 2)
