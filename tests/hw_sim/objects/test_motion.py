"""Hands that move, by drawing or by chance: where the object then is seen, and what a long exposure makes of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.objects.hand_track import HandTrack
from hw_sim.objects.motion import Motion, object_pose, pose_matrix
from tests.hw_sim.pictures import FACING, renderer, shot

POSE = (10.0, -5.0, 530.0, 5.0, 10.0, 20.0)
MIDDLE = np.array([0.0, 0.0, 522.5])


def rig_point(motion: Motion | HandTrack, time_s: float, point: np.ndarray) -> np.ndarray:
    """A point fixed to the object, in the frame of the moved rig."""
    R0, t0 = pose_matrix(POSE)
    R, t = object_pose(POSE, motion, time_s) if isinstance(motion, Motion) else motion.seen(R0, t0, time_s)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    return np.asarray(R @ (R0.T @ (point - t0)) + t)


@pytest.mark.parametrize("still", [HandTrack(), HandTrack.drawn(np.random.default_rng(1)), Motion(tremor_hz=5.0)])
def test_at_time_zero_nothing_has_moved(still: Motion | HandTrack) -> None:
    np.testing.assert_allclose(rig_point(still, 0.0, MIDDLE), MIDDLE, atol=1e-12)


def test_a_rig_moving_right_sees_the_object_move_left_and_turns_about_the_middle_of_the_volume() -> None:
    motion = Motion(velocity_mm_s=(8.0, 0.0, -4.0), acceleration_mm_s2=(0.0, 10.0, 0.0))
    np.testing.assert_allclose(rig_point(motion, 0.5, MIDDLE) - MIDDLE, [-4.0, -1.25, 2.0], atol=1e-12)
    turn, two = Motion(rotation_deg_s=(0.0, 4.0, 0.0)), math.radians(2.0)
    np.testing.assert_allclose(rig_point(turn, 0.5, MIDDLE), MIDDLE, atol=1e-12)
    beside = rig_point(turn, 0.5, MIDDLE + np.array([50.0, 0.0, 0.0])) - MIDDLE
    np.testing.assert_allclose(beside, [50.0 * math.cos(two), 0.0, 50.0 * math.sin(two)], atol=1e-9)
    track, h = HandTrack(jerk_mm_s3=(60.0, -30.0, 12.0)), 0.01
    at = [rig_point(track, k * h, MIDDLE) for k in range(4)]
    third = (at[3] - 3 * at[2] + 3 * at[1] - at[0]) / h**3
    np.testing.assert_allclose(third, [-60.0, 30.0, -12.0], rtol=1e-6, err_msg="jerk is the third derivative")


@pytest.mark.parametrize(
    ("shaken", "period_s", "range_mm"),
    [
        (Motion(tremor_mm=(0.2, 0.0, 0.1), tremor_hz=5.0), 0.2, [0.4, 0.0, 0.2]),
        (HandTrack(swell_mm=(0.4, 0.0, 0.0), swell_hz=0.8, swell_phase_rad=0.7), 1.25, [0.8, 0.0, 0.0]),
    ],
)
def test_tremor_and_swell_go_as_far_as_they_say_and_return(
    shaken: Motion | HandTrack, period_s: float, range_mm: list[float]
) -> None:
    path = np.array([rig_point(shaken, s, MIDDLE) for s in np.linspace(0.0, period_s, 401)])
    np.testing.assert_allclose(np.ptp(path, axis=0), range_mm, atol=1e-3)
    np.testing.assert_allclose(path[-1], path[0], atol=1e-9)


def test_turns_leave_the_shoulder_where_it_is_and_swing_the_rig_by_its_arm() -> None:
    track = HandTrack(shoulder_deg=(0.0, 0.05, 0.0), shoulder_hz=1.0, shoulder_mm=(0.0, 0.0, -450.0))
    for z_mm, x_mm in ((-450.0, 0.0), (550.0, -1000.0 * math.radians(0.05))):
        R, t = track.seen(np.eye(3), np.array([0.0, 0.0, z_mm]), 0.25)
        assert t[0] == pytest.approx(x_mm, rel=1e-6, abs=1e-12)
        assert math.degrees(math.acos((np.trace(R) - 1.0) / 2.0)) == pytest.approx(0.05, rel=1e-5)


def test_a_long_exposure_of_moving_hands_smears_the_texture_along_the_motion() -> None:
    textured = replace(FACING, texture="strong")
    still, fast = (renderer(replace(textured, motion=Motion(velocity_mm_s=(v, 0.0, 0.0)))) for v in (0.0, 150.0))

    def detail(picture: np.ndarray, axis: int) -> float:
        return float(np.sqrt((np.diff(picture, axis=axis)[60:240, 80:300] ** 2).mean()))

    np.testing.assert_array_equal(shot(fast, 247), shot(still, 247))  # before a sequence hands are still
    sharp, smeared = shot(still, 247), shot(fast, 247, time_s=0.012)
    along, across = detail(smeared, 1) / detail(sharp, 1), detail(smeared, 0) / detail(sharp, 0)
    assert along < 0.8, "1.8 mm are almost 3 px of this picture"
    assert across > along + 0.05
    assert smeared.mean() == pytest.approx(sharp.mean(), rel=0.05), "but takes no light"
