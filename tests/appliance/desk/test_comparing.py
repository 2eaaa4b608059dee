"""An object that the calibration bends is no object that deviates: sigma knows, and it is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.desk.comparing import NominalSurface, compare
from appliance.desk.object_errors import with_sigma_in_frame
from appliance.desk.registration.joint import JointErrors
from appliance.desk.surface.fusion import FusedCloud
from appliance.desk.surface.nominal import Nominal, nominal_of
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS
from appliance.measure.overlap.rigid import Rigid

Array = NDArray[np.float64]
HALF_MM, WIDE_MM, NOISE_MM = 350.0, 60.0, 0.02
SCANS_MM = np.linspace(-300.0, 300.0, 7)
"""Middles of seven scans along a plate, each from 500 mm above it."""
BEND = 2.5e-4
"""Sagitta over the square of the distance from the middle, 1/mm per mm of the coefficient."""
COEFFICIENT_MM = 0.03
HERE = Rigid(np.eye(3), np.zeros(3))


def height(x: Array, y: Array) -> Array:
    """A plate with bosses at uneven distances, so that nothing slides; z points away from the camera."""
    bosses = ((-290.0, 20.0), (-180.0, -25.0), (-60.0, 30.0), (40.0, -10.0), (170.0, 25.0), (260.0, -30.0))
    return np.asarray(-sum(8.0 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 200.0) for a, b in bosses))


def grid(step_mm: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Places on the plate (n, 3), unit normals towards the camera, and triangles seen from there."""
    x, y = np.arange(-HALF_MM, HALF_MM + 0.1, step_mm), np.arange(-WIDE_MM, WIDE_MM + 0.1, step_mm)
    u, v = (one.ravel() for one in np.meshgrid(x, y, indexing="ij"))
    slope = [(height(u + d, v + e) - height(u - d, v - e)) / 0.02 for d, e in ((0.01, 0.0), (0.0, 0.01))]
    normal = np.stack([slope[0], slope[1], -np.ones_like(u)], 1)
    k = np.arange(len(u)).reshape(len(x), len(y))
    a, b, c, d = (one.ravel() for one in (k[:-1, :-1], k[1:, :-1], k[:-1, 1:], k[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    return np.stack([u, v, height(u, v)], 1), normal / np.linalg.norm(normal, axis=1)[:, None], faces


@pytest.fixture(scope="module")
def plate() -> Nominal:
    points, _, faces = grid(2.0)
    return nominal_of(points, faces)


@pytest.fixture(scope="module")
def errors() -> JointErrors:
    """Seven scans in a row, each turned a little against the one before by what they share: a parabola."""
    follow = np.zeros((6 * len(SCANS_MM), DEPTH_ERROR_TERMS))
    # z = -F c, by a turn about y and a shift that make the parabola's tangent.
    follow[1::6, 0] = 2.0 * BEND * SCANS_MM
    follow[5::6, 0] = BEND * SCANS_MM**2
    shared = np.zeros((DEPTH_ERROR_TERMS, 1))
    shared[0] = COEFFICIENT_MM
    poses = tuple(Rigid(np.eye(3), np.array([x, 0.0, -500.0])) for x in SCANS_MM)
    return JointErrors(poses, np.zeros((6 * len(poses), 1)), follow, shared)


def measured(errors: JointErrors, times_sigma: float) -> FusedCloud:
    """The plate as those scans see it, bent by so many of its standard deviations."""
    points, normals, _ = grid(5.0)
    rng = np.random.default_rng(4)
    scan = np.abs(points[:, :1] - SCANS_MM).argmin(1).astype(np.uint16)
    off = points[:, 0] - SCANS_MM[scan]
    # What each scan's own points err by is the same bow: u squared at 500 mm.
    own = (off / 500.0 / 0.24) ** 2 * (500.0 / 525.0) ** 2
    tangent = -BEND * (SCANS_MM[scan] ** 2 + 2.0 * SCANS_MM[scan] * off)
    moved = points + np.stack([0.0 * own, 0.0 * own, times_sigma * COEFFICIENT_MM * (own - (-tangent))], 1)
    moved = moved + normals * rng.normal(0.0, NOISE_MM, (len(points), 1))
    return FusedCloud(
        moved.astype(np.float32), normals.astype(np.float32), np.full(len(points), NOISE_MM, np.float32),
        np.full(len(points), 128, np.uint8), np.ones(len(points), np.uint16), first_scan=scan,
    )  # fmt: skip


def test_a_bent_object_is_within_its_sigma_and_that_is_said(plate: Nominal, errors: JointErrors) -> None:
    surface, nominal = measured(errors, 1.3), NominalSurface("plate.stl", plate)
    blind = compare(surface, nominal, 5.0, HERE)
    summary = blind.deviation.summary
    assert summary.most_mm is not None
    assert summary.least_mm is not None
    assert summary.most_mm - summary.least_mm > 0.6, "half a millimetre and more of bending"
    assert summary.within_2_sigma_percent is not None
    assert summary.within_2_sigma_percent < 50.0, "noise alone does not explain it"
    assert blind.warnings == ()

    told = compare(surface, nominal, 5.0, HERE, errors)
    assert told.deviation.summary.rms_mm == pytest.approx(summary.rms_mm), "the place does not depend on it"
    assert told.deviation.summary.within_2_sigma_percent is not None
    assert told.deviation.summary.within_2_sigma_percent > 93.0
    (warning,) = told.warnings
    assert "within the object's depth error" in warning
    # What bends a row most is its middle against its ends; where those cross, nothing moves.
    bending = told.surface.shares
    assert bending is not None
    x = np.abs(surface.points_mm[:, 0])
    ends, between = (float(np.median(bending.bending_mm[at])) for at in (x > 330.0, np.abs(x - 202.0) < 10.0))
    assert ends > 0.4
    assert between < 0.25 * ends
    np.testing.assert_array_equal(told.in_nominal_frame.sigma_mm, told.deviation.sigma_mm)


def test_a_boss_that_stands_out_by_more_than_anything_may_bend_stays_a_deviation_of_a_straight_object(
    plate: Nominal, errors: JointErrors
) -> None:
    surface = measured(errors, 0.0)
    points = surface.points_mm.copy()
    at = np.hypot(points[:, 0] - 40.0, points[:, 1] + 10.0) < 12.0
    points[at, 2] -= 2.0
    found = compare(replace(surface, points_mm=points), NominalSurface("plate.stl", plate), 5.0, HERE, errors)
    off = found.deviation
    assert found.warnings == ()
    assert np.median(off.deviation_mm[at]) > 1.5
    assert (np.abs(off.deviation_mm[at]) > 2.0 * off.sigma_mm[at]).mean() > 0.9


def test_the_frames_sigma_grows_from_the_first_scan_on_and_keeps_what_is_near_by(errors: JointErrors) -> None:
    # In the frame of the first scan: its place does not move.
    first = errors.follow[:6]
    of_first = replace(errors, follow=errors.follow - np.tile(first, (len(SCANS_MM), 1)))
    surface = with_sigma_in_frame(measured(errors, 0.0), of_first)
    assert surface.shares is not None
    np.testing.assert_array_equal(surface.beside_mm, np.float32(NOISE_MM))
    scan = surface.first_scan
    assert scan is not None
    by_scan = [float(np.median(surface.sigma_mm[scan == k])) for k in range(len(SCANS_MM))]
    assert by_scan[0] < 0.03
    assert by_scan[-1] > 10.0 * by_scan[0]
    total = surface.shares.beside_mm**2 + surface.shares.place_mm**2 + surface.shares.bending_mm**2
    np.testing.assert_allclose(surface.sigma_mm**2, total, rtol=1e-5)
