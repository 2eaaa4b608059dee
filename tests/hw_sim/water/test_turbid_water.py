"""Turbid water: attenuation, veil and blur of one scattering coefficient, held against the pictures that they make."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hw_sim.optics.projector import LightSlice
from hw_sim.rendering.render import Renderer
from hw_sim.rendering.sensor import OFFSET_DN
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water, turbid
from hw_sim.water.scattering import FRINGE_MM, WAY_MM, phase_function, survival


def test_the_phase_function_scatters_all_light_and_its_known_share_backwards() -> None:
    angles = np.geomspace(1e-7, math.pi, 20_000)
    weight = 2.0 * math.pi * phase_function(angles) * np.sin(angles)
    whole = np.trapezoid(weight, angles)
    assert whole == pytest.approx(1.0, abs=0.02)
    back = np.trapezoid(np.where(angles > math.pi / 2.0, weight, 0.0), angles)
    assert back / whole == pytest.approx(0.0183, abs=0.0003), "Mobley's table: 0.0183"


@pytest.mark.parametrize("periods", [1.0, 0.5])
def test_fringes_are_dimmed_as_the_theory_of_small_angles_says(periods: float) -> None:
    c, share = 2.0, 0.8
    water, way_m = turbid(c, share), WAY_MM / 1000.0
    sigma_mm, wave = water.blur_px_per_m * way_m * 0.160, 2.0 * math.pi / (periods * FRINGE_MM)
    made = math.exp(-water.attenuation_per_m * way_m) * math.exp(-0.5 * (wave * sigma_mm) ** 2)
    wanted = math.exp(-c * way_m + c * share * way_m * survival(periods * FRINGE_MM))
    assert made == pytest.approx(wanted, rel=1e-6)


def test_the_pictures_modulation_falls_with_beam_attenuation() -> None:
    scene = Scene(object="plane", texture="none", noise=False, ambient=0.0, pose=(0.0, 0.0, 522.5, 0.0, 0.0, 0.0))
    truth = draw_truth("nominal", 1, 400, 300, Water().index)
    renderer = Renderer(truth, scene)
    code = np.rint(127.0 + 100.0 * np.cos(2.0 * np.pi * np.arange(1024) / 16.0)).astype(np.uint8)
    light = [LightSlice(np.ascontiguousarray(np.broadcast_to(code, (768, 1024))), 0.012)]

    def modulation(water: Water) -> float:
        renderer.scene = Scene(**{name: getattr(scene, name) for name in scene.__slots__} | {"water": water})
        image = renderer.expose("left", light, 0.0, 0.012, 0.0, (False, False), 1).astype(float) - OFFSET_DN
        return float(np.ptp(np.percentile(image[140:160, 150:250], (5, 95))))

    seen = modulation(turbid(1.5)) / modulation(turbid(0.5))
    ways_m = 0.487 + 0.500
    assert seen == pytest.approx(math.exp(-ways_m * (1.0 - 0.8 * survival(FRINGE_MM))), rel=0.05)
