"""Fish before the object: ellipsoids that rays of cameras and projector meet first, traced like the object."""

# Symbols:
#   o, d      origin and unit direction of a ray, rig frame
#   a, b, c   of |p + far d|² = 1 in units of the half axes: a far² + 2 b far + c = 0
#   w, n      point met and its normal (not unit); s the path to the projector's port, length = |s|
#   ahead, up place on the body in units of its half axes

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.geometry import GREY, LIT, MIDDLE_MM, SOFT, Geometry, Lamp, P, Q
from hw_sim.optics.projector import FAR_MM
from hw_sim.optics.shadow import nearest
from hw_sim.optics.table import OUTSIDE, look_up
from hw_sim.optics.trace import FOCUS, HEIGHT, WIDTH
from hw_sim.water.drift import School

Array = NDArray[np.float64]

FIN_AT, FIN_HALF = -1.08, (0.2, 1.0, 0.25)
"""The tail fin: its place along the half length, and its half axes against the body's."""


def before(
    rays: Array, geometry: Geometry, school: School, lamp: Lamp, attenuation_per_m: float, is_lit: bool
) -> Geometry:
    """Return the geometry of a camera with ``rays`` (h, w, 6) with fish before the scene.

    Their shadow falls on the object.
    """
    places = np.concatenate([school.places_mm, school.places_mm + school.axes[:, 0] * FIN_AT * school.half_mm[:, :1]])
    axes = np.concatenate([school.axes, school.axes])
    half = np.concatenate([school.half_mm, school.half_mm * np.array(FIN_HALF)])
    with_fish = Geometry(geometry.distance_mm.copy(), geometry.pixels.copy())
    _before(
        rays, places, axes, half, is_lit, attenuation_per_m / 1000.0, lamp.eye, lamp.table, lamp.window, lamp.depth_mm,
        with_fish.distance_mm, with_fish.pixels,
    )  # fmt: skip
    return with_fish


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _meet(
    places: Array, axes: Array, half: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[int, float]:
    """Return the index of the ellipsoid that a ray meets first, and the distance in mm; (−1, inf) for none."""
    which, nearest = -1, math.inf
    for i in range(places.shape[0]):
        px, py, pz = ox - places[i, 0], oy - places[i, 1], oz - places[i, 2]
        along = px * dx + py * dy + pz * dz
        reach = half[i, 0] if half[i, 0] > half[i, 1] else half[i, 1]
        # Most rays pass the ball around the fish: no need for the quadratic.
        if px * px + py * py + pz * pz - along * along > reach * reach:
            continue
        a, b, c = 0.0, 0.0, -1.0
        for k in range(3):
            p = (px * axes[i, k, 0] + py * axes[i, k, 1] + pz * axes[i, k, 2]) / half[i, k]
            d = (dx * axes[i, k, 0] + dy * axes[i, k, 1] + dz * axes[i, k, 2]) / half[i, k]
            a, b, c = a + d * d, b + p * d, c + p * p
        inside = b * b - a * c
        if inside > 0.0:
            far = (-b - math.sqrt(inside)) / a
            if 0.0 < far < nearest:
                which, nearest = i, far
    return which, nearest


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _skin(ahead: float, up: float) -> float:
    """Return the albedo at a place of the body in units of its half axes: banded, dark above and light below."""
    return 0.30 - 0.14 * up + 0.12 * math.sin(9.0 * ahead + 1.5 * math.sin(5.0 * up))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _before(
    rays: Array, places: Array, axes: Array, half: Array, is_lit: bool, per_mm: float, lamp: Array, table: Array,
    window: NDArray[np.float32], depth_mm: float, distance: Array, pixels: NDArray[np.float32],
) -> None:  # fmt: skip
    """Draw the fish into ``distance`` (h, w) and ``pixels`` (h, w, CHANNELS), in place."""
    width, height = lamp[WIDTH], lamp[HEIGHT]
    for y in range(distance.shape[0]):
        for x in range(distance.shape[1]):
            ray, out = rays[y, x], pixels[y, x]
            which, far = _meet(places, axes, half, ray[0], ray[1], ray[2], ray[3], ray[4], ray[5])
            if which < 0 or far > distance[y, x]:
                if is_lit and out[LIT] > 0.0:
                    far = distance[y, x]
                    wx, wy, wz = ray[0] + far * ray[3], ray[1] + far * ray[4], ray[2] + far * ray[5]
                    # The object is visible here: is a fish between it and the projector's port?
                    start = window[nearest(out[Q]), nearest(out[P])]
                    sx, sy, sz = start[0] - wx, start[1] - wy, start[2] - wz
                    length = math.sqrt(sx * sx + sy * sy + sz * sz)
                    if _meet(places, axes, half, wx, wy, wz, sx / length, sy / length, sz / length)[0] >= 0:
                        out[LIT] = 0.0
                continue
            wx, wy, wz = ray[0] + far * ray[3], ray[1] + far * ray[4], ray[2] + far * ray[5]
            px, py, pz = wx - places[which, 0], wy - places[which, 1], wz - places[which, 2]
            nx, ny, nz, ahead, up = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                axis = axes[which, k]
                # The normal is the gradient of Σ (p · axis / half)².
                coordinate = (px * axis[0] + py * axis[1] + pz * axis[2]) / half[which, k]
                nx, ny, nz = (
                    nx + coordinate / half[which, k] * axis[0],
                    ny + coordinate / half[which, k] * axis[1],
                    nz + coordinate / half[which, k] * axis[2],
                )
                if k == 0:
                    ahead = coordinate
                elif k == 1:
                    up = coordinate
            grey = _skin(ahead, up) * math.exp(-per_mm * far)
            distance[y, x] = far
            out[P], out[Q], out[LIT], out[SOFT], out[GREY] = OUTSIDE, OUTSIDE, 0.0, 0.0, grey
            if not is_lit:
                continue
            u, v = look_up(lamp, table, wx, wy, wz)
            if not (-2.0 < u < width + 1.0 and -2.0 < v < height + 1.0):
                continue
            out[P], out[Q] = u, v
            start = window[nearest(v), nearest(u)]
            sx, sy, sz = start[0] - wx, start[1] - wy, start[2] - wz
            length = math.sqrt(sx * sx + sy * sy + sz * sz)
            facing = (sx * nx + sy * ny + sz * nz) / (length * math.sqrt(nx * nx + ny * ny + nz * nz))
            if facing > 0.0:
                # Lit as the object is: see optics.geometry.
                spread = (MIDDLE_MM + depth_mm) / (length + depth_mm)
                out[LIT] = grey * facing * spread * spread * start[3] * math.exp(-per_mm * length)
                away = (wz - lamp[FOCUS]) / FAR_MM
                out[SOFT] = min(away * away, 1.0)
