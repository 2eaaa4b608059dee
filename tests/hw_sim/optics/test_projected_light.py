"""Projected light: pixels are squares seen through a lens, codes are no light, water dims and veils."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.optics.geometry import LIT, SOFT, P, Q
from hw_sim.optics.projector import LightSlice, collect, light_between, response, soften
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water

WHITE = np.full((768, 1024), 247, np.uint8)
BLACK = np.zeros((768, 1024), np.uint8)
EXPOSURE_S = 0.012
QUIET = Scene(object="plane", texture="none", noise=False, ambient=0.0)


def sampled(light: np.ndarray, p: np.ndarray, q: float, softness: float = 0.0) -> np.ndarray:
    pixels = np.zeros((1, len(p), 5), np.float32)
    pixels[0, :, P], pixels[0, :, Q], pixels[0, :, LIT], pixels[0, :, SOFT] = p, q, 1.0, softness
    out = np.zeros((1, len(p)), np.float32)
    nothing = np.zeros_like(out)
    collect(pixels, soften(light.astype(np.float32), 0.0), np.float32(1.0), np.float32(0.0), nothing, out)
    return np.asarray(out[0], float)


def fringes(period_px: float, step: int) -> np.ndarray:
    phase = 2 * np.pi * (np.arange(1024) + 0.5) / period_px + step * np.pi / 2
    return np.broadcast_to(0.5 + 0.5 * np.cos(phase), (768, 1024))


def renderer(scene: Scene, kind: str = "nominal", width_px: int = 400) -> Renderer:
    return Renderer(draw_truth(kind, 3, width_px, width_px * 3 // 4, scene.water.index), scene)


def shot(r: Renderer, *slices: LightSlice, exposure_s: float = EXPOSURE_S) -> np.ndarray:
    return r.expose("left", list(slices), 0.0, exposure_s, 0.0, (False, False), 1).astype(float)


def white(exposure_s: float = EXPOSURE_S) -> LightSlice:
    return LightSlice(WHITE, exposure_s)


def test_codes_make_light_monotonously_and_by_no_pure_gamma() -> None:
    light = response().astype(float)
    assert (np.diff(light) > 0).all()
    assert 100 < light[255] / light[0] < 1000, "a contrast as beamers have"
    net = (light - light[0]) / (light[255] - light[0])
    gamma = [math.log(net[code]) / math.log(code / 255) for code in (25, 128, 230)]
    assert max(gamma) - min(gamma) > 0.05


@pytest.mark.parametrize("softness", [0.0, 0.4, 1.0])
def test_a_point_is_lit_by_the_phase_of_its_coordinate(softness: float) -> None:
    p = np.linspace(300.0, 340.0, 1001)
    i0, i1, i2, i3 = (sampled(fringes(16.0, k), p, 200.3, softness) for k in range(4))
    phase = np.unwrap(np.arctan2(i3 - i1, i0 - i2))
    found = phase / (2 * np.pi) * 16.0 - 0.5
    error = found - p
    error -= 16.0 * np.round(error.mean() / 16.0)
    assert np.abs(error).max() < 1e-3


def test_fringes_lose_contrast_as_a_square_pixel_and_a_lens_make_them() -> None:
    p = np.linspace(300.0, 348.0, 1001)
    for period_px in (4.0, 8.0, 16.0):
        seen = np.ptp(sampled(fringes(period_px, 0), p, 200.0))
        square = math.sin(math.pi / period_px) / (math.pi / period_px)
        assert seen == pytest.approx(square * math.exp(-2 * (math.pi * 0.5 / period_px) ** 2), rel=0.03)
    soft = [np.ptp(sampled(fringes(8.0, 0), p, 200.0, s)) for s in (0.0, 0.5, 1.0)]
    assert soft[0] > soft[1] > soft[2] > 0.5 * soft[0]


def test_beside_the_pattern_it_is_dark() -> None:
    p = np.array([-1.9, -0.5, 2.0, 1021.0, 1023.5, 1024.9])
    lit = sampled(np.ones((768, 1024)), p, 300.0)
    np.testing.assert_allclose(lit, [0.0, 0.5, 1.0, 1.0, 0.5, 0.0], atol=0.02)
    corner = sampled(np.ones((768, 1024)), np.array([-0.5]), 767.5)
    assert corner[0] == pytest.approx(0.25, abs=0.01)


def test_an_exposure_adds_up_what_was_shown_during_it() -> None:
    table = response()
    slices = (LightSlice(WHITE, 0.004), LightSlice(BLACK, 0.008))
    whole, first = light_between(slices, 0.0, 0.012, table), light_between(slices, 0.0, 0.002, table)
    assert whole is not None
    assert first is not None
    np.testing.assert_allclose(whole[0, 0], 0.004 * table[247] + 0.008 * table[0], rtol=1e-5)
    np.testing.assert_allclose(first[0, 0], 0.002 * table[247], rtol=1e-5)
    assert light_between(slices, 0.02, 0.03, table) is None
    r = renderer(QUIET)
    seen = r.view("left", 0.0).seen_by_all
    third = shot(r, *slices)[seen] - 2.0
    assert np.median(third / (shot(r, white())[seen] - 2.0)) == pytest.approx(1 / 3, abs=0.02)


def modulation(r: Renderer, period_px: float, exposure_s: float = EXPOSURE_S) -> np.ndarray:
    """Amplitude of the sine that the four steps show, DN."""
    steps = []
    for k in range(4):
        codes = np.rint(127.5 + 119.5 * np.cos(2 * np.pi * (np.arange(1024) + 0.5) / period_px + k * np.pi / 2))
        image = np.broadcast_to(codes.astype(np.uint8), (768, 1024))
        steps.append(shot(r, LightSlice(image, exposure_s), exposure_s=exposure_s))
    return np.asarray(0.5 * np.hypot(steps[0] - steps[2], steps[3] - steps[1]))


def test_a_good_exposure_gives_the_levels_the_noise_figure_assumes() -> None:
    """12 ms, 0 dB: 200 DN from an albedo of 0.6 facing the rig; 80 DN of modulation on things as they come."""
    facing = renderer(replace(QUIET, pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0)), width_px=800)
    assert np.median(shot(facing, white())[280:320, 380:420]) == pytest.approx(200, abs=8)
    pipe = renderer(Scene(noise=False), width_px=800)
    seen = pipe.view("left", 0.0).seen_by_all
    assert np.median(modulation(pipe, 16.0)[seen]) == pytest.approx(80, abs=10)


def test_fringes_are_softer_away_from_the_focus() -> None:
    contrast = {}
    for z_mm in (462.5, 522.5, 582.5):
        r = renderer(replace(QUIET, pose=(0.0, 0.0, z_mm, 0.0, 0.0, 0.0)), width_px=800)
        level = shot(r, white(0.008), exposure_s=0.008)[260:340, 340:460] - 2.0
        contrast[z_mm] = np.median(modulation(r, 8.0, 0.008)[260:340, 340:460] / level)
    assert contrast[462.5] < 0.95 * contrast[522.5]
    assert contrast[582.5] < 0.95 * contrast[522.5]


def test_water_dims_by_the_law_of_beer_and_lambert() -> None:
    pictures = {}
    for per_m in (0.4, 1.4):
        water = Water(attenuation_per_m=per_m, backscatter=0.0, blur_px_per_m=0.0)
        pictures[per_m] = shot(renderer(replace(QUIET, water=water)), white()) - 2.0
    r = renderer(QUIET)
    view = r.view("left", 0.0)
    points, seen = view.points_rig_mm, view.seen_by_all
    left, lamp = np.array([-115.0, 0.0, 0.0]), np.zeros(3)
    # Both windows stand 35 mm before their centres.
    path_m = sum(np.linalg.norm(points - eye, axis=-1) - 35.0 for eye in (left, lamp)) / 1000.0
    expected = np.exp(-1.0 * path_m)
    ratio = pictures[1.4] / np.maximum(pictures[0.4], 1.0)
    np.testing.assert_allclose(ratio[seen].mean(), expected[seen].mean(), rtol=0.01)
    assert np.corrcoef(ratio[seen], expected[seen])[0, 1] > 0.5


def test_distance_falls_off_as_light_spreads() -> None:
    levels = []
    clear = Water(attenuation_per_m=0.0, backscatter=0.0)
    for z_mm in (460.0, 580.0):
        r = renderer(replace(QUIET, water=clear, pose=(0.0, 0.0, z_mm, 0.0, 0.0, 0.0)))
        levels.append(np.median((shot(r, white(0.006), exposure_s=0.006) - 2.0)[140:160, 190:210]))
    # The light seems to come from 8.8 mm behind the projector's lens (optics of a flat port).
    assert levels[0] / levels[1] == pytest.approx(((580.0 + 8.8) / (460.0 + 8.8)) ** 2, rel=0.02)


def test_the_veil_is_the_light_between_and_grows_with_the_water_looked_through() -> None:
    thick = Water(attenuation_per_m=0.4, backscatter=0.3)
    r = renderer(Scene(object="ballbar", noise=False, ambient=0.0, water=thick, pose=(0.0, 0.0, 2000.0, 0, 0, 0)))
    empty = shot(r, white())
    assert empty[150, 200] > 20
    assert np.abs(np.diff(empty[150])).max() <= 3, "rays slip into the beam, nothing steps"
    assert shot(r, LightSlice(BLACK, EXPOSURE_S)).max() <= 3
    # A plane cuts the path: behind it there is no water.
    near, far = (
        renderer(Scene(object="plane", noise=False, ambient=0.0, texture="none", water=water, pose=(0, 0, z, 0, 0, 0)))
        for water, z in ((thick, 450.0), (thick, 620.0))
    )
    bare = replace(thick, backscatter=0.0)
    gained = []
    for with_veil in (near, far):
        without = renderer(replace(with_veil.scene, water=bare))
        gained.append(np.median((shot(with_veil, white(0.004)) - shot(without, white(0.004)))[100:200, 130:270]))
    assert gained[0] < gained[1]
    # Light on one half of the pattern makes a veil on the side where the camera looks through it.
    half = BLACK.copy()
    half[:, 512:] = 247
    lit = shot(r, LightSlice(half, EXPOSURE_S)) - 2.0
    assert lit[150, 330] > 2.0 * lit[150, 60]
