"""Backscatter resolved in both directions: against the phase function's closed forms, drawn photons, and an integral along one ray."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hw_sim.optics.geometry import MIDDLE_MM
from hw_sim.optics.projector import defocus_px
from hw_sim.outside import Outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.rendering.stage import Stage
from hw_sim.scene import Imaging, Scene
from hw_sim.truth import TrueRig, draw_truth, project, ray
from hw_sim.water.medium import Water
from hw_sim.water.particles import FORWARD_DEG, Particles, Transfer
from hw_sim.water.spread import ForwardSpread
from hw_sim.water.veil import Veil

WIDTH_PX, HEIGHT_PX = 200, 150
NOWHERE = np.full((HEIGHT_PX, WIDTH_PX), np.nan)
ROWS, COLUMNS = np.arange(768.0)[:, None], np.arange(1024.0)[None]
SINGLE = Particles()
WHITE = np.ones((768, 1024), np.float32)


@cache
def rig() -> TrueRig:
    return draw_truth("realistic", 5, WIDTH_PX, HEIGHT_PX, Water().index)


@cache
def veil(particles: Particles = SINGLE, per_m: float = 0.0, defocus: bool = False) -> Veil:
    stage = Stage(rig())
    return Veil(stage.rays("left"), stage.lamp, particles, per_m, defocus)


def fringes(coordinate: np.ndarray, period_px: float, phase: float = 0.0) -> np.ndarray:
    wave = 0.5 + 0.5 * np.cos(2.0 * math.pi * coordinate / period_px - phase)
    return np.ascontiguousarray(np.broadcast_to(wave, (768, 1024)), np.float32)


def contrast(of: Veil, coordinate: np.ndarray, period_px: float) -> np.ndarray:
    """Share of the fringes' contrast that the veil keeps, at each pixel that has a veil."""
    shifted = [of.seen(fringes(coordinate, period_px, 0.5 * math.pi * k), NOWHERE) for k in range(4)]
    mean = np.sum(shifted, axis=0)
    bright = mean > 0.2 * mean.max()
    return np.asarray(2.0 * np.hypot(shifted[0] - shifted[2], shifted[1] - shifted[3])[bright] / mean[bright])


@pytest.mark.parametrize(("index", "slope"), [(1.10, 3.5835), (1.05, 3.3), (1.15, 3.9)])
def test_the_phase_function_scatters_all_light_and_backwards_what_its_closed_form_says(
    index: float, slope: float
) -> None:
    particles = Particles(0.8, index, slope)
    angles = np.geomspace(1e-9, math.pi, 20_000)
    weight = 2.0 * math.pi * particles.phase(angles) * np.sin(angles)
    assert np.trapezoid(weight, angles) == pytest.approx(1.0, abs=0.01)
    # Fournier and Jonasz (1999): the share that is turned by more than 90°.
    nu, d = 0.5 * (3.0 - slope), 2.0 / (3.0 * (index - 1.0) ** 2)
    backwards = 1.0 - (1.0 - d ** (nu + 1.0) - 0.5 * (1.0 - d**nu)) / ((1.0 - d) * d**nu)
    assert np.trapezoid(np.where(angles > 0.5 * math.pi, weight, 0.0), angles) == pytest.approx(backwards, rel=0.02)
    back = particles.phase(np.radians([140.0, 155.0, 175.0]))
    assert back[0] * 1.05 < back[2], "it varies over the angles in use"


def test_the_particles_of_mobley_scatter_as_much_backwards_as_petzolds() -> None:
    angles = np.geomspace(math.pi / 2.0, math.pi, 2000)
    weight = 2.0 * math.pi * Particles().phase(angles) * np.sin(angles)
    assert np.trapezoid(weight, angles) == pytest.approx(0.0183, abs=0.0003), "n = 1.10, slope 3.5835: 0.0183"


