"""The sums that tell a fogged window from a fogged scene: how much counts, when an alarm begins and ends, and what is another scene."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.machine import events as on
from appliance.scan.fault import FaultCode
from appliance.scan.sides import SIDES
from appliance.service.windows import WindowWatch
from appliance.verdict.window import CELLS, Windows
from tests.support.golden_texts import Says

N = CELLS[0] * CELLS[1]


def looked(fall: float, light_dn: float, cell: int = 0, forgiven: float = 0.0, whole: float | None = None) -> Windows:
    """The left window with a fall in one cell, before a scene of one brightness."""
    falls = {side: np.zeros(N) for side in SIDES}
    falls["left"][cell] = fall
    light = {side: np.full(N, light_dn) for side in SIDES}
    return Windows(falls, {"left": whole, "right": None}, {"left": forgiven, "right": 0.0}, light)


def passed(watch: WindowWatch, *falls: float, forgiven: float = 0.0) -> list[bool | None]:
    """The verdict after each scan, of scenes that change."""
    return [watch.judge(looked(fall, 100.0 + 50.0 * (k % 2), forgiven=forgiven)).passed for k, fall in enumerate(falls)]


@pytest.mark.parametrize(
    ("falls", "forgiven", "expected"),
    [
        ((1.0, 1.0, 1.0), 0.0, [True, True, False]),
        ((0.094, 0.094, 0.094), 0.0, [True, True, False]),
        ((0.093, 0.093, 0.093), 0.0, [True, True, True]),
        ((0.194, 0.194, 0.194), 0.1, [True, True, False]),
        ((0.193, 0.193, 0.193), 0.1, [True, True, True]),
        ((-1.0, 1.0, 1.0, 1.0), 0.0, [True, True, True, False]),
        ((1.0, 1.0, np.nan, 1.0), 0.0, [True, True, True, False]),
    ],
)
def test_an_alarm_needs_three_scans_and_what_exceeds_the_forgiven(
    falls: tuple[float, ...], forgiven: float, expected: list[bool]
) -> None:
    assert passed(WindowWatch(), *falls, forgiven=forgiven) == expected


def test_however_long_it_lasted_three_clean_scans_end_an_alarm() -> None:
    ended = passed(WindowWatch(), *[1.0] * 10, *[0.0] * 4, forgiven=0.08)
    assert ended == [True, True, *[False] * 10, True, True]


@pytest.mark.parametrize(
    ("before_dn", "light_dn", "counts"),
    [(100.0, 104.0, False), (100.0, 106.0, True), (100.0, 96.0, False), (100.0, 94.0, True), (0.1, 1.0, False), (0.1, 1.1, True)],
)  # fmt: skip
def test_a_scene_is_another_one_from_a_twentieth_of_its_light_on_unless_it_is_dark(
    before_dn: float, light_dn: float, counts: bool
) -> None:
    watch = WindowWatch()
    watch.judge(looked(0.0, before_dn))
    assert ("not counted" in watch.judge(looked(0.0, light_dn)).text) is not counts


@pytest.mark.parametrize("cell", [CELLS[0] - 1, 3 * CELLS[0] + 4])
def test_the_place_is_named_and_a_scan_counts_once(cell: int, says: Says) -> None:
    watch = WindowWatch()
    for scan in range(3):
        seen = looked(1.0, 100.0 + 50.0 * scan, cell)
        told = watch.count(scan, seen)
        assert watch.count(scan, seen) is None
    assert told is not None
    verdict, (left, right) = told
    says(verdict.text)
    assert isinstance(left, on.ConditionRaised)
    assert (left.fault.code, left.fault.device, left.fault.detail) == (FaultCode.WINDOW, "camera.left", verdict.text)
    assert right == on.ConditionCleared(FaultCode.WINDOW, "camera.right")


def test_a_window_that_is_soft_all_over_is_named_as_a_whole(says: Says) -> None:
    watch = WindowWatch()
    verdicts = [watch.judge(looked(0.0, 100.0 + 50.0 * scan, whole=1.0)) for scan in range(3)]
    assert [one.passed for one in verdicts] == [True, True, False]
    says(verdicts[-1].text)
