"""What a laser pointer does: a dot where its beam meets the surface, shared by edges, and a streak before it in milky water."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, project
from hw_sim.water.medium import Water
from tests.hw_sim.pictures import FACING, renderer, shot


def light_of_beam(scene: Scene, exposure_s: float = 0.001, side: str = "left", width_px: int = 800) -> np.ndarray:
    """What the left pointer adds to the picture; the exposure is short, so that nothing saturates."""
    r = renderer(scene, width_px)
    on, off = (shot(r, 0, exposure_s, side=side, gain_db=12.0, lasers=(lit, False)) for lit in (True, False))
    return np.asarray(on - off)


def beam(width_px: int) -> tuple[TrueRig, np.ndarray, np.ndarray]:
    truth = draw_truth("nominal", 3, width_px, width_px * 3 // 4, FACING.index)
    return truth, np.array(truth.lasers[0].origin_mm), np.array(truth.lasers[0].direction)


@pytest.mark.parametrize("side", ["left", "right"])
def test_both_cameras_see_the_dot_where_the_refracted_beam_ends(side: str) -> None:
    dot = light_of_beam(FACING, side=side)
    truth, origin, direction = beam(800)
    met = origin + direction * (522.5 - origin[2]) / direction[2]
    np.testing.assert_allclose(met, (-20.0, 0.0, 522.5), atol=1e-9)
    (u, v), weight = project(truth, side, met[None])[0], np.where(dot > 0.3 * dot.max(), dot, 0.0)
    vv, uu = np.mgrid[0:600, 0:800]
    assert (weight * uu).sum() / weight.sum() == pytest.approx(u, abs=0.2)
    assert (weight * vv).sum() / weight.sum() == pytest.approx(v, abs=0.2)


@pytest.mark.parametrize("beside_mm", [-0.9, 0.5])
def test_an_edge_that_cuts_a_beam_gets_its_share_of_the_light_even_where_the_axis_passes_by(beside_mm: float) -> None:
    """Of a Gaussian of 0.9 mm, on a bar of 10 mm: the middle of the beam passes its edge ``beside_mm`` outside."""
    bar = replace(FACING, object="ballbar", water=Water(backscatter=0.0))
    whole, cut = (
        light_of_beam(replace(bar, pose=(0.0, y_mm, 522.5, 0.0, 0.0, 0.0)), 0.0005).sum()
        for y_mm in (0.0, 5.0 + beside_mm)
    )
    assert cut / whole == pytest.approx(0.5 * math.erfc(beside_mm / 0.9 / math.sqrt(2.0)), abs=0.06)


def test_milky_water_shows_the_beam_as_a_streak_that_ends_at_the_dot() -> None:
    """Nothing of it in clear water, and nothing behind the surface."""
    truth, origin, direction = beam(400)
    milk, clear = (light_of_beam(replace(FACING, water=Water(backscatter=b)), 0.012, width_px=400) for b in (0.4, 0.0))
    points = origin + np.array([[300.0], [620.0]]) * direction
    (u, v), (far_u, far_v) = np.rint(project(truth, "left", points)).astype(int)
    assert milk[v, u] > 8.0
    assert milk[v, u] > 4.0 * milk[v + 12, u], "narrow"
    assert clear[v, u] < 1.0
    assert milk[far_v, far_u] < 1.0
