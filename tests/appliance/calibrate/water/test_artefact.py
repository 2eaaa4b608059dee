"""An artefact at its unknown place: where rays meet it and each other, what its certificate adds, and what does not look like it."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibrate.water.artefact import BarPose, PlanePose, first_pose, fit_sphere, nearest_points
from appliance.measure.calibration.design import design_calibration
from tests.support.calibrating import SMALL
from tests.support.truth import WATER

Array = NDArray[np.float64]
RIG = design_calibration(SMALL, "KF", 400, 300, WATER).rig
CENTRES = np.array([[-60.0, -10.0, 500.0], [70.0, 20.0, 540.0]])
LENGTH_MM = float(np.linalg.norm(CENTRES[1] - CENTRES[0]))
BAR = BarPose(CENTRES, 20.0, 0.01, LENGTH_MM, 0.005)


def rays_to(targets: Array) -> tuple[Array, Array]:
    """From a place beside the instrument's origin to each target: starts and unit directions."""
    start = np.broadcast_to([5.0, -3.0, 30.0], targets.shape)
    way = targets - start
    return start, way / np.linalg.norm(way, axis=1, keepdims=True)


def test_a_ray_meets_the_near_side_of_its_own_ball_and_a_ray_that_misses_comes_as_near_as_it_can() -> None:
    rng = np.random.default_rng(1)
    ball = np.repeat([0, 1], 50)
    origin, direction = rays_to(CENTRES[ball] + rng.uniform(-11.0, 11.0, (100, 3)))
    points = BAR.intersect(origin, direction, ball, np.zeros(8))
    away = points - CENTRES[ball]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 20.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(points - origin, direction), 0.0, atol=1e-9)
    assert (np.sum(away * direction, 1) < 0.0).all(), "the side that faces where the ray comes from"
    # Beside the ball, at 30 mm from its centre: the foot of the perpendicular.
    origin, direction = rays_to(np.add(CENTRES[:1], [30.0, 0.0, 0.0]))
    (missed,) = BAR.intersect(origin, direction, np.array([0]), np.zeros(8))
    assert (missed - CENTRES[0]) @ direction[0] == pytest.approx(0.0, abs=1e-9)


def test_a_certificate_is_an_observation_in_its_own_standard_deviations() -> None:
    residual, _ = BAR.certificate(np.zeros(8))
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)
    along = (CENTRES[1] - CENTRES[0]) / LENGTH_MM
    residual, _ = BAR.certificate(np.array([*(-0.01 * along), *(0.02 * along), 0.03, -0.01]))
    assert residual == pytest.approx([0.03 / 0.005, 3.0, -1.0], rel=1e-6)
    x = np.random.default_rng(2).normal(0.0, 0.2, 8)
    _, jacobian = BAR.certificate(x)
    steps = 1e-6 * np.eye(8)
    by_difference = np.stack([(BAR.certificate(x + e)[0] - BAR.certificate(x - e)[0]) / 2e-6 for e in steps], -1)
    np.testing.assert_allclose(jacobian, by_difference, atol=1e-4)
    assert BAR.steps.shape == x.shape, "one step for each unknown"


def test_a_plane_leans_along_its_axes_and_goes_along_its_normal() -> None:
    place = PlanePose(np.array([0.0, 0.0, 1.0]), np.eye(3)[:2], 500.0)
    targets = np.array([[40.0, 0.0, 500.0], [0.0, -30.0, 500.0], [0.0, 0.0, 500.0]])
    origin, direction = rays_to(targets)
    ball = np.zeros(3, np.intp)
    np.testing.assert_allclose(place.intersect(origin, direction, ball, np.zeros(3)), targets, atol=1e-9)
    for lean in ((0.02, 0.0, 0.0), (0.0, -0.03, 0.0), (0.01, 0.02, 3.0)):
        points = place.intersect(origin, direction, ball, np.array(lean))
        normal = np.array([lean[0], lean[1], 1.0]) / np.linalg.norm([lean[0], lean[1], 1.0])
        np.testing.assert_allclose(points @ normal, 500.0 + lean[2], atol=1e-9)
    residual, jacobian = place.certificate(np.zeros(3))
    assert (residual.shape, jacobian.shape) == ((0,), (0, 3))
    assert place.steps.shape == (3,)


def bar_recording(length_mm: float | None = LENGTH_MM, widest_cos: float = 0.2) -> Recording:
    """A bar as the drawing sees it; its balls down to where the view meets them at a cosine of ``widest_cos``."""
    rng = np.random.default_rng(3)
    n = 400
    ball = np.repeat([0, 1], n)
    cos, turn = rng.uniform(widest_cos, 1.0, 2 * n), rng.uniform(0.0, 2.0 * np.pi, 2 * n)
    sin = np.sqrt(1.0 - cos**2)
    points = CENTRES[ball] + 20.0 * np.column_stack([sin * np.cos(turn), sin * np.sin(turn), -cos])
    left, right = (camera.project(points, WATER.index) for camera in (RIG.left, RIG.right))
    radius = 20.0 if length_mm is not None else None
    return Recording("bar", ArtefactKind.BALL_BAR, left, right, WATER, ball, length_mm=length_mm, radius_mm=radius)


