"""Grey values scatter as electrons do: photons, read-out, fixed pattern; and no two frames are alike."""

from __future__ import annotations

import numpy as np
import pytest

from hw_sim.rendering.sensor import DSNU_E, E_PER_DN, OFFSET_DN, PRNU, READ_NOISE_E, Sensor


def frames(sensor: Sensor, level_dn: float, count: int, shape: tuple[int, int], gain_db: float = 0.0) -> np.ndarray:
    electrons = np.full(shape, level_dn * E_PER_DN, np.float32)
    return np.stack([sensor.read_out(electrons, gain_db, seed).astype(float) for seed in range(count)])


def test_the_photon_transfer_curve_gives_back_gain_and_read_noise() -> None:
    """The camera test of EMVA 1288: variance against mean is a line whose slope is the gain."""
    sensor = Sensor(300, 200, 1, noise=True)
    means, variances = [], []
    for level_dn in np.linspace(10.0, 220.0, 8):
        a, b = frames(sensor, level_dn, 2, (200, 300))
        means.append(a.mean() - OFFSET_DN)
        variances.append(np.var(a - b) / 2 - 1 / 12)
    slope, offset = np.polyfit(means, variances, 1)
    assert slope == pytest.approx(1 / E_PER_DN, rel=0.05)
    assert offset == pytest.approx((READ_NOISE_E / E_PER_DN) ** 2, abs=0.06)


def test_noise_at_mid_level_is_what_the_accuracy_figures_assume() -> None:
    stack = frames(Sensor(200, 200, 2, noise=True), 128.0, 30, (200, 200))
    assert np.sqrt(stack.var(axis=0, ddof=1).mean()) == pytest.approx(1.65, abs=0.08)


def test_the_fixed_pattern_stays_and_grows_with_light() -> None:
    sensor = Sensor(100, 100, 3, noise=True)
    for level_dn in (20.0, 200.0):
        stack = frames(sensor, level_dn, 120, (100, 100))
        fixed = stack.mean(axis=0)
        expected = np.hypot(PRNU * level_dn, DSNU_E / E_PER_DN)
        left = np.sqrt(max(fixed.var() - stack.var(axis=0).mean() / 120, 0.0))
        assert left == pytest.approx(expected, rel=0.12)
    other = Sensor(100, 100, 4, noise=True)
    mine, theirs = frames(sensor, 200.0, 60, (100, 100)), frames(other, 200.0, 60, (100, 100))
    assert abs(np.corrcoef(mine.mean(0).ravel(), theirs.mean(0).ravel())[0, 1]) < 0.1


def test_noise_is_white_in_space_and_time() -> None:
    stack = frames(Sensor(256, 256, 5, noise=True), 100.0, 6, (256, 256))
    noise = stack - stack.mean(axis=0)
    flat = noise.reshape(6, -1)
    # Subtracting the mean of six frames leaves −1/5 between any two.
    between = np.corrcoef(flat)[np.triu_indices(6, 1)]
    np.testing.assert_allclose(between, -0.2, atol=0.02)
    one = noise[0]
    for shifted in (one[:, 1:], one[1:, :]):
        same = one[: shifted.shape[0], : shifted.shape[1]]
        assert abs(np.corrcoef(same.ravel(), shifted.ravel())[0, 1]) < 0.02
    rows = np.corrcoef(one)
    assert np.abs(rows[np.triu_indices(256, 1)]).max() < 0.5, "no row repeats another"


def test_without_noise_grey_is_a_straight_line_up_to_saturation() -> None:
    sensor = Sensor(256, 1, 1, noise=False)
    ramp = (np.arange(256, dtype=np.float32) * np.float32(E_PER_DN))[None]
    out = sensor.read_out(ramp, 0.0, 1)[0].astype(int)
    np.testing.assert_array_equal(out, np.minimum(np.arange(256) + int(OFFSET_DN), 255))
