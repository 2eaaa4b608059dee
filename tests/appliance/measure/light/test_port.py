"""Light obeys Snell's law, projecting and back-projecting agree, and the paper's corrected model is a special case."""

from __future__ import annotations

import math
from contextlib import nullcontext

import numpy as np
import pytest

from appliance.measure.light import port as ports
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port, air_directions, refract, water_rays
from appliance.measure.light.rays import ray_lattice
from appliance.measure.light.water import quan_fry_index

N_WATER = 1.3352
TILTED = Port(
    (math.sin(0.03), math.sin(-0.02), math.sqrt(1 - math.sin(0.03) ** 2 - math.sin(0.02) ** 2)), 30.0, 5.0, 1.77
)
FACING = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
LENS = Lens((2555.6, 2555.1), (803.0, 594.0), (-0.11, 0.05, 3e-4, -2e-4, 0.01))


def unit(a: np.ndarray) -> np.ndarray:
    return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))


def directions(seed: int, n: int = 200) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-0.32, 0.32, (n, 2))
    return unit(np.concatenate([xy, np.ones((n, 1))], 1))


def test_refraction_obeys_snell_and_stays_in_plane() -> None:
    a, n = directions(1), np.array(TILTED.normal)
    w = refract(a, n, 1 / N_WATER)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-14)
    sin_air, sin_water = (np.linalg.norm(np.cross(one, n), axis=1) for one in (a, w))
    np.testing.assert_allclose(sin_air, N_WATER * sin_water, atol=1e-14)
    np.testing.assert_allclose(np.sum(np.cross(a, n) * w, 1), 0.0, atol=1e-14)


@pytest.mark.parametrize(("steps", "within"), [(2, 5e-9), (3, 1e-13)])
def test_projection_inverts_the_ray_in_three_steps(steps: int, within: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method squares the error with each step, if it starts near and its slope is that of the path."""
    monkeypatch.setattr(ports, "NEWTON_STEPS", steps)
    a = directions(3)
    point, w = water_rays(TILTED, N_WATER, a)
    for depth_mm in (1.0, 60.0, 400.0, 700.0):
        points = point + depth_mm * w
        points[2] = np.nan
        seen = unit(air_directions(TILTED, N_WATER, points))
        assert np.flatnonzero(np.isnan(seen).all(axis=1)).tolist() == [2], "spoils only itself"
        np.testing.assert_allclose(np.delete(seen, 2, 0), np.delete(a, 2, 0), atol=within)


def test_a_point_in_the_housing_or_the_window_is_in_no_water() -> None:
    n = np.array(TILTED.normal)
    outer_mm = TILTED.distance_mm + TILTED.thickness_mm
    for along_mm in (-10.0, 20.0, TILTED.distance_mm + 2.5, outer_mm - 1e-6, outer_mm):
        assert np.isnan(air_directions(TILTED, N_WATER, (along_mm * n)[None])).all(), along_mm
    np.testing.assert_allclose(air_directions(TILTED, N_WATER, (outer_mm + 0.001) * n), n, atol=1e-12)
    beside = air_directions(FACING, N_WATER, np.array([[1.0, 2.0, 35.0], [1.0, 2.0, 36.0]]))
    assert np.isnan(beside).all(axis=1).tolist() == [True, False]


def test_sea_water_has_the_index_of_quan_and_fry_and_distilled_water_that_of_the_handbook() -> None:
    """Worked out from the paper's ten coefficients with 28 decimals; the handbook's is at the sodium line."""
    for t_c, s_psu, nm, index in (
        (5.0, 35.0, 450.0, 1.347101), (30.0, 35.0, 650.0, 1.336499), (30.0, 20.0, 530.0, 1.337678), (5.0, 0.0, 530.0, 1.335994),
        (0.0, 35.0, 400.0, 1.351468),
    ):  # fmt: skip
        assert quan_fry_index(t_c, s_psu, nm) == pytest.approx(index, abs=1e-6)
    assert [quan_fry_index(t_c, 0.0, 589.3) for t_c in (5.0, 30.0)] == pytest.approx([1.33388, 1.33192], abs=2e-5)


def test_water_out_of_range_is_named_and_the_limits_themselves_are_in_range() -> None:
    for at, low, high, said in (
        (0, -2.0, 40.0, r"water temperature {} °C; allowed are -2\.\.40 °C"),
        (1, 0.0, 45.0, r"salinity {} psu; allowed are 0\.\.45 psu"),
        (2, 380.0, 750.0, r"wavelength {} nm; allowed are 380\.\.750 nm"),
    ):
        for value, allowed in ((low, True), (high, True), (low - 0.1, False), (high + 0.1, False)):
            water = [20.0, 10.0, 530.0]
            water[at] = value
            with nullcontext() if allowed else pytest.raises(ValueError, match=said.format(f"{value:g}")):
                assert 1.3 < quan_fry_index(*water) < 1.4


def test_lattice_interpolation_stays_below_a_micrometre_and_a_small_image_has_a_node_at_every_pixel() -> None:
    camera = HousedCamera(1600, 1200, LENS, TILTED)
    lattice = ray_lattice(camera, N_WATER, 535.0)
    uv = np.random.default_rng(5).uniform(0, [1599, 1199], (2000, 2))
    i, j = (uv // lattice.step_px).astype(int).T
    fx, fy = (uv / lattice.step_px - np.stack([i, j], -1)).T[..., None]
    n = lattice.nodes.astype(float)
    ray = (n[j, i] * (1 - fx) + n[j, i + 1] * fx) * (1 - fy) + (n[j + 1, i] * (1 - fx) + n[j + 1, i + 1] * fx) * fy
    origin, direction = camera.rays(uv, N_WATER)
    assert (lattice.step_px, lattice.plane_z_mm) == (4, 535.0)
    assert lattice.nodes.shape == (1199 // 4 + 2, 1599 // 4 + 2, 4), "a node beyond the last pixel on both sides"
    for z_mm in (460.0, 600.0):
        exact = origin + direction * ((z_mm - origin[:, 2]) / direction[:, 2])[:, None]
        near = ray[:, :2] + ray[:, 2:] * (z_mm - lattice.plane_z_mm)
        assert np.abs(near - exact[:, :2]).max() < 0.0012
    small = ray_lattice(HousedCamera(64, 48, Lens((100.0, 100.0), (31.5, 23.5)), TILTED), N_WATER, 535.0)
    assert (small.step_px, small.nodes.shape) == (1, (49, 65, 4))
    aside = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="parallel to the mid-volume plane"):
        ray_lattice(HousedCamera(1600, 1200, LENS, TILTED, aside), N_WATER, 535.0)
