"""Cameras of another make: each strength does to the grey values what a test bench of EMVA 1288 would find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw_sim.optics.camera_traits import RANGES, CameraTraits
from hw_sim.rendering.sensor_of_traits import SensorOfTraits

PLAIN = CameraTraits(full_well_e=10_000.0, read_noise_e=0.0, black_dn=4.0, prnu=0.0, dsnu_e=0.0)
SHAPE = (150, 200)


def sensor(traits: CameraTraits, noise: bool = True) -> SensorOfTraits:
    return SensorOfTraits(SHAPE[1], SHAPE[0], 3, noise, traits)


def frames(made: SensorOfTraits, electrons: float, count: int, exposure_s: float = 0.01) -> np.ndarray:
    even = np.full(SHAPE, electrons, np.float32)
    return np.stack([made.read_out(even, 0.0, seed, exposure_s).astype(float) for seed in range(count)])


def test_photon_transfer_gives_back_well_black_level_and_read_noise() -> None:
    made = sensor(replace(PLAIN, read_noise_e=22.0))
    means, variances = [], []
    for electrons in np.linspace(400.0, 8800.0, 7):
        a, b = frames(made, electrons, 2)
        means.append(a.mean())
        variances.append(np.var(a - b) / 2 - 1 / 12)
    slope, offset = np.polyfit(means, variances, 1)
    per_e = 255.0 / 10_000.0
    assert slope == pytest.approx(per_e, rel=0.04)
    assert offset + slope * 4.0 == pytest.approx((22.0 * per_e) ** 2, abs=0.08)
    assert np.polyval(np.polyfit(np.linspace(400.0, 8800.0, 7), means, 1), 0.0) == pytest.approx(4.0, abs=0.05)


@pytest.mark.parametrize("deviation", [0.01, -0.02])
def test_the_response_is_off_its_chord_by_the_nonlinearity_at_half_the_well(deviation: float) -> None:
    made = sensor(replace(PLAIN, nonlinearity=deviation, black_dn=0.0), noise=False)
    fill = np.array([0.02, 0.25, 0.5, 0.75, 0.98])
    # Half a DN of rounding is averaged away over many slightly different levels.
    ramp = (fill[:, None] + np.linspace(-0.01, 0.01, 20_000)) * 10_000.0
    read = made_read(made, ramp)
    np.testing.assert_allclose(read / 255.0 - fill, deviation * 4.0 * fill * (1.0 - fill), atol=2e-4)


def made_read(made: SensorOfTraits, ramp: np.ndarray) -> np.ndarray:
    """Return the mean grey value of each row of levels (n, 20000), laid over the sensor one after the other."""
    out = []
    for levels in ramp:
        picture = np.resize(levels, SHAPE).astype(np.float32)
        grey = made.read_out(picture, 0.0, 1, 0.0).astype(float).ravel()[: levels.size]
        out.append(grey.mean())
    return np.array(out)


def test_rows_flicker_as_a_whole_and_anew_in_each_frame() -> None:
    stack = frames(sensor(replace(PLAIN, row_noise_e=60.0)), 3000.0, 8)
    rows = stack.mean(axis=2)
    per_e, photon_e = 255.0 / 10_000.0, 3000.0**0.5
    expected = np.hypot(60.0, photon_e / SHAPE[1] ** 0.5) * per_e
    assert rows.std() == pytest.approx(expected, rel=0.08)
    columns = stack.mean(axis=1)
    assert columns.std() < 1.3 * np.hypot(60.0 / SHAPE[0] ** 0.5, photon_e / SHAPE[0] ** 0.5) * per_e
    assert np.abs(np.corrcoef(rows)[np.triu_indices(8, 1)]).max() < 0.35


def test_hot_pixels_stay_where_they_are_and_grow_with_the_exposure() -> None:
    made = sensor(replace(PLAIN, hot_per_million=4000.0))
    short, long = frames(made, 0.0, 6, 0.002).mean(axis=0), frames(made, 0.0, 6, 0.02).mean(axis=0)
    hot = long > 30.0
    # 30 DN more than black in 20 ms are 10^4.7 electrons per second: of 120 pixels between 10^3 and 10^6, 52.
    assert 34 < hot.sum() < 70
    assert (long[hot] >= short[hot]).all()
    unsaturated = hot & (long < 200.0)
    np.testing.assert_allclose((short - 4.0)[unsaturated], (long - 4.0)[unsaturated] / 10.0, atol=2.0)
    assert (frames(sensor(PLAIN), 0.0, 2, 0.02) < 8.0).all()


def test_the_fixed_pattern_has_its_size() -> None:
    made = sensor(replace(PLAIN, prnu=0.01, dsnu_e=100.0))
    per_e = 255.0 / 10_000.0
    for electrons in (1500.0, 8000.0):
        stack = frames(made, electrons, 60)
        fixed = np.sqrt(stack.mean(axis=0).var() - stack.var(axis=0).mean() / 60)
        assert fixed == pytest.approx(np.hypot(0.01 * electrons, 100.0) * per_e, rel=0.06)


def test_a_full_well_holds_no_more() -> None:
    made = sensor(PLAIN, noise=False)
    assert (made.read_out(np.full(SHAPE, 1e6, np.float32), -12.0, 1) == round(1.04 * 255 * 10 ** (-12 / 20) + 4)).all()
    assert (made.read_out(np.full(SHAPE, 1e6, np.float32), 0.0, 1) == 255).all()


def test_corners_lack_their_share_and_the_middle_nothing() -> None:
    seen = replace(PLAIN, corner_loss=0.3).through_lens(np.full((121, 161), 1000.0, np.float32))
    assert seen[60, 80] == pytest.approx(1000.0)
    # A corner pixel's centre is half a pixel from the corner.
    diagonal2 = 161**2 + 121**2
    corner = 1000.0 * (1.0 - 0.3 * (160**2 + 120**2) / diagonal2)
    np.testing.assert_allclose(seen[[0, 0, -1, -1], [0, -1, 0, -1]], corner, rtol=1e-5)
    assert seen[60, 0] == pytest.approx(1000.0 * (1.0 - 0.3 * 160**2 / diagonal2), rel=1e-5)


def test_glare_takes_no_light_away_and_brings_some_to_the_dark() -> None:
    picture = np.zeros((240, 320), np.float32)
    picture[100:140, 100:160] = 5000.0
    seen = replace(PLAIN, glare=0.04).through_lens(picture)
    assert seen.sum() == pytest.approx(picture.sum(), rel=2e-3)
    assert seen[230, 310] == pytest.approx(0.02 * picture.mean(), rel=0.05), "far away: the half that goes everywhere"
    assert seen[95, 130] > 3.0 * seen[230, 310], "the other half stays around"
    even = np.full((60, 80), 700.0, np.float32)
    np.testing.assert_allclose(replace(PLAIN, glare=0.04).through_lens(even), even, rtol=1e-5)


def test_half_of_the_glare_lies_round_about_its_source() -> None:
    """A Gaussian of 160 px of 1600: 32 of these."""
    picture = np.zeros((240, 320), np.float32)
    picture[112:128, 152:168] = 1000.0
    seen = replace(PLAIN, glare=0.04).through_lens(picture)
    thrown = 0.02 * float(picture.sum())
    for across, down in ((45, 0), (-45, 0), (0, 45), (0, -45), (30, -30)):
        near = thrown * np.exp(-(across**2 + down**2) / (2.0 * 32.0**2)) / (2.0 * np.pi * 32.0**2)
        around = seen[118 + down : 122 + down, 158 + across : 162 + across].mean()
        assert around == pytest.approx(near + thrown / picture.size, rel=0.06), (across, down)


def test_drawn_cameras_are_at_least_one_percent_from_linear_and_none_is_the_ordinary_one() -> None:
    drawn = [CameraTraits.drawn(np.random.default_rng(seed)) for seed in range(60)]
    assert all(0.01 <= abs(c.nonlinearity) <= 0.02 for c in drawn)
    assert 10 < sum(c.nonlinearity > 0 for c in drawn) < 50
    for name in RANGES.keys() - {"nonlinearity"}:
        values = [getattr(c, name) for c in drawn]
        assert RANGES[name].low <= min(values) < max(values) <= RANGES[name].high
    with pytest.raises(ValueError, match=r"cameras: glare = 0.9; allowed are 0..0.5"):
        CameraTraits(glare=0.9)
