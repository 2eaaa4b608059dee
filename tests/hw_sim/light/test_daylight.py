"""Foreign light: lamps flicker as exposures average them, a torch shines where it points, waves gather light and lose none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.light.caustics import CELLS, Net
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.rendering.sensor import OFFSET_DN
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, project
from hw_sim.water.medium import Water

GREY = np.full((768, 1024), 128, np.uint8)
PLANE = Scene(
    object="plane", texture="none", noise=False, ambient=0.5, pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0),
    water=Water(attenuation_per_m=0.0, backscatter=0.0),
)  # fmt: skip
FRAME_S = 1.0 / 60.0


def renderer(scene: Scene, width_px: int = 160) -> Renderer:
    return Renderer(draw_truth("nominal", 3, width_px, width_px * 3 // 4, scene.water.index), scene)


def shot(
    r: Renderer, clock_s: float, exposure_s: float = 0.012, light: bool = False, time_s: float = 0.0
) -> np.ndarray:
    slices = [LightSlice(GREY, exposure_s)] if light else []
    return r.expose("left", slices, time_s, exposure_s, 0.0, (False, False), 1, clock_s).astype(float) - OFFSET_DN


def swing(depth: float, hz: float, exposure_s: float) -> float:
    """Half the range of the middle's brightness over many phases, against its mean."""
    r = renderer(replace(PLANE, daylight=Daylight(flicker_depth=depth, flicker_hz=hz)))
    seen = [shot(r, k / (16.0 * hz), exposure_s)[50:70, 70:90].mean() for k in range(16)]
    return float(np.ptp(seen) / 2.0 / np.mean(seen))


@pytest.mark.parametrize(("hz", "exposure_s"), [(100.0, 0.012), (120.0, 0.012), (100.0, 0.005), (120.0, 0.004)])
def test_an_exposure_averages_flicker_as_the_sinc_says(hz: float, exposure_s: float) -> None:
    left = abs(math.sin(math.pi * hz * exposure_s) / (math.pi * hz * exposure_s))
    assert swing(0.8, hz, exposure_s) == pytest.approx(0.8 * left, abs=0.01)


def test_whole_periods_show_no_flicker() -> None:
    assert swing(1.0, 100.0, 0.010) < 0.004


def test_100_hz_beats_with_60_frames_a_second_every_third_frame_and_120_hz_stands_still() -> None:
    for hz, period in ((100.0, 3), (120.0, 1)):
        r = renderer(replace(PLANE, daylight=Daylight(flicker_depth=1.0, flicker_hz=hz)))
        seen = np.array([shot(r, k * FRAME_S, 0.005)[60, 80] for k in range(9)])
        assert np.ptp(seen[::period]) <= 1.0
        assert (np.ptp(seen) > 20.0) == (period == 3)


def test_the_projectors_light_does_not_flicker() -> None:
    r = renderer(replace(PLANE, ambient=0.0, daylight=Daylight(flicker_depth=1.0)))
    np.testing.assert_array_equal(shot(r, 0.0, light=True), shot(r, 0.003, light=True))


def test_without_special_light_the_clock_does_not_matter() -> None:
    r = renderer(Scene(object="pipe"))
    np.testing.assert_array_equal(shot(r, 0.0, light=True), shot(r, 12.34, light=True))


def test_a_torch_lights_its_place_and_half_as_much_at_half_its_diameter() -> None:
    torch = Daylight(
        torch=0.8, torch_at_mm=(20.0, 10.0, 522.5), torch_direction=(0.0, 0.0, 1.0), torch_diameter_mm=60.0
    )
    r = renderer(replace(PLANE, ambient=0.0, daylight=torch), 800)
    seen = shot(r, 0.0)
    spots = np.array([[20.0, 10.0, 522.5], [50.0, 10.0, 522.5], [20.0, -20.0, 522.5]])
    middle, right, above = (seen[round(v), round(u)] for u, v in project(r.truth, "left", spots))
    assert (right / middle, above / middle) == (pytest.approx(0.5, abs=0.02), pytest.approx(0.5, abs=0.02))
    even = shot(renderer(replace(PLANE, ambient=0.8), 800), 0.0)
    assert middle == pytest.approx(even[300, 400], abs=1.5), "as bright as ambient light of the same strength"


