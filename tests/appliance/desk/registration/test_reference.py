"""A measured surface finds its place on a drawing, or says what leaves it open."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.desk.comparing import NominalReference, NominalSurface, compare
from appliance.desk.registration.reference import (
    OrientedPoints,
    SurfaceMatchError,
    _refine,
    _slide_to_best,
    register_to_reference,
)
from appliance.desk.surface.deviation import NominalTree, spread_over
from appliance.desk.surface.nominal import Nominal, nominal_of
from appliance.measure.light.rotation import rotation_matrix, rotation_vector
from appliance.measure.overlap.rigid import Rigid
from tests.support.flanged import cloud

HERE = Rigid(np.eye(3), np.zeros(3))
ELSEWHERE = Rigid(rotation_matrix(np.array([1.9, -0.7, 0.4])), np.array([300.0, -120.0, 50.0]))
SEEN = Rigid(rotation_matrix(np.array([0.2, 0.5, -1.3])), np.array([30.0, -20.0, -540.0]))
"""Maps the view into the frame of the bodies."""
NOISE_MM = 0.02


def heap(bodies: list[Any], motion: Rigid = HERE, scale: float = 1.0) -> Nominal:
    whole: Any = trimesh.util.concatenate(bodies)
    return nominal_of(motion.of(scale * np.asarray(whole.vertices)), whole.faces)


def box(size: tuple[float, ...], at: tuple[float, ...]) -> Any:
    made: Any = trimesh.creation.box(extents=size)
    return made.apply_translation(at)


def block() -> list[Any]:
    """A plate with steps that no turn brings upon themselves."""
    boss: Any = trimesh.creation.cylinder(radius=18.0, height=30.0, sections=48)
    return [
        box((200.0, 150.0, 20.0), (0.0, 0.0, -10.0)),
        box((60.0, 35.0, 24.0), (-50.0, 40.0, 12.0)),
        box((25.0, 70.0, 14.0), (60.0, -20.0, 7.0)),
        boss.apply_translation((-20.0, -40.0, 15.0)),
    ]


def view(bodies: list[Any], corner: tuple[float, float] = (-1e3, -1e3)) -> OrientedPoints:
    """What is seen of the bodies from above, obliquely too, beyond a corner in x and y; in the view's frame."""
    nominal = heap(bodies)
    places, face = spread_over(nominal, 8_000)
    normals = nominal.face_normals[face]
    hidden = np.zeros(len(places), bool)
    for low, high in (one.bounds for one in bodies[1:]):
        hidden |= (np.abs(places[:, 2]) < 1e-6) & ((places > low) & (places < high))[:, :2].all(1)
    on = (normals[:, 2] > -0.2) & (places[:, :2] > corner).all(1) & ~hidden & (places[:, 2] > -15.0)
    rng = np.random.default_rng(4)
    points = places[on] + normals[on] * rng.normal(0.0, NOISE_MM, (int(on.sum()), 1))
    # As they are of a cloud: good to a few degrees.
    turned = normals[on] + 0.03 * rng.normal(size=(len(points), 3))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    back = SEEN.inverse
    return OrientedPoints(back.of(points), turned @ back.rotation.T, np.full(len(points), NOISE_MM))


@cache
def reference(motion: Rigid, scale: float = 1.0) -> NominalReference:
    return NominalReference(NominalTree.of(heap(block(), motion, scale)))


def test_a_part_finds_its_place_on_a_drawing_in_any_frame() -> None:
    found = register_to_reference(view(block(), (-60.0, -1e3)), reference(ELSEWHERE))
    off = SEEN.then(ELSEWHERE).inverse.then(found.pose)
    assert np.linalg.norm(off.of(found.middle_mm) - found.middle_mm) < 0.02
    assert np.linalg.norm(rotation_vector(off.rotation)) * found.lever_mm < 0.02
    # The drawing is the surface itself: what is left is the noise.
    assert found.scatter_mm == pytest.approx(NOISE_MM, rel=0.1)
    assert found.fitting > 0.97
    assert (found.free, found.elsewhere) == ((), ())
    assert float(np.sqrt(np.trace(found.covariance))) < 0.02


