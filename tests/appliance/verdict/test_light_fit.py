"""The fit of changing light, block by block, is that of plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.verdict.light_changes import Level, find_frequency_hz
from appliance.verdict.light_fit import COSINE, EXPECTED, SIGMA, SINE, THIRD, fit_blocks

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
    row, column = rng.uniform(0.0, 300.0, PIXELS), rng.uniform(0.0, 400.0, PIXELS)
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
        terms = np.stack([*waves, np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        shift, sigma, expected = by_numpy(length[block] / contrast[block], terms, contrast[block])
        twice = np.stack([np.ones_like(x), np.cos(2.0 * t), np.sin(2.0 * t)], axis=1)
        level, _, _ = by_numpy(third[block], twice, contrast[block])
        left[block] -= twice @ level
        wanted = {COSINE: shift[0], SINE: shift[1], THIRD: level[0], SIGMA: sigma, EXPECTED: expected}
        assert {key: float(found[key, k]) for key in wanted} == pytest.approx(wanted, rel=1e-6, abs=1e-9)
    assert np.allclose(rest, left, atol=1e-9)


@pytest.mark.parametrize("hz", [5.0, 12.5, 20.0, 29.5, 30.0])
def test_a_lamp_is_found_at_its_frequency_up_to_half_the_frame_rate(hz: float) -> None:
    frames = np.arange(24)
    value = 0.1 * np.cos(2.0 * np.pi * hz * frames / 60.0 + 0.4)
    groups = np.array(["gray x", "sine x", "sine y"])[frames // 8]
    levels = []
    for group in np.unique(groups):
        own = groups == group
        mean = value[own].mean()
        levels += [Level(int(k), str(group), float(value[k] - mean)) for k in frames[own]]
    found = find_frequency_hz(tuple(levels), 1.0 / 60.0)
    assert found is not None
    assert found[0] == pytest.approx(hz, abs=0.3)
    assert found[1] > 0.99
