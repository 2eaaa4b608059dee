"""Rotations: from a rotation vector to a matrix and back, and to the immutable value in a camera."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import Matrix3

Array = NDArray[np.float64]


def rotation_matrix(vector_rad: Array) -> Array:
    """Return the rotation matrix (3, 3) about the direction of ``vector_rad`` (3,), by its length in rad.

    A vector of length 0 gives the identity.
    """
    angle = float(np.linalg.norm(vector_rad))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector_rad / angle
    # Rodrigues: R = I + sin θ K + (1 − cos θ) K², where K a = (x, y, z) × a.
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K)


def rotation_vector(rotation: Array) -> Array:
    """Return the vector (3,), rad, of a rotation matrix, for rotations of less than 180°."""
    axis = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = float(np.linalg.norm(axis)), 0.5 * (float(np.trace(rotation)) - 1.0)
    return axis if sine < 1e-12 else np.asarray(axis / sine * np.arctan2(sine, cosine))


def matrix3(matrix: Array) -> Matrix3:
    """Return a rotation matrix (3, 3) as the immutable value that a ``HousedCamera`` keeps."""
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return a, b, c
