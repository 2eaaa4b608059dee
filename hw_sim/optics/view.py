"""The ground truth of an image: points, pattern coordinates, visibility, and the true surface."""

# Symbols in _look:
#   p         surface point in the rig's frame, h the same in the object's, n its unit normal
#   u, v      pattern coordinate; a, b pixel of the other camera
#   s         where the eye's ray leaves its port (object frame), v = s − h

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw_sim.objects.shapes import distances, gradient
from hw_sim.optics.geometry import Geometry, Lamp, Pose
from hw_sim.optics.shadow import into, shaded
from hw_sim.optics.table import look_up
from hw_sim.optics.trace import HEIGHT, WIDTH, pixel_ray

Array = NDArray[np.float64]

MOST_OBLIQUE_DEG = 75.0


@dataclass(frozen=True, slots=True)
class TrueView:
    """The ground truth of one camera's pixels."""

    points_rig_mm: Array
    """(h, w, 3), NaN where no surface is hit."""
    projector_px: Array
    """(h, w, 2): pattern coordinate (illuminated or not); NaN if no surface is hit or the point is far outside of the
    beam."""
    seen_by_all: NDArray[np.bool_]
    """(h, w): the surface point is in the field of both cameras and of the projector, occluded for none of them, and
    seen by none more obliquely than ``MOST_OBLIQUE_DEG``."""


def true_view(
    rays: Array, geometry: Geometry, pose: Pose, lamp: Lamp, second_eye: Array, second_table: Array
) -> TrueView:
    """Return the true view of the camera with ``rays`` (h, w, 6), together with the second camera."""
    h, w = rays.shape[:2]
    points = rays[..., :3] + rays[..., 3:] * geometry.distance_mm[..., None]
    pixels, seen_by_all = np.full((h, w, 2), np.nan), np.zeros((h, w), np.bool_)
    _look(
        pose.kind, pose.sizes, pose.R, pose.t, points, rays, second_eye, second_table, lamp.eye, lamp.table, pixels,
        seen_by_all,
    )  # fmt: skip
    return TrueView(points, pixels, seen_by_all)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _look(
    kind: int, sizes: Array, R: Array, t: Array, points: Array, rays: Array, second_eye: Array, second_table: Array,
    lamp: Array, lamp_table: Array, pixels: Array, seen_by_all: NDArray[np.bool_],
) -> None:  # fmt: skip
    limit = math.cos(math.radians(MOST_OBLIQUE_DEG))
    for y in range(points.shape[0]):
        for x in range(points.shape[1]):
            px, py, pz = points[y, x, 0], points[y, x, 1], points[y, x, 2]
            if math.isnan(px):
                continue
            # Both other eyes must have the point in their pictures.
            u, v = look_up(lamp, lamp_table, px, py, pz)
            if u < -1e5:
                continue
            pixels[y, x, 0], pixels[y, x, 1] = u, v
            if not (0.0 <= u <= lamp[WIDTH] - 1.0 and 0.0 <= v <= lamp[HEIGHT] - 1.0):
                continue
            a, b = look_up(second_eye, second_table, px, py, pz)
            if not (0.0 <= a <= second_eye[WIDTH] - 1.0 and 0.0 <= b <= second_eye[HEIGHT] - 1.0):
                continue
            hx, hy, hz = into(R, px - t[0], py - t[1], pz - t[2])
            nx, ny, nz = gradient(kind, sizes, hx, hy, hz)
            norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
            nx, ny, nz = nx / norm, ny / norm, nz / norm
            good = True
            # This camera, the other one, the projector: no view may be too oblique or occluded.
            for which in range(3):
                ox, oy, oz = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
                if which == 1:
                    ox, oy, oz, _dx, _dy, _dz = pixel_ray(second_eye, a, b)
                elif which == 2:
                    ox, oy, oz, _dx, _dy, _dz = pixel_ray(lamp, u, v)
                sx, sy, sz = into(R, ox - t[0], oy - t[1], oz - t[2])
                vx, vy, vz = sx - hx, sy - hy, sz - hz
                facing = (vx * nx + vy * ny + vz * nz) / math.sqrt(vx * vx + vy * vy + vz * vz)
                if facing < limit or (which > 0 and shaded(kind, sizes, hx, hy, hz, nx, ny, nz, sx, sy, sz)):
                    good = False
                    break
            seen_by_all[y, x] = good


class Surface:
    """The true surface at a moment, for measuring distances."""

    def __init__(self, pose: Pose) -> None:
        self._pose = pose

    def distance_mm(self, points_rig_mm: ArrayLike) -> NDArray[np.float64]:
        """Return signed distances (n,) float64 of rig points (n, 3), outside positive; exact near the surface."""
        points = np.reshape(np.asarray(points_rig_mm, np.float64), (-1, 3))
        out = np.empty(len(points))
        pose = self._pose
        distances(pose.kind, pose.sizes, np.ascontiguousarray((points - pose.t) @ pose.R), out)
        return out
