"""The mesh of an object: closed where there is data all round, open where there is none, and as good as its points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.desk.surface.fusion import FusedCloud, PlacedScan, fuse
from appliance.desk.surface.mesh import Mesh
from appliance.desk.surface.object_mesh import mesh_of_surface
from tests.support.solids import Ball, Pose, around, looking, seen

BALL = Ball((0.0, 0.0, 0.0), 20.0)


def fused(poses: list[Pose]) -> FusedCloud:
    return fuse(
        [
            PlacedScan(seen([BALL], pose, k, (220, 220)), pose.rotation, pose.translation_mm, 0.0)
            for k, pose in enumerate(poses)
        ]
    )


def kept(cloud: FusedCloud, which: np.ndarray) -> FusedCloud:
    return FusedCloud(
        cloud.points_mm[which], cloud.normals[which], cloud.sigma_mm[which], cloud.grey[which], cloud.views[which]
    )


def as_trimesh(mesh: Mesh) -> Any:
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


@pytest.fixture(scope="module")
def ball() -> FusedCloud:
    """A ball seen from all sides; at 0.5 mm it lies in eight blocks of the grid."""
    return fused([*around(6, 480.0), looking((0.0, 1.0, 480.0)), looking((0.0, 1.0, -480.0))])


@pytest.mark.parametrize("voxel_mm", [0.5, 1.0])
def test_a_ball_seen_from_all_sides_is_closed_and_has_its_volume(voxel_mm: float, ball: FusedCloud) -> None:
    mesh = mesh_of_surface(ball, voxel_mm)
    read = as_trimesh(mesh)
    assert (read.is_watertight, read.is_winding_consistent, read.euler_number) == (True, True, 2)
    # And looks outwards, else it were negative.
    assert read.volume == pytest.approx(4.0 / 3.0 * np.pi * 20.0**3, rel=0.002)
    out = BALL.off(mesh.vertices_mm.astype(float))
    assert abs(out.mean()) < 0.003, "a bent surface is not moved"
    assert out.std() < np.median(mesh.sigma_mm)
    outwards = mesh.vertices_mm / np.linalg.norm(mesh.vertices_mm, axis=1)[:, None]
    np.testing.assert_allclose(mesh.normals, outwards, atol=0.08)
    assert np.median(mesh.sigma_mm) == pytest.approx(np.median(ball.sigma_mm), rel=0.1)
    assert mesh.grey.min() >= ball.grey.min()


def test_a_hole_stays_open_unless_it_is_asked_to_be_closed(ball: FusedCloud) -> None:
    small = np.hypot(ball.points_mm[:, 0], ball.points_mm[:, 1]) < 2.0
    large = np.hypot(ball.points_mm[:, 0], ball.points_mm[:, 2]) < 6.0
    # One hole on either side of the ball: 4 mm wide at z > 0, and 12 mm at y > 0.
    rest = kept(ball, ~(small & (ball.points_mm[:, 2] > 0)) & ~(large & (ball.points_mm[:, 1] > 0)))
    open_mesh, closed = mesh_of_surface(rest), mesh_of_surface(rest, close_holes_mm=6.0)
    assert as_trimesh(open_mesh).euler_number == 0, "a ball with two holes"
    read = as_trimesh(closed)
    assert read.euler_number == 1, "the large one is left"
    assert read.is_winding_consistent
    made_up = np.isnan(closed.sigma_mm)
    assert made_up.sum() == 1
    np.testing.assert_allclose(closed.vertices_mm[made_up][0], [0.0, 0.0, 19.9], atol=0.3)
    assert np.isfinite(open_mesh.sigma_mm).all()


def test_nothing_gives_nothing_and_other_voxels_are_refused(ball: FusedCloud) -> None:
    none = kept(ball, np.zeros(len(ball.grey), np.bool_))
    for voxel_mm in (0.05, 20.0):
        assert mesh_of_surface(none, voxel_mm).faces.shape == (0, 3)
    for voxel_mm in (0.049, 20.1):
        with pytest.raises(ValueError, match=r"allowed are 0\.05\.\.20"):
            mesh_of_surface(none, voxel_mm)