def test_what_fits_in_several_places_is_said_with_the_start_that_leads_to_each() -> None:
    frustum: Any = trimesh.creation.cylinder(radius=60.0, height=40.0, sections=4)
    frustum.vertices[frustum.vertices[:, 2] > 0.0, :2] *= 0.5
    points, there_mm = view([frustum]), np.array([3e5, 0.0, -2e3])
    seen = cloud(points)
    nominal = NominalSurface("frustum", replace(heap([frustum]), origin_mm=there_mm))
    found = compare(seen, nominal)
    turned = [rotation_vector(found.laid.pose.inverse.then(one).rotation) for one in found.laid.elsewhere]
    assert len(turned) == 3
    np.testing.assert_allclose(sorted(np.degrees(np.linalg.norm(one)) for one in turned), [90.0, 90.0, 180.0], atol=0.5)
    (said,) = found.warnings
    starts = [[float(one) for one in start.split(",")] for start in re.findall(r"--start (\S+) \(turned", said)]
    assert len(starts) == 3
    for start, there in zip(starts, found.laid.elsewhere, strict=True):
        begun = Rigid(rotation_matrix(np.radians(start[3:])), np.array(start[:3]))
        chosen = compare(seen, nominal, start=begun)
        moved = chosen.laid.pose.of(points.points_mm) - there.of(points.points_mm)
        assert np.linalg.norm(moved, axis=1).max() < 0.1
        assert chosen.deviation.summary.rms_mm == pytest.approx(found.deviation.summary.rms_mm, abs=0.001)
        assert chosen.warnings == ()


def test_another_thing_or_a_drawing_in_metres_is_refused_with_both_sizes() -> None:
    stone: Any = trimesh.creation.icosphere(subdivisions=3, radius=70.0)
    with pytest.raises(SurfaceMatchError, match=r"must: is it the same thing, in mm.* and 200 x 150 x 5\d"):
        register_to_reference(view([stone]), reference(HERE))
    with pytest.raises(SurfaceMatchError, match=r"0\.2 x 0\.15 x 0\.05 mm; if the CAD model is in metres"):
        register_to_reference(view(block()), reference(HERE, 0.001))


def test_what_slides_settles_by_most_of_what_it_shows_and_a_rib_beside_its_place_does_not_draw_it() -> None:
    ribs = [box((10.0, 60.0, 8.0), (x, 0.0, 4.0)) for x in (-60.0, 60.0)]
    drawing = NominalReference(NominalTree.of(heap([box((240.0, 160.0, 20.0), (0.0, 0.0, -10.0)), *ribs])))
    rng = np.random.default_rng(1)
    # A noisy plate, and a few points of one side of each rib: too few to hold it. The second rib is 0.45 mm off.
    plate = np.column_stack([rng.uniform(-50.0, 50.0, 3_000), rng.uniform(-60.0, 60.0, 3_000), np.zeros(3_000)])
    sides = [
        np.column_stack([np.full(count, x), rng.uniform(-25.0, 25.0, count), rng.uniform(2.0, 7.0, count)])
        for x, count in ((-55.0, 20), (65.45, 8))
    ]
    plate[:, 2] += rng.normal(0.0, 0.1, len(plate))
    normals = np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], [len(plate), 28], axis=0)
    normals = normals + 0.25 * rng.normal(size=normals.shape)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = OrientedPoints(np.concatenate([plate, *sides]), normals, np.full(len(normals), 0.1))
    begun = _refine(points, drawing, Rigid(np.eye(3), np.array([0.1, 0.0, 0.0])), 1.0)
    assert begun is not None
    assert begun.pose.translation_mm[0] == pytest.approx(0.1, abs=0.01), "nothing holds it"
    settled = _slide_to_best(begun, points, drawing)
    assert settled is not None
    assert settled.pose.translation_mm[0] == pytest.approx(0.0, abs=0.03)
    assert settled.pose.translation_mm[2] == pytest.approx(0.0, abs=0.02)
