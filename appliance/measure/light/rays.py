"""The ray lattice: every pixel's water ray as a point on the mid-volume plane and a slope, in float32.

With the plane in the middle of the volume, float32 is accurate to 0.013 µm, with origins at the port only to 0.3 µm.
Rays vary smoothly, so a lattice every few pixels with bilinear interpolation suffices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera

LATTICE_NODES_ACROSS = 400
"""Nodes across the image: every 4 px of 1600; the interpolation error grows with the square of their angle."""

LEAST_TOWARDS = 1e-3
"""Least component of a ray's direction across the plane."""


@dataclass(frozen=True, slots=True)
class RayLattice:
    """Rays (x, y) = (x0, y0) + (sx, sy)·(z − plane_z_mm), left camera frame."""

    plane_z_mm: float
    step_px: int
    nodes: NDArray[np.float32]
    """Shape (rows, columns, 4) float32: x0, y0 in mm, sx, sy; node (j, i) belongs to pixel (i·step, j·step)."""


def usual_step_px(camera: HousedCamera) -> int:
    """Return the distance of the nodes for a camera's width."""
    return max(1, camera.width_px // LATTICE_NODES_ACROSS)


def ray_lattice(
    camera: HousedCamera, water_index: float, plane_z_mm: float, step_px: int | None = None, *, partial: bool = False
) -> RayLattice:
    """Trace the lattice of one camera, every ``step_px`` px or as its width needs it.

    Two lattices that are used together have equal steps. If a ray is parallel to the plane or away from it: raises
    ValueError, or gives NaN if the lattice may be ``partial``.
    """
    step_px = step_px or usual_step_px(camera)
    columns = (camera.width_px - 1) // step_px + 2
    rows = (camera.height_px - 1) // step_px + 2
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64) * step_px
    origin, direction = camera.rays(np.stack([u, v], -1), water_index)
    if partial:
        with np.errstate(invalid="ignore"):
            direction[direction[..., 2] < LEAST_TOWARDS] = np.nan
    elif float(np.min(direction[..., 2])) < LEAST_TOWARDS:
        raise ValueError("a ray runs parallel to the mid-volume plane; check the calibration's relative orientation")
    # The intersection of each ray with the plane in the middle of the volume.
    slope = direction[..., :2] / direction[..., 2:]
    start = origin[..., :2] + slope * (plane_z_mm - origin[..., 2:])
    nodes = np.ascontiguousarray(np.concatenate([start, slope], -1), np.float32)
    return RayLattice(plane_z_mm, step_px, nodes)
