"""Ray gaps have the pattern of what changed: a knock or wrong water is noticed at the first or second scan, normal scans never alarm."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from appliance.calibrate import health
from appliance.calibrate.health import LEARNT_SCANS, HealthTrend, OverlapNews, accept_change, judge_health
from appliance.measure.calibration.gaps import MODES, TURNS, GapModes, pairs_in_volume, signed_gap_mm
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import Water
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.truth import TrueRig, project, ray
from tests.support.calibrating import hidden_rig, inside
from tests.support.gap_scans import calibrated, follow, in_water, learnt, scan, scans_until_alarm
from tests.support.truth import WATER, true_calibration

TRUTH = hidden_rig("modelled", 3)
RIG = true_calibration(TRUTH).rig


def pairs_of(truth: TrueRig) -> tuple[np.ndarray, np.ndarray]:
    """True pairs, made by the simulator's own optics."""
    uv, _ = pairs_in_volume(RIG, WATER.index)
    origin, direction = ray(truth, "left", uv)
    points = origin + direction * ((520.0 - origin[:, 2:]) / direction[:, 2:])
    right = project(truth, "right", points)
    keep = inside(right)
    return uv[keep], right[keep]


def test_rays_of_true_pairs_meet_and_the_gap_is_positive_where_the_left_ray_passes_below() -> None:
    """The right camera sinks: the calibration believes it higher than it is, so its rays are reported too high."""
    for y_mm, abs_mm in ((0.0, 1e-6), (0.05, 0.003)):
        gap = signed_gap_mm(RIG, WATER.index, *pairs_of(with_mount_shifted(TRUTH, MountShift("right", y_mm=y_mm))))
        assert gap == pytest.approx(y_mm, abs=abs_mm)


def test_patterns_are_independent_and_of_unit_size() -> None:
    modes = GapModes(RIG, WATER.index)
    at = modes.at(*modes.field_px)
    assert at.T @ at / len(at) == pytest.approx(np.eye(len(MODES)), abs=1e-6)


def test_a_knock_has_the_pattern_that_the_model_derives() -> None:
    modes = GapModes(RIG, WATER.index)
    turns = dict(zip(TURNS, modes.turns_um, strict=True))

    def amplitudes(**knock: float) -> np.ndarray:
        left, right = pairs_of(with_mount_shifted(TRUTH, MountShift("right", **knock)))
        gap_um = 1000.0 * signed_gap_mm(RIG, WATER.index, left, right)
        found, squares, *_ = np.linalg.lstsq(modes.at(left, right), gap_um, rcond=None)
        assert math.sqrt(float(squares[0]) / len(gap_um)) < 0.6, "four patterns hold all of a knock"
        return found

    for axis, way, deg in (("x", "pitch_deg", 0.02), ("y", "yaw_deg", -0.02), ("z", "roll_deg", 0.02)):
        # The calibration has not made the turn, so the gap is what taking it back would do.
        name, found = f"right camera's turn {axis} (rad)", amplitudes(**{way: deg})
        assert found == pytest.approx(-deg * turns[name], rel=0.03, abs=0.3)
        said, size, share = health.likeliest(found, turns)
        assert said == name
        assert size == pytest.approx(-deg, rel=0.1)
        assert share > 0.97
    assert health.likeliest(amplitudes(y_mm=0.05), turns)[2] > 0.97