def test_a_bar_is_first_put_where_its_balls_are_and_loses_what_a_camera_sees_at_a_grazing_angle() -> None:
    recording = bar_recording()
    place, used = first_pose(recording, RIG)
    assert isinstance(place, BarPose)
    np.testing.assert_allclose(place.centres_mm, CENTRES, atol=0.02)
    assert (place.radius_mm, place.length_mm) == (20.0, LENGTH_MM)
    ahead = RIG.left.rays(used.left_px, WATER.index)
    away = place.intersect(*ahead, used.sphere, np.zeros(8)) - CENTRES[used.sphere]
    for camera in (RIG.left, RIG.right):
        sight = np.asarray(camera.translation_mm) - (CENTRES[used.sphere] + away)
        cos = np.sum(away * sight, 1) / 20.0 / np.linalg.norm(sight, axis=1)
        assert cos.min() > 0.39
    assert 0.5 * len(recording.left_px) < len(used.left_px) < 0.95 * len(recording.left_px)


@pytest.mark.parametrize(("share", "taken"), [(1.08, True), (0.92, True), (1.13, False), (0.88, False)])
def test_a_length_that_is_ten_percent_off_is_another_bars(share: float, taken: bool) -> None:
    with nullcontext() if taken else pytest.raises(RecordingError, match=rf"bar: .* {LENGTH_MM:.1f} mm"):
        first_pose(bar_recording(LENGTH_MM / share), RIG)


def test_a_plane_is_first_put_where_its_points_are() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(-60.0, 60.0, (200, 2))
    points = np.column_stack([xy, 520.0 + 0.2 * xy[:, 0] - 0.1 * xy[:, 1]])
    left, right = (camera.project(points, WATER.index) for camera in (RIG.left, RIG.right))
    plane = Recording("plane", ArtefactKind.PLANE, left, right, WATER, np.zeros(200, np.intp))
    place, used = first_pose(plane, RIG)
    assert isinstance(place, PlanePose)
    assert used is plane
    wanted = np.array([-0.2, 0.1, 1.0]) / np.linalg.norm([-0.2, 0.1, 1.0])
    np.testing.assert_allclose(place.normal, wanted, atol=1e-6)
    assert place.offset_mm == pytest.approx(520.0 * wanted[2], abs=1e-3)
    np.testing.assert_allclose(
        np.stack([*place.axes, place.normal]) @ np.stack([*place.axes, place.normal]).T, np.eye(3), atol=1e-9
    )


CENTRE = np.array([30.0, -20.0, 510.0])


def face(radius_mm: float, half_deg: float, n: int = 400, noise_mm: float = 0.0, seed: int = 1) -> Array:
    """Points of the part of a sphere about CENTRE that looks at the instrument; errors stand on the surface."""
    rng = np.random.default_rng(seed)
    cos, turn = rng.uniform(np.cos(np.radians(half_deg)), 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    sin = np.sqrt(1.0 - cos**2)
    normal = np.column_stack([sin * np.cos(turn), sin * np.sin(turn), -cos])
    return np.asarray(CENTRE + (radius_mm + noise_mm * rng.standard_normal((n, 1))) * normal)


def test_a_noisy_part_of_a_sphere_is_not_found_too_small() -> None:
    """The closed form, from which the search starts, shrinks it by more than its own scatter."""
    found = [fit_sphere(face(15.0, 45.0, 300, 0.1, seed)) for seed in range(40)]
    radii = np.array([radius for _, radius in found])
    assert radii.mean() == pytest.approx(15.0, abs=4.0 * radii.std() / np.sqrt(40) + 0.005)
    assert radii.std() < 0.1


def test_a_wrong_radius_is_kept_and_moves_the_centre_along_the_view() -> None:
    centre, radius = fit_sphere(face(15.0, 45.0), 15.5)
    assert radius == 15.5
    np.testing.assert_allclose(centre[:2], CENTRE[:2], atol=0.02)
    assert 0.4 < centre[2] - CENTRE[2] < 0.75, "the part that is seen stays where it is"
    # Least squares: what is left pulls the centre to no side.
    away = face(15.0, 45.0) - centre
    distance = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(((distance - radius) / distance) @ away, 0.0, atol=1e-7)


def test_rays_are_nearest_in_the_middle_between_them() -> None:
    p, q = np.array([[0.0, 0.0, 0.0], [-100.0, 0.0, 0.0]]), np.array([[0.0, 0.4, 0.0], [100.0, 0.0, 0.0]])
    a = np.array([[1.0, 0.0, 0.0], [0.2, 0.0, 1.0]])
    b = np.array([[0.6, 0.0, 0.8], [-0.2, 0.0, 1.0]])
    a, b = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (a, b))
    # Skew lines 0.4 mm apart over the origin; two rays that meet half a metre away.
    np.testing.assert_allclose(nearest_points(p, a, q, b), [[0.0, 0.2, 0.0], [0.0, 0.0, 500.0]], atol=1e-9)
    further = nearest_points(p + 70.0 * a, a, q - 30.0 * b, b)
    np.testing.assert_allclose(further, [[0.0, 0.2, 0.0], [0.0, 0.0, 500.0]], atol=1e-9)
