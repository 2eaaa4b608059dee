"""Light that the object itself throws into its dark stripes is not called backscatter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.verdict.water.backscatter import Cells
from appliance.verdict.water.beam import GatheredLight
from appliance.verdict.water.judge import halo_share

COUNT = 120
RNG = np.random.default_rng(10_001)
PLACE = np.linspace(0.0, 1.0, COUNT)
GATHERED = GatheredLight(
    (0.5 + 2.0 * PLACE)[:, None], np.full((COUNT, 1), 0.8), np.full(COUNT, 300.0), np.ones(COUNT), np.ones(COUNT)
)
SIGNAL_DN = 80.0 + 40.0 * np.sin(7.0 * PLACE)


def cells(veil_dn: float, halo: float) -> Cells:
    seen = veil_dn * (0.5 + 2.0 * PLACE) + halo * SIGNAL_DN + RNG.normal(0.0, 0.05, COUNT)
    return Cells(
        np.arange(COUNT),
        np.full(COUNT, 100.0),
        np.zeros((COUNT, 2)),
        seen,
        np.full(COUNT, 0.05),
        SIGNAL_DN,
        np.full(COUNT, 2.0),
    )


def test_scattering_by_small_angles_is_told_from_backscatter() -> None:
    """A third of the light of a complete scan was called backscatter at 1 /m, where it was 2 %."""
    made = cells(2.0, 0.4)
    true = 0.4 * SIGNAL_DN.sum() / (made.signal_dn + made.backscatter_dn).sum()
    assert halo_share(made, GATHERED) == pytest.approx(true, rel=0.05)


def test_backscatter_alone_is_no_halo() -> None:
    assert halo_share(cells(30.0, 0.0), GATHERED) == 0.0


def test_a_trace_of_halo_leaves_the_backscatter_as_it_is_measured() -> None:
    assert halo_share(cells(5.0, 0.02), GATHERED) == 0.0


def test_where_the_object_sends_nothing_back_there_is_no_halo() -> None:
    """Its light then explains nothing: the equations have no solution, for any attenuation."""
    assert halo_share(replace(cells(5.0, 0.0), signal_dn=np.zeros(COUNT)), GATHERED) == 0.0