def test_cameras_that_share_no_volume_are_refused() -> None:
    away = replace(RIG.right, translation_mm=(5000.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="share too little"):
        GapModes(StereoRig(RIG.left, away), WATER.index)


SEED = 1
MADE = calibrated(SEED)


@pytest.fixture(scope="module")
def usual() -> HealthTrend:
    return learnt(MADE)


def turned(**shift: float) -> TrueRig:
    return with_mount_shifted(MADE.truth, MountShift("right", **shift))


def salty(psu: float, celsius: float = 20.0) -> float:
    return Water(celsius, psu, 530.0).index


@pytest.mark.parametrize(
    ("changed", "most", "alarms"),
    [
        *((with_mount_shifted(MADE.truth, MountShift(camera, **{axis: size})), 2, True) for camera, axis, size in (
            ("left", "pitch_deg", -0.02), ("left", "yaw_deg", 0.02), ("left", "roll_deg", -0.02),
            ("right", "pitch_deg", 0.02), ("right", "yaw_deg", -0.02), ("right", "roll_deg", 0.02))),
        (turned(y_mm=0.1), 2, True), (turned(z_mm=0.1), 2, True),
        # 0.05 mm of 230 mm is 0.02 % of every length, and the rays meet to a micrometre as before: a length check's.
        (turned(x_mm=0.05), 5, False),
        (in_water(MADE.truth, salty(35.0)), 1, True), (in_water(MADE.truth, salty(10.0)), 3, True),
    ],
)  # fmt: skip
def test_a_knock_or_wrong_water_alarms_soon(usual: HealthTrend, changed: TrueRig, most: int, alarms: bool) -> None:
    assert (scans_until_alarm(MADE, usual, changed, most) is not None) == alarms


def test_water_that_is_stated_rightly_never_alarms_and_a_knock_before_the_first_scan_does(usual: HealthTrend) -> None:
    """The trend follows the instrument from the lake to the sea."""
    assert MADE.truth.n_water == pytest.approx(WATER.index, abs=1e-9)
    sea = salty(35.0, 12.0)
    assert scans_until_alarm(MADE, usual, in_water(MADE.truth, sea), most=6, index=sea) is None
    assert scans_until_alarm(MADE, HealthTrend(), turned(pitch_deg=0.02), most=2) is not None


def test_neither_normal_scans_nor_mounts_that_follow_the_temperature_of_the_case_alarm() -> None:
    """Turns about x and z of some thousandths of a degree, another one before each scan: no length notices them."""
    rng = np.random.default_rng(5)
    scans = (scan(MADE, MADE.truth, rng) for _ in range(24))
    totals = [said.point.total for _, said in follow(HealthTrend(), scans) if said.point]
    assert len(totals) == 24
    assert max(totals) < 3.0, "half of the limit is never reached"
    rng = np.random.default_rng(10_004)
    some = (rng.normal(0.0, 0.002, 2).tolist() for _ in range(10))
    warm = (scan(MADE, turned(pitch_deg=pitch, roll_deg=roll), rng) for pitch, roll in some)
    assert not any(said.alarm for _, said in follow(HealthTrend(), warm))


def test_a_slow_drift_alarms_before_it_is_learnt() -> None:
    """0.006° of roll per scan, from the first scan on: no single step is remarkable."""
    rng = np.random.default_rng(3)
    drifting = (scan(MADE, turned(roll_deg=0.006 * (k + 1)), rng) for k in range(LEARNT_SCANS))
    alarms = [said.alarm for _, said in follow(HealthTrend(), drifting)]
    assert not alarms[0]
    assert any(alarms)


def test_an_alarm_stays_until_a_length_check_is_accepted_and_then_the_new_state_is_normal(usual: HealthTrend) -> None:
    knocked = turned(pitch_deg=0.03)
    rng = np.random.default_rng(4)
    followed = list(follow(usual, [scan(MADE, truth, rng) for truth in (knocked, MADE.truth, knocked)]))
    assert [said.alarm for _, said in followed] == [True] * 3, "a camera that moves to and fro is no better"
    accepted = accept_change(followed[-1][0], "ball bar, largest |E_L| 0.02 %")
    assert (accepted.alarm, accepted.answers) == (None, ("ball bar, largest |E_L| 0.02 %",))
    assert scans_until_alarm(MADE, accepted, knocked, most=12) is None
    again = with_mount_shifted(knocked, MountShift("left", roll_deg=0.02))
    assert scans_until_alarm(MADE, accepted, again, most=2) is not None


def only(gaps: PatchGaps, which: np.ndarray) -> PatchGaps:
    return replace(gaps, **{name: getattr(gaps, name)[which] for name in ("patch", "gap_um", "noise_um", "modes")})


def test_too_little_and_what_is_no_number_is_not_judged_and_a_corner_is_uncertain() -> None:
    """An alarm, or an exception in the heartbeat, would be no better."""
    whole = scan(MADE, MADE.truth, np.random.default_rng(1))
    spoilt = replace(whole, gap_um=np.where(np.arange(len(whole.gap_um)) == 3, np.nan, whole.gap_um))
    for gaps, named in ((only(whole, np.arange(5)), "5 of 48"), (spoilt, "not a number")):
        trend, said = judge_health(HealthTrend(), gaps, "000001")
        assert (trend, said.point, bool(said.alarm)) == (HealthTrend(), None, False)
        assert named in said.text
    part = only(whole, np.isin(whole.patch, [0, 1, 2, 8, 9, 10, 16, 17, 18]))
    of_whole, of_part = (judge_health(HealthTrend(), gaps, None)[1] for gaps in (whole, part))
    assert of_part.point is not None
    assert of_whole.point is not None
    # Height and twist have the drift of mounts in them, however much is seen.
    assert max(of_part.point.sigma_um[2:]) > 2.0 * max(of_whole.point.sigma_um[2:])
    assert not of_part.alarm


def test_overlaps_that_bend_all_scans_alarm_once_and_the_latest_word_of_each_object_is_kept() -> None:
    fine = OverlapNews("hull", 20, 9.0, 4.0, health.OVERLAP_LIMIT)
    bent = OverlapNews("hull", 26, 62.0, 5.0, health.OVERLAP_LIMIT + 0.1)
    trend = health.add_overlap_news(HealthTrend(), fine)
    after = health.add_overlap_news(trend, bent)
    assert (trend.alarm, after.overlaps) == (None, (bent,))
    scanned, _ = judge_health(trend, scan(MADE, MADE.truth, np.random.default_rng(1)))
    assert (scanned.overlaps, scanned.judged) == ((fine,), 1), "a scan says nothing of overlaps"
    assert after.alarm is not None
    assert "hull" in after.alarm
    assert "62 ± 5 µm" in after.alarm
    assert health.add_overlap_news(after, fine).alarm == after.alarm, "it stands until a length check answers it"
    assert accept_change(after, "ball bar").alarm is None
    for k in range(health.MOST_OBJECTS):
        after = health.add_overlap_news(after, replace(fine, object=f"{k}"))
    assert [one.object for one in after.overlaps] == [f"{k}" for k in range(health.MOST_OBJECTS)]
