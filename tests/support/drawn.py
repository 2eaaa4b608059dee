"""Owns the drawings of simulated objects: triangles of their surfaces, from the simulated world's own implicit functions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage import measure

from hw_sim.objects import shapes
from tests.support.views import SIZES

Array = NDArray[np.float64]


def drawing(
    name: str, low_mm: tuple[float, float, float], high_mm: tuple[float, float, float], voxel_mm: float = 1.0
) -> tuple[Array, NDArray[np.int64]]:
    """Triangles of an object's surface inside of a box of its frame: vertices (v, 3) mm, on the surface, and faces (m, 3)."""
    axes = [np.arange(low, high + voxel_mm, voxel_mm) for low, high in zip(low_mm, high_mm, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    value = np.empty(grid.shape[:3])
    shapes.values(shapes.NAMES[name], SIZES, grid.reshape(-1, 3), value.reshape(-1))
    cut: Any = measure.marching_cubes
    vertices, faces, _, _ = cut(value, 0.0, spacing=(voxel_mm,) * 3, gradient_direction="descent")
    vertices = vertices.astype(np.float64) + np.array(low_mm)
    # The cubes interpolate linearly; two steps along the function's slope bring each vertex onto the surface.
    for _ in range(2):
        slope, off = np.empty_like(vertices), np.empty(len(vertices))
        shapes.values(shapes.NAMES[name], SIZES, vertices, off)
        for axis in range(3):
            for sign in (1e-3, -1e-3):
                moved, there = vertices.copy(), np.empty(len(vertices))
                moved[:, axis] += sign
                shapes.values(shapes.NAMES[name], SIZES, moved, there)
                slope[:, axis] = there if sign > 0 else (slope[:, axis] - there) / 2e-3
        vertices -= slope * (off / np.maximum((slope**2).sum(1), 1e-9))[:, None]
    return vertices, faces.astype(np.int64)
