"""Pictures follow from physics: true points lie on the surface, shadows are dark, hands and waves move picture and truth alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hw_sim.objects.hand_track import HandTrack
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import NAMES
from hw_sim.objects.soft import SoftBody
from hw_sim.optics.trace import pixels_of
from hw_sim.outside import Outside, draw_outside
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from tests.hw_sim.pictures import pattern, renderer, shot

PLANE = Scene(object="plane", noise=False, texture="none", ambient=0.0)
FRINGES = pattern(127.5 + 110.0 * np.sin(2.0 * np.pi * np.arange(1024) / 16.0))


@pytest.mark.parametrize("name", list(NAMES))
def test_what_is_seen_lies_on_the_surface_and_is_seen_there_by_the_other_camera(name: str) -> None:
    r = renderer(Scene(object=name), 200, "realistic")
    view = r.view("left", 0.0)
    assert view.seen_by_all.mean() > 0.04
    points = view.points_rig_mm[view.seen_by_all]
    assert np.abs(r.surface(0.0).distance_mm(points)).max() < 1e-4
    away = points + np.array([0.0, 0.0, -0.3])
    assert (r.surface(0.0).distance_mm(away) > 0.0).mean() > 0.99, "towards the instrument is outside"
    pixels = np.empty((len(points), 2))
    pixels_of(r.truth.right.packed(r.truth.n_water), points, pixels)
    u, v = np.rint(pixels).astype(int).T
    inner = (u > 1) & (v > 1) & (u < 198) & (v < 148)
    right = r.view("right", 0.0).points_rig_mm[v[inner], u[inner]]
    assert np.nanmedian(np.linalg.norm(right - points[inner], axis=1)) < 1.4, "within a pixel"


def test_shadows_are_black_in_the_picture_and_not_seen_by_all() -> None:
    r = renderer(Scene(object="frustum", noise=False, ambient=0.0), kind="realistic")
    view = r.view("left", 0.0)
    surface = np.isfinite(view.points_rig_mm[..., 0])
    shadow = surface & (shot(r, 247) - shot(r, 0) <= 2)
    assert 50 < shadow.sum() < 0.2 * surface.sum()
    assert (view.seen_by_all & shadow).sum() < 0.02 * shadow.sum() + 20


@pytest.mark.parametrize(
    ("scene", "nearer_mm"),
    [
        (replace(PLANE, motion=Motion(velocity_mm_s=(0.0, 0.0, 10.0))), 4.0),
        (replace(PLANE, outside=Outside(hands=HandTrack(jerk_mm_s3=(0.0, 0.0, 300.0)))), 3.2),
    ],
)
def test_moving_hands_move_the_picture_and_the_truth_alike(scene: Scene, nearer_mm: float) -> None:
    r = renderer(scene, 160, "realistic")
    np.testing.assert_array_equal(shot(r, FRINGES, time_s=-0.1), shot(renderer(PLANE, 160, "realistic"), FRINGES))
    start, later = r.view("left", 0.0), r.view("left", 0.4)
    both = start.seen_by_all & later.seen_by_all
    depth_mm = (start.points_rig_mm[..., 2] - later.points_rig_mm[..., 2])[both]
    assert np.median(depth_mm) == pytest.approx(nearer_mm, abs=0.3), "moving forward brings the plane nearer"
    assert np.abs(r.surface(0.4).distance_mm(later.points_rig_mm[both])).max() < 1e-5
    assert (shot(r, FRINGES, time_s=0.4) != shot(r, FRINGES)).mean() > 0.2


def test_a_soft_object_waves_during_the_sequence() -> None:
    r = renderer(replace(PLANE, outside=Outside(soft=SoftBody(wave_mm=2.0, length_mm=150.0, wave_hz=1.0))), 160)
    now, soon, again = (shot(r, FRINGES, time_s=s) for s in (0.1, 0.35, 1.1))
    assert (now != soon).mean() > 0.1
    np.testing.assert_array_equal(now, again)
    points = r.view("left", 0.1).points_rig_mm
    points = points[np.isfinite(points[..., 0])]
    assert np.abs(r.surface(0.1).distance_mm(points)).max() < 1e-4
    assert 1.5 < np.abs(r.surface(0.35).distance_mm(points)).max() < 4.1


def test_the_same_seed_gives_the_same_picture_and_what_was_switched_off_leaves_nothing() -> None:
    r: Renderer = renderer(replace(PLANE, noise=True), 160)
    before = shot(r, FRINGES, seed=5)
    assert (before != shot(r, FRINGES, seed=6)).mean() > 0.5
    ordinary, r.scene = r.scene, replace(r.scene, outside=draw_outside(3, ["cameras", "hands"]))
    assert (shot(r, FRINGES, seed=5) != before).mean() > 0.3
    r.scene = ordinary
    np.testing.assert_array_equal(shot(r, FRINGES, seed=5), before)