def test_a_swinging_torch_moves_with_its_velocity() -> None:
    torch = Daylight(torch=0.8, torch_velocity_mm_s=(-100.0, 0.0, 0.0))
    moved = torch.torch_mm(0.02) - torch.torch_mm(0.0)
    np.testing.assert_allclose(moved, [-2.0, 0.0, 0.0], atol=0.01)
    assert max(abs(torch.torch_mm(t)[0] - torch.torch_at_mm[0]) for t in np.linspace(0.0, 50.0, 500)) < 150.0


def test_the_spot_stays_where_it_is_while_the_hands_move() -> None:
    torch = Daylight(torch=0.8, torch_at_mm=(0.0, 0.0, 522.5), torch_direction=(0.0, 0.0, 1.0), torch_diameter_mm=40.0)
    r = renderer(replace(PLANE, ambient=0.0, daylight=torch, motion=Motion(velocity_mm_s=(50.0, 0.0, 0.0))), 400)

    def middle(time_s: float) -> float:
        seen = shot(r, time_s, time_s=time_s, exposure_s=0.002)
        return float((seen.sum(axis=0) @ np.arange(400)) / seen.sum())

    u = project(r.truth, "left", np.array([[0.0, 0.0, 522.5], [-20.0, 0.0, 522.5]]))[:, 0]
    assert middle(0.4) - middle(0.0) == pytest.approx(u[1] - u[0], abs=0.5)


def test_water_dims_a_torch_on_the_way_back() -> None:
    torch, dim = Daylight(torch=0.4), Water(attenuation_per_m=2.0, backscatter=0.0)
    clear = shot(renderer(replace(PLANE, ambient=0.0, daylight=torch)), 0.0).max()
    seen = shot(renderer(replace(PLANE, ambient=0.0, daylight=torch, water=dim)), 0.0).max()
    assert seen / clear == pytest.approx(math.exp(-2.0 * 0.5), rel=0.03)


def test_waves_gather_light_into_lines_and_lose_none() -> None:
    net = Net(60.0, 400.0, 5)
    light = net.light(0.3)
    assert light.shape == (CELLS, CELLS)
    assert float(light.mean()) == pytest.approx(1.0, abs=1e-4)
    assert light.min() >= 0.0
    assert np.mean(light > 2.0) < 0.15, "lines, not clouds"
    assert light.max() > 5.0


def test_the_net_has_the_mesh_it_was_asked_for() -> None:
    meshes_mm = []
    for seed in range(4):
        net = Net(60.0, 400.0, seed)
        bright = net.light(0.0) > 1.5
        entered = np.count_nonzero(bright & ~np.roll(bright, 1, axis=1)) / CELLS  # lines that a straight path meets
        meshes_mm.append(net.tile_mm / entered)
    assert np.mean(meshes_mm) == pytest.approx(60.0, rel=0.3)


def test_the_net_moves_and_belongs_to_its_seed() -> None:
    net = Net(60.0, 400.0, 5)
    now, soon, later = (net.light(t).ravel() for t in (0.0, 0.002, 0.1))
    assert np.corrcoef(now, soon)[0, 1] > 0.9 > 0.6 > np.corrcoef(now, later)[0, 1]
    np.testing.assert_array_equal(net.light(0.1), Net(60.0, 400.0, 5).light(0.1))
    assert abs(np.corrcoef(now, Net(60.0, 400.0, 6).light(0.0).ravel())[0, 1]) < 0.2


def test_both_cameras_see_the_same_net_on_the_surface() -> None:
    scene = replace(PLANE, daylight=Daylight(caustics=0.5))
    r = renderer(scene, 400)
    images = {
        side: r.expose(side, [], 0.0, 0.004, 0.0, (False, False), 1, 1.7).astype(np.float32)
        for side in ("left", "right")
    }
    x, y = np.meshgrid(np.arange(-60.0, 60.0, 4.0), np.arange(-50.0, 50.0, 4.0))
    points = np.stack([x, y, np.full_like(x, 522.5)], -1).reshape(-1, 3)
    seen = []
    for side, image in images.items():
        at = np.rint(project(r.truth, side, points)).astype(int)
        seen.append(image[at[:, 1], at[:, 0]])
    assert np.std(seen[0]) > 10.0
    assert np.corrcoef(seen)[0, 1] > 0.97


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"flicker_depth": 1.5}, "flicker_depth = 1.5; allowed are 0..1"),
        ({"flicker_hz": float("nan")}, "flicker_hz"),
        ({"torch_direction": (0.0, 0.0, 0.0)}, "torch_direction"),
        ({"torch_at_mm": (0.0, 0.0)}, "three finite numbers"),
    ],
)
def test_impossible_light_is_refused_with_its_range(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Daylight(**wrong)  # type: ignore[arg-type]
