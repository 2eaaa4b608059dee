"""The fit of changing light, block by block, is that of plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.verdict.light.changes import LightLevel, find_frequency_hz
from appliance.verdict.light.fit import (
    COSINE,
    EXPECTED,
    SIGMA,
    SINE,
    THIRD,
    common_of_neighbours,
    fit_blocks,
    in_blocks,
    medians_of,
    quantile_of,
    stripe_levels,
)

Floats = NDArray[np.float64]
PIXELS, BLOCKS = 2_400, 4


def by_numpy(value: Floats, columns: Floats, contrast: Floats) -> tuple[Floats, float, float]:
    """The same regression, term for term."""
    weight = np.minimum(contrast, np.quantile(contrast, 0.9)) ** 2
    for _ in range(2):
        normal = (columns * weight[:, None]).T @ columns
        normal += 1e-9 * np.trace(normal) * np.eye(normal.shape[0])
        inverse = np.linalg.inv(normal)
        coefficients = inverse @ ((columns * weight[:, None]).T @ value)
        residual = value - columns @ coefficients
        expected = float(np.sqrt(max(inverse[0, 0], inverse[1, 1])))
        freedom = max(int(np.count_nonzero(weight)) - columns.shape[1], 1)
        sigma = expected * float(np.sqrt(np.sum(weight * residual**2) / freedom))
        size = max(1.4826 * float(np.median(np.abs(residual) * contrast)), 1e-3)
        weight = np.where(np.abs(residual) * contrast > 3.0 * size, 0.0, weight)
    return np.asarray(coefficients), sigma, expected


@pytest.mark.parametrize("seed", range(6))
def test_every_block_is_fitted_as_numpy_fits_it(seed: int) -> None:
    """Fringes on a texture with noise, edges, and light that differs between the images."""
    rng = np.random.default_rng(seed)
    contrast = rng.uniform(20.0, 180.0, PIXELS)
    row, column = rng.integers(0, 300, PIXELS), rng.integers(0, 400, PIXELS)
    angle = rng.uniform(0.0, 2.0 * np.pi, PIXELS) + 0.01 * column
    steps = [np.cos(angle), -np.sin(angle), -np.cos(angle), np.sin(angle)]
    extra = rng.normal(0.0, 0.02, 4)
    four = np.stack([contrast * (0.5 + 0.4 * step + e) for step, e in zip(steps, extra, strict=True)])
    four += rng.normal(0.0, 1.5, four.shape)
    four[:, rng.random(PIXELS) < 0.03] += rng.normal(0.0, 30.0, (4, 1))
    order = rng.permutation(PIXELS)[:-100]
    ends = np.sort(rng.choice(np.arange(200, order.size - 200), BLOCKS - 1, replace=False))
    ends = np.append(ends, order.size)
    found, rest = fit_blocks(four, contrast, row, column, order, ends)
    cosine, sine = four[0] - four[2], four[3] - four[1]
    length = np.hypot(cosine, sine)
    c, s = cosine / length, sine / length
    third = (four[0] - four[1] + four[2] - four[3]) / contrast
    left = third.copy()
    for k, block in enumerate(np.split(order, ends[:-1])):
        y, x = ((2.0 * at - at.min() - at.max()) / (at.max() - at.min()) for at in (row[block], column[block]))
        t = np.arctan2(s[block], c[block])
        waves = [np.cos(t), np.sin(t), np.cos(4.0 * t), np.sin(4.0 * t)]
        dark = contrast[block].mean() / contrast[block]
        terms = np.stack([*waves, np.ones_like(x), x, y, x * x, x * y, y * y, dark], axis=1)
        shift, sigma, expected = by_numpy(length[block] / contrast[block], terms, contrast[block])
        harmonics = [wave(m * t) for m in (2.0, 6.0, 10.0) for wave in (np.cos, np.sin)]
        twice = np.stack([np.ones_like(x), *harmonics], axis=1)
        level, _, _ = by_numpy(third[block], twice, contrast[block])
        left[block] -= twice @ level
        wanted = {COSINE: shift[0], SINE: shift[1], THIRD: level[0], SIGMA: sigma, EXPECTED: expected}
        assert {key: float(found[key, k]) for key in wanted} == pytest.approx(wanted, rel=1e-6, abs=1e-9)
    assert np.allclose(rest, left, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 23, 24, 25, 520, 5_000])
def test_quantiles_of_a_block_are_those_of_numpy(count: int) -> None:
    """Whatever the values: evenly spread, equal, of a few kinds, or nearly all in one bin beside an outlier."""
    rng = np.random.default_rng(count)
    outlier = np.where(np.arange(count) == count // 2, 1e12, rng.random(count))
    for values in (rng.normal(size=count), np.full(count, 3.0), rng.integers(0, 9, count).astype(np.float64), outlier):
        for share in (0.0, 0.1, 0.5, 0.9, 1.0):
            assert quantile_of(values, share) == pytest.approx(float(np.quantile(values, share)), rel=1e-12)


def lattice(rng: np.random.Generator, shape: tuple[int, int], part: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of a random part of a grid, row by row."""
    row, column = np.nonzero(rng.random(shape) < part)
    return np.ascontiguousarray(row), np.ascontiguousarray(column)


