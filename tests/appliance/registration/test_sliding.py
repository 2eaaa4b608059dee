"""A pipe slides along a CAD model until its flange holds it: one answer for any triangles and any frame."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.offline.comparing import Comparison, NominalReference, NominalSurface, compare
from appliance.optics.rotation import rotation_matrix
from appliance.registration.reference import LaidOnto, OrientedPoints, _led, _Sampled, _slid_apart, lay_onto
from appliance.registration.rigid import Rigid
from appliance.surface.deviation import NominalTree
from appliance.surface.nominal import Nominal, nominal_of, read_nominal
from tests.support.flanged import AT_MM, RADIUS_MM, TRUE, cloud, finer, pipe, view
from tests.support.views import Array

SLID_MM = 60.0


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


def test_of_guesses_that_only_sliding_tells_apart_one_is_slid_to_the_flange() -> None:
    rough = _Sampled.of(NominalReference(NominalTree.of(nominal_of(*pipe(90)))).spread(10_000))
    whole = view(20.0, 200.0)
    few, some = (OrientedPoints(whole.points_mm[::k], whole.normals[::k], whole.sigma_mm[::k]) for k in (20, 60))
    ends_changed = TRUE.then(Rigid(np.diag([-1.0, 1.0, -1.0]), np.zeros(3)))
    guesses = [TRUE, TRUE, TRUE, ends_changed]
    led = [
        _led(few, rough, guess.then(Rigid(np.eye(3), np.array([off, 0.3, 0.2]))), 4.0)
        for guess, off in zip(guesses, (-100.0, -160.0, -40.0, 90.0), strict=True)
    ]
    slid = _slid_apart([fit for fit in led if fit is not None], few, some, rough)
    assert len(slid) == 2, "one of each sense along the pipe"
    for fit, from_ in zip(slid, (led[0], led[3]), strict=True):
        assert fit is not None
        assert from_ is not None
        assert from_.support < 0.88 < 0.95 < fit.support
        flange = fit.pose.of(TRUE.inverse.of(np.array([AT_MM, 0.0, 0.0])))
        assert flange[0] == pytest.approx(AT_MM, abs=3.0)


def compared(nominal: Nominal, start: Rigid = TRUE) -> Comparison:
    return compare(cloud(view(20.0, 200.0)), NominalSurface("pipe", nominal), start=start)


def assert_one_answer(found: Comparison, other: Comparison, by_mm: tuple[float, ...] = (0.0, 0.0, 0.0)) -> None:
    """Both poses put the points to the same places, and as many of them out of a tenth of a millimetre."""
    first, second = found.deviation.summary, other.deviation.summary
    assert first.rms_mm is not None
    assert second.rms_mm == pytest.approx(first.rms_mm, abs=0.001)
    out = [100.0 * np.mean(~(np.abs(one.deviation.deviation_mm) <= 0.1)) for one in (found, other)]
    assert out[1] == pytest.approx(out[0], abs=0.3)
    off = other.laid.pose.translation_mm - by_mm - found.laid.pose.translation_mm
    assert float(np.linalg.norm(off)) < 0.1


@cache
def started() -> Comparison:
    return compared(nominal_of(*pipe(256)))


def test_a_search_and_a_start_at_the_truth_find_one_place() -> None:
    assert abs(along(started().laid)) < 0.1
    # A pipe with a flange is the same turned end for end: only along it both can differ.
    assert started().laid.rms_mm == pytest.approx(searched().rms_mm, abs=0.001)
    assert started().laid.fitting == pytest.approx(searched().fitting, abs=0.003)


def test_other_triangles_of_one_shape_give_one_answer() -> None:
    other = compared(nominal_of(*finer()))
    assert other.laid.scatter_mm == pytest.approx(started().laid.scatter_mm, abs=0.001)
    assert_one_answer(started(), other)
    # Cut across, too, so that no edge of the one is an edge of the other.
    vertices, faces = pipe(256)
    split: Any = trimesh.remesh.subdivide
    assert_one_answer(started(), compared(nominal_of(*split(vertices, faces))))


@pytest.mark.parametrize("by_mm", [(3e5, 0.0, 0.0), (-3e6, 2e6, 3e6)], ids=["300 m", "3 km"])
def test_a_model_far_from_its_frames_origin_gives_one_answer(by_mm: tuple[float, ...], tmp_path: Path) -> None:
    vertices, faces = pipe(256)
    corners = (vertices + by_mm)[faces].reshape(-1, 3)
    head = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n"
    head += "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
    listed = np.zeros(len(faces), [("n", "u1"), ("of", "<i4", 3)])
    listed["n"], listed["of"] = 3, np.arange(len(corners)).reshape(-1, 3)
    file = tmp_path / "far.ply"
    file.write_bytes(
        head.format(len(corners), len(faces)).encode() + corners.astype("<f8").tobytes() + listed.tobytes()
    )
    found = compared(read_nominal(file), Rigid(TRUE.rotation, TRUE.translation_mm + by_mm))
    assert_one_answer(started(), found, by_mm)
    assert np.abs(found.in_nominal_frame.points_mm).max() < 1500.0, "single precision is enough about its own origin"


def test_a_surface_lies_on_its_own_mesh() -> None:
    x, angle = (one.ravel() for one in np.meshgrid(np.linspace(100.0, 180.0, 80), np.linspace(-0.8, 0.8, 90)))
    # A flange with a rounded edge, of which a third of the round is seen.
    radius = RADIUS_MM + 15.0 / (1.0 + np.exp(-(x - AT_MM) / 1.5)) * np.exp(-(((x - AT_MM) / 25.0) ** 4))
    normal = np.stack([0.0 * x, np.cos(angle), np.sin(angle)], 1)
    points = normal * radius[:, None] + np.outer(x, [1.0, 0.0, 0.0])
    points += normal * np.random.default_rng(3).normal(0.0, 0.015, (len(x), 1))
    k = np.arange(len(x)).reshape(90, 80)
    a, b, c, d = (one.ravel() for one in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    mesh = nominal_of(points, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))
    out = mesh.corner_normals / np.linalg.norm(mesh.corner_normals, axis=1)[:, None]
    seen, nominal = cloud(OrientedPoints(mesh.vertices_mm, out, 0.015 + 0.0 * x)), NominalSurface("its mesh", mesh)
    here = compare(seen, nominal, start=Rigid(np.eye(3), np.zeros(3))).deviation.summary
    assert here.rms_mm is not None
    assert here.rms_mm < 0.001
    # Turned about the axis, where each triangle's noise meets another's, it is the noise of both and no more.
    aside = Rigid(rotation_matrix(np.array([0.004, -0.003, 0.005])), np.array([0.4, -0.3, 0.2]))
    there = compare(seen, nominal, start=aside).deviation.summary
    assert there.rms_mm is not None
    assert there.rms_mm < 1.42 * 0.015
    assert there.beyond == 0


def test_a_start_is_kept_along_what_nothing_holds() -> None:
    points = view(-200.0, 40.0)
    start = TRUE.then(Rigid(np.eye(3), np.array([-SLID_MM, 0.5, -0.3])))
    found = laid(*pipe(90), points, start)
    assert along(found) == pytest.approx(-SLID_MM, abs=0.5)
    (sliding,) = (way for way in found.free if not way.turns)
    assert min(abs(end) for end in sliding.ends) > 30.0
    # At the one end nothing is in its way; at the other it begins to touch the flange, and that is told.
    assert min(sliding.rms_mm) < 1.2 * found.rms_mm < 2.0 * found.rms_mm < max(sliding.rms_mm)


def test_a_screw_is_read_back_from_its_motion() -> None:
    middle, shift = np.array([40.0, -30.0, 500.0]), np.array([7.0, -20.0, 3.0])
    for turn in (np.zeros(3), np.array([1e-4, 0.0, 2e-4]), np.array([1.9, -0.7, 1.5])):
        whole, half = (Rigid.along_screw(k * turn, k * shift, middle) for k in (1.0, 0.5))
        np.testing.assert_allclose(half.then(half).of(middle), whole.of(middle), atol=1e-9)
        np.testing.assert_allclose(np.concatenate(whole.screw(middle)), np.concatenate([turn, shift]), atol=1e-6)
