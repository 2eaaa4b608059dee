"""Families of the harsher world reach the picture when they are on, and none of it stays when they are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.objects.hand_track import HandTrack
from hw_sim.objects.soft import SoftBody
from hw_sim.optics.camera_traits import CameraTraits
from hw_sim.outside import Outside, draw_outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth

X = np.arange(1024)
FRINGES = np.broadcast_to(np.uint8(127.5 + 110.0 * np.sin(2.0 * np.pi * X / 16.0)), (768, 1024)).copy()
PLANE = Scene(object="plane", noise=False, texture="none", ambient=0.0)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(draw_truth("realistic", 3, 160, 120, PLANE.water.index), PLANE)


def shot(renderer: Renderer, outside: Outside, time_s: float = 0.0, scene: Scene = PLANE) -> NDArray[np.uint8]:
    renderer.scene = replace(scene, outside=outside)
    return renderer.expose("left", [LightSlice(FRINGES, 0.012)], time_s, 0.012, 0.0, (False, False), 7)


def test_switched_on_and_off_again_the_picture_is_the_ordinary_one(renderer: Renderer) -> None:
    before = shot(renderer, Outside(), 0.2)
    assert (shot(renderer, draw_outside(3, ["cameras", "hands"]), 0.2) != before).mean() > 0.3
    np.testing.assert_array_equal(shot(renderer, Outside(), 0.2), before)


def test_other_cameras_see_the_same_scene_with_their_own_response(renderer: Renderer) -> None:
    plain = shot(renderer, Outside()).astype(float) - 2.0
    traits = CameraTraits(13_000.0, 0.0, 6.0, 0.0, 0.0, corner_loss=0.4)
    seen = shot(renderer, Outside(cameras=traits)).astype(float) - 6.0
    v, u = np.mgrid[:120, :160]
    rho2 = ((u - 79.5) ** 2 + (v - 59.5) ** 2) / (80.0**2 + 60.0**2)
    lit = (plain > 30.0) & (plain < 240.0)
    assert np.abs(seen - plain * (1.0 - 0.4 * rho2))[lit].max() < 1.6


def test_hands_begin_with_the_sequence_and_move_picture_and_truth_alike(renderer: Renderer) -> None:
    hands = HandTrack(jerk_mm_s3=(0.0, 0.0, 300.0))
    np.testing.assert_array_equal(shot(renderer, Outside(hands=hands), -0.1), shot(renderer, Outside(), -0.1))
    assert (shot(renderer, Outside(hands=hands), 0.4) != shot(renderer, Outside(), 0.4)).mean() > 0.2
    still = renderer.view("left", 0.4).points_rig_mm
    renderer.scene = replace(PLANE, outside=Outside(hands=hands))
    nearer = renderer.view("left", 0.4).points_rig_mm
    normal_mm = renderer.surface(0.4).distance_mm(still[np.isfinite(still[..., 0])])
    assert np.nanmedian((still - nearer)[..., 2]) == pytest.approx(3.2, abs=0.2)
    # It has come nearer by j t³/6 along z, less along the normal of a plane that leans: the old front lies inside of it.
    assert np.median(normal_mm) == pytest.approx(-3.2 * np.cos(np.radians(8.0)) * np.cos(np.radians(12.0)), abs=0.1)


def test_a_soft_object_waves_during_the_sequence(renderer: Renderer) -> None:
    soft = SoftBody(wave_mm=2.0, length_mm=150.0, wave_hz=1.0)
    pictures: Sequence[NDArray[np.uint8]] = [shot(renderer, Outside(soft=soft), s) for s in (0.1, 0.35, 1.1)]
    assert (pictures[0] != pictures[1]).mean() > 0.1
    np.testing.assert_array_equal(pictures[0], pictures[2])
    points = renderer.view("left", 0.1).points_rig_mm
    on = np.isfinite(points[..., 0])
    assert np.abs(renderer.surface(0.1).distance_mm(points[on])).max() < 1e-4
    apart = renderer.surface(0.35).distance_mm(points[on])
    assert 1.5 < np.abs(apart).max() < 4.1


def test_the_whole_set_before_a_rig_of_its_own_still_shows_fringes() -> None:
    drawn = draw_outside(5)
    scene = Scene(object="pipe", outside=drawn)
    r = Renderer(draw_truth("outside", 5, 160, 120, scene.water.index), scene)
    picture = r.expose("right", [LightSlice(FRINGES, 0.012)], 0.1, 0.012, 0.0, (True, False), 7).astype(float)
    seen = r.view("right", 0.1).seen_by_all
    assert seen.mean() > 0.1
    assert drawn.cameras is not None
    assert picture[seen].std() > 10.0
    assert np.median(picture[~seen]) < 0.6 * np.median(picture[seen])
