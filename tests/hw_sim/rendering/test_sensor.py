"""Grey values scatter as a camera test of EMVA 1288 would find it: photons, read-out, fixed pattern; on the usual sensor and on others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw_sim.optics.camera_traits import CameraTraits
from hw_sim.rendering.sensor import DSNU_E, E_PER_DN, OFFSET_DN, PRNU, READ_NOISE_E, Sensor
from hw_sim.rendering.sensor_of_traits import SensorOfTraits

SHAPE = (150, 200)
PLAIN = CameraTraits(full_well_e=10_000.0, read_noise_e=0.0, black_dn=4.0, prnu=0.0, dsnu_e=0.0)
E_PER_DN_OF_PLAIN = 10_000.0 / 255.0


def usual(seed: int = 1, noise: bool = True) -> Sensor:
    return Sensor(SHAPE[1], SHAPE[0], seed, noise)


def other(noise: bool = True, **traits: float) -> SensorOfTraits:
    return SensorOfTraits(SHAPE[1], SHAPE[0], 3, noise, replace(PLAIN, **traits))


def frames(of: Sensor | SensorOfTraits, electrons: float, count: int, *exposure_s: float) -> np.ndarray:
    even = np.full(SHAPE, electrons, np.float32)
    return np.stack([of.read_out(even, 0.0, seed, *exposure_s).astype(float) for seed in range(count)])


@pytest.mark.parametrize(
    ("of", "e_per_dn", "black_dn", "read_e"),
    [(usual(), E_PER_DN, OFFSET_DN, READ_NOISE_E), (other(read_noise_e=22.0), E_PER_DN_OF_PLAIN, 4.0, 22.0)],
)
def test_the_photon_transfer_curve_gives_back_gain_black_level_and_read_noise(
    of: Sensor | SensorOfTraits, e_per_dn: float, black_dn: float, read_e: float
) -> None:
    """Variance against mean is a line whose slope is the gain."""
    electrons = np.linspace(10.0, 220.0, 8) * e_per_dn
    pairs = [frames(of, e, 4) for e in electrons]
    means = [pair.mean() for pair in pairs]
    slope, offset = np.polyfit(means, [pair.var(axis=0, ddof=1).mean() - 1 / 12 for pair in pairs], 1)
    assert slope == pytest.approx(1 / e_per_dn, rel=0.05)
    assert offset + slope * black_dn == pytest.approx((read_e / e_per_dn) ** 2, abs=0.08)
    assert np.polyval(np.polyfit(electrons, means, 1), 0.0) == pytest.approx(black_dn, abs=0.06)


@pytest.mark.parametrize(
    ("of", "e_per_dn", "prnu", "dsnu_e"),
    [(usual(3), E_PER_DN, PRNU, DSNU_E), (other(prnu=0.01, dsnu_e=100.0), E_PER_DN_OF_PLAIN, 0.01, 100.0)],
)
def test_the_fixed_pattern_stays_and_grows_with_light(
    of: Sensor | SensorOfTraits, e_per_dn: float, prnu: float, dsnu_e: float
) -> None:
    for level_dn in (20.0, 200.0):
        stack = frames(of, level_dn * e_per_dn, 50)
        left = np.sqrt(max(stack.mean(axis=0).var() - stack.var(axis=0).mean() / 50, 0.0))
        assert left == pytest.approx(np.hypot(prnu * level_dn, dsnu_e / e_per_dn), rel=0.12)


def test_noise_is_white_in_space_and_time() -> None:
    stack = frames(usual(5), 100.0 * E_PER_DN, 6)
    noise = stack - stack.mean(axis=0)
    # Subtracting the mean of six frames leaves −1/5 between any two.
    np.testing.assert_allclose(np.corrcoef(noise.reshape(6, -1))[np.triu_indices(6, 1)], -0.2, atol=0.025)
    for shifted in (noise[0][:, 1:], noise[0][1:, :]):
        same = noise[0][: shifted.shape[0], : shifted.shape[1]]
        assert abs(np.corrcoef(same.ravel(), shifted.ravel())[0, 1]) < 0.025


def test_without_noise_grey_is_a_straight_line_up_to_saturation() -> None:
    ramp = (np.arange(256, dtype=np.float32) * np.float32(E_PER_DN))[None]
    seen = Sensor(256, 1, 1, noise=False).read_out(ramp, 0.0, 1)[0].astype(int)
    np.testing.assert_array_equal(seen, np.minimum(np.arange(256) + int(OFFSET_DN), 255))
    assert (usual(noise=False).read_out(np.full(SHAPE, 100 * E_PER_DN, np.float32), 6.0206, 1) == 202).all(), "6 dB"


@pytest.mark.parametrize("deviation", [0.01, -0.02])
def test_the_response_is_off_its_chord_by_the_nonlinearity_at_half_the_well(deviation: float) -> None:
    made, fill = other(noise=False, nonlinearity=deviation, black_dn=0.0), np.array([0.02, 0.25, 0.5, 0.75, 0.98])
    # Half a DN of rounding is averaged away over many slightly different levels.
    ramp = (fill[:, None] + np.linspace(-0.01, 0.01, SHAPE[0] * SHAPE[1])) * 10_000.0
    read = [made.read_out(levels.reshape(SHAPE).astype(np.float32), 0.0, 1, 0.0).mean() for levels in ramp]
    np.testing.assert_allclose(np.array(read) / 255.0 - fill, deviation * 4.0 * fill * (1.0 - fill), atol=2e-4)


def test_rows_flicker_as_a_whole_and_hot_pixels_grow_with_the_exposure() -> None:
    rows = frames(other(row_noise_e=60.0), 3000.0, 8).mean(axis=2)
    photons_e = 3000.0**0.5 / SHAPE[1] ** 0.5
    assert rows.std() == pytest.approx(np.hypot(60.0, photons_e) / E_PER_DN_OF_PLAIN, rel=0.08)
    made = other(hot_per_million=4000.0)
    short, long = (frames(made, 0.0, 6, exposure_s).mean(axis=0) for exposure_s in (0.002, 0.02))
    hot = long > 30.0
    # 30 DN more than black in 20 ms are 10^4.7 electrons per second: of 120 pixels between 10^3 and 10^6, 52.
    assert 34 < hot.sum() < 70
    growing = hot & (long < 200.0)
    np.testing.assert_allclose((short - 4.0)[growing], (long - 4.0)[growing] / 10.0, atol=2.0)


def test_corners_lack_their_share_and_glare_takes_no_light_away() -> None:
    seen = replace(PLAIN, corner_loss=0.3).through_lens(np.full((121, 161), 1000.0, np.float32))
    assert seen[60, 80] == pytest.approx(1000.0)
    # A corner pixel's centre is half a pixel from the corner.
    corner = 1000.0 * (1.0 - 0.3 * (160**2 + 120**2) / (161**2 + 121**2))
    np.testing.assert_allclose(seen[[0, 0, -1, -1], [0, -1, 0, -1]], corner, rtol=1e-5)
    picture = np.zeros((240, 320), np.float32)
    picture[112:128, 152:168] = 5000.0
    seen = replace(PLAIN, glare=0.04).through_lens(picture)
    assert seen.sum() == pytest.approx(picture.sum(), rel=2e-3)
    thrown = 0.02 * float(picture.sum())
    for across, down in ((45, 0), (0, -45), (30, -30), (150, 100)):  # a Gaussian of 160 px of 1600: 32 of these
        near = thrown * np.exp(-(across**2 + down**2) / (2.0 * 32.0**2)) / (2.0 * np.pi * 32.0**2)
        around = seen[118 + down : 122 + down, 158 + across : 162 + across].mean()
        assert around == pytest.approx(near + thrown / picture.size, rel=0.06), (across, down)
