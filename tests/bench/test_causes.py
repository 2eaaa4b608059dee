"""A slice of the grid that the naming of causes is measured over: one scene of each factor, end to end, and the grid's own promise."""

from __future__ import annotations

import pytest

from appliance.measure.fault import FaultCode
from appliance.measure.verdict import Grade
from bench.verdict.causes_frames import frames_of
from bench.verdict.causes_scenes import FactorLevels, draw_base, exposure_of, grid_of
from bench.verdict.causes_truth import judge_scan

BASE = draw_base(10_000, 1)


@pytest.mark.parametrize(
    ("levels", "grade", "first"),
    [
        (FactorLevels(), Grade.GOOD, []),
        (FactorLevels(water="black"), Grade.BAD, [FaultCode.WATER_DIRTY]),
        (FactorLevels(light="dimmer"), Grade.BAD, [FaultCode.TOO_DARK]),
        (FactorLevels(distance="near"), Grade.BAD, [FaultCode.SCAN_NEAR]),
        (FactorLevels(distance="nothing"), Grade.BAD, [FaultCode.NOTHING_SEEN]),
    ],
    ids=lambda value: value.name if isinstance(value, FactorLevels) else "",
)
def test_a_bad_scan_has_a_reason_and_the_first_is_the_true_one(
    levels: FactorLevels, grade: Grade, first: list[FaultCode]
) -> None:
    found = judge_scan(frames_of(BASE, levels, None), exposure_of(levels))
    assert (found.grade, list(found.reasons[:1])) == (grade, first)


def test_every_scene_of_the_grid_is_there_without_each_of_its_factors() -> None:
    """That is how true causes are found."""
    grid = grid_of(10_000, 0)
    assert len(grid) >= 40
    for levels in grid:
        assert all(levels.without(factor) in grid for factor in levels.present)
