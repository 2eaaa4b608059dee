"""The sums that tell a fogged window from a fogged scene: how much counts, when an alarm begins and ends, and what is another scene."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.machine import events as on
from appliance.scan.fault import FaultCode
from appliance.scan.sides import SIDES
from appliance.service.windows import WindowWatch
from appliance.verdict.window import CELLS, Windows

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


@pytest.mark.parametrize(("light_dn", "counts"), [(104.0, False), (106.0, True), (96.0, False), (94.0, True)])
def test_a_scene_is_another_one_from_a_twentieth_of_its_light_on(light_dn: float, counts: bool) -> None:
    watch = WindowWatch()
    watch.judge(looked(0.0, 100.0))
    assert ("not counted" in watch.judge(looked(0.0, light_dn)).text) is not counts


@pytest.mark.parametrize(("dark_dn", "counts"), [(1.0, False), (1.1, True)])
def test_what_is_too_dark_is_no_other_scene(dark_dn: float, counts: bool) -> None:
    watch = WindowWatch()
    watch.judge(looked(0.0, 0.1))
    assert ("not counted" in watch.judge(looked(0.0, dark_dn)).text) is not counts


@pytest.mark.parametrize(
    ("cell", "where"),
    [
        (0, "upper left (cell 0, 0 of 8 x 6)"),
        (CELLS[0] - 1, "upper right (cell 7, 0 of 8 x 6)"),
        (3 * CELLS[0] + 4, "middle middle (cell 4, 3 of 8 x 6)"),
        (N - 1, "lower right (cell 7, 5 of 8 x 6)"),
    ],
)
def test_the_place_is_named_and_a_scan_counts_once(cell: int, where: str) -> None:
    watch = WindowWatch()
    for scan in range(3):
        seen = looked(1.0, 100.0 + 50.0 * scan, cell)
        told = watch.count(scan, seen)
        assert watch.count(scan, seen) is None
    assert told is not None
    verdict, (left, right) = told
    assert verdict.text == f"the left window makes fringes soft, {where}"
    assert isinstance(left, on.ConditionRaised)
    assert (left.fault.code, left.fault.device, left.fault.detail) == (FaultCode.WINDOW, "camera.left", verdict.text)
    assert right == on.ConditionCleared(FaultCode.WINDOW, "camera.right")


def test_a_window_that_is_soft_all_over_is_named_as_a_whole() -> None:
    watch = WindowWatch()
    for scan in range(3):
        verdict = watch.judge(looked(0.0, 100.0 + 50.0 * scan, whole=1.0))
    assert verdict.text == "all of the left window makes fringes soft"
