"""A pipe slides along a CAD model until its flange holds it: one answer for any triangles and any frame."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.offline.comparing import NominalReference
from appliance.optics.rotation import rotation_matrix
from appliance.registration.reference import LaidOnto, OrientedPoints, lay_onto
from appliance.registration.rigid import Rigid
from appliance.surface.deviation import NominalTree
from appliance.surface.nominal import nominal_of
from tests.support.views import Array

RADIUS_MM, FLANGE_MM, AT_MM, WIDTH_MM, LONG_MM = 60.0, 82.0, 140.0, 22.0, 600.0
TRUE = Rigid(rotation_matrix(np.array([0.3, -1.1, 0.5])), np.array([80.0, -40.0, 500.0]))
"""Maps the points into the model's frame."""
SLID_MM = 60.0


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


def finer() -> tuple[Array, Array]:
    cut: Any = trimesh.remesh.subdivide_to_size
    vertices, faces = cut(*pipe(256), 60.0)
    return vertices, faces


def view(low_mm: float, high_mm: float) -> OrientedPoints:
    """What a camera beside it has of the pipe between both places on its axis: a third of its round, in a frame of its own."""
    rng = np.random.default_rng(8)
    n = 16_000
    x, angle = rng.uniform(low_mm, high_mm, n), rng.uniform(-1.0, 1.0, n)
    on_flange = np.abs(x - AT_MM) < WIDTH_MM / 2.0
    normal = np.stack([np.zeros(n), np.cos(angle), np.sin(angle)], 1)
    points = normal * np.where(on_flange, FLANGE_MM, RADIUS_MM)[:, None] + np.outer(x, [1.0, 0.0, 0.0])
    points = points + normal * rng.normal(0.0, 0.02, (n, 1))
    back = TRUE.inverse
    return OrientedPoints(back.of(points), normal @ back.rotation.T, np.full(n, 0.02))


def laid(vertices: Array, faces: Array, points: OrientedPoints, start: Rigid | None = None) -> LaidOnto:
    return lay_onto(points, NominalReference(NominalTree.of(nominal_of(vertices, faces))), start)


def along(found: LaidOnto) -> float:
    """Return how far the view was laid from its place along the pipe, mm."""
    middle = TRUE.inverse.of(np.array([AT_MM, 0.0, 0.0]))
    return float(found.pose.of(middle)[0] - AT_MM)


@cache
def searched() -> LaidOnto:
    return laid(*pipe(256), view(20.0, 200.0))


def test_a_flange_in_view_holds_a_pipe_and_turning_it_changes_nothing() -> None:
    found = searched()
    assert abs(along(found)) < 0.6, "the flange's sides are not seen: its edges tell to a fraction of a millimetre"
    assert found.fitting > 0.98
    (turning,) = (way for way in found.free if way.turns)
    assert max(turning.rms_mm) < 1.5 * found.rms_mm + 0.02
    sliding = [way for way in found.free if not way.turns]
    assert all(abs(end) <= 8.0 for way in sliding for end in way.ends), "the way that is left ends at the flange"


def test_other_triangles_of_one_shape_give_one_answer() -> None:
    found, points = searched(), view(20.0, 200.0)
    again = laid(*finer(), points, found.pose)
    assert along(again) == pytest.approx(along(found), abs=0.1)
    assert again.rms_mm == pytest.approx(found.rms_mm, abs=0.005)
    assert again.fitting == pytest.approx(found.fitting, abs=0.005)


def test_a_start_is_kept_along_what_nothing_holds() -> None:
    points = view(-200.0, 40.0)
    start = TRUE.then(Rigid(np.eye(3), np.array([-SLID_MM, 0.5, -0.3])))
    found = laid(*pipe(90), points, start)
    assert along(found) == pytest.approx(-SLID_MM, abs=0.5)
    (sliding,) = (way for way in found.free if not way.turns)
    assert min(abs(end) for end in sliding.ends) > 30.0
    # At the one end nothing is in its way; at the other it begins to touch the flange, and that is told.
    assert min(sliding.rms_mm) < 1.2 * found.rms_mm < 2.0 * found.rms_mm < max(sliding.rms_mm)
