"""Quantiles found rank by rank are those of NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.reconstruct.quantile import median, quantile

SHARES = (*np.linspace(0.0, 1.0, 150).tolist(), 0.5, 0.997)


@pytest.mark.parametrize("count", [1, 2, 3, 24, 25, 517, 5_000])
def test_quantiles_are_those_of_numpy(count: int) -> None:
    rng = np.random.default_rng(count)
    for values in (rng.normal(size=count), rng.integers(0, 9, count).astype(np.float32), np.full(count, 3.0)):
        assert [quantile(values, share) for share in SHARES] == pytest.approx(
            [float(np.quantile(values.astype(np.float64), share)) for share in SHARES], rel=1e-12
        )
        assert median(values) == pytest.approx(float(np.median(values.astype(np.float64))), rel=1e-12)


def test_of_nothing_there_is_no_quantile() -> None:
    with pytest.raises(ValueError, match="no values"):
        median(np.empty(0))
