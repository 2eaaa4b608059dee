"""Planes and spheres through points whose place is known, and where rays pass each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.water.shapes import fit_sphere, nearest_points

Array = NDArray[np.float64]
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
