"""Projected light: pixels are squares seen through a lens, codes are no light, water dims and veils; each cause can be switched off."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from hw_sim.optics.geometry import LIT, SOFT, P, Q
from hw_sim.optics.projector import LightSlice, collect, light_between, response, soften
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Imaging, Scene
from hw_sim.water.medium import Water
from tests.hw_sim.pictures import FACING, pattern, renderer, shot

LEANING = Scene(object="plane", texture="none", noise=False, ambient=0.0)
CLEAR = Water(attenuation_per_m=0.0, backscatter=0.0)


def at_depth(z_mm: float, width_px: int = 200, **changed: object) -> Renderer:
    return renderer(replace(FACING, pose=(0.0, 0.0, z_mm, 0.0, 0.0, 0.0), **changed), width_px)  # type: ignore[arg-type]


def middle(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    h, w = picture.shape
    return picture[int(0.4 * h) : int(0.6 * h), int(0.4 * w) : int(0.6 * w)]


def fringes(period_px: float, step: int = 0) -> NDArray[np.float64]:
    """Of 0..1, by column."""
    wave: NDArray[np.float64] = np.cos(2 * np.pi * (np.arange(1024) + 0.5) / period_px + step * np.pi / 2)
    return 0.5 + 0.5 * wave


def sampled(light: np.ndarray, p: np.ndarray, q: float, softness: float = 0.0) -> np.ndarray:
    pixels = np.zeros((1, len(p), 5), np.float32)
    pixels[0, :, P], pixels[0, :, Q], pixels[0, :, LIT], pixels[0, :, SOFT] = p, q, 1.0, softness
    out = np.zeros((1, len(p)), np.float32)
    picture = np.broadcast_to(light, (768, 1024)).astype(np.float32)
    collect(pixels, soften(picture, 0.0), np.float32(1.0), np.float32(0.0), np.zeros_like(out), out)
    return np.asarray(out[0], float)


@pytest.mark.parametrize("softness", [0.0, 1.0])
def test_a_point_is_lit_by_the_phase_of_its_coordinate(softness: float) -> None:
    p = np.linspace(300.0, 340.0, 1001)
    i0, i1, i2, i3 = (sampled(fringes(16.0, k), p, 200.3, softness) for k in range(4))
    error = np.unwrap(np.arctan2(i3 - i1, i0 - i2)) / (2 * np.pi) * 16.0 - 0.5 - p
    error -= 16.0 * np.round(error.mean() / 16.0)
    assert np.abs(error).max() < 1e-3


def test_fringes_lose_contrast_as_a_square_pixel_and_a_lens_make_them() -> None:
    p = np.linspace(300.0, 348.0, 1001)
    for period_px in (4.0, 8.0, 16.0):
        square = math.sin(math.pi / period_px) / (math.pi / period_px)
        lens = math.exp(-2 * (math.pi * 0.5 / period_px) ** 2)
        assert np.ptp(sampled(fringes(period_px), p, 200.0)) == pytest.approx(square * lens, rel=0.03)
    soft = [np.ptp(sampled(fringes(8.0), p, 200.0, s)) for s in (0.0, 0.5, 1.0)]
    assert soft[0] > soft[1] > soft[2] > 0.5 * soft[0]
    beside = sampled(np.ones(1024), np.array([-1.9, -0.5, 2.0, 1021.0, 1023.5, 1024.9]), 300.0)
    np.testing.assert_allclose(beside, [0.0, 0.5, 1.0, 1.0, 0.5, 0.0], atol=0.02)


def test_an_exposure_adds_up_what_was_shown_during_it() -> None:
    table, slices = response(), [LightSlice(pattern(247), 0.004), LightSlice(pattern(0), 0.008)]
    whole, first = (light_between(tuple(slices), 0.0, until_s, table) for until_s in (0.012, 0.002))
    assert whole is not None
    assert first is not None
    np.testing.assert_allclose(whole[0, 0], 0.004 * table[247] + 0.008 * table[0], rtol=1e-5)
    np.testing.assert_allclose(first[0, 0], 0.002 * table[247], rtol=1e-5)
    assert light_between(tuple(slices), 0.02, 0.03, table) is None
    r = renderer(LEANING)
    seen = r.view("left", 0.0).seen_by_all
    assert np.median(shot(r, slices)[seen] / shot(r, 247)[seen]) == pytest.approx(1 / 3, abs=0.02)


@pytest.mark.parametrize(("law", "half"), [("linear", 0.5), ("gamma", 0.5**2.2), ("measured", 0.40)])
def test_half_the_code_is_as_much_light_as_the_response_says(law: str, half: float) -> None:
    r = at_depth(522.5, imaging=Imaging(law))
    black, some, white = (middle(shot(r, code)).mean() for code in (0, 120, 240))
    assert (some - black) / (white - black) == pytest.approx(half, abs=0.015)
    light = response(law).astype(float)
    assert (np.diff(light) > 0).all()
    assert 100 < light[255] / light[0] < 1000, "a contrast as beamers have"


def modulation(r: Renderer, period_px: float, exposure_s: float = 0.012) -> NDArray[np.float64]:
    """Amplitude of the sine that the four steps show, DN."""
    steps = [shot(r, pattern(8.0 + 239.0 * fringes(period_px, k)), exposure_s) for k in range(4)]
    return np.asarray(0.5 * np.hypot(steps[0] - steps[2], steps[3] - steps[1]))


def test_a_good_exposure_gives_the_levels_the_noise_figure_assumes() -> None:
    """12 ms, 0 dB: 200 DN from an albedo of 0.6 facing the rig; 80 DN of modulation on things as they come."""
    assert np.median(middle(shot(renderer(FACING), 247))) == pytest.approx(198, abs=8)
    pipe = renderer(Scene(noise=False))
    assert np.median(modulation(pipe, 16.0)[pipe.view("left", 0.0).seen_by_all]) == pytest.approx(80, abs=10)


@pytest.mark.parametrize(("focused", "least", "most"), [(True, 0.0, 0.95), (False, 0.97, 1.03)])
def test_fringes_are_softer_away_from_the_projectors_focus_if_it_has_one(
    focused: bool, least: float, most: float
) -> None:
    contrast = {}
    for z_mm in (462.5, 522.5, 582.5):
        r = at_depth(z_mm, imaging=Imaging("linear", projector_defocus=focused))
        contrast[z_mm] = np.median(middle(modulation(r, 8.0, 0.004)) / middle(shot(r, 247, 0.004)))
    assert least < contrast[462.5] / contrast[522.5] < most
    assert least < contrast[582.5] / contrast[522.5] < most


def test_water_dims_by_the_law_of_beer_and_lambert() -> None:
    pictures = []
    for per_m in (0.4, 1.4):
        water = Water(attenuation_per_m=per_m, backscatter=0.0, blur_px_per_m=0.0)
        pictures.append(shot(renderer(replace(LEANING, water=water)), 247))
    view = renderer(LEANING).view("left", 0.0)
    points, seen = view.points_rig_mm, view.seen_by_all
    # Both windows, of the left camera and of the projector, stand 35 mm before their centres.
    path_m = sum(np.linalg.norm(points - [x, 0.0, 0.0], axis=-1) - 35.0 for x in (-115.0, 0.0)) / 1000.0
    ratio, expected = (pictures[1] / np.maximum(pictures[0], 1.0))[seen], np.exp(-path_m)[seen]
    np.testing.assert_allclose(ratio.mean(), expected.mean(), rtol=0.01)
    assert np.corrcoef(ratio, expected)[0, 1] > 0.5


def test_distance_falls_off_as_light_spreads() -> None:
    near, far = (np.median(middle(shot(at_depth(z_mm, water=CLEAR), 247, 0.006))) for z_mm in (460.0, 580.0))
    # The light seems to come from 8.8 mm behind the projector's lens (optics of a flat port).
    assert near / far == pytest.approx(((580.0 + 8.8) / (460.0 + 8.8)) ** 2, rel=0.02)


def test_the_veil_is_the_light_between_and_grows_with_the_water_looked_through() -> None:
    thick = Water(attenuation_per_m=0.4, backscatter=0.3)
    r = at_depth(2000.0, 400, object="ballbar", water=thick)
    empty = shot(r, 247)
    assert empty[150, 200] > 18
    assert np.abs(np.diff(empty[150])).max() <= 3, "rays slip into the beam, nothing steps"
    assert shot(r, 0).max() <= 1
    # A plane cuts the path: behind it there is no water.
    gained = []
    for z_mm in (450.0, 620.0):
        veiled, bare = (at_depth(z_mm, 400, water=water) for water in (thick, replace(thick, backscatter=0.0)))
        gained.append(np.median((shot(veiled, 247, 0.004) - shot(bare, 247, 0.004))[100:200, 130:270]))
    assert gained[0] < gained[1]
    # Light on one half of the pattern makes a veil on the side where the camera looks through it.
    lit = shot(r, pattern(247.0 * (np.arange(1024) >= 512)))
    assert lit[150, 330] > 2.0 * lit[150, 60]
