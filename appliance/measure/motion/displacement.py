"""Owns where the scene's points go in a picture when the scene moves: exactly at nodes, and linearised at single points.

A **displacement field** says, for every pixel of one camera and every frame, how far from the pixel the point lies that the
pixel shows at the reference time, and by how much of a period its phase changed. Both follow exactly from the motion at nodes a
twentieth of the image apart, at three depths; between nodes the field is bilinear, and in depth a parabola in

    t = linear in 1/z, −1 at ``NEAR_MM`` and 1 at ``FAR_MM`` of the standard housing.

The depth of a pixel follows from its pattern column p by the same nodes: p is a parabola in t, too.

Grey values between pixels are read with the cubic B-spline, which does not pass through them: it sees a spot of 0.6 px (σ)
wherever it is read. Sharper kernels see a border of albedo differently by where between pixels it lies, and of four sine images
in which it lies differently they make a wrong phase.
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
_NAN, _HALF, _ONE = np.float32(np.nan), np.float32(0.5), np.float32(1.0)
_SIXTH, _TWO_THIRDS = np.float32(1.0 / 6.0), np.float32(2.0 / 3.0)


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


# Legend of the kernels:
#   c            coefficients of all parabolas at one pixel; c[k], c[k + 1], c[k + 2] are those of t⁰, t¹, t²
#   u, v         place in the picture, px; i, j the pixel up to the left of it; s, r the rest in 0 … 1
#   a0 … a3      weights of the four columns i − 1 … i + 2; b0 … b3 those of the rows


@numba.njit(nogil=True, cache=True, error_model="numpy")
def parabola_at(c: NDArray[np.float32], k: int, t: np.float32) -> np.float32:
    """Return the value at ``t`` of the parabola whose coefficients begin at place ``k``."""
    return np.float32(c[k] + t * (c[k + 1] + t * c[k + 2]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def interpolate_row(nodes: NDArray[np.float32], step: int, row: int, at_row: NDArray[np.float32]) -> None:
    """Write the nodes of a row of pixels, between those above and below it, into ``at_row`` (columns, coefficients)."""
    j = row // step
    share = np.float32((row - j * step) / step)
    for i in range(nodes.shape[1]):
        for k in range(nodes.shape[2]):
            at_row[i, k] = nodes[j, i, k] + share * (nodes[j + 1, i, k] - nodes[j, i, k])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def interpolate_pixel(at_row: NDArray[np.float32], step: int, x: int, first: int, c: NDArray[np.float32]) -> None:
    """Write the coefficients from place ``first`` on of the pixel in column ``x``, between its row's nodes, into all of ``c``."""
    i = x // step
    share = np.float32((x - i * step) / step)
    for k in range(c.size):
        c[k] = at_row[i, first + k] + share * (at_row[i + 1, first + k] - at_row[i, first + k])


@numba.njit(nogil=True, cache=True, error_model="numpy")
def spline_weights(s: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Return the cubic B-spline's weights of the pixels at −1, 0, 1, 2 for a place ``s`` in 0 … 1."""
    r = _ONE - s
    a0, a3 = _SIXTH * r * r * r, _SIXTH * s * s * s
    a1 = _TWO_THIRDS - s * s * (_ONE - _HALF * s)
    return a0, a1, _ONE - a0 - a1 - a3, a3


@numba.njit(nogil=True, cache=True, error_model="numpy")
def read_spline(pixels: NDArray[np.uint8], start: int, width: int, u: np.float32, v: np.float32) -> np.float32:
    """Return the grey value at (u, v), at least 1 px inside, of the picture that begins at ``start``; NaN where it is saturated.

    ``pixels`` are all pictures of a sequence in one row, each ``width`` px wide.
    """
    i, j = int(u), int(v)
    s, r = u - np.float32(i), v - np.float32(j)
    a0, a1, a2, a3 = spline_weights(s)
    b0, b1, b2, b3 = spline_weights(r)
    value = np.float32(0.0)
    # Unsigned, for of an index that may be negative numba asks each time whether it is.
    at, stride = np.uint64(start + (j - 1) * width + i - 1), np.uint64(width)
    for m in range(4):
        b = b0 if m == 0 else (b1 if m == 1 else (b2 if m == 2 else b3))
        value += b * (
            a0 * np.float32(pixels[at])
            + a1 * np.float32(pixels[at + np.uint64(1)])
            + a2 * np.float32(pixels[at + np.uint64(2)])
            + a3 * np.float32(pixels[at + np.uint64(3)])
        )
        at += stride
    # Of the sixteen pixels the nearest one decides whether light was cut off.
    nearest = np.uint64(start + (j + int(r > _HALF)) * width + i + int(s > _HALF))
    return value if pixels[nearest] != np.uint8(255) else _NAN


@numba.njit(nogil=True, cache=True, error_model="numpy")
def spline_noise_share(u: np.float32, v: np.float32) -> np.float32:
    """Return the variance of what ``read_spline`` reads at (u, v), as a share of one pixel's: Σ a² · Σ b² of the weights."""
    a0, a1, a2, a3 = spline_weights(u - np.floor(u))
    b0, b1, b2, b3 = spline_weights(v - np.floor(v))
    return np.float32((a0 * a0 + a1 * a1 + a2 * a2 + a3 * a3) * (b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3))
