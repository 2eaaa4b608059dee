"""The ladder's measurement is honest: its poses are unseen ones."""

from __future__ import annotations

import numpy as np
import pytest

from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES, unseen
from tests.support.calibrating import hidden_rig


@pytest.mark.parametrize("truth_set", ["realistic", "paper"])
def test_unseen_poses_are_the_same_each_time_and_none_calibrates(truth_set: str) -> None:
    truth = hidden_rig(truth_set, 5)
    found = unseen(truth, 4, 3, 3)
    assert found == unseen(truth, 4, 3, 3)
    assert [name for name, _ in found] == ["ballbar"] * 4 + ["plane"] * 3 + ["frustum"] * 3
    for name, used in (("ballbar", CALIBRATION_BARS), ("plane", CALIBRATION_PLANES)):
        for pose in (pose for thing, pose in found if thing == name):
            assert min(np.abs(np.subtract(pose, other)).max() for other in used) > 3.0
