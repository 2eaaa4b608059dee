"""Shadows: points of an object that its other parts hide from the projector.

A map of the lengths of the projector's rays decides for most points; where it is uncertain, near the edges of shadows,
the point's ray is traced.
"""

# Symbols:
#   kind, sizes   the object, see objects.shapes; R, t its pose: p_rig = R p_object + t
#   o, d          origin and unit direction of a ray in the object's frame
#   u, v          pattern coordinate; a, b, i, j, s, t the same in steps of the map, its whole part and the rest
#   n, s          in shaded: unit normal, and the point that the light comes from

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.shapes import RADIUS, SOFT, VARIED, implicit, march

Array = NDArray[np.float64]

STEP_PX, MARGIN_PX = 2, 4
"""The map's rays start at pattern coordinate −MARGIN_PX and are STEP_PX apart."""
SURE_MM = 0.05
"""Largest difference between a point's distance and the map's of an illuminated point."""
EDGE_MM = 3.0
"""Largest step of the map within a few rays at which it is reliable."""
LIFT_MM = 0.02
"""Shadow rays start this far above the surface, so that its own roundoff does not shade it."""
BLOCK_PX = 8


def map_pixels(width_px: int, height_px: int) -> Array:
    """Return the pattern coordinates (rows, columns, 2) float64 of the map's rays."""
    u = np.arange(-MARGIN_PX, width_px + MARGIN_PX + 1, STEP_PX, dtype=np.float64)
    v = np.arange(-MARGIN_PX, height_px + MARGIN_PX + 1, STEP_PX, dtype=np.float64)
    return np.stack(np.meshgrid(u, v), -1)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def nearest(coordinate: float) -> int:
    """Return the row or column of the map next to a pattern coordinate."""
    return int((coordinate + MARGIN_PX) * (1.0 / STEP_PX) + 0.5)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def into(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return Rᵀ v: a direction of the rig frame in the object frame."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def block_start(kind: int, sizes: Array, R: Array, t: Array, rays: Array, y0: int, y1: int, x0: int, x1: int) -> float:
    """Return the length, mm, that all rays of a block (rows y0..y1, columns x0..x1) are free of the object.

    The middle ray marches with the radius of the bundle around it. NaN if no ray of the block meets the object.
    """
    middle = rays[(y0 + y1) // 2, (x0 + x1) // 2]
    # The bundle: distance of its corner rays from the middle one at the start, and its growth per mm.
    apart, widening = 0.0, 0.0
    for k in range(4):
        corner = rays[(y0, y0, y1, y1)[k], (x0, x1, x0, x1)[k]]
        a, b = 0.0, 0.0
        for i in range(3):
            a += (corner[i] - middle[i]) ** 2
            b += (corner[i + 3] - middle[i + 3]) ** 2
        apart, widening = max(apart, math.sqrt(a)), max(widening, math.sqrt(b))
    apart, widening = 1.02 * apart + 1e-3, 1.02 * widening
    # Where the bundle enters and leaves the ball around the object: |o + s d|² = reach², a quadratic in s.
    ox, oy, oz = into(R, middle[0] - t[0], middle[1] - t[1], middle[2] - t[2])
    dx, dy, dz = into(R, middle[3], middle[4], middle[5])
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz
    reach = RADIUS[kind] + apart + widening * (RADIUS[kind] - b)
    if kind >= VARIED:
        reach += abs(sizes[SOFT])
    inside = b * b - c + reach * reach
    if inside <= 0.0:
        return math.nan
    length, end = max(0.0, -b - math.sqrt(inside)), -b + math.sqrt(inside)
    for _ in range(200):
        # Sphere tracing with a ball that is smaller by the bundle's radius at this length.
        free = implicit(kind, sizes, ox + length * dx, oy + length * dy, oz + length * dz) - apart - widening * length
        if free < 0.05:
            return length
        length += free / (1.0 + widening)
        if length > end:
            return math.nan
    return length


@numba.njit(nogil=True, cache=True, error_model="numpy")
def shaded(
    kind: int, sizes: Array, x: float, y: float, z: float,
    nx: float, ny: float, nz: float, sx: float, sy: float, sz: float,
) -> bool:  # fmt: skip
    """Return True if the object lies between its surface point (unit normal n) and the point s.

    Both are in the object frame.
    """
    x, y, z = x + LIFT_MM * nx, y + LIFT_MM * ny, z + LIFT_MM * nz
    dx, dy, dz = sx - x, sy - y, sz - z
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    return not math.isnan(march(kind, sizes, x, y, z, dx / length, dy / length, dz / length, 0.0, length))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def shadow_map(kind: int, sizes: Array, R: Array, t: Array, rays: Array, out: NDArray[np.float32]) -> None:
    """Fill ``out`` (rows, columns) with the length, mm, of each ray from the port to the object.

    ``rays``: (rows, columns, 6). NaN if it misses.
    """
    rows, columns = out.shape
    for y0 in range(0, rows, BLOCK_PX):
        y1 = min(y0 + BLOCK_PX, rows)
        for x0 in range(0, columns, BLOCK_PX):
            x1 = min(x0 + BLOCK_PX, columns)
            start = block_start(kind, sizes, R, t, rays, y0, y1 - 1, x0, x1 - 1)
            for y in range(y0, y1):
                for x in range(x0, x1):
                    out[y, x] = math.nan
                    if not math.isnan(start):
                        ray = rays[y, x]
                        ox, oy, oz = into(R, ray[0] - t[0], ray[1] - t[1], ray[2] - t[2])
                        dx, dy, dz = into(R, ray[3], ray[4], ray[5])
                        out[y, x] = march(kind, sizes, ox, oy, oz, dx, dy, dz, start, 1e4)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def by_map(first: NDArray[np.float32], u: float, v: float, length: float) -> int:
    """Return 1 if the point at pattern coordinate (u, v) is illuminated, −1 in shadow, 0 if uncertain.

    ``length``: mm from the port.
    """
    a, b = (u + MARGIN_PX) / STEP_PX, (v + MARGIN_PX) / STEP_PX
    i, j = int(a), int(b)
    if i < 1 or j < 1 or i > first.shape[1] - 3 or j > first.shape[0] - 3:
        return 0
    s, t = a - i, b - j
    # Four by four rays around: the edge of a shadow among them makes the result uncertain.
    nearest_mm, farthest_mm = 1e9, -1e9
    for m in range(-1, 3):
        for n in range(-1, 3):
            d = first[j + m, i + n]
            if math.isnan(d):
                return 0
            nearest_mm, farthest_mm = min(nearest_mm, d), max(farthest_mm, d)
    if farthest_mm < length - EDGE_MM:
        return -1
    if farthest_mm - nearest_mm > 2.0 * EDGE_MM:
        return 0
    # Bilinear between the four rays around: the exact length of the light there.
    exact_mm = (first[j, i] * (1.0 - s) + first[j, i + 1] * s) * (1.0 - t) + (
        first[j + 1, i] * (1.0 - s) + first[j + 1, i + 1] * s
    ) * t
    return 1 if abs(exact_mm - length) < SURE_MM else 0
