"""Flaws of lens and window: a field of the amount and spectrum that was asked for, a pupil that moves, a window that is bent."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hw_sim.optics.aberrations import ORDERS, Aberrations, LensFlaws, flawed
from hw_sim.optics.trace import flaw_field, pixel_ray
from hw_sim.truth import TrueEye, draw_truth
from hw_sim.water.medium import Water

N_WATER = Water().index
NOMINAL = draw_truth("nominal", 1, 1600, 1200, N_WATER).left


def field_at(eye: TrueEye, uv: np.ndarray) -> np.ndarray:
    packed = eye.packed(N_WATER)
    return np.array([flaw_field(packed, float(u), float(v)) for u, v in uv])


def grid(step: int = 40) -> np.ndarray:
    v, u = np.mgrid[step // 2 : 1200 : step, step // 2 : 1600 : step]
    return np.stack([u.ravel(), v.ravel()], -1) - 0.5


def test_the_field_has_its_amount_in_each_component_up_to_order_eleven_and_no_shift() -> None:
    strengths = LensFlaws(field_px=0.06, fall=1.5)
    eye = replace(NOMINAL, aberrations=flawed(strengths, np.random.default_rng(4), 1600, 1200, 1.0))
    field = field_at(eye, grid())
    np.testing.assert_allclose(np.sqrt((field**2).mean(axis=0)), 0.06, rtol=1e-6)
    assert np.abs(field.mean(axis=0)).max() < 1e-12
    assert eye.aberrations is not None
    high = np.reshape(eye.aberrations.field_px, (2, ORDERS, ORDERS))
    assert np.abs(high[:, ORDERS - 1, :]).min() > 0.0
    assert np.abs(high[:, :, ORDERS - 1]).min() > 0.0


def test_a_dent_displaces_radially_and_most_at_its_width() -> None:
    eye = replace(NOMINAL, aberrations=Aberrations(dent=(700.0, 500.0, 100.0, 0.1)))
    around = np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0.0, 6.0, 7)])
    np.testing.assert_allclose(field_at(eye, [700.0, 500.0] + 100.0 * around), 0.1 * around, atol=1e-12)
    for other in (60.0, 160.0, 400.0):
        assert np.hypot(*field_at(eye, np.array([[700.0 + other, 500.0]]))[0]) < 0.1
    np.testing.assert_allclose(field_at(eye, np.array([[700.0, 500.0]])), 0.0)


def test_a_window_under_pressure_is_the_weak_lens_that_a_meniscus_is() -> None:
    bend = 2e-4  # a hundred times what a dive does, so that the change is far above roundoff
    flat, bent = (replace(NOMINAL, aberrations=Aberrations(window_bend_per_mm=k)) for k in (0.0, bend))
    R = np.array(NOMINAL.R)
    u = NOMINAL.c_px[0] + 60.0
    angles = [
        math.asin(float((np.array(pixel_ray(e.packed(N_WATER), u, NOMINAL.c_px[1])[3:]) @ R)[0])) for e in (flat, bent)
    ]
    # n₂θ₂ = n₁θ₁ + (n₂ − n₁)α at each face, whose normal leans by α = −bend · height.
    port, angle = NOMINAL.port, 60.0 / NOMINAL.f_px[0]
    inner_mm = port.d_mm * angle
    outer_mm = inner_mm + port.th_mm * angle / port.n_g
    change = -bend * ((port.n_g - 1.0) * inner_mm + (N_WATER - port.n_g) * outer_mm) / N_WATER
    assert angles[1] - angles[0] == pytest.approx(change, rel=2e-3)
