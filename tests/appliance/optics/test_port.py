"""Light obeys Snell's law, projecting and back-projecting agree, and the paper's corrected model is a special case."""

from __future__ import annotations

import math

import numpy as np
import pytest

from appliance.optics import port as ports
from appliance.optics.model import HousedCamera
from appliance.optics.pinhole import Lens
from appliance.optics.port import Port, air_directions, refract, water_rays
from appliance.optics.rays import ray_lattice
from appliance.optics.water import quan_fry_index

N_WATER = 1.3352
TILTED = Port(
    (math.sin(0.03), math.sin(-0.02), math.sqrt(1 - math.sin(0.03) ** 2 - math.sin(0.02) ** 2)), 30.0, 5.0, 1.77
)
LENS = Lens((2555.6, 2555.1), (803.0, 594.0), (-0.11, 0.05, 3e-4, -2e-4, 0.01))


def directions(seed: int, n: int = 200) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-0.32, 0.32, (n, 2))
    a = np.concatenate([xy, np.ones((n, 1))], 1)
    return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))


def test_refraction_obeys_snell_and_stays_in_plane() -> None:
    a, n = directions(1), np.array(TILTED.normal)
    w = refract(a, n, 1 / N_WATER)
    np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1.0, atol=1e-14)
    sin_air = np.linalg.norm(np.cross(a, n), axis=1)
    sin_water = np.linalg.norm(np.cross(w, n), axis=1)
    np.testing.assert_allclose(sin_air, N_WATER * sin_water, atol=1e-14)
    np.testing.assert_allclose(np.sum(np.cross(a, n) * w, 1), 0.0, atol=1e-14)


def test_the_path_through_the_port_takes_least_time() -> None:
    a, n = directions(2, 20), np.array(TILTED.normal)
    outer, w = water_rays(TILTED, N_WATER, a)
    inner = a * (TILTED.distance_mm / (a @ n))[:, None]
    target = outer + 400.0 * w

    def optical_path(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        glass = TILTED.glass_index * np.linalg.norm(q - p, axis=1)
        water = N_WATER * np.linalg.norm(target - q, axis=1)
        return np.asarray(np.linalg.norm(p, axis=1) + glass + water)

    along = np.cross(n, [0.0, 1.0, 0.0])
    along /= np.linalg.norm(along)
    best = optical_path(inner, outer)
    for axis in (along, np.cross(n, along)):
        for shift_p, shift_q in ((1e-2, 0.0), (-1e-2, 0.0), (0.0, 1e-2), (0.0, -1e-2)):
            assert (optical_path(inner + shift_p * axis, outer + shift_q * axis) > best).all()


def test_projection_inverts_the_ray() -> None:
    a = directions(3)
    point, w = water_rays(TILTED, N_WATER, a)
    for depth_mm in (1.0, 400.0, 700.0):
        seen = air_directions(TILTED, N_WATER, point + depth_mm * w)
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        np.testing.assert_allclose(seen, a, atol=1e-13)


def test_pixels_survive_the_round_trip_through_lens_port_and_water() -> None:
    camera = HousedCamera(
        1600, 1200, LENS, TILTED, ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)), (10.0, -5.0, 3.0)
    )
    v, u = np.mgrid[0:1200:97, 0:1600:113].astype(float)
    uv = np.stack([u, v], -1)
    origin, direction = camera.rays(uv, N_WATER)
    np.testing.assert_allclose(camera.project(origin + 510.0 * direction, N_WATER), uv, atol=1e-9)


