"""A rotation vector and its matrix."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from appliance.optics.rotation import matrix3, rotation_matrix


@pytest.mark.parametrize("vector_rad", [(0.0, 0.0, 0.0), (1e-9, 0.0, 0.0), (0.3, -0.2, 0.9), (0.0, math.pi, 0.0)])
def test_a_rotation_vector_turns_about_its_direction_by_its_length(vector_rad: tuple[float, float, float]) -> None:
    vector = np.array(vector_rad)
    R = rotation_matrix(vector)
    np.testing.assert_allclose(R, cv2.Rodrigues(vector)[0], atol=1e-14)
    np.testing.assert_allclose(R @ vector, vector, atol=1e-14)
    np.testing.assert_array_equal(np.array(matrix3(R)), R)
