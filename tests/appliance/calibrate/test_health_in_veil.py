"""Backscatter that moves rows is no knock: what is not known of it counts as scatter, what it did to the reference cancels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.health import LEARNT_SCANS, MATTERS_DEG, MOST_VEIL_UM, SCANS_TO_FIND, HealthTrend, judge_health
from appliance.measure.cloud import PatchGaps

Array = NDArray[np.float64]
Y, X = np.divmod(np.arange(PatchGaps.COUNT), PatchGaps.GRID[0])
X, Y = 2.0 * X / (PatchGaps.GRID[0] - 1.0) - 1.0, 2.0 * Y / (PatchGaps.GRID[1] - 1.0) - 1.0
PATTERNS = np.stack([np.ones(PatchGaps.COUNT), 1.5 * X, 1.5 * Y, 2.4 * X * Y], -1)
CAUSES = np.stack([0.5 * X + Y * Y, X + 0.5, X * Y - 0.3], -1)
"""Shapes of what a wrong strength and a wrong place of the projector do, µm."""


def gaps(rng: np.random.Generator, moved_um: Array, doubts_um: float | None) -> PatchGaps:
    """Return a scan whose gaps are moved by ``moved_um`` (48,), with ``doubts_um`` rms of each cause."""
    noise = np.full(PatchGaps.COUNT, 0.8)
    known: dict[str, Any] = {} if doubts_um is None else {
        "veil_um": np.zeros(PatchGaps.COUNT), "doubts_um": doubts_um * CAUSES, "shape_um": np.full(PatchGaps.COUNT, 0.1 * doubts_um)
    }  # fmt: skip
    return PatchGaps(
        np.arange(PatchGaps.COUNT), moved_um + rng.normal(0.0, noise), noise, PATTERNS, 5_000, 1.33, **known
    )


def learnt(rng: np.random.Generator, moved_um: Array, doubts_um: float | None) -> HealthTrend:
    trend = HealthTrend()
    for _ in range(LEARNT_SCANS):
        trend, said = judge_health(trend, gaps(rng, moved_um, doubts_um))
        assert not said.alarm
    return trend


def alarms(rng: np.random.Generator, trend: HealthTrend, moved_um: Array, doubts_um: float | None, scans: int) -> bool:
    for _ in range(scans):
        trend, said = judge_health(trend, gaps(rng, moved_um, doubts_um))
    return bool(said.alarm)


def test_other_water_than_that_of_the_reference_is_no_alarm() -> None:
    rng = np.random.default_rng(10_001)
    veiled = 5.0 * CAUSES @ np.array([0.8, -1.0, 0.9])
    assert not alarms(rng, learnt(rng, np.zeros(PatchGaps.COUNT), None), veiled, 5.0, 10), "turbid after clear water"
    assert not alarms(rng, learnt(rng, veiled, 5.0), np.zeros(PatchGaps.COUNT), None, 10), "clear after turbid water"
    # The same without the doubt is what the alarm is for.
    assert alarms(rng, learnt(rng, np.zeros(PatchGaps.COUNT), None), veiled, None, 2)


def test_a_reference_of_the_same_water_sees_a_knock_that_one_of_other_water_does_not() -> None:
    """The causes are wrong in the same way in every scan: what counts is the difference."""
    rng = np.random.default_rng(10_003)
    veiled = 8.0 * CAUSES @ np.array([1.0, 0.8, -0.9])
    # A turn about y: for those about x and z the drift of mounts is allowed for as well.
    yaw = PATTERNS @ np.array([0.0, 0.0, 0.0, 10.0])
    _, same = judge_health(learnt(rng, veiled, 8.0), gaps(rng, veiled + yaw, 8.0))
    _, other = judge_health(learnt(rng, np.zeros(PatchGaps.COUNT), None), gaps(rng, yaw, 8.0))
    assert same.point is not None
    assert other.point is not None
    assert same.alarm
    assert not other.alarm
    assert same.point.score > 1.5 * other.point.score


def test_a_scan_in_which_backscatter_could_hide_a_knock_is_not_judged() -> None:
    rng = np.random.default_rng(10_004)
    rms = float(np.sqrt(np.mean(np.sum(CAUSES**2, axis=1) + 0.01)))
    for doubts_um, judged in ((0.9 * MOST_VEIL_UM / rms, True), (1.1 * MOST_VEIL_UM / rms, False)):
        trend, said = judge_health(HealthTrend(), gaps(rng, np.zeros(PatchGaps.COUNT), doubts_um))
        assert (said.point is not None) == judged
        assert trend.judged == int(judged)
    assert "backscatter" in said.text
    assert "22" in said.text


TURNS_UM = np.array([[9_300.0, 0.0, 0.0, 0.0], [0.0, 0.0, 225.0, 107.0], [150.0, 1_100.0, 0.0, 0.0]])
"""Amplitudes per degree about x, y, z, as those of a rig."""


def test_a_roll_is_told_from_backscatter_whose_shape_is_known_by_the_scan_itself() -> None:
    """A turn about z by 0.02° gives 22 µm of twist; that the projector may stand elsewhere, 12, and bends besides."""
    rng = np.random.default_rng(10_006)
    trend = learnt(rng, np.zeros(PatchGaps.COUNT), None)
    bent = 6.0 * (CAUSES + np.stack([X * X * Y, 2.0 * X * Y * Y, X**3 - Y * Y], -1))
    veiled = bent @ np.array([0.9, -1.2, 0.8])
    roll = PATTERNS @ (MATTERS_DEG * TURNS_UM[2])
    normal = knocked = trend
    for _ in range(SCANS_TO_FIND):
        normal, said = judge_health(normal, replace(gaps(rng, veiled, 6.0), doubts_um=bent))
        assert not said.alarm
        knocked, found = judge_health(knocked, replace(gaps(rng, veiled + roll, 6.0), doubts_um=bent))
    assert found.alarm


def test_the_turns_that_a_scan_says_it_finds_are_found_by_three_like_it() -> None:
    rng = np.random.default_rng(10_007)
    # As if the reference were complete: what a scan finds grows while it is learnt.
    trend = learnt(rng, np.zeros(PatchGaps.COUNT), None)
    for doubts_um in (None, 6.0):
        one = replace(gaps(rng, np.zeros(PatchGaps.COUNT), doubts_um), turns_um=TURNS_UM)
        _, said = judge_health(trend, one)
        for axis, turn_um in zip("xyz", TURNS_UM, strict=True):
            least = said.numbers[f"found_{axis}_deg"]
            assert least is not None
            for times, alarms in ((1.05, True), (0.95, False)):
                at = trend
                for _ in range(SCANS_TO_FIND):
                    # Without noise: the mean of many.
                    moved = one.modes @ (times * least * turn_um)
                    at, told = judge_health(at, replace(one, gap_um=moved))
                assert told.alarm == alarms, (doubts_um, axis, times)


def test_a_scan_that_would_miss_a_turn_says_which_and_a_keen_one_says_nothing() -> None:
    rng = np.random.default_rng(10_008)
    trend = learnt(rng, np.zeros(PatchGaps.COUNT), None)
    _, keen = judge_health(trend, replace(gaps(rng, np.zeros(PatchGaps.COUNT), None), turns_um=4.0 * TURNS_UM))
    assert "do not show" not in keen.text
    _, blind = judge_health(trend, replace(gaps(rng, np.zeros(PatchGaps.COUNT), 9.0), turns_um=TURNS_UM))
    assert "3 such scans do not show rotations of a camera about z below" in blind.text
    assert "backscatter may move the gaps by" in blind.text
    x_deg, z_deg = blind.numbers["found_x_deg"], blind.numbers["found_z_deg"]
    assert x_deg is not None
    assert z_deg is not None
    assert x_deg < MATTERS_DEG < z_deg


def test_water_that_is_not_as_the_model_says_makes_amplitudes_less_certain() -> None:
    rng = np.random.default_rng(10_009)
    trend = learnt(rng, np.zeros(PatchGaps.COUNT), None)
    odd = 12.0 * np.cos(3.0 * X) * np.cos(4.0 * Y)
    expected, other = (
        judge_health(trend, gaps(rng, moved, 3.0))[1].point for moved in (np.zeros(PatchGaps.COUNT), odd)
    )
    assert expected is not None
    assert other is not None
    assert other.sigma_um[3] > 1.5 * expected.sigma_um[3]


def test_of_what_backscatter_did_a_share_may_be_wrong_unless_the_reference_had_it_too() -> None:
    rng = np.random.default_rng(10_010)
    plain = gaps(rng, np.zeros(PatchGaps.COUNT), 4.0)
    taken = replace(plain, veil_um=PATTERNS @ np.array([0.0, 0.0, 0.0, 20.0]))
    clear, veiled = learnt(rng, np.zeros(PatchGaps.COUNT), None), learnt(rng, np.zeros(PatchGaps.COUNT), 4.0)

    def shear_um(trend: HealthTrend, seen: PatchGaps) -> float:
        point = judge_health(trend, seen)[1].point
        assert point is not None
        return point.sigma_um[3]

    assert shear_um(clear, taken) == pytest.approx(np.hypot(8.0, shear_um(clear, plain)), rel=0.01)
    assert shear_um(veiled, taken) == pytest.approx(shear_um(veiled, plain), rel=0.01)
