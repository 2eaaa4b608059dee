"""Where two rays meet, how far they miss each other, and what an error of the right image point does, by float64 algebra."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.optics.rays import RayLattice, ray_lattice
from appliance.reconstruct.scratch import GAP, POINT_VARIANCE, SIGMA, SIZE, U, V, X, Y, Z
from appliance.reconstruct.triangulate import RAY_BLOCK, Rays, rays_of, triangulate_row
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
    triangulate_row(rays, y, first, stride, s, n)
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


@pytest.mark.parametrize(("first", "stride"), [(480, 1), (549, 1), (700, 3)])
@pytest.mark.parametrize("depth_mm", [400.0, 520.0, 660.0])
@pytest.mark.parametrize("y", [85, 602, 1115])
def test_a_point_seen_by_both_is_found_to_a_micrometre(y: int, first: int, stride: int, depth_mm: float) -> None:
    columns = first + stride * np.arange(80)
    (origin, direction), uv = scene(y, columns, depth_mm)
    inside = np.all((uv > 8) & (uv < [1590, 1190]), axis=1)
    assert inside.sum() > 30
    found = triangulated(RAYS, y, first, stride, uv)
    exact = origin + direction * ((depth_mm - origin[:, 2]) / direction[:, 2])[:, None]
    assert np.abs(found["xyz"] - exact)[inside].max() < 0.002
    assert found["gap"][inside].max() < 0.001


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("depth_mm", [400.0, 520.0, 660.0])
def test_rays_that_miss_each_other_are_met_half_way_and_the_gap_is_their_distance(depth_mm: float, stride: int) -> None:
    columns = 401 + stride * np.arange(48)
    left, uv = scene(763, columns, depth_mm)
    uv = np.add(uv, [0.0, 6.0])
    found = triangulated(RAYS, 763, 401, stride, uv)
    on_left, on_right = met(left, CAL.rig.right.rays(uv, INDEX))
    np.testing.assert_allclose(found["xyz"], 0.5 * (on_left + on_right), atol=0.002)
    np.testing.assert_allclose(found["gap"][:, 0], np.linalg.norm(on_left - on_right, axis=1), atol=0.001)
    assert found["gap"].min() > 0.5


@pytest.mark.parametrize("stride", [1, 4])
@pytest.mark.parametrize("depth_mm", [390.0, 520.0, 670.0])
def test_sigma_is_what_an_error_of_the_right_point_moves_along_the_left_ray_at_every_depth(
    depth_mm: float, stride: int
) -> None:
    columns = 481 + stride * np.arange(40)
    left, uv = scene(602, columns, depth_mm)
    found = triangulated(RAYS, 602, 481, stride, uv)
    feet = [met(left, CAL.rig.right.rays(np.add(uv, [shift, 0.0]), INDEX))[0] for shift in (-SIGMA_PX, SIGMA_PX)]
    moved_mm = np.linalg.norm(feet[1] - feet[0], axis=1) / 2.0
    np.testing.assert_allclose(found["sigma"][:, 0], moved_mm, rtol=0.012)


def test_a_gap_across_a_slanted_baseline_is_halved_in_all_three_directions() -> None:
    """Straight made-up rays, whose connection points into no axis."""

    def lattice(x: float, y: float, sx: float, sy: float) -> RayLattice:
        return RayLattice(500.0, 4, np.broadcast_to(np.array([x, y, sx, sy], np.float32), (4, 20, 4)).copy())

    rays = rays_of(lattice(1.0, 2.0, 0.2, 0.5), lattice(4.0, 1.0, -0.4, 0.1), 64)
    for stride in (1, 3):
        found = triangulated(rays, 2, 0, stride, np.full((16, 2), 6.0))
        on_left, on_right = met(
            (np.array([[1.0, 2.0, 500.0]]), np.array([[0.2, 0.5, 1.0]])),
            (np.array([[4.0, 1.0, 500.0]]), np.array([[-0.4, 0.1, 1.0]])),
        )
        assert np.abs(on_left - on_right).min() > 0.1
        np.testing.assert_allclose(found["xyz"], np.repeat(0.5 * (on_left + on_right), 16, 0), atol=1e-3)
        np.testing.assert_allclose(found["gap"], np.linalg.norm(on_left - on_right), atol=1e-4)


def test_a_pixel_without_a_match_has_no_point_and_takes_none_from_its_neighbours() -> None:
    columns = 400 + np.arange(48)
    _, uv = scene(602, columns, 520.0)
    whole = triangulated(RAYS, 602, 400, 1, uv)["xyz"]
    holes = uv.copy()
    holes[[0, 8, 20, 24, 47]] = np.nan
    found = triangulated(RAYS, 602, 400, 1, holes)
    gone = np.isnan(found["xyz"]).any(axis=1)
    assert np.flatnonzero(gone).tolist() == [0, 8, 20, 24, 47]
    np.testing.assert_allclose(found["xyz"][~gone], whole[~gone], atol=0.002)


def test_a_step_in_the_surface_does_not_borrow_the_rays_of_the_other_side() -> None:
    columns = 600 + np.arange(48)
    _, near = scene(602, columns, 440.0)
    _, far = scene(602, columns, 620.0)
    uv = np.where((np.arange(48) % 16 < 5)[:, None], near, far)
    depths = np.where(np.arange(48) % 16 < 5, 440.0, 620.0)
    assert np.abs(np.diff(uv[:, 0])).max() > 16.0
    found = triangulated(RAYS, 602, 600, 1, uv)
    inside = (uv[:, 0] > 8) & (uv[:, 0] < 1590)
    assert inside.all()
    np.testing.assert_allclose(found["xyz"][inside, 2], depths[inside], atol=0.003)


def test_lattices_that_do_not_belong_together_are_refused() -> None:
    left = ray_lattice(CAL.rig.left, INDEX, PLANE_MM)
    for other in (RayLattice(left.plane_z_mm + 1.0, left.step_px, left.nodes), RayLattice(PLANE_MM, 7, left.nodes)):
        with pytest.raises(ValueError, match="differ in step or plane"):
            rays_of(left, other, 400)
