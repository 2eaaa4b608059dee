"""A pipe slides along a CAD model until its flange holds it: one answer for any triangles and any frame."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.desk.comparing import NominalReference
from appliance.desk.registration.reference import OrientedPoints, SurfaceRegistration, register_to_reference
from appliance.desk.surface.deviation import NominalTree
from appliance.desk.surface.nominal import nominal_of
from appliance.measure.overlap.rigid import Rigid
from tests.support.flanged import AT_MM, TRUE, pipe, view
from tests.support.views import Array

SLID_MM = 60.0


def laid(vertices: Array, faces: Array, points: OrientedPoints, start: Rigid | None = None) -> SurfaceRegistration:
    return register_to_reference(points, NominalReference(NominalTree.of(nominal_of(vertices, faces))), start)


def along(found: SurfaceRegistration) -> float:
    """Return how far the view was laid from its place along the pipe, mm."""
    middle = TRUE.inverse.of(np.array([AT_MM, 0.0, 0.0]))
    return float(found.pose.of(middle)[0] - AT_MM)


@cache
def searched() -> SurfaceRegistration:
    return laid(*pipe(120), view(20.0, 200.0, 4_000))


def test_a_flange_in_view_holds_a_pipe_and_turning_it_changes_nothing() -> None:
    found = searched()
    assert abs(along(found)) < 0.6, "the flange's sides are not seen: its edges tell to a fraction of a millimetre"
    assert found.fitting > 0.98
    (turning,) = (way for way in found.free if way.is_rotation)
    assert max(turning.rms_mm) < 1.5 * found.rms_mm + 0.02
    sliding = [way for way in found.free if not way.is_rotation]
    assert all(abs(end) <= 8.0 for way in sliding for end in way.ends), "the way that is left ends at the flange"


def test_a_start_is_kept_along_what_nothing_holds() -> None:
    points = view(-200.0, 40.0, 4_000)
    start = TRUE.then(Rigid(np.eye(3), np.array([-SLID_MM, 0.5, -0.3])))
    found = laid(*pipe(90), points, start)
    assert along(found) == pytest.approx(-SLID_MM, abs=0.5)
    (sliding,) = (way for way in found.free if not way.is_rotation)
    assert min(abs(end) for end in sliding.ends) > 30.0
    # At the one end nothing is in its way; at the other it begins to touch the flange, and that is told.
    assert min(sliding.rms_mm) < 1.2 * found.rms_mm < 2.0 * found.rms_mm < max(sliding.rms_mm)
