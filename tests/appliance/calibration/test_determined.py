"""Normal equations that leave something free name it; all others are solved, whatever their units."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.calibration.determined import UndeterminedError, solved

NAMES = ("length (mm)", "turn (rad)", "shift (mm)")


def test_units_of_any_size_are_solved() -> None:
    rows = np.random.default_rng(1).normal(size=(9, 3)) * [1e6, 1e-6, 1.0]
    truth = np.array([3e-6, 2e6, -1.0])
    assert solved(rows.T @ rows, rows.T @ (rows @ truth), NAMES) == pytest.approx(truth)
    scale = np.sqrt(np.diag(rows.T @ rows))
    inverse = solved(rows.T @ rows, np.eye(3), NAMES) * np.outer(scale, scale)
    assert np.allclose(inverse @ (rows.T @ rows / np.outer(scale, scale)), np.eye(3), atol=1e-6)


@pytest.mark.parametrize(
    ("free", "names"),
    [
        ([[1.0, 2.0, 0.0], [2.0, 4.0, 0.0], [0.0, 0.0, 1.0]], NAMES[:2]),
        ([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], NAMES[1:2]),
        ([[1.0, 0.0, 0.0], [0.0, 1.0, np.nan], [0.0, np.nan, 1.0]], NAMES[1:]),
        ([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]], NAMES[1:2]),
    ],
)
def test_what_is_free_is_named(free: list[list[float]], names: tuple[str, ...]) -> None:
    with pytest.raises(UndeterminedError) as raised:
        solved(np.array(free), np.ones(3), NAMES)
    assert raised.value.names == names
