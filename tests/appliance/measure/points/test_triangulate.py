"""Where two rays meet, how far they miss each other, and what an error of the right image point does, by float64 algebra."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.measure.decode.scratch import GAP, POINT_VARIANCE, SIGMA, SIZE, U, V, X, Y, Z
from appliance.measure.light.rays import RayLattice, ray_lattice
from appliance.measure.points.triangulate import RAY_BLOCK, Rays, rays_of, triangulate_row
from tests.support import synthetic

CAL = synthetic.calibration(1600, 1200)
INDEX = synthetic.WATER.index
PLANE_MM = float(CAL.rig.volume_centre_mm(INDEX)[2])
RAYS = rays_of(
    ray_lattice(CAL.rig.left, INDEX, PLANE_MM), ray_lattice(CAL.rig.right, INDEX, PLANE_MM), CAL.rig.left.width_px
)
SIGMA_PX = 0.1


def triangulated(rays: Rays, y: int, first: int, stride: int, uv: np.ndarray) -> dict[str, np.ndarray]:
    s = np.full(SIZE, np.nan, np.float32)
    n = len(uv)
    room = -(-n // RAY_BLOCK) * RAY_BLOCK
    s[U : U + room], s[V : V + room] = 150.0, 150.0
    s[U : U + n], s[V : V + n] = uv.T
    s[POINT_VARIANCE : POINT_VARIANCE + room] = SIGMA_PX**2
    triangulate_row(rays, y, first, stride, s, s, n)
    named = {"xyz": (X, Y, Z), "gap": (GAP,), "sigma": (SIGMA,)}
    return {name: np.stack([s[a : a + n] for a in places], -1).astype(float) for name, places in named.items()}


def met(left: tuple[np.ndarray, np.ndarray], right: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The feet (n, 3) of the shortest connection on either ray."""
    (p, d), (q, e) = left, right
    feet = []
    for k in range(len(p)):
        along, *_ = np.linalg.lstsq(np.stack([d[k], -e[k]], -1), q[k] - p[k], rcond=None)
        feet.append((p[k] + along[0] * d[k], q[k] + along[1] * e[k]))
    return np.array([a for a, _ in feet]), np.array([b for _, b in feet])


def scene(y: int, columns: np.ndarray, depth_mm: float) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Left rays of a row, and where the right camera sees the points on them at a depth."""
    origin, direction = CAL.rig.left.rays(np.stack([columns, np.full(len(columns), y)], -1).astype(float), INDEX)
    points = origin + direction * ((depth_mm - origin[:, 2]) / direction[:, 2])[:, None]
    return (origin, direction), CAL.rig.right.project(points, INDEX)


@pytest.mark.parametrize(("depth_mm", "y", "first", "stride"), [(400.0, 85, 480, 1), (660.0, 1115, 700, 3)])
def test_a_point_seen_by_both_is_found_to_a_micrometre(depth_mm: float, y: int, first: int, stride: int) -> None:
    (origin, direction), uv = scene(y, first + stride * np.arange(80), depth_mm)
    inside = np.all((uv > 8) & (uv < [1590, 1190]), axis=1)
    assert inside.sum() > 30
    found = triangulated(RAYS, y, first, stride, uv)
    exact = origin + direction * ((depth_mm - origin[:, 2]) / direction[:, 2])[:, None]
    assert np.abs(found["xyz"] - exact)[inside].max() < 0.002
    assert found["gap"][inside].max() < 0.001


@pytest.mark.parametrize(("stride", "depth_mm"), [(1, 390.0), (4, 670.0)])
def test_rays_that_miss_are_met_half_way_and_errors_move_along_the_left_ray(stride: int, depth_mm: float) -> None:
    left, uv = scene(602, 481 + stride * np.arange(40), depth_mm)
    aside = np.add(uv, [0.0, 6.0])
    missing = triangulated(RAYS, 602, 481, stride, aside)
    on_left, on_right = met(left, CAL.rig.right.rays(aside, INDEX))
    np.testing.assert_allclose(missing["xyz"], 0.5 * (on_left + on_right), atol=0.002)
    np.testing.assert_allclose(missing["gap"][:, 0], np.linalg.norm(on_left - on_right, axis=1), atol=0.001)
    feet = [met(left, CAL.rig.right.rays(np.add(uv, [shift, 0.0]), INDEX))[0] for shift in (-SIGMA_PX, SIGMA_PX)]
    moved_mm = np.linalg.norm(feet[1] - feet[0], axis=1) / 2.0
    np.testing.assert_allclose(triangulated(RAYS, 602, 481, stride, uv)["sigma"][:, 0], moved_mm, rtol=0.012)


def test_lattices_that_do_not_belong_together_are_refused() -> None:
    left = ray_lattice(CAL.rig.left, INDEX, PLANE_MM)
    for other in (RayLattice(left.plane_z_mm + 1.0, left.step_px, left.nodes), RayLattice(PLANE_MM, 7, left.nodes)):
        with pytest.raises(ValueError, match="differ in step or plane"):
            rays_of(left, other, 400)


STEP_PX = 4
"""Between the nodes of made-up lattices."""
LEFT_RAY = np.array([5.0, 1.0, 500.0]), np.array([0.2, 0.1, 1.0])


def made_up(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rays (..., 4) of a right camera: x0, y0, sx, sy, bent far more than those of any lens."""
    x = 40.0 - 0.3 * u + 0.05 * v + 1e-3 * u * u - 2e-3 * u * v + 3e-3 * v * v
    y = 2.0 + 0.1 * u + 0.2 * v - 2e-3 * u * u + 1e-3 * u * v + 2e-3 * v * v
    sx = -0.4 + 1e-3 * u - 2e-3 * v + 1e-5 * u * u + 2e-5 * u * v - 1e-5 * v * v
    sy = 0.1 - 2e-3 * u + 1e-3 * v - 1e-5 * u * u + 1e-5 * u * v + 2e-5 * v * v
    return np.stack([x, y, sx, sy], -1)


