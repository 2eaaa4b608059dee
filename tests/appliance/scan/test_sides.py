"""Either camera's part is the one that is asked for, and a third camera there is not."""

from __future__ import annotations

import pytest

from appliance.scan.noise import CameraNoise, StereoNoise
from appliance.scan.sides import SIDES, of_side

LEFT, RIGHT = CameraNoise(0.6, 0.02, 2.0), CameraNoise(0.9, 0.05, 3.0)


def test_each_camera_gets_its_own_part() -> None:
    both = StereoNoise(LEFT, RIGHT)
    assert [of_side(both, side) for side in SIDES] == [LEFT, RIGHT]


def test_a_camera_that_there_is_not_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="side 'middle': the cameras are called left and right"):
        of_side(StereoNoise(LEFT, RIGHT), "middle")