def test_fringes_survive_scattering_as_drawn_photons_carry_them() -> None:
    particles = Particles(0.8, 1.08, 3.4)
    angles = np.geomspace(1e-6, math.radians(FORWARD_DEG), 20_000)
    weight = particles.phase(angles) * np.sin(angles)
    grown = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(angles))])
    rng = np.random.default_rng(3)
    turned = np.interp(rng.uniform(0.0, grown[-1], 200_000), grown, angles)
    across = turned * rng.uniform(0.0, 1.0, turned.size) * np.cos(rng.uniform(0.0, 2.0 * math.pi, turned.size))
    waves = np.array([3.0, 100.0, 750.0])
    drawn = np.cos(waves[:, None] * across).mean(axis=1) * particles.turned_forwards
    np.testing.assert_allclose(particles.survival(waves), drawn, atol=0.006)


def test_water_without_particles_passes_pictures_on_and_other_water_keeps_their_energy_and_dims_fine_fringes() -> None:
    picture = np.random.default_rng(1).uniform(0.0, 1.0, (60, 80)).astype(np.float32)
    np.testing.assert_allclose(ForwardSpread(Particles(), 2.0).picture(picture), picture, atol=1e-5)
    particles, per_m = Particles(0.8, 1.10, 3.6), 2.0
    spread = ForwardSpread(particles, per_m)
    forwards = particles.turned_forwards
    assert spread.gain == pytest.approx(math.exp(0.8 * per_m * MIDDLE_MM / 1000.0 * forwards))
    np.testing.assert_allclose(spread.picture(np.ones((60, 80), np.float32)), spread.gain, rtol=1e-4)
    point = np.zeros((768, 1024), np.float32)
    point[384, 512] = 1.0
    around = spread.light(point)
    assert 0.8 * spread.gain < around.sum() <= spread.gain * 1.001, "what is missing lies outside of the pattern"
    core, halo = around[384, 514], around[384, 612]
    assert core > 50.0 * halo > 0.0, "a core, and a halo of centimetres"
    amplitude = np.ptp(spread.light(fringes(COLUMNS, 16.0))[384, 500:532])
    carried = Transfer(particles, per_m)(MIDDLE_MM, np.array(2.0 * math.pi / (16.0 * 0.255)))
    assert 1.0 < amplitude == pytest.approx(float(carried), rel=0.01)


def test_the_veil_keeps_fringes_in_rows_and_loses_those_in_columns() -> None:
    kept_y, kept_x = contrast(veil(), ROWS, 16.0), contrast(veil(), COLUMNS, 16.0)
    assert np.median(kept_y) > 0.65
    assert np.percentile(kept_y, 90) > 0.9
    assert np.median(kept_x) < 0.03
    assert np.median(contrast(veil(), ROWS, 64.0)) > 0.97
    unfocused = np.median(contrast(veil(defocus=True), ROWS, 16.0))
    assert 0.1 < unfocused < 0.8 * np.median(kept_y), "near the window the projector is out of focus"


@pytest.mark.parametrize(("u_px", "v_px"), [(60, 40), (101, 73), (150, 120)])
def test_the_veil_is_the_integral_along_the_ray(u_px: int, v_px: int) -> None:
    per_m, end_mm, particles = 1.0, 520.0, Particles(0.0, 1.07, 3.5)
    seen = veil(particles, per_m)
    origin, direction = (a[0] for a in ray(rig(), "left", [[float(u_px), float(v_px)]]))
    lengths = np.arange(80.0, end_mm, 0.4) + 0.2
    points = origin + lengths[:, None] * direction
    uv = project(rig(), "projector", points)
    lit = ((uv > -0.5) & (uv < [1023.5, 767.5])).all(axis=1)
    start, ahead = ray(rig(), "projector", np.nan_to_num(uv))
    path = np.linalg.norm(points - start, axis=1)
    axis = np.array(rig().projector.R)[:, 2]
    port = rig().projector.port
    behind = rig().n_water * (port.d_mm + port.th_mm / port.n_g) * port.normal[2]
    light = particles.phase(np.arccos(-ahead @ direction)) * (ahead @ axis) ** 4
    light *= ((MIDDLE_MM + behind) / (path + behind)) ** 2 * np.exp(-per_m / 1000.0 * (path + lengths)) * lit
    far = np.full((HEIGHT_PX, WIDTH_PX), end_mm)
    white = seen.seen(WHITE, far)[v_px, u_px]
    for coordinate, place in ((ROWS, uv[:, 1]), (COLUMNS, uv[:, 0])):
        wave = 0.5 + 0.5 * np.cos(2.0 * math.pi * place / 32.0)
        wanted = np.sum(light * wave) / np.sum(light)
        # Pixel and lens are a square of two px.
        wanted = 0.5 + (wanted - 0.5) * math.sin(math.pi / 16.0) / (math.pi / 16.0)
        made = seen.seen(fringes(coordinate, 32.0), far)[v_px, u_px] / white
        assert made == pytest.approx(wanted, abs=0.008)