@pytest.mark.parametrize("seed", range(3))
def test_what_neighbours_have_in_common_is_that_of_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (60, 80)
    row, column = lattice(rng, shape, 0.7)
    contrast = rng.uniform(20.0, 180.0, row.size)
    rest = rng.normal(0.0, 1.0, row.size) / contrast
    block = np.where(row < 55, column // 40, -1)  # the last rows belong to no block
    order = np.concatenate([np.flatnonzero(block == k) for k in range(2)])
    ends = np.cumsum([np.count_nonzero(block == k) for k in range(2)])
    most_dn, most_share = 4.0 * float(np.median(np.abs(rest * contrast))), 5.0 * float(np.median(np.abs(rest)))
    found = common_of_neighbours(rest, contrast, row, column, order, ends, most_dn, most_share)
    value, weight, of = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, -1)
    grey = rest * contrast
    most = np.maximum(most_dn, most_share * contrast)
    value[row, column] = np.clip(grey, -most, most)
    weight[row, column], of[row, column] = contrast, block
    for k in range(2):
        sums = weights = 0.0
        for one, other in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
            both = weight[one] * weight[other]
            use = np.isfinite(both) & (of[one] == k) & (of[other] >= 0)
            sums += float((value[one] * value[other] * both)[use].sum())
            weights += float((both**2)[use].sum())
        assert found[k] == pytest.approx(sums / weights, rel=1e-9)


def test_fine_light_before_dark_and_bright_is_told_in_its_square() -> None:
    """A part of 0.02 of the projector's light, in squares of 6 px, before labels ten times as bright as the rest."""
    rng = np.random.default_rng(5)
    row, column = lattice(rng, (150, 200), 1.0)
    contrast = np.where(rng.random(row.size) < 0.3, 20.0, 200.0)
    share = 0.02 * np.where((row // 6 + column // 6) % 2, 1.0, -1.0)
    noisy = share + rng.normal(0.0, 2.0, row.size) / contrast
    order, ends = np.arange(row.size), np.array([row.size])
    seen = common_of_neighbours(noisy, contrast, row, column, order, ends, 1e3, 1e3)
    # Every sixth pair is one of two squares.
    assert seen[0] == pytest.approx(0.02**2 * (1.0 - 2.0 / 6.0), rel=0.05)
    none = common_of_neighbours(noisy - share, contrast, row, column, order, ends, 1e3, 1e3)
    assert abs(none[0]) < 0.02**2 / 20.0


def test_the_level_of_stripes_is_half_way_between_two_medians() -> None:
    rng = np.random.default_rng(6)
    contrast = rng.uniform(50.0, 180.0, 4_000)
    dark = rng.uniform(3.0, 9.0, 4_000).astype(np.float32)
    lit = rng.random(4_000) < 0.4
    share = np.where(lit, 1.03, 0.02) + rng.normal(0.0, 0.02, 4_000)
    grey = np.rint(np.stack([dark, dark + share * contrast])).clip(0.0, 255.0).astype(np.uint8)
    share = (grey[1] - grey[0].astype(np.float64)) / contrast
    found = stripe_levels(grey, np.array([1]), 0, np.arange(4_000), contrast, 100)
    assert found[0] == pytest.approx(0.5 * (np.median(share[~lit]) + np.median(share[lit])), abs=2e-4)
    assert np.isnan(stripe_levels(grey, np.array([0]), 0, np.arange(4_000), contrast, 100))[0]  # no stripe is lit


def test_blocks_hold_the_good_pixels_of_their_part_of_the_image_row_by_row_and_small_ones_are_left_out() -> None:
    good = np.random.default_rng(7).random((31, 43)) < 0.5
    good[:11, :15] = False
    good[2, 3:7] = True  # the only ones of the first of three by three blocks
    pixels, rows, columns, order, ends = in_blocks(good, (3, 3), 5)
    np.testing.assert_array_equal(pixels, np.flatnonzero(good))
    np.testing.assert_array_equal((rows, columns), np.nonzero(good))
    block = rows * 3 // 31 * 3 + columns * 3 // 43
    wanted = [np.flatnonzero(block == k) for k in range(1, 9)]
    np.testing.assert_array_equal(order, np.concatenate(wanted))
    np.testing.assert_array_equal(ends, np.cumsum([one.size for one in wanted]))
    value = np.random.default_rng(8).normal(size=pixels.size)
    np.testing.assert_allclose(medians_of(value, order, ends), [np.median(value[one]) for one in wanted], rtol=1e-12)
    assert in_blocks(good, (3, 3), 4)[4].size == 9


@pytest.mark.parametrize("hz", [5.0, 12.5, 20.0, 29.5, 30.0])
def test_a_lamp_is_found_at_its_frequency_up_to_half_the_frame_rate(hz: float) -> None:
    frames = np.arange(24)
    value = 0.1 * np.cos(2.0 * np.pi * hz * frames / 60.0 + 0.4)
    groups = np.array(["gray x", "sine x", "sine y"])[frames // 8]
    levels = []
    for group in np.unique(groups):
        own = groups == group
        mean = value[own].mean()
        levels += [LightLevel(int(k), str(group), float(value[k] - mean)) for k in frames[own]]
    found = find_frequency_hz(tuple(levels), 1.0 / 60.0)
    assert found is not None
    assert found[0] == pytest.approx(hz, abs=0.3)
    assert found[1] > 0.99


def test_frames_that_come_too_slowly_tell_no_frequency() -> None:
    levels = tuple(LightLevel(k, "gray x", 0.1 * (-1.0) ** k) for k in range(24))
    assert find_frequency_hz(levels, 1.0 / 1.9) is None
    assert find_frequency_hz(levels, 1.0 / 60.0) is not None, "the same levels do at a projector's usual rate"
