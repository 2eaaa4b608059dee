"""Backscatter resolved in both directions: against the phase function's closed forms, drawn photons, and an integral along one ray."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from hw_sim.optics.geometry import MIDDLE_MM
from hw_sim.rendering.stage import Stage
from hw_sim.truth import TrueRig, draw_truth, project, ray
from hw_sim.water.medium import Water
from hw_sim.water.particles import FORWARD_DEG, Particles
from hw_sim.water.veil import Veil

WIDTH_PX, HEIGHT_PX = 200, 150
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


def test_the_veil_is_the_integral_along_the_ray() -> None:
    u_px, v_px = 150, 120
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
