"""What part of a drift makes the ripple follows from the way that the fringes went before it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdicts.motion.course import steps2
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm

SEQUENCE = build_sequence(16)
AXIS = SEQUENCE.axis(Direction.X)
FRAMES = np.array([*AXIS.gray, *AXIS.sine], float)
FRAME_S = 1.0 / 60.0
CELLS = (6, 8)


def found(way_px: np.ndarray, edge_sd_px: float = 0.005, seed: int = 1) -> float | None:
    """The factor for a way of the fringes (frames,), left less right, that cells share up to a factor between −1.3 and 1.3."""
    rng = np.random.default_rng(seed)
    factors = rng.choice([-1.0, 1.0], CELLS) * rng.uniform(0.7, 1.3, CELLS)
    x = way_px[-4:]
    nothing = {name: np.zeros(CELLS) for name in DriftMap.__dataclass_fields__}
    early, late = (x[2] - x[0]) / 2.0, (x[3] - x[1]) / 2.0
    left = DriftMap(**(nothing | {"early_px": factors * early, "late_px": factors * late}))
    right = DriftMap(**nothing)
    drift = (early + late) / 2.0 * factors
    values: dict[str, Any] = dict.fromkeys(Harm.__dataclass_fields__)
    harm = Harm(**(values | {"drift_px": drift, "sd_px": np.full(CELLS, 1e-3), "weight": np.ones(CELLS)}))
    # Of the typical cell, as the course of the edges is given: left less right in the direction of its drift.
    typical = np.median(np.abs(drift)) / ((early + late) / 2.0)
    shift = typical * (way_px[:-4] - x.mean()) + edge_sd_px * rng.standard_normal(len(AXIS.gray))
    return steps2((shift, np.full(len(shift), edge_sd_px)), left, right, harm, SEQUENCE, FRAME_S)


def shake(hz: float, size_px: float) -> np.ndarray:
    """A shake that passes its middle in the middle of the x-sines."""
    return size_px * np.sin(2.0 * np.pi * hz * FRAME_S * (FRAMES - 10.5))


@pytest.mark.parametrize(("hz", "factor"), [(6.0, 0.89), (10.0, 0.67)])
def test_a_quick_shake_is_not_taken_for_a_steady_movement_that_harms_more(hz: float, factor: float) -> None:
    way = shake(hz, 0.4)
    x = way[-4:]
    true = (x[1] - x[0] + x[3] - x[2]) / 2.0 / ((x[2] - x[0] + x[3] - x[1]) / 4.0)
    assert true == pytest.approx(factor, abs=0.01)
    assert found(way) == pytest.approx(true**2, abs=0.08)
    assert found(shake(hz, 4.0), 0.05) == pytest.approx(found(way), abs=0.05), "however large it is"


STEADY = FRAMES - 10.5
GRAY = np.arange(len(FRAMES)) < len(AXIS.gray)


@pytest.mark.parametrize(
    ("way", "within"),
    [
        (0.2 * STEADY, 0.04),
        (0.2 * STEADY - 0.015 * STEADY**2, 0.04),
        (0.2 * STEADY * np.where(GRAY, 0.8, 1.0), 0.06),
        (0.2 * STEADY * np.where(GRAY, np.nan, 1.0), 0.1),
    ],
    ids=["steady", "gathers speed", "edges whose shifts are a fifth too small", "no edge is known"],
)
def test_a_movement_that_does_not_shake_harms_as_its_drift_says(way: np.ndarray, within: float) -> None:
    assert found(way) == pytest.approx(1.0, abs=within)


def test_a_drift_that_no_cell_is_certain_of_is_not_followed() -> None:
    assert found(1e-4 * STEADY) is None