def test_the_unit_is_clear_white_water_before_the_middle_of_the_middle_ray() -> None:
    for particles in (Particles(), Particles(0.0, 1.05, 3.9)):
        seen = veil(particles).seen(WHITE, np.full((HEIGHT_PX, WIDTH_PX), MIDDLE_MM))
        assert seen[HEIGHT_PX // 2, WIDTH_PX // 2] == pytest.approx(1.0, abs=0.02)


def test_surfaces_cut_the_veil_and_scattering_twice_brightens_it() -> None:
    near, far = (veil().seen(WHITE, np.full((HEIGHT_PX, WIDTH_PX), mm)) for mm in (350.0, 500.0))
    nothing = veil().seen(WHITE, NOWHERE)
    assert (near <= far + 2e-3).mean() > 0.97, (
        "but for rays along the beam's upper and lower side, where steps count whole"
    )
    assert (far <= nothing + 2e-3).mean() > 0.97
    assert near.mean() < 0.8 * far.mean()
    single = veil(Particles(0.0, 1.08, 3.5), 2.0).seen(WHITE, NOWHERE)
    many = veil(Particles(0.8, 1.08, 3.5), 2.0).seen(WHITE, NOWHERE)
    assert 1.3 * single.mean() < many.mean() < math.exp(2.0 * 0.8) * single.mean()


def test_the_projector_is_sharp_in_the_middle_and_softer_the_nearer() -> None:
    depth_mm = 44.0
    sigmas = [float(defocus_px(way, depth_mm)) for way in (MIDDLE_MM, 400.0, 300.0, 200.0, 120.0)]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == 0.0
    assert float(defocus_px(MIDDLE_MM + 120.0, depth_mm)) == pytest.approx(1.1)


def test_a_picture_of_empty_turbid_water_shows_the_fringes_in_rows_only_in_the_harsher_world() -> None:
    water = Water(attenuation_per_m=1.0, backscatter=0.5)
    scene = Scene("ballbar", (0.0, 0.0, 5000.0, 0.0, 0.0, 0.0), "none", water, 0.0, False, imaging=Imaging("linear"))
    lines = [LightSlice(np.rint(250.0 * fringes(ROWS, 16.0)).astype(np.uint8), 0.012)]
    renderer = Renderer(rig(), scene)
    swings = []
    for outside in (Outside(), Outside(backscatter=Particles(0.7))):
        renderer.scene = replace(scene, outside=outside)
        column = renderer.expose("left", lines, 0.0, 0.012, 0.0, (False, False), 1)[40:110, 90:96].mean(axis=1)
        swings.append(np.std(np.diff(column)) / column.mean())
    assert swings[0] < 0.05
    assert swings[1] > 0.15


@pytest.mark.parametrize("strengths", [{"scattering_share": 1.0}, {"index": 1.0}, {"slope": 3.0}])
def test_impossible_particles_are_refused(strengths: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=f"backscatter: {next(iter(strengths))} = .*; allowed are"):
        Particles(**strengths)