def test_a_perpendicular_port_is_the_papers_ray_model() -> None:
    c, d, th, n_g = 2555.6, 30.0, 5.0, 1.77
    port = Port((0.0, 0.0, 1.0), d, th, n_g)
    r = np.array([50.0, 400.0, 900.0])
    tan_a = r / c
    sin_a = np.sin(np.arctan(tan_a))
    tan_g, tan_w = np.tan(np.arcsin(sin_a / n_g)), np.tan(np.arcsin(sin_a / N_WATER))
    shift = d * (tan_a / tan_w - 1) - th * (1 - tan_g / tan_w)
    a = np.stack([r / c, 0 * r, np.ones(3)], -1)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    point, w = water_rays(port, N_WATER, a)
    on_axis = point[:, 2] - point[:, 0] * w[:, 2] / w[:, 0]
    np.testing.assert_allclose(on_axis, -shift, atol=1e-10)
    np.testing.assert_allclose(w[:, 0] / w[:, 2], tan_w, atol=1e-14)


def test_points_inside_the_housing_are_not_seen() -> None:
    assert np.isnan(air_directions(TILTED, N_WATER, np.array([[1.0, 2.0, 20.0]]))).all()


def test_a_point_between_the_faces_of_the_window_is_in_no_water() -> None:
    n = np.array(TILTED.normal)
    outer_mm = TILTED.distance_mm + TILTED.thickness_mm
    for along_mm in (-10.0, TILTED.distance_mm + 0.001, TILTED.distance_mm + 2.5, outer_mm - 1e-6, outer_mm):
        assert np.isnan(air_directions(TILTED, N_WATER, along_mm * n + [0.5, -0.5, 0.0] @ PLANE)).all(), along_mm
    seen = air_directions(TILTED, N_WATER, (outer_mm + 0.001) * n)
    np.testing.assert_allclose(seen, n, atol=1e-12)


PLANE = np.eye(3) - np.outer(TILTED.normal, TILTED.normal)


def test_one_bad_point_among_good_ones_spoils_only_itself() -> None:
    point, w = water_rays(TILTED, N_WATER, directions(3, 5))
    points = point + 500.0 * w
    points[2] = np.nan
    seen = air_directions(TILTED, N_WATER, points)
    assert np.isnan(seen).all(axis=1).tolist() == [False, False, True, False, False]


@pytest.mark.parametrize(
    ("t_c", "index"),
    [(5.0, 1.33388), (20.0, 1.33299), (30.0, 1.33192)],
)
def test_distilled_water_has_the_index_of_the_tables_at_the_sodium_line(t_c: float, index: float) -> None:
    """Handbook values for 589.3 nm, relative to air; the formula was fitted to within 2e-5 of measurements."""
    assert quan_fry_index(t_c, 0.0, 589.3) == pytest.approx(index, abs=2e-5)


@pytest.mark.parametrize(
    ("t_c", "s_psu", "nm", "index"),
    [
        (20.0, 35.0, 589.3, 1.339406),
        (5.0, 35.0, 450.0, 1.347101),
        (30.0, 35.0, 650.0, 1.336499),
        (30.0, 20.0, 530.0, 1.337678),
        (5.0, 0.0, 530.0, 1.335994),
        (30.0, 0.0, 530.0, 1.334027),
        (0.0, 35.0, 400.0, 1.351468),
    ],
)
def test_sea_water_has_the_index_of_quan_and_fry(t_c: float, s_psu: float, nm: float, index: float) -> None:
    """Worked out from the paper's ten coefficients with 28 decimals."""
    assert quan_fry_index(t_c, s_psu, nm) == pytest.approx(index, abs=1e-6)


@pytest.mark.parametrize(
    ("at", "low", "high", "said"),
    [
        (0, -2.0, 40.0, r"water temperature {} °C; allowed are -2\.\.40 °C"),
        (1, 0.0, 45.0, r"salinity {} psu; allowed are 0\.\.45 psu"),
        (2, 380.0, 750.0, r"wavelength {} nm; allowed are 380\.\.750 nm"),
    ],
)
def test_water_out_of_range_is_named_and_the_limits_themselves_are_in_range(
    at: int, low: float, high: float, said: str
) -> None:
    for value, allowed in ((low, True), (high, True), (low - 0.1, False), (high + 0.1, False)):
        water = [20.0, 10.0, 530.0]
        water[at] = value
        if allowed:
            assert 1.3 < quan_fry_index(*water) < 1.4
        else:
            with pytest.raises(ValueError, match=said.format(f"{value:g}")):
                quan_fry_index(*water)


