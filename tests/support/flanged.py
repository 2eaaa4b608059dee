"""A pipe with a flange as a CAD program writes it, and what a camera beside it has of it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import trimesh

from appliance.desk.registration.reference import OrientedPoints
from appliance.desk.surface.fusion import FusedCloud
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.rigid import Rigid
from tests.support.views import Array

RADIUS_MM, FLANGE_MM, AT_MM, WIDTH_MM, LONG_MM = 60.0, 82.0, 140.0, 22.0, 600.0
TRUE = Rigid(rotation_matrix(np.array([0.3, -1.1, 0.5])), np.array([80.0, -40.0, 500.0]))
"""Maps the points into the model's frame."""


@cache
def pipe(sections: int) -> tuple[Array, Array]:
    """Vertices and triangles of a pipe along x with a flange; of slender triangles, as CAD programs write cylinders."""
    half = LONG_MM / 2.0
    low, high = AT_MM - WIDTH_MM / 2.0, AT_MM + WIDTH_MM / 2.0
    profile = [
        (-half, 0.0),
        (-half, RADIUS_MM),
        (low, RADIUS_MM),
        (low, FLANGE_MM),
        (high, FLANGE_MM),
        (high, RADIUS_MM),
    ]
    profile += [(half, RADIUS_MM), (half, 0.0)]
    turned: Any = trimesh.creation.revolve([(r, x) for x, r in profile], sections=sections)
    along_x = turned.vertices[:, [2, 0, 1]]
    # Outside out, whatever the sense of the profile.
    faces = turned.faces if trimesh.Trimesh(along_x, turned.faces).volume > 0.0 else turned.faces[:, ::-1]
    return along_x, faces


def view(low_mm: float, high_mm: float, n: int = 16_000) -> OrientedPoints:
    """What a camera beside it has of the pipe between both places on its axis: ``n`` points of a third of its round, in a frame of its own."""
    rng = np.random.default_rng(8)
    x, angle = rng.uniform(low_mm, high_mm, n), rng.uniform(-1.0, 1.0, n)
    on_flange = np.abs(x - AT_MM) < WIDTH_MM / 2.0
    normal = np.stack([np.zeros(n), np.cos(angle), np.sin(angle)], 1)
    points = normal * np.where(on_flange, FLANGE_MM, RADIUS_MM)[:, None] + np.outer(x, [1.0, 0.0, 0.0])
    points = points + normal * rng.normal(0.0, 0.02, (n, 1))
    back = TRUE.inverse
    return OrientedPoints(back.of(points), normal @ back.rotation.T, np.full(n, 0.02))


def cloud(points: OrientedPoints) -> FusedCloud:
    n = len(points.points_mm)
    return FusedCloud(
        points.points_mm.astype(np.float32), points.normals.astype(np.float32), points.sigma_mm.astype(np.float32),
        np.full(n, 128, np.uint8), np.ones(n, np.uint16),
    )  # fmt: skip
