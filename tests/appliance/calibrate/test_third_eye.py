"""The projector, learnt from the first normal scans, tells what the ray gaps of two cameras cannot: by the simulator's own optics."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibrate.health import HealthJudgement, HealthTrend, accept_change, judge_health
from appliance.calibrate.third_eye import FITTED_SCANS, ThirdEye, judge_with_projector, third_eye_file
from appliance.measure.calibration.gaps import GapModes, signed_gap_mm
from appliance.measure.calibration.patches import average
from appliance.measure.cloud import PatchGaps
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.truth import TrueRig, project, ray
from tests.support.calibrating import hidden_rig
from tests.support.truth import WATER, true_calibration

TRUTH, FOREIGN = hidden_rig("modelled", 3), hidden_rig("modelled", 4)
HASH = "ab" * 32
DISTANCE_MM = 520.0
PATTERN_PX = (1024, 768)
Watched = tuple[HealthTrend, ThirdEye]


class Instrument:
    """What scans of planes show of a true rig, looked at with the calibration of ``stated``."""

    def __init__(self, stated: TrueRig = TRUTH) -> None:
        self.rig = true_calibration(stated).rig
        self._modes = GapModes(self.rig, WATER.index)

    def seen(self, truth: TrueRig, seed: int, tall: float = 1.0) -> PatchGaps:
        """One scan: a plane at a random distance and tilt, in the middle ``tall`` of the image, noise of 0.05 px in the right
        camera."""
        rng = np.random.default_rng([seed, 8])
        uv = rng.uniform([-0.5, -0.5 * tall], [0.5, 0.5 * tall], (5_000, 2)) + 0.5
        uv *= [truth.left.width_px - 1, truth.left.height_px - 1]
        origin, direction = ray(truth, "left", uv)
        normal = np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
        away = (rng.uniform(480.0, 560.0) - origin @ normal) / (direction @ normal)
        points = origin + direction * away[:, None]
        right, shown = project(truth, "right", points), project(truth, "projector", points)
        inside = np.all((right >= 0) & (right <= [truth.right.width_px - 1, truth.right.height_px - 1]), axis=1)
        inside &= np.all((shown >= 0) & (shown <= np.array(PATTERN_PX) - 1), axis=1)
        left, right, shown = uv[inside], right[inside] + rng.normal(0.0, 0.05, (inside.sum(), 2)), shown[inside]
        gaps = average(self._modes, left, right, 1000.0 * signed_gap_mm(self.rig, WATER.index, left, right), shown)
        return replace(gaps, pattern_size_px=PATTERN_PX)

    def follow(self, watched: Watched, truth: TrueRig, seeds: range) -> Iterator[tuple[Watched, HealthJudgement]]:
        """Scans one after the other, as the instrument judges them."""
        for seed in seeds:
            trend, eye, said = judge_with_projector(*watched, self.rig, self.seen(truth, seed))
            watched = trend, eye
            yield watched, said


OWN = Instrument()


def knocked(side: str = "right", **shift: float) -> TrueRig:
    return with_mount_shifted(TRUTH, MountShift(side, **shift))


def learnt(scans: int = FITTED_SCANS + 3) -> Watched:
    """The memory after so many normal scans, none of which alarmed."""
    *_, (watched, said) = OWN.follow((HealthTrend(), ThirdEye()), TRUTH, range(scans))
    assert not said.alarm
    return watched


@pytest.fixture(scope="module")
def usual() -> Watched:
    return learnt()


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("way", ["pitch_deg", "yaw_deg", "roll_deg"])
def test_a_fiftieth_of_a_degree_about_any_axis_is_found_by_the_second_scan(usual: Watched, side: str, way: str) -> None:
    turned = knocked(side, **{way: -0.02})
    said = [one for _, one in OWN.follow(usual, turned, range(50, 52))]
    assert said[-1].alarm


def test_where_the_ray_gap_sees_nothing_of_a_turn_about_y_the_third_gap_does(usual: Watched) -> None:
    """Both rays turn within the plane that they span: what little the gap has of it lies above and below the middle."""
    (trend, eye), turned = usual, knocked(yaw_deg=0.02)
    of_two = trend
    for seed in range(50, 53):
        low = OWN.seen(turned, seed, tall=0.2)
        of_two, alone = judge_health(of_two, low)
        trend, eye, said = judge_with_projector(trend, eye, OWN.rig, low)
    assert (alone.alarm, said.alarm) == (False, True)
    assert "most like the right camera turned by +0.0" in said.text
    assert "about its y axis" in said.text


def test_a_scan_says_which_turn_three_like_it_would_find(usual: Watched) -> None:
    """A score of 4 each, to which both gaps add as squares; of 0.02° the third has 93 µm even, of 14 forgiven, and 9.5 µm across, of 6."""
    gaps = OWN.seen(TRUTH, 50, tall=0.2)
    both, rays = judge_with_projector(*usual, OWN.rig, gaps)[2], judge_health(usual[0], gaps)[1]
    per_deg2 = [(4.0 / (said.numbers["found_y_deg"] or 1.0)) ** 2 for said in (both, rays)]
    assert 0.02 * (per_deg2[0] - per_deg2[1]) ** 0.5 == pytest.approx(math.hypot(93.0 / 14.0, 9.5 / 6.0), rel=0.1)


def test_the_third_gap_is_what_half_the_angle_leaves_of_a_turn_about_y(usual: Watched) -> None:
    """A ray that is D·ψ aside moves the point along the other ray by D·ψ / sin 2α; from the middle, α beside it, that is D·ψ / (2 cos α)."""
    _, eye = usual
    a, b = (np.array(camera.rotation)[:, 2] for camera in (OWN.rig.left, OWN.rig.right))
    half_rad = 0.5 * math.acos(float(a @ b))
    expected_um = 1000.0 * DISTANCE_MM * math.radians(0.02) / (2.0 * math.cos(half_rad))
    rest, moved = (eye.gaps(OWN.rig, OWN.seen(truth, 60)) for truth in (TRUTH, knocked(yaw_deg=0.02)))
    assert rest is not None
    assert moved is not None
    assert np.sqrt(np.mean(rest.gap_um**2)) < 6.0
    assert abs(np.mean(moved.gap_um) - np.mean(rest.gap_um)) == pytest.approx(expected_um, rel=0.1)
    # The answer to a turn, by which the verdict tells how small a one it finds, is the same.
    assert moved.turns_um is not None
    assert abs(moved.turns_um[1, 0]) * 0.02 == pytest.approx(expected_um, rel=0.1)


def test_no_scan_after_the_first_ones_changes_the_projector_and_a_knocked_one_never_teaches_it(usual: Watched) -> None:
    (_, before), (_, half) = usual, learnt(FITTED_SCANS - 1)
    *_, ((trend, after), said) = OWN.follow(usual, knocked(yaw_deg=0.03), range(70, 74))
    assert (after.hash, said.alarm) == (before.hash, True)
    assert abs(said.numbers["even_um"] or 0.0) > 100.0, "what is knocked stays beside what was learnt"
    turned = knocked(pitch_deg=0.05)
    *_, ((_, eye), said) = OWN.follow((learnt(FITTED_SCANS - 1)[0], half), turned, range(70, 74))
    assert (eye, said.alarm) == (half, True)
    # A length check that found lengths right makes the third gap as it is now the usual one.
    *_, (_, said) = OWN.follow((accept_change(trend, "a ball bar"), after), knocked(yaw_deg=0.03), range(80, 83))
    assert not said.alarm


def test_another_instruments_calibration_does_not_fit_the_projector_learnt_with_it(usual: Watched) -> None:
    foreign = OWN.seen(FOREIGN, 90)
    third = usual[1].gaps(OWN.rig, foreign)
    assert third is not None
    assert np.median(np.abs(third.gap_um)) > 300.0


def test_the_file_is_of_one_calibration_and_a_damaged_one_is_learnt_anew(usual: Watched, tmp_path: Path) -> None:
    trend, eye = usual
    file = third_eye_file(tmp_path, HASH)
    assert file.read() == ThirdEye()
    for one in (learnt(1)[1], eye):
        file.write(one)
        assert third_eye_file(tmp_path, HASH).read() == one
    file.path.write_bytes(file.path.read_bytes().replace(b'"misfit_px": 0', b'"misfit_px": 1'))
    assert file.read() == ThirdEye()
    file.write(learnt(1)[1])
    assert file.path.with_suffix(".damaged").exists()
    # What was remembered of the lost fit says nothing of another one: its reference begins anew.
    followed = [*OWN.follow((trend, ThirdEye()), TRUTH, range(20, 20 + FITTED_SCANS + 1))]
    assert not any(said.alarm for _, said in followed)
    again, _ = followed[-1]
    assert again[0].third.projector == again[1].hash != eye.hash
    assert max(again[0].third.reference.scans) == 1
