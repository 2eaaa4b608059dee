"""The simulator's light obeys Snell, Fermat and reversibility to 1e-9, with tilted and wedged windows."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize

from hw_sim.optics.table import fit_table, look_up_all
from hw_sim.optics.trace import INNER, OUTER, pixel_ray, pixels_of, rays_of, refract
from hw_sim.truth import SETS, TrueEye, draw_truth, project, ray
from hw_sim.water.medium import Water

N_WATER = Water().index


def some_pixels(eye: TrueEye, count: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, [eye.width_px - 1, eye.height_px - 1], (count, 2))


def refracted(direction: np.ndarray, normal: np.ndarray, ratio: float) -> np.ndarray:
    x, y, z = refract(direction[0], direction[1], direction[2], normal[0], normal[1], normal[2], ratio)
    return np.array([x, y, z])


def test_refraction_is_snells_law_in_one_plane() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        n = rng.normal(size=3)
        n /= np.linalg.norm(n)
        i = n + 0.6 * rng.normal(size=3) / np.sqrt(3)
        i /= np.linalg.norm(i)
        if i @ n < 0.2:
            continue
        o = refracted(i, n, 1.0 / 1.77)
        assert abs(np.linalg.norm(o) - 1) < 1e-12
        assert abs(np.linalg.norm(np.cross(i, n)) - 1.77 * np.linalg.norm(np.cross(o, n))) < 1e-12
        assert abs(np.cross(i, n) @ o) < 1e-12
        back = refracted(-o, -n, 1.77)
        np.testing.assert_allclose(back, -i, atol=1e-12)


@pytest.mark.parametrize("kind", SETS)
@pytest.mark.parametrize("name", ["left", "right", "projector"])
def test_projecting_inverts_tracing(kind: str, name: str) -> None:
    truth = draw_truth(kind, 5, 1600, 1200, N_WATER)
    eye = truth.eye(name).packed(truth.n_water)
    uv = some_pixels(truth.eye(name), 300)
    rays = np.empty((300, 6))
    rays_of(eye, uv, rays)
    points = rays[:, :3] + rays[:, 3:] * np.random.default_rng(1).uniform(380, 650, (300, 1))
    found = np.empty((300, 2))
    pixels_of(eye, points, found)
    np.testing.assert_allclose(found, uv, atol=1e-9)


@pytest.mark.parametrize("name", ["left", "right", "projector"])
@pytest.mark.parametrize(("kind", "limit_px"), [("hard", 5e-5), ("paper", 5e-5), ("outside", 1e-3)])
def test_the_projection_table_is_the_exact_projection(kind: str, name: str, limit_px: float) -> None:
    truth = draw_truth(kind, 11, 1600, 1200, N_WATER)
    eye = truth.eye(name).packed(truth.n_water)
    table = fit_table(eye)
    uv = some_pixels(truth.eye(name), 4000)
    uv[:4] = [[0, 0], [0, uv[:, 1].max()], [uv[:, 0].max(), 0], uv.max(axis=0)]
    origin, direction = ray(truth, name, uv)
    for near_mm, far_mm in ((400.0, 660.0), (240.0, 1400.0)):
        depth = np.random.default_rng(2).uniform(near_mm, far_mm, len(uv))
        points = origin + direction * ((depth - origin[:, 2]) / direction[:, 2])[:, None]
        found = np.empty_like(uv)
        look_up_all(eye, table, points, found)
        assert np.abs(found - uv).max() < limit_px
        np.testing.assert_allclose(project(truth, name, points), uv, atol=1e-9)


def test_light_takes_the_quickest_path_through_a_wedged_window() -> None:
    truth = draw_truth("hard", 2, 1600, 1200, N_WATER)
    eye = truth.left.packed(truth.n_water)
    port = truth.left.port
    R, centre = np.array(truth.left.R), np.array(truth.left.t_mm)
    inner, outer = eye[INNER : INNER + 3], eye[OUTER : OUTER + 3]
    assert math.degrees(math.acos(inner @ outer)) == pytest.approx(port.wedge_deg, rel=1e-6)
    x_axis = np.cross(inner, [0.0, 1.0, 0.0])
    x_axis /= np.linalg.norm(x_axis)
    face = np.stack([x_axis, np.cross(inner, x_axis)])
    for u, v in some_pixels(truth.left, 10):
        ray = np.array(pixel_ray(eye, u, v))
        leaving = (ray[:3] - centre) @ R
        target = (ray[:3] + 400 * ray[3:] - centre) @ R

        # Gradient of the optical path by the point of entry and by the point of exit, within the two faces.
        def by_entry(ab: np.ndarray, leaving: np.ndarray = leaving) -> np.ndarray:
            entry = inner * port.d_mm + ab @ face
            glass = (leaving - entry) / np.linalg.norm(leaving - entry)
            return np.asarray(face @ (entry / np.linalg.norm(entry) - port.n_g * glass))

        found = optimize.root(by_entry, leaving @ face.T, tol=1e-14).x
        assert np.abs(by_entry(found)).max() < 1e-11
        entry = inner * port.d_mm + found @ face
        glass = (leaving - entry) / np.linalg.norm(leaving - entry)
        water = (target - leaving) / np.linalg.norm(target - leaving)
        change = port.n_g * glass - N_WATER * water
        assert np.linalg.norm(change - outer * (change @ outer)) < 1e-9, "stationary: no exit point is quicker"
