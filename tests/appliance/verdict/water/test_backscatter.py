"""The sums by which the water is judged are those of plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.verdict.water.backscatter import disagreement, sum_cells

PIXELS, CELLS = 3_001, 5


@pytest.mark.parametrize("count", [1, 2, 3_000, 3_001])
def test_how_far_opposite_steps_disagree_is_what_numpy_finds(count: int) -> None:
    """Fringes with a second harmonic that differs from cell to cell, flicker and noise."""
    rng = np.random.default_rng(count)
    cell = rng.integers(0, CELLS, count)
    angle, light = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(60.0, 120.0, count)
    harmonic = 0.05 * (cell - 2) * np.cos(2.0 * angle)
    waves = np.stack([np.cos(angle), -np.sin(angle), -np.cos(angle), np.sin(angle)])
    steps = light * (1.0 + 0.7 * waves + harmonic * np.array([[1.0], [-1.0], [1.0], [-1.0]]))
    steps += rng.normal(0.0, 1.5, steps.shape) + np.array([[3.0], [0.0], [0.0], [0.0]])
    grey = np.rint(steps).clip(0.0, 255.0).astype(np.uint8)
    common, scaled = disagreement(grey, cell, CELLS)

    i0, i1, i2, i3 = grey.astype(np.float64)
    off = i0 + i2 - i1 - i3
    assert common == np.median(off)
    off -= np.median(off)
    second = ((i0 - i2) ** 2 - (i3 - i1) ** 2) / np.hypot(i0 - i2, i3 - i1)
    for k in range(CELLS):
        mine = cell == k
        off[mine] -= np.sum(off[mine] * second[mine]) / max(np.sum(second[mine] ** 2), 1.0) * second[mine]
    assert scaled == pytest.approx(np.abs(off) / np.sqrt(i0 + i1 + i2 + i3 + 1.0), rel=1e-3, abs=1e-4)


def test_what_is_far_from_its_cells_mean_has_no_part_in_the_sums() -> None:
    rng = np.random.default_rng(1)
    between = rng.normal(10.0, 1.0, (6, PIXELS)).astype(np.float32)
    between[0] = rng.integers(0, CELLS, PIXELS)
    between[3, ::100] += 40.0
    count, sums, squares = sum_cells(between, CELLS)
    for k in range(CELLS):
        mine = between[:, between[0] == k].astype(np.float64)
        off = mine[3] - mine[3].mean()
        kept = mine[:, np.abs(off) <= 4.0 * np.sqrt(np.mean(off**2))]
        assert 0 < kept.shape[1] < mine.shape[1]
        assert count[k] == kept.shape[1]
        assert sums[:, k] == pytest.approx(kept[1:].sum(axis=1), rel=1e-6)
        assert squares[k] == pytest.approx(np.sum(kept[3] ** 2), rel=1e-6)
