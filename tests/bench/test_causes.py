"""A slice of the grid that the naming of causes is measured over: one scene of each factor, end to end, and the grid's own promise."""

from __future__ import annotations

import pytest

from appliance.measure.fault import FaultCode
from appliance.measure.verdict import Grade
from bench.verdict.causes_frames import frames_of
from bench.verdict.causes_scenes import Spoilt, draw_base, exposure_of, grid_of
from bench.verdict.causes_truth import judged

BASE = draw_base(10_000, 1)


@pytest.mark.parametrize(
    ("spoilt", "grade", "first"),
    [
        (Spoilt(), Grade.GOOD, []),
        (Spoilt(water="black"), Grade.BAD, [FaultCode.WATER_DIRTY]),
        (Spoilt(light="dimmer"), Grade.BAD, [FaultCode.TOO_DARK]),
        (Spoilt(distance="near"), Grade.BAD, [FaultCode.SCAN_NEAR]),
        (Spoilt(distance="nothing"), Grade.BAD, [FaultCode.NOTHING_SEEN]),
    ],
    ids=lambda value: value.name if isinstance(value, Spoilt) else "",
)
def test_a_bad_scan_has_a_reason_and_the_first_is_the_true_one(
    spoilt: Spoilt, grade: Grade, first: list[FaultCode]
) -> None:
    found = judged(frames_of(BASE, spoilt, None), exposure_of(spoilt))
    assert (found.grade, list(found.reasons[:1])) == (grade, first)


def test_every_scene_of_the_grid_is_there_without_each_of_its_factors() -> None:
    """That is how true causes are found."""
    grid = grid_of(10_000, 0)
    assert len(grid) >= 40
    for spoilt in grid:
        assert all(spoilt.without(factor) in grid for factor in spoilt.present)