def made_up_rays(width: int = 96, height: int = 64) -> Rays:
    j, i = np.mgrid[0 : (height - 1) // STEP_PX + 2, 0 : (width - 1) // STEP_PX + 2].astype(float)
    right = RayLattice(500.0, STEP_PX, made_up(STEP_PX * i, STEP_PX * j).astype(np.float32))
    (origin, slope), shape = LEFT_RAY, (*j.shape, 4)
    constant = np.array([origin[0], origin[1], slope[0], slope[1]], np.float32)
    return rays_of(RayLattice(500.0, STEP_PX, np.broadcast_to(constant, shape).copy()), right, width)


def half_way(rays: np.ndarray) -> np.ndarray:
    """Points (n, 3) half way between the left ray and the right ones (n, 4)."""
    n = len(rays)
    origin = np.column_stack([rays[:, :2], np.full(n, 500.0)])
    left = np.tile(LEFT_RAY[0], (n, 1)), np.tile(LEFT_RAY[1], (n, 1))
    a, b = met(left, (origin, np.column_stack([rays[:, 2:], np.ones(n)])))
    return np.asarray(0.5 * (a + b))


def first_order(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Rays (n, 4) as each point's nearest node and the slopes there have them."""
    i, j = STEP_PX * np.floor(u / STEP_PX + 0.5), STEP_PX * np.floor(v / STEP_PX + 0.5)
    h = 1e-4
    by_u, by_v = (made_up(i + h, j) - made_up(i - h, j)) / (2 * h), (made_up(i, j + h) - made_up(i, j - h)) / (2 * h)
    return np.asarray(made_up(i, j) + (u - i)[:, None] * by_u + (v - j)[:, None] * by_v)


@pytest.mark.parametrize(("axis", "limit_px"), [(0, 16.0), (1, 8.0)])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("place", [0, 15])
def test_beyond_its_limit_a_block_is_given_up_point_by_point(axis: int, limit_px: float, sign: int, place: int) -> None:
    uv = np.tile([40.0, 32.0], (32, 1)) + np.array([1.3, 0.8])
    for away_px, series in ((limit_px - 0.5, True), (limit_px + 0.5, False)):
        asked = uv.copy()
        asked[place, axis] = (40.0, 32.0)[axis] + sign * away_px
        found = triangulated(made_up_rays(), 5, 3, 1, asked)["xyz"]
        exact, alone = half_way(made_up(*asked.T)), half_way(first_order(*asked.T))
        assert np.abs(exact - alone)[:16].max() > 2e-3
        np.testing.assert_allclose(found[:16], (exact if series else alone)[:16], atol=5e-4)
        np.testing.assert_allclose(found[16:], exact[16:], atol=5e-4, err_msg="the next block is its own")


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("wild", [1e9, -np.inf])
def test_a_row_that_means_nothing_where_there_is_no_match_leads_nowhere(stride: int, wild: float) -> None:
    """Only U is NaN without a match; V may be anything."""
    uv = np.column_stack([40.0 + 0.3 * np.arange(32), np.full(32, 30.2)])
    uv[[8, 20], 0], uv[[8, 20], 1] = np.nan, wild
    found = triangulated(made_up_rays(), 5, 3, stride, uv)["xyz"]
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [8, 20]
    there = np.isfinite(uv[:, 0])
    # A block with such a place is given up: each of its points asks its own node.
    np.testing.assert_allclose(found[there], half_way(first_order(*uv[there].T)), atol=5e-4)
