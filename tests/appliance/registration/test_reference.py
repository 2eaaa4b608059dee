"""A measured surface finds its place on a drawing, or says what leaves it open."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from appliance.offline.comparing import NominalReference
from appliance.optics.rotation import rotation_matrix, rotation_vector
from appliance.registration.reference import OrientedPoints, SurfaceMatchError, lay_onto
from appliance.registration.rigid import Rigid
from appliance.surface.deviation import NominalTree
from appliance.surface.fusion import PlacedScan, fuse
from appliance.surface.nominal import nominal_of
from tests.support.drawn import drawing
from tests.support.views import Array, SeenView, view

SHELL = ((-106.0, -81.0, -42.0), (106.0, 81.0, 13.0))
HERE = Rigid(np.eye(3), np.zeros(3))
ELSEWHERE = Rigid(rotation_matrix(np.array([1.9, -0.7, 0.4])), np.array([300.0, -120.0, 50.0]))


def reference_of(
    vertices: Array, faces: np.ndarray[tuple[int, ...], np.dtype[np.int64]], motion: Rigid = HERE
) -> NominalReference:
    return NominalReference(NominalTree.of(nominal_of(motion.of(vertices), faces)))


@cache
def shell(motion: Rigid) -> NominalReference:
    return reference_of(*drawing("shell", *SHELL), motion)


def measured(seen: SeenView) -> OrientedPoints:
    surface = fuse([PlacedScan(seen.cloud, np.eye(3), np.zeros(3))], 0.8)
    return OrientedPoints(
        surface.points_mm.astype(np.float64), surface.normals.astype(np.float64), surface.sigma_mm.astype(np.float64)
    )


@pytest.mark.parametrize(
    "pose", [(0.0, 0.0, 545.0, 5.0, -8.0, 12.0), (45.0, -30.0, 530.0, -12.0, 20.0, 130.0)], ids=["whole", "part"]
)
def test_a_view_finds_its_place_on_a_drawing_in_any_frame(pose: tuple[float, ...]) -> None:
    seen = view("shell", pose, "none", 4)
    reference = shell(ELSEWHERE)
    found = lay_onto(measured(seen), reference)
    true = seen.place.then(ELSEWHERE)
    off = true.inverse.then(found.pose)
    assert np.linalg.norm(off.of(found.middle_mm) - found.middle_mm) < 0.02
    assert np.linalg.norm(rotation_vector(off.rotation)) * found.lever_mm < 0.02
    # The drawing is the surface itself: what is left is the noise, of which the fused points have less than a pixel's.
    assert found.scatter_mm < 0.025
    assert found.fitting > 0.97
    assert found.free == ()
    assert found.elsewhere == ()
    assert float(np.sqrt(np.trace(found.covariance))) < 0.02


def test_a_pipe_turns_about_its_axis_and_the_deviations_know_nothing_of_it() -> None:
    seen = view("pipe", (0.0, 0.0, 560.0, 0.0, 4.0, 10.0), "none", 5)
    reference = reference_of(*drawing("pipe", (-90.0, -63.0, -63.0), (90.0, 63.0, 63.0)))
    found = lay_onto(measured(seen), reference, seen.place)
    # The axis is x; what is seen lies beside it, so that such a turn is a turn and a shift across. Its steps hold it along the axis.
    (way,) = found.free
    free = way.direction
    assert way.turns
    assert way.ends == pytest.approx((-180.0, 180.0))
    turn = np.concatenate([np.array([found.lever_mm, 0.0, 0.0]), np.cross([1.0, 0.0, 0.0], found.middle_mm)])
    assert abs(free @ turn) > 0.999 * np.linalg.norm(turn)
    # What is free adds nothing to the deviations, however far it may turn.
    on_it = reference.spread(600)
    assert found.sigma_at(on_it.points_mm, on_it.normals).max() < 0.05


def test_what_fits_in_several_places_is_said() -> None:
    seen = view("frustum", (0.0, 0.0, 545.0, 4.0, -6.0, 20.0), "none", 6)
    # Without its plate, whose corners tell two of the four turns.
    reference = reference_of(*drawing("frustum", (-70.0, -70.0, -46.0), (70.0, 70.0, -2.0)))
    points = measured(seen)
    on_it = np.abs(seen.place.of(points.points_mm)[:, :2]).max(axis=1) < 60.0
    on_it &= seen.place.of(points.points_mm)[:, 2] < -4.0
    found = lay_onto(OrientedPoints(points.points_mm[on_it], points.normals[on_it], points.sigma_mm[on_it]), reference)
    quarter = [rotation_vector(found.pose.inverse.then(one).rotation) for one in found.elsewhere]
    assert len(quarter) == 3
    np.testing.assert_allclose(
        sorted(np.degrees(np.linalg.norm(one)) for one in quarter), [90.0, 90.0, 180.0], atol=0.5
    )


def test_another_thing_is_refused_with_both_sizes() -> None:
    seen = view("stones", (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), "none", 7)
    with pytest.raises(SurfaceMatchError, match=r"must: is it the same thing, in mm.* and 210 x 160 x 50\.3 mm"):
        lay_onto(measured(seen), shell(HERE))


def test_a_drawing_in_metres_is_refused() -> None:
    seen = view("shell", (0.0, 0.0, 545.0, 5.0, -8.0, 12.0), "none", 4)
    vertices, faces = drawing("shell", *SHELL)
    with pytest.raises(SurfaceMatchError, match=r"0\.21 x 0\.16 x 0\.0503 mm; is the CAD model in metres"):
        lay_onto(measured(seen), reference_of(vertices / 1000.0, faces))
