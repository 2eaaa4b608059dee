"""Owns where the scene's points go in a picture when the scene moves: exactly at nodes, and linearised at single
points.

A **displacement field** says, for every pixel of one camera and every frame, how far from the pixel the point lies that
the pixel shows at the reference time, and by how much of a period its phase changed. Both follow exactly from the
motion at nodes a twentieth of the image apart, at three depths; between nodes the field is bilinear, and in depth a
parabola in

    t = linear in 1/z, −1 at ``NEAR_MM`` and 1 at ``FAR_MM`` of the standard housing.

The depth of a pixel follows from its pattern column p by the same nodes: p is a parabola in t, too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.motion.prior import LEVER_MM

Array = NDArray[np.float64]

NODES_ACROSS = 20
NEAR_MM, FAR_MM = 420.0, 640.0
"""Depths of t = −1 and 1 in the standard housing."""
P_OF_T, Q_OF_T, FIRST_FRAME = 0, 3, 6
"""Places of a node's coefficients: the parabolas of p and q, then those of the frames, one after the other."""
FRAME_COEFFICIENTS = 9
"""Each frame has three parabolas: displacement in u (px), in v (px), and change of phase (turns)."""
OF_V, OF_PHASE = 3, 6
"""Places of the second and third parabola of a frame."""
_STEP_MM = 0.5
"""Half the way over which a derivative is taken."""


class DisplacementField(NamedTuple):
    """Parabolas in t at the nodes of one camera's image."""

    nodes: NDArray[np.float32]
    """(rows, columns, FIRST_FRAME + FRAME_COEFFICIENTS · frames) float32."""
    step_px: int
    """Distance of neighbouring nodes."""


def displacement_field(
    camera: HousedCamera,
    projector: HousedCamera,
    water_index: float,
    motion_mm: Array,
    centre_mm: Array,
    directions: tuple[int, ...],
    period_px: float,
    volume: WorkingVolume = STANDARD,
) -> DisplacementField:
    """Return the field of n frames whose scene is displaced by ``motion_mm`` (n, 6) against the reference time.

    ``directions`` (n) says along which pattern coordinate each frame varies (0: p, 1: q): that of its phase.
    """
    step_px = -(-camera.width_px // NODES_ACROSS)
    columns = (camera.width_px - 1) // step_px + 2
    rows = (camera.height_px - 1) // step_px + 2
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64) * step_px
    origin, direction = camera.rays(np.stack([u, v], -1), water_index)
    near_mm, far_mm = volume.scaled(NEAR_MM), volume.scaled(FAR_MM)
    inverse = 0.5 * np.array([2.0 / near_mm, 1.0 / near_mm + 1.0 / far_mm, 2.0 / far_mm])
    points = np.stack([origin + direction * ((1.0 / k - origin[..., 2:]) / direction[..., 2:]) for k in inverse])
    shown = projector.project(points, water_index)
    table = [_parabola(shown[..., 0]), _parabola(shown[..., 1])]
    plain = without_corrections(camera)
    at_rest = plain.project(points, water_index)
    for motion, axis in zip(motion_mm, directions, strict=True):
        # X + d + ω × (X − c), with the turn ω in rad.
        moved = points + motion[:3] + np.cross(motion[3:] / LEVER_MM, points - centre_mm)
        way = plain.project(moved, water_index) - at_rest
        phase = (projector.project(moved, water_index)[..., axis] - shown[..., axis]) / period_px
        table += [_parabola(way[..., 0]), _parabola(way[..., 1]), _parabola(phase)]
    return DisplacementField(np.ascontiguousarray(np.concatenate(table, -1), np.float32), step_px)


def _parabola(values: Array) -> Array:
    """Return the coefficients (..., 3) of the parabola through the values (3, ...) at t = −1, 0, 1."""
    below, middle, above = values
    return np.stack([middle, 0.5 * (above - below), 0.5 * (above + below) - middle], -1)


class ProjectedPoints(NamedTuple):
    """n points as one camera (or the projector) sees them, and how their pixels change when they move by d (3,) mm:

        u(X + d) = u(X) + J d / (1 + e·d)

    exact for a pinhole, and behind a port within some hundredths of a pixel over the 20 mm that a scan can move.
    """

    px: Array
    """(n, 2); NaN for points that cannot be seen."""
    jacobian: Array
    """J (n, 2, 3) px/mm."""
    inverse_depth_gradient: Array
    """e (n, 3) 1/mm: the optical axis divided by the point's distance along it."""


def linearise(camera: HousedCamera, water_index: float, points_mm: Array) -> ProjectedPoints:
    """Project points (n, 3), given in the left camera frame, with the derivative by their place."""
    steps = np.concatenate([_STEP_MM * np.eye(3), -_STEP_MM * np.eye(3)])
    px = without_corrections(camera).project(points_mm[None] + steps[:, None], water_index)
    jacobian = np.moveaxis(px[:3] - px[3:], 0, -1) / (2.0 * _STEP_MM)
    axis = np.asarray(camera.rotation)[:, 2]
    distance_mm = (points_mm - np.asarray(camera.translation_mm)) @ axis
    return ProjectedPoints(
        camera.project(points_mm, water_index), np.ascontiguousarray(jacobian), axis / distance_mm[:, None]
    )


def without_corrections(camera: HousedCamera) -> HousedCamera:
    """Return the camera without what shifts its pixels smoothly beyond every formula.

    That changes a displacement or a derivative by a thousandth, and costs more than all the rest.
    """
    return replace(camera, correction=None, ray_shift=None)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def interpolate_row(nodes: NDArray[np.float32], step: int, row: int, at_row: NDArray[np.float32]) -> None:
    """Write the nodes of a row of pixels, between those above and below it, into ``at_row`` (columns, coefficients)."""
    j = row // step
    share = np.float32((row - j * step) / step)
    for i in range(nodes.shape[1]):
        for k in range(nodes.shape[2]):
            at_row[i, k] = nodes[j, i, k] + share * (nodes[j + 1, i, k] - nodes[j, i, k])
