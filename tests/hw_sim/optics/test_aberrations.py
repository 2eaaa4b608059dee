"""Flaws of lens and window: a field of the amount and spectrum that was asked for, a pupil that moves, a window that is bent."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw_sim.optics.aberrations import ORDERS, RANGES, Aberrations, LensFlaws, flawed
from hw_sim.optics.table import fit_table, look_up_all
from hw_sim.optics.trace import FLAWS, PACKED_WITH_FLAWS, cosines, flaw_field, pixel_ray
from hw_sim.outside import draw_outside
from hw_sim.truth import TrueEye, draw_truth, in_air, project, ray, save_truth, with_flaws
from hw_sim.water.medium import Water

N_WATER = Water().index
NOMINAL = draw_truth("nominal", 1, 1600, 1200, N_WATER).left


def field_at(eye: TrueEye, uv: np.ndarray) -> np.ndarray:
    packed = eye.packed(N_WATER)
    return np.array([flaw_field(packed, float(u), float(v)) for u, v in uv])


def grid(step: int = 40) -> np.ndarray:
    v, u = np.mgrid[step // 2 : 1200 : step, step // 2 : 1600 : step]
    return np.stack([u.ravel(), v.ravel()], -1) - 0.5


def test_the_recurrence_is_the_sum_of_its_cosines() -> None:
    rng = np.random.default_rng(3)
    table = np.concatenate([np.zeros(FLAWS), rng.standard_normal(ORDERS * ORDERS)])
    for x, y in rng.uniform(0.0, math.pi, (20, 2)):
        c = table[FLAWS:].reshape(ORDERS, ORDERS)
        expected = np.cos(np.arange(ORDERS) * y) @ c @ np.cos(np.arange(ORDERS) * x)
        assert cosines(table, FLAWS, x, y) == pytest.approx(expected, abs=1e-10)


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


def test_the_spectrum_falls_with_the_exponent() -> None:
    strengths = LensFlaws(field_px=0.1, fall=1.5)
    many = np.stack(
        [
            np.reshape(flawed(strengths, np.random.default_rng(k), 1600, 1200, 1.0).field_px, (2, 12, 12))
            for k in range(60)
        ]
    )
    spread = np.sqrt((many**2).mean(axis=(0, 1)))
    order = np.add.outer(np.arange(ORDERS), np.arange(ORDERS))
    counted = order >= 2
    slope = np.polyfit(np.log(1.0 + order[counted]), np.log(spread[counted]), 1)[0]
    assert slope == pytest.approx(-1.5, abs=0.1)


def test_a_dent_displaces_radially_and_most_at_its_width() -> None:
    eye = replace(NOMINAL, aberrations=Aberrations(dent=(700.0, 500.0, 100.0, 0.1)))
    around = np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0.0, 6.0, 7)])
    np.testing.assert_allclose(field_at(eye, [700.0, 500.0] + 100.0 * around), 0.1 * around, atol=1e-12)
    for other in (60.0, 160.0, 400.0):
        assert np.hypot(*field_at(eye, np.array([[700.0 + other, 500.0]]))[0]) < 0.1
    np.testing.assert_allclose(field_at(eye, np.array([[700.0, 500.0]])), 0.0)


def test_a_stria_is_the_same_along_its_line_and_acts_across_it() -> None:
    turn = 0.7
    across, along = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
    eye = replace(NOMINAL, aberrations=Aberrations(stria=(800.0, 600.0, turn, 70.0, 0.05)))
    at = np.array([800.0, 600.0]) + 70.0 * across
    field = field_at(eye, np.array([at + s * along for s in (-300.0, 0.0, 250.0)]))
    np.testing.assert_allclose(field, np.tile(0.05 * across, (3, 1)), atol=1e-12)


def test_flaws_of_no_strength_leave_every_ray_as_it_was() -> None:
    plain = draw_truth("realistic", 4, 1600, 1200, N_WATER).left
    same = replace(plain, aberrations=Aberrations())
    assert same.packed(N_WATER).size == PACKED_WITH_FLAWS
    for u, v in grid(300):
        assert pixel_ray(plain.packed(N_WATER), u, v) == pixel_ray(same.packed(N_WATER), u, v)


def test_in_air_rays_leave_from_where_the_pupil_stands_at_their_angle() -> None:
    rig = draw_truth("nominal", 1, 1600, 1200, N_WATER)
    eye = replace(rig.left, aberrations=Aberrations(pupil_mm=0.5, dent=(100.0, 100.0, 100.0, 3.0)))
    before = in_air(replace(rig, left=eye))
    uv = grid(400)
    origin, direction = ray(before, "left", uv)
    R, centre = np.array(before.left.R), np.array(before.left.t_mm)
    d = direction @ R
    tangent2 = (d[:, 0] ** 2 + d[:, 1] ** 2) / d[:, 2] ** 2
    axis_points = centre + 0.5 * tangent2[:, None] * R[:, 2]
    assert np.abs(np.cross(axis_points - origin, direction)).max() < 1e-9
    # The dent is the window's, which is not there in air.
    expected = (uv[:, 0] - before.left.c_px[0]) / before.left.f_px[0]
    np.testing.assert_allclose(d[:, 0] / d[:, 2], expected, atol=1e-12)


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


@pytest.mark.parametrize("name", ["left", "projector"])
def test_the_projection_table_follows_the_flaws(name: str) -> None:
    truth = draw_truth("outside", 11, 1600, 1200, N_WATER)
    eye = truth.eye(name)
    uv = np.random.default_rng(1).uniform(0, [eye.width_px - 1, eye.height_px - 1], (1500, 2))
    origin, direction = ray(truth, name, uv)
    points = origin + direction * np.random.default_rng(2).uniform(380.0, 650.0, (len(uv), 1))
    found = np.empty_like(uv)
    packed = eye.packed(N_WATER)
    look_up_all(packed, fit_table(packed), points, found)
    assert np.abs(found - uv).max() < 1e-3
    np.testing.assert_allclose(project(truth, name, points[:100]), uv[:100], atol=1e-9)


def test_the_set_outside_is_a_realistic_rig_with_the_flaws_of_its_seed(tmp_path: Path) -> None:
    truth, plain = (draw_truth(kind, 6, 800, 600, N_WATER) for kind in ("outside", "realistic"))
    drawn = draw_outside(6)
    flawed_rig = with_flaws(plain, drawn)
    for name in ("left", "right", "projector"):
        assert truth.eye(name).lens_field is None
        assert truth.eye(name).aberrations == flawed_rig.eye(name).aberrations
        assert replace(flawed_rig.eye(name), aberrations=None, lens_field=plain.eye(name).lens_field) == plain.eye(name)
    assert truth.artefacts.board_form_mm == flawed_rig.artefacts.board_form_mm != plain.artefacts.board_form_mm
    assert drawn.lens is not None
    assert RANGES["field_px"].low <= drawn.lens.field_px
    assert truth.left.aberrations != truth.right.aberrations
    path = tmp_path / "truth.toml"
    save_truth(truth, path)
    assert draw_truth(str(path), 0, 800, 600, N_WATER) == truth


def test_a_smaller_picture_has_the_same_flaws() -> None:
    big, small = (draw_truth("outside", 6, w, h, N_WATER) for w, h in ((1600, 1200), (400, 300)))
    uv = np.random.default_rng(1).uniform(10, 1190, (30, 2))
    _, a = ray(big, "right", uv)
    _, b = ray(small, "right", (uv + 0.5) / 4 - 0.5)
    # The middle of a dent is given to the pixel's centre, a hundredth of its width off.
    np.testing.assert_allclose(a, b, atol=2e-6)


def test_impossible_flaws_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"lens: dent_width_px = 10.0; allowed are 80..800"):
        LensFlaws(dent_width_px=10.0)
