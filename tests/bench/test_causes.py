"""A slice of the grid that the naming of causes is measured over: one scene of each factor, end to end, and the grid's own promise."""

from __future__ import annotations

import pytest

from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.scan.grade import Grade
from bench.verdict.causes_frames import frames_of
from bench.verdict.causes_scenes import Spoilt, draw_base, exposure_of, grid_of
from bench.verdict.causes_truth import Outcome, Truth, judged

BASE = draw_base(10_000, 1)


def outcome(spoilt: Spoilt) -> Outcome:
    return judged(frames_of(BASE, spoilt, None), exposure_of(spoilt))


@pytest.mark.parametrize(
    ("spoilt", "expected"),
    [
        (Spoilt(water="black"), FaultCode.WATER_DIRTY),
        (Spoilt(light="dimmer"), FaultCode.TOO_DARK),
        (Spoilt(distance="near"), FaultCode.SCAN_NEAR),
        (Spoilt(distance="nothing"), FaultCode.NOTHING_SEEN),
    ],
    ids=lambda value: value.name if isinstance(value, Spoilt) else value.value,
)
def test_a_bad_scan_has_a_reason_and_the_first_is_the_true_one(spoilt: Spoilt, expected: FaultCode) -> None:
    found = outcome(spoilt)
    assert found.grade is Grade.BAD
    assert found.reasons[0] is expected


def test_a_good_scan_has_none() -> None:
    found = outcome(Spoilt())
    assert found.grade is Grade.GOOD
    assert found.reasons == ()


def test_every_scene_of_the_grid_is_there_without_each_of_its_factors() -> None:
    """That is how true causes are found."""
    grid = grid_of(10_000, 0)
    assert len(grid) >= 40
    for spoilt in grid:
        assert all(spoilt.without(factor) in grid for factor in spoilt.present)


class Counted(Truth):
    """Scenes of which only the number of good points is known."""

    def __init__(self, good: dict[Spoilt, int]) -> None:
        super().__init__(BASE, None)
        self._good = good

    def outcome(self, spoilt: Spoilt, exposure: Exposure | None = None) -> Outcome:
        return Outcome(Grade.BAD, (), None, self._good[spoilt], None, {}, {})


@pytest.mark.parametrize(
    ("moving", "bright", "both", "mending", "true"),
    [
        (3_000, 16_000, 5_000, {"hands"}, {"hands", "light"}),
        (3_000, 30_000, 5_000, {"hands"}, {"hands"}),
        (60_000, 0, 0, {"light"}, {"light"}),
        (3_000, 5_000, 1_000, {"hands", "light"}, {"hands", "light"}),
    ],
    ids=["both must go", "bright and still is usable", "moving and well exposed is usable", "neither mends alone"],
)
def test_what_leaves_no_usable_scan_by_itself_is_a_true_cause_beside_what_mends(
    moving: int, bright: int, both: int, mending: set[str], true: set[str]
) -> None:
    """Of 100,000 points of the base, a tenth more mends, and a quarter is usable."""
    hands, light, scene = Spoilt(hands="60 x"), Spoilt(light="over"), Spoilt(hands="60 x", light="over")
    truth = Counted({Spoilt(): 100_000, hands: moving, light: bright, scene: both})
    assert truth.mending(scene, "hands") == mending
    assert truth.causes(scene, "hands") == true
