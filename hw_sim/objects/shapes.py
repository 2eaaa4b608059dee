"""Owns the shapes: for each object an implicit function, negative inside, whose zero set is the surface.

Object frame, mm: the side that the instrument looks at faces −z. Away from the surface the function is a lower bound of
the distance, so that rays can march along it. The seven shapes are what a metrologist and a diver put before the rig.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLANE, BALLBAR, FRUSTUM, PIPE, SHELL, STONES = range(6)
NAMES = {"plane": PLANE, "ballbar": BALLBAR, "frustum": FRUSTUM, "pipe": PIPE, "shell": SHELL, "stones": STONES}
BOUND_MM = 165.0
"""Radius of a sphere around the origin that holds every object."""

BALL_RADIUS_MM = 20.0
BALL_DISTANCE_MM = 150.0
PIPE_RADIUS_MM, FLANGE_RADIUS_MM, WELD_RADIUS_MM = 45.0, 60.0, 4.0
FRUSTUM_BASE_MM, FRUSTUM_TOP_MM, FRUSTUM_HEIGHT_MM = 150.0, 80.0, 45.0

DEFAULT_POSE: dict[str, tuple[float, float, float, float, float, float]] = {
    "plane": (0.0, 0.0, 522.5, 8.0, 12.0, 0.0),
    "ballbar": (0.0, 0.0, 522.5, 0.0, 10.0, 15.0),
    "frustum": (0.0, 0.0, 545.0, 5.0, -8.0, 12.0),
    "pipe": (0.0, 0.0, 560.0, 0.0, 6.0, 20.0),
    "shell": (0.0, 0.0, 545.0, 6.0, 0.0, 10.0),
    "stones": (0.0, 0.0, 535.0, 0.0, 0.0, 0.0),
}


@numba.njit(nogil=True, cache=True)
def _box(x: float, y: float, z: float, a: float, b: float, c: float) -> float:
    dx, dy, dz = abs(x) - a, abs(y) - b, abs(z) - c
    ox, oy, oz = max(dx, 0.0), max(dy, 0.0), max(dz, 0.0)
    return math.sqrt(ox * ox + oy * oy + oz * oz) + min(max(dx, max(dy, dz)), 0.0)


@numba.njit(nogil=True, cache=True)
def _cylinder_x(x: float, y: float, z: float, radius: float, half_length: float) -> float:
    dr, dx = math.sqrt(y * y + z * z) - radius, abs(x) - half_length
    outer_r, outer_x = max(dr, 0.0), max(dx, 0.0)
    return math.sqrt(outer_r * outer_r + outer_x * outer_x) + min(max(dr, dx), 0.0)


@numba.njit(nogil=True, cache=True)
def _pipe(x: float, y: float, z: float) -> float:
    pipe = _cylinder_x(x, y, z, 45.0, 130.0)
    flange = _cylinder_x(x - 55.0, y, z, 60.0, 9.0)
    ring = math.sqrt(y * y + z * z) - 45.0
    weld = math.sqrt((x + 45.0) * (x + 45.0) + ring * ring) - 4.0
    return min(pipe, min(flange, weld))


@numba.njit(nogil=True, cache=True)
def _frustum(x: float, y: float, z: float) -> float:
    # Top at z = -45 (towards the instrument), base at z = 0, on a plate.
    slope = (150.0 - 80.0) / 2.0 / 45.0
    k = 1.0 / math.sqrt(1.0 + slope * slope)
    half = 75.0 + slope * z
    sides = max(abs(x) - half, abs(y) - half) * k
    body = max(sides, max(z, -45.0 - z))
    plate = _box(x, y, z - 4.0, 100.0, 85.0, 4.0)
    return min(body, plate)


@numba.njit(nogil=True, cache=True)
def _shell(x: float, y: float, z: float) -> float:
    # A ribbed, spiral-free dome like a fossil scallop lying on a slab: a height field over the (x, y) plane.
    if z < -46.0:
        return -41.0 - z  # in front of all of it: a bound is enough
    ry = (y + 60.0) / 125.0
    rx = x / 88.0
    inside = 1.0 - rx * rx - (2.0 * ry - 1.0) * (2.0 * ry - 1.0)
    height = 0.0
    if inside > 0.0:
        angle = math.atan2(x, y + 85.0)
        rib = math.cos(22.0 * angle)
        growth = math.sin(0.16 * math.sqrt(x * x + (y + 85.0) * (y + 85.0)))
        smooth = inside * inside * (3.0 - 2.0 * inside)
        height = smooth * (38.0 + 1.6 * rib + 0.5 * growth)
    # Solid behind the height field, in front of the slab's back; 0.45 keeps it a bound of the distance on the ribs.
    return max(max((-height - z) * 0.45, z - 12.0), max(abs(x) - 105.0, abs(y) - 80.0))


@numba.njit(nogil=True, cache=True)
def _stones(x: float, y: float, z: float) -> float:
    best = 1e9
    for i in range(5):
        cx = (-62.0, 18.0, 70.0, -20.0, 45.0)[i]
        cy = (-20.0, -38.0, 8.0, 36.0, 50.0)[i]
        cz = (8.0, 0.0, 12.0, -4.0, 14.0)[i]
        radius = (38.0, 32.0, 28.0, 34.0, 22.0)[i]
        dx, dy, dz = x - cx, y - cy, z - cz
        r = math.sqrt(dx * dx + dy * dy + dz * dz) + 1e-9
        if r > 1.35 * radius:
            best = min(best, r - 1.18 * radius)  # no bump reaches that far: a bound is enough
            continue
        ux, uy, uz = dx / r, dy / r, dz / r
        bump = (
            0.07 * math.sin(3.0 * ux + 1.7 * i)
            + 0.05 * math.sin(4.0 * uy - 2.0 * i + 1.0)
            + 0.04 * math.sin(5.0 * uz + 3.0 * ux + i)
            + 0.012 * math.sin(11.0 * ux + 9.0 * uy + 2.0 * i)
        )
        best = min(best, (r - radius * (1.0 + bump)) * 0.8)
    return best


@numba.njit(nogil=True, cache=True)
def implicit(kind: int, x: float, y: float, z: float) -> float:
    """The implicit function of an object at a point of its frame."""
    if kind == 0:
        return _box(x, y, z - 5.0, 125.0, 95.0, 5.0)
    if kind == 1:
        a = math.sqrt((x - 75.0) ** 2 + y * y + z * z) - 20.0
        b = math.sqrt((x + 75.0) ** 2 + y * y + z * z) - 20.0
        return min(min(a, b), _cylinder_x(x, y, z, 6.0, 75.0))
    if kind == 2:
        return _frustum(x, y, z)
    if kind == 3:
        return _pipe(x, y, z)
    if kind == 4:
        return _shell(x, y, z)
    return _stones(x, y, z)


@numba.njit(nogil=True, cache=True)
def gradient(kind: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Central differences of ``implicit``; not normalised."""
    h = 1e-4
    k = 0.5 / h
    return (
        (implicit(kind, x + h, y, z) - implicit(kind, x - h, y, z)) * k,
        (implicit(kind, x, y + h, z) - implicit(kind, x, y - h, z)) * k,
        (implicit(kind, x, y, z + h) - implicit(kind, x, y, z - h)) * k,
    )


