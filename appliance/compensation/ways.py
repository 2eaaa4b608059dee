"""Owns the ways of one camera's pixels: where a point that the reference shows is in each frame, and what phase it has there.

Both follow exactly from the motion at nodes a twentieth of the image apart, at three depths; between nodes they are linear,
in inverse depth a parabola. The depth of a pixel follows from its pattern column by the same nodes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appliance.compensation.eyes import bare
from appliance.compensation.hand import LEVER_MM
from appliance.optics.model import HousedCamera

Array = NDArray[np.float64]

NODES_ACROSS = 20
NEAR_MM, FAR_MM = 420.0, 640.0
"""Depths of t = −1 and 1; t is linear in inverse depth."""
P_OF_T, Q_OF_T, FIRST_WAY = 0, 3, 6
PER_FRAME = 9
"""u, v and phase in turns, three coefficients each."""


class Ways(NamedTuple):
    """Parabolas in t at nodes."""

    nodes: NDArray[np.float32]
    """(rows, columns, FIRST_WAY + PER_FRAME · frames) float32."""
    step_px: int


def ways(
    camera: HousedCamera,
    projector: HousedCamera,
    water_index: float,
    motion_mm: Array,
    centre_mm: Array,
    directions: tuple[int, ...],
    period_px: float,
) -> Ways:
    """For frames with ``motion_mm`` (n, 6) against the reference, that vary along ``directions`` (0: p, 1: q) each."""
    step_px = -(-camera.width_px // NODES_ACROSS)
    columns = (camera.width_px - 1) // step_px + 2
    rows = (camera.height_px - 1) // step_px + 2
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64) * step_px
    at_px = np.stack([u, v], -1)
    origin, direction = camera.rays(at_px, water_index)
    inverse = 0.5 * np.array([2.0 / NEAR_MM, 1.0 / NEAR_MM + 1.0 / FAR_MM, 2.0 / FAR_MM])
    points = np.stack([origin + direction * ((1.0 / k - origin[..., 2:]) / direction[..., 2:]) for k in inverse])
    shown = projector.project(points, water_index)
    table = [_parabola(shown[..., 0]), _parabola(shown[..., 1])]
    eye = bare(camera)
    at_rest = eye.project(points, water_index)
    for motion, axis in zip(motion_mm, directions, strict=True):
        moved = points + motion[:3] + np.cross(motion[3:] / LEVER_MM, points - centre_mm)
        way = eye.project(moved, water_index) - at_rest
        phase = (projector.project(moved, water_index)[..., axis] - shown[..., axis]) / period_px
        table += [_parabola(way[..., 0]), _parabola(way[..., 1]), _parabola(phase)]
    return Ways(np.ascontiguousarray(np.concatenate(table, -1), np.float32), step_px)


def _parabola(values: Array) -> Array:
    """Coefficients (..., 3) through the values (3, ...) at t = −1, 0, 1."""
    below, middle, above = values
    return np.stack([middle, 0.5 * (above - below), 0.5 * (above + below) - middle], -1)
