"""Signed distances to a nominal surface: against closed forms and against trying every triangle."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from appliance.surface.deviation import NominalTree, deviations, spread_over
from appliance.surface.fusion import PlacedScan, fuse
from appliance.surface.mesh import mesh_of_scan
from appliance.surface.nominal import Nominal, nominal_of, nominal_of_mesh, read_nominal
from tests.support.solids import Ball, around, looking, seen


def nominal_box(size_mm: tuple[float, float, float]) -> Nominal:
    box: Any = trimesh.creation.box(extents=size_mm)
    return nominal_of(box.vertices, box.faces)


def measured(points: NDArray[np.float64], nominal: Nominal, **more: Any) -> NDArray[np.float32]:
    few = np.full(len(points), 0.01, np.float32)
    return deviations(points.astype(np.float32), few, nominal, **more).deviation_mm


def test_distances_to_a_box_are_right_beside_faces_edges_and_corners_inside_and_outside() -> None:
    points = np.random.default_rng(1).uniform(-14.0, 14.0, (4000, 3))
    half = np.array([10.0, 6.0, 3.0])
    # The signed distance to a box in closed form: outside by what sticks out, inside by the nearest face.
    over = np.abs(points) - half
    expected = np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0)
    found = measured(points, nominal_box((20.0, 12.0, 6.0)), limit_mm=50.0)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_large_and_small_triangles_side_by_side_are_searched_as_if_each_were_tried() -> None:
    rng = np.random.default_rng(2)
    fine: Any = trimesh.creation.icosphere(subdivisions=3, radius=5.0)
    sliver = np.array([[-300.0, 6.0, 0.0], [300.0, 6.0, 0.0], [0.0, 6.02, 1.0]])
    vertices = np.concatenate([fine.vertices, sliver])
    faces = np.concatenate([fine.faces, [[len(fine.vertices), len(fine.vertices) + 1, len(fine.vertices) + 2]]])
    points = np.concatenate([rng.uniform(-8, 8, (500, 3)), rng.uniform([-290, 4, -3], [290, 9, 3], (500, 3))])
    all_of_it: Any = trimesh.Trimesh(vertices, faces, process=False)
    tried: Any = trimesh.proximity.closest_point_naive
    _, expected, _ = tried(all_of_it, points.astype(np.float32))
    found = NominalTree.of(nominal_of(vertices, faces)).nearest(points)
    np.testing.assert_allclose(np.abs(found.signed_mm), expected, atol=1e-5)


def test_what_is_far_is_counted_and_never_dropped() -> None:
    points = np.array([[0.0, 0.0, 3.5], [0.0, 0.0, 4.5], [0.0, 0.0, 900.0], [0.0, 0.0, 2.75]])
    sigma = np.array([0.3, 0.1, 0.1, 0.1], np.float32)
    found = deviations(points.astype(np.float32), sigma, nominal_box((20.0, 12.0, 6.0)), limit_mm=1.0)
    np.testing.assert_allclose(found.deviation_mm, [0.5, np.nan, np.nan, -0.25], atol=1e-6)
    summary = found.summary
    assert (summary.points, summary.beyond, summary.limit_mm) == (4, 2, 1.0)
    assert summary.mean_mm == pytest.approx(0.125)
    assert summary.rms_mm == pytest.approx(np.sqrt((0.5**2 + 0.25**2) / 2))
    assert (summary.least_mm, summary.most_mm) == pytest.approx((-0.25, 0.5))
    assert summary.within_2_sigma_percent == 50.0, "0.5 of 2 x 0.3, and not 0.25 of 2 x 0.1"
    assert dict(summary.percentiles_mm)[50.0] == pytest.approx(0.125)
    nothing = deviations(
        points[1:3].astype(np.float32), sigma[1:3], nominal_box((20.0, 12.0, 6.0)), limit_mm=1.0
    ).summary
    assert (nothing.beyond, nothing.rms_mm, nothing.percentiles_mm) == (2, None, ())


def test_the_far_side_of_a_thin_plate_is_not_what_was_measured() -> None:
    plate = nominal_box((40.0, 40.0, 0.2))
    # 0.15 mm too low on the upper side: nearer to the lower one.
    points = np.array([[1.0, 2.0, -0.05], [1.0, 2.0, -0.05]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], np.float32)
    np.testing.assert_allclose(measured(points, plate, normals=normals), [-0.15, -0.05], atol=1e-6)
    unknown = np.full((2, 3), np.nan, np.float32)
    np.testing.assert_allclose(measured(points, plate, normals=unknown), -0.05, atol=1e-6)


def test_a_fused_ball_lies_on_its_nominal_within_its_sigma() -> None:
    ball = Ball((0.0, 0.0, 0.0), 20.0)
    scans = [PlacedScan(seen([ball], p, k), p.rotation, p.translation_mm, 0.0) for k, p in enumerate(around(6, 480.0))]
    cloud = fuse(scans)
    sphere: Any = trimesh.creation.icosphere(subdivisions=6, radius=20.0)
    found = deviations(cloud.points_mm, cloud.sigma_mm, nominal_of(sphere.vertices, sphere.faces), cloud.normals)
    assert found.summary.beyond == 0
    # The chords of 40 000 triangles lie 1 µm inside of the ball.
    assert found.summary.mean_mm == pytest.approx(0.0006, abs=0.001)
    assert found.summary.within_2_sigma_percent is not None
    assert found.summary.within_2_sigma_percent > 95.0


def test_a_scans_own_mesh_can_be_the_nominal_surface() -> None:
    pose = looking((0.0, 0.0, -500.0))
    ball = Ball((0.0, 0.0, 0.0), 10.0)
    exact = mesh_of_scan(seen([ball], pose, 1, size_px=(120, 120), noise_mm=0.0, steepest=60.0))
    noisy = seen([ball], pose, 2, size_px=(120, 120), noise_mm=0.02, steepest=50.0)
    found = deviations(noisy.points_mm[noisy.mask], noisy.sigma_mm[noisy.mask], nominal_of_mesh(exact)).summary
    # Along the normal a point errs by the cosine of its incidence times its error along the ray: 0.82 in the mean square.
    assert found.rms_mm == pytest.approx(0.02 * 0.84, rel=0.05)
    assert found.mean_mm == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply"])
def test_nominal_surfaces_are_read_from_files_of_other_programs(suffix: str, tmp_path: Path) -> None:
    box: Any = trimesh.creation.box(extents=(20.0, 12.0, 6.0))
    box.export(tmp_path / f"box{suffix}")
    nominal = read_nominal(tmp_path / f"box{suffix}")
    assert len(nominal.vertices_mm) == 8, "corners that a file has three times are one"
    # Beside an edge: neither of its two faces alone knows whether that is inside.
    assert measured(np.array([[10.5, 6.5, 0.0]]), nominal)[0] == pytest.approx(np.sqrt(0.5))


def test_numbers_that_make_no_surface_are_refused() -> None:
    with pytest.raises(ValueError, match="no triangle has an area"):
        nominal_of(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(ValueError, match=r"limit_mm is 0\.0"):
        measured(np.zeros((1, 3)), nominal_box((1.0, 1.0, 1.0)), limit_mm=0.0)


@pytest.mark.parametrize("subdivisions", [3, 5])
def test_of_a_thin_shell_the_side_that_was_seen_counts_whatever_its_triangles(subdivisions: int) -> None:
    outer: Any = trimesh.creation.icosphere(subdivisions=subdivisions, radius=20.0)
    vertices = np.concatenate([outer.vertices, 0.98 * outer.vertices])
    shell = nominal_of(vertices, np.concatenate([outer.faces, outer.faces[:, ::-1] + len(outer.vertices)]))
    rng = np.random.default_rng(6)
    # 0.3 mm too low on the outside, 0.1 mm off the inner side, with normals that are up to a quarter of a right angle off.
    triangle = rng.integers(0, len(outer.faces), 400)
    out = outer.face_normals[triangle]
    points = outer.triangles_center[triangle] - 0.3 * out
    normals = out + 0.15 * rng.normal(size=out.shape)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    few = np.full(400, 0.01, np.float32)
    np.testing.assert_allclose(deviations(points, few, shell, normals).deviation_mm, -0.3, atol=2e-3)
    # And as much beyond the outer side, it was the inner one that was seen.
    beyond = outer.triangles_center[triangle] + 0.1 * out
    inner = deviations(beyond, few, shell, -normals).deviation_mm
    assert inner == pytest.approx(np.full(400, -0.5), abs=0.02 if subdivisions == 5 else 0.12)


def test_a_sharp_corner_weighs_its_triangles_by_their_angles() -> None:
    # A spike of a pyramid, of which one side is cut into many slivers: without angles they outvote the others.
    tip, low = np.array([0.0, 0.0, 1.0]), 4.0
    base = np.array([[-1.0, -1.0, -low], [1.0, -1.0, -low], [1.0, 1.0, -low], [-1.0, 1.0, -low]])
    cut = np.linspace(base[0], base[1], 13)[1:-1]
    places = np.concatenate([[tip], base, cut])
    ring = [1, *range(5, 5 + len(cut)), 2, 3, 4]
    sides = [[0, one, other] for one, other in zip(ring, [*ring[1:], 1], strict=True)]
    nominal = nominal_of(places, np.array(sides + [[4, other, one] for one, other in pairwise(ring[:-1])]))
    assert not nominal.open_edges.any()
    up = nominal.corner_normals[np.flatnonzero((nominal.vertices_mm == tip).all(1))[0]]
    assert abs(up[1]) < 1e-6 * up[2] + 1e-9, "by its symmetry it points straight up"


def test_beside_an_open_border_there_is_nothing_to_compare_with() -> None:
    sheet = nominal_of(np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    points = np.array([[5.0, 5.0, 0.5], [-1.0, 5.0, 0.0], [-0.04, 5.0, 0.2], [10.5, 10.5, -0.1], [40.0, 0.0, 0.0]])
    few = np.full(len(points), 0.01, np.float32)
    found = deviations(points, few, sheet)
    np.testing.assert_allclose(found.deviation_mm, [0.5, np.nan, 0.204, np.nan, np.nan], atol=1e-3)
    assert (found.summary.beside, found.summary.beyond) == (2, 1)


def test_places_are_spread_over_slivers_as_over_even_triangles() -> None:
    fan: Any = trimesh.creation.cylinder(radius=5.0, height=400.0, sections=64)
    places, face = spread_over(nominal_of(fan.vertices, fan.faces), 4000)
    on_side = np.abs(places[:, 2]) < 199.999
    thirds = np.histogram(places[on_side, 2], bins=8, range=(-200.0, 200.0))[0]
    assert thirds.min() > 0.93 * thirds.mean()
    assert len(np.unique(face[on_side])) == 128