def test_lattice_interpolation_stays_below_a_micrometre() -> None:
    camera = HousedCamera(1600, 1200, LENS, TILTED)
    lattice = ray_lattice(camera, N_WATER, 535.0)
    uv = np.random.default_rng(5).uniform(0, [1599, 1199], (2000, 2))
    i, j = (uv // lattice.step_px).astype(int).T
    fx, fy = (uv / lattice.step_px - np.stack([i, j], -1)).T[..., None]
    n = lattice.nodes.astype(float)
    ray = (n[j, i] * (1 - fx) + n[j, i + 1] * fx) * (1 - fy) + (n[j + 1, i] * (1 - fx) + n[j + 1, i + 1] * fx) * fy
    origin, direction = camera.rays(uv, N_WATER)
    assert lattice.step_px == 4
    assert lattice.plane_z_mm == 535.0
    assert lattice.nodes.shape == (1199 // 4 + 2, 1599 // 4 + 2, 4), "a node beyond the last pixel on both sides"
    for z_mm in (460.0, 535.0, 600.0):
        exact = origin + direction * ((z_mm - origin[:, 2]) / direction[:, 2])[:, None]
        near = ray[:, :2] + ray[:, 2:] * (z_mm - lattice.plane_z_mm)
        assert np.abs(near - exact[:, :2]).max() < 0.0012


def test_a_small_image_has_a_node_at_every_pixel() -> None:
    camera = HousedCamera(64, 48, Lens((100.0, 100.0), (31.5, 23.5)), TILTED)
    lattice = ray_lattice(camera, N_WATER, 535.0)
    assert lattice.step_px == 1
    assert lattice.nodes.shape == (49, 65, 4)
    assert lattice.nodes.dtype == np.float32


def test_a_camera_that_looks_along_the_plane_is_refused() -> None:
    aside = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="parallel to the mid-volume plane"):
        ray_lattice(HousedCamera(1600, 1200, LENS, TILTED, aside), N_WATER, 535.0)


def test_a_point_on_the_outer_face_itself_is_not_in_the_water() -> None:
    port = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
    points = np.array([[1.0, 2.0, 35.0], [0.0, 0.0, 35.0], [1.0, 2.0, 36.0]])
    assert np.isnan(air_directions(port, N_WATER, points)).all(axis=1).tolist() == [True, True, False]


@pytest.mark.parametrize(("steps", "within"), [(2, 5e-9), (3, 1e-15)])
def test_a_point_in_the_water_is_found_in_three_steps(
    steps: int, within: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Newton's method squares the error with each step, if it starts near and its slope is that of the path."""
    monkeypatch.setattr(ports, "NEWTON_STEPS", steps)
    a = directions(3)
    point, w = water_rays(TILTED, N_WATER, a)
    for depth_mm in (1.0, 60.0, 400.0, 700.0):
        seen = air_directions(TILTED, N_WATER, point + depth_mm * w)
        np.testing.assert_allclose(seen / np.linalg.norm(seen, axis=1, keepdims=True), a, atol=within)


def test_points_a_few_tenths_of_a_millimetre_beside_the_axis_are_seen_beside_it() -> None:
    port = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
    seen = air_directions(port, N_WATER, np.array([[0.3, -0.2, 500.0], [-0.6, 0.4, 500.0]]))
    # So near the axis angles are so small that each medium only shortens its part of the way.
    straight_mm = 30.0 + 5.0 / 1.77 + 465.0 / N_WATER
    np.testing.assert_allclose(seen[:, :2], np.array([[0.3, -0.2], [-0.6, 0.4]]) / straight_mm, rtol=1e-5)