@numba.njit(nogil=True, cache=True)
def march(
    kind: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, start: float, stop: float
) -> float:
    """Distance along a ray (object frame, unit direction) to the first surface after ``start``; NaN when none before
    ``stop``. Refined to 1e-9 mm."""
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 165.0 * 165.0
    disc = b * b - c
    if disc <= 0.0:
        return math.nan
    root = math.sqrt(disc)
    t = max(start, -b - root)
    end = min(stop, -b + root)
    f = implicit(kind, ox + t * dx, oy + t * dy, oz + t * dz)
    for _ in range(400):
        if t > end:
            return math.nan
        if f < 1e-4:
            break
        t += f
        f = implicit(kind, ox + t * dx, oy + t * dy, oz + t * dz)
    for _ in range(6):
        h = 1e-5
        slope = (implicit(kind, ox + (t + h) * dx, oy + (t + h) * dy, oz + (t + h) * dz) - f) / h
        if slope > -1e-3:
            break  # grazing: the marched point is as good as it gets
        step = -f / slope
        t += min(max(step, -0.1), 0.1)
        f = implicit(kind, ox + t * dx, oy + t * dy, oz + t * dz)
        if abs(step) < 1e-10:
            break
    return t


@numba.njit(nogil=True, cache=True)
def distances(kind: int, points: Array, out: Array) -> None:
    """Signed distance (n,) of points (n, 3) in the object frame to the surface, outside positive: the foot point is
    found by iterating along the gradient, so the value is exact near the surface whatever the function's slope."""
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        fx, fy, fz = x, y, z
        f0 = implicit(kind, x, y, z)
        for _ in range(8):
            f = implicit(kind, fx, fy, fz)
            gx, gy, gz = gradient(kind, fx, fy, fz)
            g2 = gx * gx + gy * gy + gz * gz
            if g2 < 1e-12:
                break
            fx -= f * gx / g2
            fy -= f * gy / g2
            fz -= f * gz / g2
            if f * f < 1e-18 * g2:
                break
        away = math.sqrt((x - fx) ** 2 + (y - fy) ** 2 + (z - fz) ** 2)
        out[i] = away if f0 >= 0.0 else -away
