"""What a laser pointer does: a dot where its beam meets the surface, wider and dimmer in turbid water, and a streak before it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.medium import Water, turbid

BLACK = np.zeros((768, 1024), np.uint8)
BARE = Scene(object="plane", pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0), texture="none", ambient=0.0, noise=False)


def light_of_beam(scene: Scene, exposure_s: float = 0.001, side: str = "left", width_px: int = 1600) -> np.ndarray:
    """What the left pointer adds to the picture; the exposure is short, so that nothing saturates."""
    truth = draw_truth("nominal", 1, width_px, width_px * 3 // 4, scene.water.index)
    renderer = Renderer(truth, scene)
    on, off = (
        renderer.expose(side, [LightSlice(BLACK, exposure_s)], 0.0, exposure_s, 12.0, (lit, False), 1).astype(float)
        for lit in (True, False)
    )
    return np.asarray(on - off)


def spread_px(dot: np.ndarray) -> float:
    """Half width along the rows of what is brighter than a tenth of the brightest."""
    weight = np.where(dot > 0.1 * dot.max(), dot, 0.0)
    u = np.arange(dot.shape[1])
    mean = (weight * u).sum() / weight.sum()
    return float(np.sqrt((weight * (u - mean) ** 2).sum() / weight.sum()))


@pytest.mark.parametrize("side", ["left", "right"])
def test_both_cameras_see_the_dot_where_the_refracted_beam_ends(side: str) -> None:
    dot = light_of_beam(BARE, side=side)
    truth = draw_truth("nominal", 1, 1600, 1200, BARE.water.index)
    origin, direction = (np.array(v) for v in (truth.lasers[0].origin_mm, truth.lasers[0].direction))
    met = origin + direction * (522.5 - origin[2]) / direction[2]
    np.testing.assert_allclose(met, (-20.0, 0.0, 522.5), atol=1e-9)
    (u, v), weight = project(truth, side, met[None])[0], np.where(dot > 0.3 * dot.max(), dot, 0.0)
    vv, uu = np.mgrid[0:1200, 0:1600]
    assert (weight * uu).sum() / weight.sum() == pytest.approx(u, abs=0.2)
    assert (weight * vv).sum() / weight.sum() == pytest.approx(v, abs=0.2)


@pytest.mark.parametrize("beside_mm", [-0.9, 0.0, 0.5, 1.0])
def test_an_edge_that_cuts_a_beam_gets_its_share_of_the_light_even_where_the_axis_passes_by(beside_mm: float) -> None:
    """Of a Gaussian of 0.9 mm, on a bar of 10 mm: the middle of the beam passes its edge ``beside_mm`` outside."""
    bar = replace(BARE, object="ballbar", water=Water(backscatter=0.0))
    whole, cut = (
        light_of_beam(replace(bar, pose=(0.0, y_mm, 522.5, 0.0, 0.0, 0.0)), 0.0005).sum()
        for y_mm in (0.0, 5.0 + beside_mm)
    )
    assert cut / whole == pytest.approx(0.5 * math.erfc(beside_mm / 0.9 / math.sqrt(2.0)), abs=0.06)


def test_what_passes_an_edge_lights_what_is_behind_it() -> None:
    """The edge of a pipe's flange halves the beam: half of the light ends on the flange, half on the pipe 15 mm behind."""
    scene = replace(BARE, object="pipe", pose=(-84.0, 0.0, 582.5, 0.0, 0.0, 0.0), water=Water(backscatter=0.0))
    light = light_of_beam(scene, 0.0005, "right")
    depth_mm = (
        Renderer(draw_truth("nominal", 1, 1600, 1200, scene.water.index), scene)
        .view("right", 0.0)
        .points_rig_mm[..., 2]
    )
    flange, pipe = (light[near].sum() for near in (depth_mm < 525.0, (depth_mm > 535.0) & (depth_mm < 545.0)))
    assert flange == pytest.approx(pipe, rel=0.35), "what is nearer looks larger"
    assert flange + pipe > 0.9 * light.sum()


def test_turbid_water_dims_the_dot_and_widens_it() -> None:
    clear, dirty = light_of_beam(BARE, 0.0005), light_of_beam(replace(BARE, water=turbid(4.0)), 0.004)
    assert dirty.max() / 8.0 < 0.2 * clear.max()
    assert spread_px(dirty) > 1.01 * spread_px(clear)


def test_milky_water_shows_the_beam_as_a_streak_that_ends_at_the_dot() -> None:
    """Nothing of it in clear water, and nothing behind the surface."""
    truth = draw_truth("nominal", 1, 400, 300, BARE.water.index)
    origin, direction = (np.array(v) for v in (truth.lasers[0].origin_mm, truth.lasers[0].direction))
    before, behind = (origin + s * direction for s in (300.0, 620.0))
    milk = light_of_beam(replace(BARE, water=Water(backscatter=0.4)), 0.012, width_px=400)
    clear = light_of_beam(replace(BARE, water=Water(backscatter=0.0)), 0.012, width_px=400)
    (u, v), (far_u, far_v) = np.rint(project(truth, "left", np.array([before, behind]))).astype(int)
    assert milk[v, u] > 8.0
    assert milk[v, u] > 4.0 * milk[v + 12, u], "narrow"
    assert clear[v, u] < 1.0
    assert milk[far_v, far_u] < 1.0


def test_speckle_belongs_to_the_place_and_a_dot_that_moves_has_another() -> None:
    scene = replace(BARE, noise=True)
    same = light_of_beam(scene), light_of_beam(scene)
    np.testing.assert_array_equal(*same)
    moved = light_of_beam(replace(scene, pose=(0.5, 0.0, 522.5, 0.0, 0.0, 0.0)))
    lit = same[0] > 0.3 * same[0].max()
    assert np.corrcoef(same[0][lit], moved[lit])[0, 1] < 0.9
    smooth = light_of_beam(BARE)[lit]
    grain = same[0][lit] / smooth
    assert 0.1 < grain.std() < 0.7
