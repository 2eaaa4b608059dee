"""Signed distances to a nominal surface: against closed forms and against trying every triangle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from appliance.desk.surface.deviation import NominalTree, deviations
from appliance.desk.surface.nominal import Nominal, nominal_of


def nominal_box(*size_mm: float) -> Nominal:
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
    found = measured(points, nominal_box(20.0, 12.0, 6.0), limit_mm=50.0)
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
    points = np.array([[0.0, 0.0, 3.5], [0.0, 0.0, 4.5], [0.0, 0.0, 900.0], [0.0, 0.0, 2.75]], np.float32)
    sigma, box = np.array([0.3, 0.1, 0.1, 0.1], np.float32), nominal_box(20.0, 12.0, 6.0)
    found = deviations(points, sigma, box, limit_mm=1.0)
    np.testing.assert_allclose(found.deviation_mm, [0.5, np.nan, np.nan, -0.25], atol=1e-6)
    summary = found.summary
    assert (summary.points, summary.beyond, summary.limit_mm) == (4, 2, 1.0)
    assert (summary.mean_mm, summary.rms_mm) == pytest.approx((0.125, np.sqrt((0.5**2 + 0.25**2) / 2)))
    assert (summary.least_mm, summary.most_mm) == pytest.approx((-0.25, 0.5))
    assert summary.within_2_sigma_percent == 50.0, "0.5 of 2 x 0.3, and not 0.25 of 2 x 0.1"
    assert dict(summary.percentiles_mm)[50.0] == pytest.approx(0.125)
    nothing = deviations(points[1:3], sigma[1:3], box, limit_mm=1.0).summary
    assert (nothing.beyond, nothing.rms_mm, nothing.percentiles_mm) == (2, None, ())


def test_the_far_side_of_a_thin_plate_is_not_what_was_measured() -> None:
    plate = nominal_box(40.0, 40.0, 0.2)
    # 0.15 mm too low on the upper side: nearer to the lower one.
    points = np.array([[1.0, 2.0, -0.05], [1.0, 2.0, -0.05]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], np.float32)
    np.testing.assert_allclose(measured(points, plate, normals=normals), [-0.15, -0.05], atol=1e-6)
    unknown = np.full((2, 3), np.nan, np.float32)
    np.testing.assert_allclose(measured(points, plate, normals=unknown), -0.05, atol=1e-6)


def test_numbers_that_make_no_surface_are_refused() -> None:
    with pytest.raises(ValueError, match=r"limit_mm is 0\.0"):
        measured(np.zeros((1, 3)), nominal_box(1.0, 1.0, 1.0), limit_mm=0.0)


def test_beside_an_open_border_there_is_nothing_to_compare_with() -> None:
    sheet = nominal_of(np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    points = np.array([[5.0, 5.0, 0.5], [-1.0, 5.0, 0.0], [-0.04, 5.0, 0.2], [10.5, 10.5, -0.1], [40.0, 0.0, 0.0]])
    few = np.full(len(points), 0.01, np.float32)
    found = deviations(points, few, sheet)
    np.testing.assert_allclose(found.deviation_mm, [0.5, np.nan, 0.204, np.nan, np.nan], atol=1e-3)
    assert (found.summary.beside, found.summary.beyond) == (2, 1)
