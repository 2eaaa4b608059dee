"""Normals and the mesh of one scan: right on balls, and nothing goes across a step or over a hole."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.desk.surface.mesh import mesh_of_scan
from appliance.desk.surface.normals import normals
from appliance.desk.surface.steps import connect_neighbours
from appliance.measure.points.organised import OrganisedCloud
from tests.support.solids import Ball, Box, looking, seen

PITCH_MM = 0.2
"""Way between neighbouring pixels at the distance at which the solids lie."""
EYE = looking((0.0, 0.0, -500.0))


def stairs(height_mm: float) -> OrganisedCloud:
    """Two flats that face the camera, the right one (x > 0.05) farther away by ``height_mm``."""
    near = Box((-60.0, -60.0, 0.0), (0.05, 60.0, 50.0))
    far = Box((-60.0, -60.0, height_mm), (60.0, 60.0, 50.0))
    return seen([near, far], EYE, 3, size_px=(80, 60))


# ------------------------------------------------------------------------------------------- normals


def test_normals_of_a_ball_point_out_of_it_and_scatter_as_the_noise_says() -> None:
    cloud = seen([Ball((0.0, 0.0, 530.0), 30.0)], looking((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), 1)
    found = normals(cloud)
    assert np.isfinite(found[cloud.mask]).all()
    out = cloud.points_mm - np.array([0.0, 0.0, 530.0])
    out /= np.linalg.norm(out, axis=-1, keepdims=True)
    wrong = np.linalg.norm(found - out, axis=-1)[cloud.mask]
    # A slope fitted to 5 x 5 pixels of noise s: s / (pitch √50), in each of two directions.
    expected = 0.02 / (PITCH_MM * np.sqrt(50.0)) * np.sqrt(2.0)
    assert np.sqrt(np.mean(wrong[: len(wrong)] ** 2)) == pytest.approx(expected, rel=0.3)
    np.testing.assert_allclose(np.linalg.norm(found[cloud.mask], axis=-1), 1.0, atol=1e-5)


def patch(kept: str, down_mm: float = 0.2) -> OrganisedCloud:
    """A flat half a metre away of some pixels in a row of rows, such as ``xx./xxx``; exact."""
    rows = kept.split("/")
    v, u = np.mgrid[0 : len(rows), 0 : len(rows[0])].astype(float)
    points = np.stack([u * 0.2, v * down_mm, np.full_like(u, 500.0)], axis=-1)
    points[np.array([[one == "." for one in row] for row in rows])] = np.nan
    column = np.full(u.shape, 0.02, np.float32)
    return OrganisedCloud(points.astype(np.float32), column, column, column, np.zeros(u.shape, np.uint8))


@pytest.mark.parametrize(
    ("kept", "down_mm", "known"),
    [
        ("xxx/xxx", 0.2, True),
        ("xx./xxx", 0.2, False),
        # Of 5 x 5 points squeezed to r of their height, 4 r² / (1 + r²)² is the determinant over its largest value: 0.05 for r of 0.113.
        ("/".join(["xxxxx"] * 5), 0.2 * 0.12, True),
        ("/".join(["xxxxx"] * 5), 0.2 * 0.108, False),
    ],
)
def test_a_normal_is_of_six_points_at_least_that_have_a_plane(kept: str, down_mm: float, known: bool) -> None:
    found = normals(patch(kept, down_mm))
    assert bool(np.isfinite(found[2, 2] if found.shape[0] == 5 else found).any()) is known
    for radius_px in (0, 8):
        with pytest.raises(ValueError, match=rf"radius_px is {radius_px}; allowed are 1\.\.7"):
            normals(patch(kept), radius_px=radius_px)


def in_a_row(*depths_mm: float, sigma_mm: float = 0.02) -> list[bool]:
    """Which neighbours of a row, 0.2 mm apart across its rays, see one surface."""
    z = 500.0 + np.array(depths_mm)
    points = np.stack([0.2 * np.arange(len(z)) * z / 500.0, 0.0 * z, z], axis=-1)[None].astype(np.float32)
    column = np.full((1, len(z)), sigma_mm, np.float32)
    cloud = OrganisedCloud(points, column, column, column, np.zeros((1, len(z)), np.uint8))
    found: list[bool] = connect_neighbours(cloud).right[0].tolist()
    return found


@pytest.mark.parametrize(
    ("depths_mm", "sigma_mm", "same"),
    [
        # tan 80° of 0.2 mm is 1.134 mm; four deviations of a difference, 0.113 mm.
        ((0.0, 1.12), 0.0, [True]),
        ((0.0, 1.15), 0.0, [False]),
        ((0.0, -1.23), 0.02, [True]),
        ((0.0, -1.27), 0.02, [False]),
        # A slope may change by half of the way, 0.1 mm, and by four deviations of a second difference, 0.196 mm.
        ((0.0, 0.0, 0.0, 0.095, 0.095, 0.095), 0.0, [True] * 5),
        ((0.0, 0.0, 0.0, 0.105, 0.105, 0.105), 0.0, [True, True, False, True, True]),
        ((0.0, 0.0, 0.0, 0.28, 0.28, 0.28), 0.02, [True] * 5),
        ((0.0, 0.0, 0.0, 0.31, 0.31, 0.31), 0.02, [True, True, False, True, True]),
        # A slope that goes on at one side is none of a step.
        ((0.0, 0.0, 0.0, 0.5, 1.0, 1.5), 0.0, [True] * 5),
    ],
)
def test_neighbours_see_one_surface_up_to_a_steep_slope_and_to_a_bend(
    depths_mm: tuple[float, ...], sigma_mm: float, same: list[bool]
) -> None:
    assert in_a_row(*depths_mm, sigma_mm=sigma_mm) == same


# ------------------------------------------------------------------------------------------- the mesh


@pytest.mark.parametrize(("lifted", "diagonal"), [(0, {1, 2}), (1, {0, 3}), (2, {0, 3}), (3, {1, 2})])
def test_a_cell_is_cut_along_its_shorter_diagonal(lifted: int, diagonal: set[int]) -> None:
    cloud = patch("xx/xx")
    cloud.points_mm.reshape(-1, 3)[lifted, 2] += 0.1
    one, other = mesh_of_scan(cloud).faces.tolist()
    assert set(one) & set(other) == diagonal


@pytest.mark.parametrize("kept", [".x/xx", "x./xx", "xx/.x", "xx/x."])
def test_a_cell_of_three_corners_is_one_triangle(kept: str) -> None:
    assert len(mesh_of_scan(patch(kept)).faces) == 1


@pytest.mark.parametrize("height_mm", [0.5, 30.0])
def test_no_triangle_goes_across_a_step_and_none_is_missing_beside_it(height_mm: float) -> None:
    cloud = stairs(height_mm)
    mesh = mesh_of_scan(cloud)
    level = mesh.vertices_mm[:, 2] > 500.0 + height_mm / 2
    across = level[mesh.faces].any(axis=1) != level[mesh.faces].all(axis=1)
    assert not across.any()
    # Two levels of 40 x 60 pixels each, whole.
    assert len(mesh.faces) == 2 * 2 * 39 * 59
    assert len(mesh.vertices_mm) == 80 * 60


def test_faces_look_at_the_camera_and_every_inner_edge_has_two() -> None:
    cloud = seen([Ball((0.0, 0.0, 0.0), 10.0)], EYE, 4, size_px=(130, 130), noise_mm=0.005, steepest=60.0)
    mesh = mesh_of_scan(cloud)
    corners = mesh.vertices_mm[mesh.faces].astype(float)
    outwards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("nk,nk->n", outwards, corners.mean(axis=1)) < 0).all()
    n, faces = len(mesh.vertices_mm), mesh.faces.astype(np.int64)
    directed = (faces * n + np.roll(faces, -1, axis=1)).ravel()
    assert len(np.unique(directed)) == len(directed), "a directed edge belongs to one face"
    back = directed % n * n + directed // n
    border = int((~np.isin(back, directed)).sum())
    # A cap without holes has one border: the disc's circumference of 2π · 8.66 mm in pixels of 0.2 mm, √2 longer at most.
    assert 200 < border < 2 * np.pi * 8.66 / PITCH_MM * 1.42
    # Euler's number of a disc is 1.
    assert n - (len(directed) + border) // 2 + len(mesh.faces) == 1
