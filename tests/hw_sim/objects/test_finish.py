"""Surfaces besides Lambert's: Fresnel and energy of the gloss, spread below the surface, one bounce against drawn rays, white."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hw_sim.objects.finish import PX_MM, Finish
from hw_sim.objects.shapes import FRUSTUM, gradient, march_all
from hw_sim.optics.bounce import PATCH_PX
from hw_sim.optics.geometry import MIDDLE_MM
from hw_sim.optics.gloss import fresnel, glossy
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.medium import Water

WHITE = np.ones((768, 1024), np.float32)
CLEAR = Water(attenuation_per_m=0.0, backscatter=0.0, blur_px_per_m=0.0)


def test_fresnel_reflects_little_straight_on_and_all_at_grazing() -> None:
    for index in (1.08, 1.25):
        assert fresnel(1.0, index) == pytest.approx(((index - 1.0) / (index + 1.0)) ** 2)
        assert fresnel(1e-6, index) == pytest.approx(1.0, abs=1e-3)
        # At Brewster's angle only one polarisation is reflected: half of sin²(i − t).
        brewster = math.atan(index)
        turned = brewster - math.asin(math.sin(brewster) / index)
        assert fresnel(math.cos(brewster), index) == pytest.approx(0.5 * math.sin(turned) ** 2, rel=1e-6)


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.4])
def test_a_coat_sends_back_what_fresnel_says_and_both_ways_the_same(roughness: float) -> None:
    theta = (np.arange(400) + 0.5) / 400.0 * 0.5 * math.pi
    sent = 0.0
    for t in theta:
        # Light along the normal: the half vector stands at half of the eye's angle from both.
        value = glossy(1.0, math.cos(t), math.cos(0.5 * t), math.cos(0.5 * t), roughness, 1.12)
        sent += value * math.cos(t) * 2.0 * math.pi * math.sin(t) * (0.5 * math.pi / 400.0)
    assert 0.75 < sent / fresnel(1.0, 1.12) < 1.1, "facets shade each other, and lean towards grazing"
    one = glossy(0.9, 0.7, 0.95, 0.85, roughness, 1.12)
    assert one == pytest.approx(glossy(0.7, 0.9, 0.95, 0.85, roughness, 1.12)) != 0.0


def test_light_below_the_surface_keeps_its_energy_and_falls_exponentially() -> None:
    coat = Finish(below_part=0.5, below_mm=0.8)
    point = np.zeros((96, 128), np.float32)
    point[48, 64] = 1.0
    spread = coat.spread_below(point)
    assert spread.sum() == pytest.approx(1.0, abs=0.01)
    assert spread[48, 64] > 0.5
    assert spread[48, 76] / spread[48, 72] == pytest.approx(math.exp(-4.0 * PX_MM / 0.8), rel=0.05)
    assert Finish().spread_below(point) is point
    # A fringe of 8 px against a sum over the exponential kernel.
    x, y = np.meshgrid(np.arange(-8.0, 8.0, 0.02), np.arange(-8.0, 8.0, 0.02))
    kernel = np.exp(-np.hypot(x, y) / 0.8)
    wave = 2.0 * math.pi / (8.0 * PX_MM)
    kept = 0.5 + 0.5 * float((kernel * np.cos(wave * x)).sum() / kernel.sum())
    fringe = np.broadcast_to(0.5 + 0.5 * np.cos(2.0 * math.pi * np.arange(128) / 8.0), (96, 128)).astype(np.float32)
    assert np.ptp(coat.spread_below(fringe)[48, 40:88]) == pytest.approx(kept, abs=0.01)


def test_gloss_shines_where_a_mirror_would_and_nowhere_else() -> None:
    truth = draw_truth("nominal", 1, 160, 120, Water().index)
    # The left camera looks from 12.4° at the side: a plane that leans by half of that mirrors the projector into it.
    levels = {}
    for lean_deg in (6.2, 0.0, -25.0):
        scene = Scene("plane", (0.0, 0.0, 522.5, 0.0, lean_deg, 0.0), "none", CLEAR, 0.0, False)
        stages = [Stage(truth, None, coat) for coat in (None, Finish(gloss_index=1.16, roughness=0.1))]
        lit = [stage.geometry("left", scene, stage.pose(scene, 0.0)).pixels[55:65, 75:85, 2].mean() for stage in stages]
        levels[lean_deg] = float(lit[1] / lit[0])
    mirrored = {lean: ratio - 1.0 for lean, ratio in levels.items()}
    shine = max(mirrored.values())
    assert shine > 20.0 * mirrored[-25.0]
    # By Beckmann's facets, which now lean by half of 12.4°.
    assert mirrored[0.0] / shine == pytest.approx(math.exp(-((math.tan(math.radians(6.2)) / 0.1) ** 2)), rel=0.3)
    straight = math.pi * fresnel(1.0, 1.16) / (4.0 * math.pi * 0.1**2) / 0.6
    assert 0.3 * straight < shine < 1.3 * straight


def test_a_corner_gets_as_much_from_its_other_side_as_drawn_rays_fetch() -> None:
    truth = draw_truth("nominal", 1, 160, 120, Water().index)
    stage = Stage(truth)
    scene = Scene("frustum", (0.0, 0.0, 545.0, 0.0, 0.0, 0.0), "none", CLEAR)
    pose = stage.pose(scene, 0.0)
    bounce = stage.bounce(scene, Finish(bounce=1.0))
    fallen = bounce.irradiance(WHITE)
    # On the plate, 6 mm right of the foot of the slope.
    spot = np.array([81.0, 4.0, 0.0])
    u, v = project(truth, "projector", pose.R @ spot + pose.t)[0]
    made = fallen[int((v + 0.5) / PATCH_PX), int((u + 0.5) / PATCH_PX)]
    rng = np.random.default_rng(1)
    turn, part = rng.uniform(0.0, 2.0 * math.pi, 3000), rng.uniform(0.0, 1.0, 3000)
    # Cosine-weighted directions about −z, where the plate faces.
    rays = np.empty((3000, 6))
    rays[:, :3] = spot + np.array([0.0, 0.0, -1e-3])
    rays[:, 3], rays[:, 4] = np.sqrt(part) * np.cos(turn), np.sqrt(part) * np.sin(turn)
    rays[:, 5] = -np.sqrt(1.0 - part)
    far = np.empty(3000)
    march_all(FRUSTUM, pose.sizes, rays, far)
    fetched = 0.0
    lens = np.array(truth.projector.t_mm)
    for ray, way in zip(rays[np.isfinite(far)], far[np.isfinite(far)], strict=True):
        place = ray[:3] + way * ray[3:]
        normal = np.array(gradient(FRUSTUM, pose.sizes, *place))
        normal /= np.linalg.norm(normal)
        seen = pose.R @ place + pose.t
        # Apparent source, by small angles: everything in water's lengths behind the window.
        window = 35.0 / (seen[2] - lens[2])
        start = lens + window * (seen - lens)
        length = float(np.linalg.norm(start - seen))
        ahead = (start - seen) / length
        spread = (MIDDLE_MM + stage.lamp.depth_mm) / (length + stage.lamp.depth_mm)
        fetched += 0.6 * max(float(ahead @ (pose.R @ normal)), 0.0) * spread**2 * float(ahead[2]) ** 4
    assert made == pytest.approx(fetched / 3000.0, rel=0.25)
    assert made > 0.03, "per cent of white, on the plate beside the slope"
