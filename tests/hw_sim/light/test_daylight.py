"""Foreign light: lamps flicker as exposures average them, a torch shines where it points, waves gather light and lose none."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.light.caustics import CELLS, Net
from hw_sim.light.daylight import Daylight
from hw_sim.truth import project
from hw_sim.water.medium import Water
from tests.hw_sim.pictures import FACING, renderer, shot

PLANE = replace(FACING, water=Water(attenuation_per_m=0.0, backscatter=0.0))
TORCH = Daylight(torch=0.8, torch_at_mm=(20.0, 10.0, 522.5), torch_direction=(0.0, 0.0, 1.0), torch_diameter_mm=60.0)


@pytest.mark.parametrize(("hz", "exposure_s"), [(100.0, 0.012), (120.0, 0.004), (100.0, 0.010)])
def test_an_exposure_averages_flicker_as_the_sinc_says_but_not_the_projectors_light(
    hz: float, exposure_s: float
) -> None:
    lamp = Daylight(flicker_depth=0.8, flicker_hz=hz)
    r = renderer(replace(PLANE, ambient=0.5, daylight=lamp), 160)
    seen = [shot(r, None, exposure_s, clock_s=k / (16.0 * hz))[50:70, 70:90].mean() for k in range(16)]
    left = abs(math.sin(math.pi * hz * exposure_s) / (math.pi * hz * exposure_s))
    assert np.ptp(seen) / 2.0 / np.mean(seen) == pytest.approx(0.8 * left, abs=0.01)
    dark = renderer(replace(PLANE, daylight=lamp), 160)
    np.testing.assert_array_equal(shot(dark, 128, exposure_s), shot(dark, 128, exposure_s, clock_s=0.003))


def test_a_torch_lights_its_place_and_half_as_much_at_half_its_diameter() -> None:
    r = renderer(replace(PLANE, daylight=TORCH), 400)
    seen = shot(r, None)
    spots = np.array([[20.0, 10.0, 522.5], [50.0, 10.0, 522.5], [20.0, -20.0, 522.5]])
    middle, right, above = (seen[round(v), round(u)] for u, v in project(r.truth, "left", spots))
    assert (right / middle, above / middle) == (pytest.approx(0.5, abs=0.02), pytest.approx(0.5, abs=0.02))
    even = shot(renderer(replace(PLANE, ambient=0.8), 400), None)
    assert middle == pytest.approx(even[150, 200], abs=1.5), "as bright as ambient light of the same strength"
    dim = Water(attenuation_per_m=2.0, backscatter=0.0)
    assert shot(renderer(replace(PLANE, daylight=TORCH, water=dim), 400), None).max() / seen.max() == pytest.approx(
        math.exp(-2.0 * 0.5), rel=0.03
    )


def test_waves_gather_light_into_lines_and_lose_none() -> None:
    light = Net(60.0, 400.0, 5).light(0.3)
    assert light.shape == (CELLS, CELLS)
    assert float(light.mean()) == pytest.approx(1.0, abs=1e-4)
    assert light.min() >= 0.0
    assert np.mean(light > 2.0) < 0.15, "lines, not clouds"
    assert light.max() > 5.0
    np.testing.assert_array_equal(light, Net(60.0, 400.0, 5).light(0.3))


def test_both_cameras_see_the_same_net_on_the_surface() -> None:
    r = renderer(replace(PLANE, ambient=0.5, daylight=Daylight(caustics=0.5)), 400)
    x, y = np.meshgrid(np.arange(-60.0, 60.0, 4.0), np.arange(-50.0, 50.0, 4.0))
    points = np.stack([x, y, np.full_like(x, 522.5)], -1).reshape(-1, 3)
    seen = []
    for side in ("left", "right"):
        u, v = np.rint(project(r.truth, side, points)).astype(int).T
        seen.append(shot(r, None, 0.004, side=side, clock_s=1.7)[v, u])
    assert np.std(seen[0]) > 10.0
    assert np.corrcoef(seen)[0, 1] > 0.97
