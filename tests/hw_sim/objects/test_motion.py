"""Hands that move: where the object then is, and what a long exposure makes of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.objects.motion import Motion, object_pose, pose_matrix
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth

WHITE = np.full((768, 1024), 247, np.uint8)
POSE = (10.0, -5.0, 530.0, 5.0, 10.0, 20.0)
TEXTURED = Scene(object="plane", texture="strong", noise=False, pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0))


def rig_point(motion: Motion, time_s: float, point: np.ndarray) -> np.ndarray:
    """A point fixed to the object, in the frame of the moved rig."""
    R0, t0 = pose_matrix(POSE)
    R, t = object_pose(POSE, motion, time_s)
    return np.asarray(R @ (R0.T @ (point - t0)) + t)


def shot(r: Renderer, time_s: float, exposure_s: float) -> np.ndarray:
    light = [LightSlice(WHITE, exposure_s)]
    return r.expose("left", light, time_s, exposure_s, 0.0, (False, False), 1).astype(float)


def test_a_rig_moving_right_sees_the_object_move_left() -> None:
    where = np.array([10.0, 20.0, 500.0])
    moved = rig_point(Motion(velocity_mm_s=(8.0, 0.0, -4.0), acceleration_mm_s2=(0.0, 10.0, 0.0)), 0.5, where)
    np.testing.assert_allclose(moved - where, [-4.0, -1.25, 2.0], atol=1e-12)


def test_turning_is_about_the_middle_of_the_volume() -> None:
    turn = Motion(rotation_deg_s=(0.0, 4.0, 0.0))
    middle = np.array([0.0, 0.0, 522.5])
    np.testing.assert_allclose(rig_point(turn, 0.5, middle), middle, atol=1e-12)
    beside = rig_point(turn, 0.5, middle + np.array([50.0, 0.0, 0.0])) - middle
    two = math.radians(2.0)
    np.testing.assert_allclose(beside, [50.0 * math.cos(two), 0.0, 50.0 * math.sin(two)], atol=1e-9)


def test_tremor_shakes_by_its_amount_and_returns() -> None:
    tremor = Motion(tremor_mm=(0.2, 0.0, 0.1), tremor_hz=5.0)
    where = np.array([0.0, 0.0, 500.0])
    path = np.array([rig_point(tremor, s, where) for s in np.linspace(0.0, 0.4, 401)])
    np.testing.assert_allclose(np.ptp(path, axis=0), [0.4, 0.0, 0.2], atol=1e-3)
    np.testing.assert_allclose(rig_point(tremor, 0.2, where), where, atol=1e-9)


def test_a_long_exposure_of_moving_hands_smears_the_texture_along_the_motion() -> None:
    truth = draw_truth("nominal", 3, 400, 300, TEXTURED.water.index)
    still = shot(Renderer(truth, TEXTURED), 0.0, 0.012)
    fast = Renderer(truth, replace(TEXTURED, motion=Motion(velocity_mm_s=(150.0, 0.0, 0.0))))
    middle = (slice(60, 240), slice(80, 300))

    def detail(picture: np.ndarray, axis: int) -> float:
        return float(np.sqrt((np.diff(picture, axis=axis)[middle] ** 2).mean()))

    smeared = shot(fast, 0.012, 0.012)
    along, across = detail(smeared, 1) / detail(still, 1), detail(smeared, 0) / detail(still, 0)
    assert along < 0.8, "1.8 mm are almost 3 px of this picture"
    assert across > along + 0.05
    brief = shot(fast, 0.012, 0.001)
    assert detail(brief, 1) / brief[middle].mean() > 1.1 * detail(smeared, 1) / smeared[middle].mean()
    assert smeared[middle].mean() == pytest.approx(still[middle].mean(), rel=0.05), "but takes no light"


def test_before_a_sequence_the_hands_are_still() -> None:
    truth = draw_truth("nominal", 3, 200, 150, TEXTURED.water.index)
    moving = Renderer(truth, replace(TEXTURED, motion=Motion(velocity_mm_s=(150.0, 0.0, 0.0))))
    np.testing.assert_array_equal(shot(moving, 0.0, 0.012), shot(Renderer(truth, TEXTURED), 0.0, 0.012))


def test_impossible_motion_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"velocity_mm_s = \(1.0, 2.0\); give three finite numbers"):
        Motion(velocity_mm_s=(1.0, 2.0))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"tremor_hz = 0.0; allowed are"):
        Motion(tremor_hz=0.0)
