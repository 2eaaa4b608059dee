"""A knock or wrong water is noticed at the first or second scan, what the gaps cannot see is not, normal scans never are.

Realistic hidden rigs, calibrated with noise; planes at random poses that cover all or part of the image.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from appliance.calibration.health import (
    LEARNT_SCANS,
    MOST_OBJECTS,
    OVERLAP_LIMIT,
    HealthTrend,
    OverlapNews,
    answered,
    judge,
    told_by_overlaps,
)
from appliance.calibration.patches import PatchGaps
from appliance.calibration.water.method import Method
from appliance.optics.water import Water
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.truth import TrueRig
from tests.support.gap_scans import calibrated, follow, in_water, learnt, scan, scans_until_alarm
from tests.support.truth import WATER

SEED = 1
KNOCKS = [
    MountShift(camera, **{f"{axis}_deg": sign * 0.02})
    for camera in ("left", "right")
    for axis in ("pitch", "yaw", "roll")
    for sign in (-1.0, 1.0)
]


@pytest.mark.parametrize("knock", KNOCKS, ids=str)
def test_a_turn_of_two_hundredths_of_a_degree_alarms_at_the_first_or_second_scan(knock: MountShift) -> None:
    made = calibrated(SEED)
    needed = scans_until_alarm(made, learnt(made), with_mount_shifted(made.truth, knock), most=2)
    assert needed is not None


@pytest.mark.parametrize("axis", ["y_mm", "z_mm"])
def test_a_shift_across_the_base_line_of_a_tenth_alarms(axis: str) -> None:
    made = calibrated(SEED)
    needed = scans_until_alarm(
        made, learnt(made), with_mount_shifted(made.truth, MountShift("right", **{axis: 0.1})), most=2
    )
    assert needed is not None


def test_a_shift_along_the_base_line_is_what_only_a_length_check_finds_soon() -> None:
    """0.05 mm of 230 mm is 0.02 % of every length, and the rays meet to a micrometre as before."""
    made = calibrated(SEED)
    assert (
        scans_until_alarm(made, learnt(made), with_mount_shifted(made.truth, MountShift("right", x_mm=0.05)), most=5)
        is None
    )


@pytest.mark.parametrize(("salinity_psu", "most"), [(35.0, 1), (10.0, 3)])
def test_salt_water_taken_for_fresh_alarms(salinity_psu: float, most: int) -> None:
    made = calibrated(SEED)
    salt = in_water(made.truth, Water(20.0, salinity_psu, 530.0).index)
    assert scans_until_alarm(made, learnt(made), salt, most) is not None


def test_water_that_is_stated_rightly_never_alarms() -> None:
    """The trend follows the instrument from the lake to the sea."""
    made = calibrated(SEED)
    sea = Water(12.0, 35.0, 530.0).index
    assert scans_until_alarm(made, learnt(made), in_water(made.truth, sea), most=12, index=sea) is None


@pytest.mark.parametrize("method", [Method.SPLINE, Method.PORTS])
def test_normal_scans_never_alarm(method: Method) -> None:
    made = calibrated(SEED, method)
    rng = np.random.default_rng(5)
    totals = [
        said.point.total
        for _, said in follow(HealthTrend(), (scan(made, made.truth, rng) for _ in range(40)))
        if said.point
    ]
    assert len(totals) == 40
    assert max(totals) < 3.0, "half of the limit is never reached"


def test_a_knock_between_calibration_and_first_scan_is_noticed() -> None:
    made = calibrated(SEED)
    for knock in (MountShift("right", pitch_deg=0.02), MountShift("left", roll_deg=0.02)):
        assert scans_until_alarm(made, HealthTrend(), with_mount_shifted(made.truth, knock), most=2) is not None


def test_mounts_that_follow_the_temperature_of_the_case_never_alarm() -> None:
    """Turns about x and z of some thousandths of a degree, another one before each scan: no length notices them."""
    made = calibrated(SEED)
    rng = np.random.default_rng(10_004)

    def some() -> TrueRig:
        pitch, roll = rng.normal(0.0, 0.002, 2)
        return with_mount_shifted(made.truth, MountShift("right", pitch_deg=float(pitch), roll_deg=float(roll)))

    alarms = [said.alarm for _, said in follow(HealthTrend(), (scan(made, some(), rng) for _ in range(16)))]
    assert not any(alarms)


def test_a_slow_drift_alarms_before_it_is_learnt() -> None:
    """0.006° of roll per scan, from the first scan on: no single step is remarkable."""
    made = calibrated(SEED)
    rng = np.random.default_rng(3)
    drifting = (
        scan(made, with_mount_shifted(made.truth, MountShift("right", roll_deg=0.006 * (k + 1))), rng)
        for k in range(LEARNT_SCANS)
    )
    alarms = [said.alarm for _, said in follow(HealthTrend(), drifting)]
    assert not alarms[0]
    assert any(alarms)


def test_an_alarm_stays_until_a_length_check_is_accepted_and_then_the_new_state_is_normal() -> None:
    made = calibrated(SEED)
    turned = with_mount_shifted(made.truth, MountShift("right", pitch_deg=0.03))
    rng = np.random.default_rng(4)
    scans = [scan(made, truth, rng) for truth in (turned, made.truth, made.truth, turned)]
    followed = list(follow(learnt(made), scans))
    assert [said.alarm for _, said in followed] == [True] * 4, "a camera that moves to and fro is no better"
    accepted = answered(followed[-1][0], "ball bar, largest |E_L| 0.02 %")
    assert accepted.alarm is None
    assert accepted.answers == ("ball bar, largest |E_L| 0.02 %",)
    assert scans_until_alarm(made, accepted, turned, most=12) is None
    assert (
        scans_until_alarm(made, accepted, with_mount_shifted(turned, MountShift("left", roll_deg=0.02)), most=2)
        is not None
    )


def only(gaps: PatchGaps, which: np.ndarray) -> PatchGaps:
    return replace(
        gaps, patch=gaps.patch[which], gap_um=gaps.gap_um[which], noise_um=gaps.noise_um[which], modes=gaps.modes[which]
    )


def test_too_little_of_the_image_is_not_judged() -> None:
    made = calibrated(SEED)
    whole = scan(made, made.truth, np.random.default_rng(1))
    few = only(whole, np.arange(5))
    trend, said = judge(HealthTrend(), few, "000001")
    assert trend == HealthTrend()
    assert said.point is None
    assert not said.alarm
    assert said.text.startswith("not judged: 5 of 48 patches")


def test_what_is_no_number_is_not_judged() -> None:
    """An alarm, or an exception in the heartbeat, would be no better."""
    made = calibrated(SEED)
    whole = scan(made, made.truth, np.random.default_rng(1))
    whole.gap_um[3] = np.nan
    trend, said = judge(HealthTrend(), whole)
    assert trend == HealthTrend()
    assert said.point is None
    assert said.text == "not judged: a gap is not a number"


def test_a_change_that_the_seen_corner_cannot_tell_is_no_alarm_and_no_certainty() -> None:
    """A scan of one corner has wide standard deviations instead of a wrong verdict."""
    made = calibrated(SEED)
    whole = scan(made, made.truth, np.random.default_rng(1))
    corner = np.isin(whole.patch, [0, 1, 2, 8, 9, 10, 16, 17, 18])
    part = only(whole, corner)
    _, said_whole = judge(HealthTrend(), whole, None)
    _, said_part = judge(HealthTrend(), part, None)
    assert said_part.point is not None
    assert said_whole.point is not None
    # Height and twist have the drift of mounts in them, however much is seen.
    assert max(said_part.point.sigma_um[2:]) > 2.0 * max(said_whole.point.sigma_um[2:])
    assert not said_part.alarm


def test_the_water_of_the_tests_is_that_of_the_calibration() -> None:
    assert calibrated(SEED).truth.n_water == pytest.approx(WATER.index, abs=1e-9)


def test_overlaps_that_bend_all_scans_alarm_once_and_the_latest_word_of_each_object_is_kept() -> None:
    usual = OverlapNews("hull", 20, 9.0, 4.0, OVERLAP_LIMIT)
    bent = OverlapNews("hull", 26, 62.0, 5.0, OVERLAP_LIMIT + 0.1)
    trend = told_by_overlaps(HealthTrend(), usual)
    assert trend.alarm is None
    after = told_by_overlaps(trend, bent)
    assert after.overlaps == (bent,)
    assert after.alarm is not None
    assert "object hull" in after.alarm
    assert "62 ± 5 µm" in after.alarm
    # An alarm stands until a length check answers it, whatever is told meanwhile.
    assert told_by_overlaps(after, usual).alarm == after.alarm
    assert answered(after, "ball bar").alarm is None
    for k in range(MOST_OBJECTS):
        after = told_by_overlaps(after, replace(usual, object=f"{k}"))
    assert [one.object for one in after.overlaps] == [f"{k}" for k in range(MOST_OBJECTS)]
