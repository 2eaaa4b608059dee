"""What a correspondence expects of its error, part by part, against the sums of ``docs/uncertainty.md`` in float64."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from appliance.measure.decode.scratch import (
    BEND_RIGHT,
    MODULATION,
    MODULATION_RIGHT,
    OFFSET,
    POINT_VARIANCE,
    RIGHT_SHARE,
    SIZE,
    SLOPE,
    UP,
    UQ,
    P,
)
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.points.quality import Ripple
from appliance.measure.points.sigma import SigmaFactors, expect_row, sigma_factors

LEFT = CameraNoise(read_dn=0.6, dn_per_e=0.02, black_dn=2.0)
RIGHT = CameraNoise(read_dn=0.9, dn_per_e=0.05, black_dn=3.0)
QUIET = CameraNoise(read_dn=1e-6, dn_per_e=0.0, black_dn=0.0)
PERIOD_PX = 16
N = 9
PLAIN: dict[int, float] = {
    MODULATION: 60.0, MODULATION_RIGHT: 40.0, OFFSET: 90.0, SLOPE: 1.5, BEND_RIGHT: 0.0, RIGHT_SHARE: 0.8, UP: 0.6, UQ: 0.2,
}  # fmt: skip


def with_row(
    factors: SigmaFactors, changes: dict[int, Any], next_to: bool = True, p: np.ndarray | None = None
) -> np.ndarray:
    """Variance in px² of a row (n,) whose quantities are those of PLAIN but for the changes."""
    s = np.full(SIZE, np.nan, np.float32)
    for place, value in (PLAIN | changes).items():
        s[place - 1 : place + N + 1] = value
    s[P - 1 : P + N + 1] = 100.0 + 1.5 * np.arange(-1, N + 1) if p is None else p
    expect_row(factors, next_to, False, s, s, N)
    return s[POINT_VARIANCE : POINT_VARIANCE + N].astype(float)


def noise_px2(modulation: float, light: float, camera: CameraNoise) -> float:
    """P·σ/(2π·√2·B), squared."""
    variance = camera.read_dn**2 + camera.dn_per_e * (light - camera.black_dn)
    return (PERIOD_PX / (2.0 * math.pi * math.sqrt(2.0) * modulation)) ** 2 * variance


FACTORS = sigma_factors(PERIOD_PX, StereoNoise(LEFT, RIGHT))
SILENT = sigma_factors(PERIOD_PX, StereoNoise(QUIET, QUIET))


def test_noise_is_that_of_both_cameras_each_at_its_own_light() -> None:
    both = noise_px2(60.0, 90.0, LEFT) + 0.8 * noise_px2(40.0, 90.0 * 40.0 / 60.0, RIGHT)
    np.testing.assert_allclose(with_row(FACTORS, {}), (0.6**2 + 0.2**2) * both, rtol=1e-4)


def test_a_bend_that_noise_alone_could_make_does_not_count() -> None:
    noise = noise_px2(60.0, 90.0, LEFT) + 0.8 * noise_px2(40.0, 60.0, RIGHT)
    plain = with_row(FACTORS, {})[0]
    at_the_limit = math.sqrt(20.0 * noise)
    assert with_row(FACTORS, {BEND_RIGHT: 0.99 * at_the_limit})[0] == pytest.approx(plain, rel=1e-4)
    more = with_row(FACTORS, {BEND_RIGHT: 2.0 * at_the_limit})[0]
    assert more - plain == pytest.approx(0.4 * 0.2**2 * 3.0 * at_the_limit**2, rel=1e-2)


def test_beside_a_missing_neighbour_a_point_expects_a_border() -> None:
    p = 100.0 + 1.5 * np.arange(-1.0, N + 1)
    p[4] = np.nan
    found = with_row(SILENT, {}, p=p)
    border = 0.4 * (0.07 * 1.5) ** 2
    assert found[[2, 4]] == pytest.approx([border, border], rel=1e-3)
    assert found[[0, 6]] == pytest.approx([0.0, 0.0], abs=1e-9)
    missing = with_row(SILENT, {BEND_RIGHT: np.nan})
    np.testing.assert_allclose(missing, border, rtol=1e-3)
    alone = with_row(SILENT, {BEND_RIGHT: np.nan}, next_to=False)
    np.testing.assert_allclose(alone, 0.0, atol=1e-9)


def test_a_ripple_that_is_lost_in_noise_does_not_count() -> None:
    for lost_px, counts in ((0.021, True), (0.019, False)):
        factors = sigma_factors(PERIOD_PX, StereoNoise(LEFT, RIGHT), Ripple(0.05, lost_px, 0.1))
        assert (factors.ripple_px2 > 0.0) == counts
    assert sigma_factors(PERIOD_PX, StereoNoise(LEFT, RIGHT)).ripple_px2 == 0.0
