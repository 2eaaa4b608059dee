"""A soft object: the wave lifts every surface by what it says, travels at its speed, and the tape measure follows it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hw_sim.objects.shapes import NAMES, PLANE, VARIED, distances, march_all
from hw_sim.objects.soft import SoftBody
from hw_sim.truth import Artefacts

RIGID = Artefacts().sizes()
SOFTEST = SoftBody(wave_mm=3.0, length_mm=90.0, wave_hz=0.5, phase_rad=0.4)


def met(kind: int, sizes: np.ndarray, xy: np.ndarray) -> np.ndarray:
    rays = np.zeros((len(xy), 6))
    rays[:, :2], rays[:, 2], rays[:, 5] = xy, -400.0, 1.0
    out = np.empty(len(xy))
    march_all(kind if sizes is RIGID else kind + VARIED, sizes, rays, out)
    return out


@pytest.mark.parametrize("name", [name for name in NAMES if name != "board"])
def test_every_surface_is_lifted_by_the_wave(name: str) -> None:
    xy = np.random.default_rng(5).uniform(-35.0, 35.0, (200, 2))
    flat, waving = met(NAMES[name], RIGID, xy), met(NAMES[name], SOFTEST.waving(RIGID, 0.3), xy)
    hit = np.isfinite(flat)
    assert hit.sum() > 5
    phase = 2.0 * math.pi * ((0.8 * xy[:, 0] + 0.6 * xy[:, 1]) / 90.0 - 0.5 * 0.3) + 0.4
    np.testing.assert_allclose((waving - flat)[hit], 3.0 * np.sin(phase)[hit], atol=2e-6)


def test_the_tape_measure_lies_on_the_waving_surface() -> None:
    sizes = SOFTEST.waving(RIGID, 0.2)
    xy = np.random.default_rng(6).uniform(-60.0, 60.0, (50, 2))
    points = np.column_stack([xy, met(PLANE, sizes, xy) - 400.0])
    out = np.empty(len(points))
    distances(PLANE + VARIED, sizes, points, out)
    assert np.abs(out).max() < 1e-6
