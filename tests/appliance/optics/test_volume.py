"""The working range of a housing, and what goes with its size."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.config import default_rig_path, load_rig
from appliance.instrument import design_of, volume_of
from appliance.optics.volume import STANDARD, WorkingVolume

SMALL = WorkingVolume(264.0, 300.0, 336.0)


def test_the_shipped_rig_file_states_the_standard_housing() -> None:
    rig = load_rig(default_rig_path())
    assert volume_of(rig) == STANDARD
    assert design_of(rig).rig.volume == STANDARD


def test_lengths_of_the_standard_housing_stay_as_they_are_to_the_last_bit() -> None:
    lengths = np.random.default_rng(1).uniform(0.01, 2000.0, 1000).tolist()
    assert [STANDARD.scaled(mm) for mm in lengths] == lengths
    assert [SMALL.scaled(mm) for mm in (500.0, 440.0, 700.0)] == pytest.approx([300.0, 264.0, 420.0])


@pytest.mark.parametrize("wrong", [(500.0, 440.0, 560.0), (440.0, 600.0, 560.0), (-1.0, 500.0, 560.0)])
def test_a_range_without_order_is_refused_with_the_remedy(wrong: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match=r"correct \[volume\] in the rig file"):
        WorkingVolume(*wrong)
