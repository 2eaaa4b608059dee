"""Uneven ambient light in a camera's image: the torch's spot and the caustics."""

# Symbols in _add:
#   w, p      surface point in the rig frame now, and in that of time 0, where the light stays; rotation, shift: w to p
#   off2      squared distance of the point from the torch's axis; per_mm2 = 4 ln 2 / diameter² makes the diameter an FWHM
#   a, b      place in the net, cells; i, j the integer and s, t the fractional part of it

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.latest import Latest
from hw_sim.light.caustics import CELLS, Net
from hw_sim.light.daylight import Daylight
from hw_sim.optics.geometry import GREY, Geometry, Pose

Array = NDArray[np.float64]
Picture = NDArray[np.float32]

LOOKS_PER_S = 250.0
"""Rate at which an exposure samples the net, so that its moving lines are blurred."""
MOST_LOOKS = 4


class UnevenLight:
    """Uneven light on one rig's scene. May be used by several threads at once."""

    def __init__(self) -> None:
        self._nets: Latest[tuple[float, float, int], Net] = Latest(keep=2)
        # The cameras' threads need the same moments, but at different times.
        self._moments: Latest[tuple[object, ...], Picture] = Latest(keep=4 * MOST_LOOKS)

    def add(
        self,
        daylight: Daylight,
        clock_s: float,
        duration_s: float,
        ambient_e: float,
        white_e: float,
        rays: Array,
        geometry: Geometry,
        pose: Pose,
        initial_pose: Pose,
        electrons: Picture,
    ) -> None:
        """Add the spot, and the net minus even light, to mean ``electrons`` (h, w) in place.

        ``ambient_e`` and ``white_e`` are the electrons of ambient light and of the projector's white in ``duration_s``;
        the object is at ``pose``; ``initial_pose`` is that to which the places of the light refer.
        """
        net, tile_mm = np.ones((CELLS, CELLS), np.float32), 1.0
        if daylight.caustics > 0.0:
            looks = min(MOST_LOOKS, max(1, math.ceil(duration_s * LOOKS_PER_S)))
            moments = [clock_s + duration_s * ((k + 0.5) / looks - 0.5) for k in range(looks)]
            net = np.mean([self._net_at(daylight, at_s) for at_s in moments], axis=0, dtype=np.float32)
            tile_mm = self._net(daylight).tile_mm
        rotation = initial_pose.R @ pose.R.T  # from the rig's frame of now to that of time 0
        sun_x, sun_y = _across(np.array(daylight.sun_direction))
        axis = np.array(daylight.torch_direction) / np.linalg.norm(daylight.torch_direction)
        _add(
            rays, geometry.distance_mm, geometry.pixels, rotation, initial_pose.t - rotation @ pose.t,
            net, ambient_e * daylight.caustics, CELLS / tile_mm, sun_x, sun_y,
            daylight.torch * white_e, daylight.torch_mm(clock_s), axis,
            4.0 * math.log(2.0) / daylight.torch_diameter_mm**2, electrons,
        )  # fmt: skip

    def _net(self, daylight: Daylight) -> Net:
        key = (daylight.caustics_scale_mm, daylight.caustics_speed_mm_s, daylight.seed)
        return self._nets.get(key, lambda: Net(*key))

    def _net_at(self, daylight: Daylight, clock_s: float) -> Picture:
        net = self._net(daylight)
        return self._moments.get((net, clock_s), lambda: net.light(clock_s))


def _across(direction: Array) -> tuple[Array, Array]:
    """Return two unit vectors (3,) perpendicular to a direction and to each other."""
    axis = direction / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [1.0, 0.0, 0.0], axis)
    x /= np.linalg.norm(x)
    return x, np.cross(axis, x)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _add(
    rays: Array, distance: Array, pixels: Picture, rotation: Array, shift: Array,
    net: Picture, net_e: float, per_mm: float, sun_x: Array, sun_y: Array,
    torch_e: float, torch_at: Array, axis: Array, per_mm2: float, electrons: Picture,
) -> None:  # fmt: skip
    """Add albedo × (torch + net − 1) to ``electrons`` (h, w) where the camera meets a surface."""
    rows, columns = net.shape
    for y in range(distance.shape[0]):
        for x in range(distance.shape[1]):
            far = distance[y, x]
            if math.isnan(far):
                continue
            ray = rays[y, x]
            wx, wy, wz = ray[0] + far * ray[3], ray[1] + far * ray[4], ray[2] + far * ray[5]
            px = rotation[0, 0] * wx + rotation[0, 1] * wy + rotation[0, 2] * wz + shift[0]
            py = rotation[1, 0] * wx + rotation[1, 1] * wy + rotation[1, 2] * wz + shift[1]
            pz = rotation[2, 0] * wx + rotation[2, 1] * wy + rotation[2, 2] * wz + shift[2]
            light = 0.0
            if torch_e > 0.0:
                ax, ay, az = px - torch_at[0], py - torch_at[1], pz - torch_at[2]
                along = ax * axis[0] + ay * axis[1] + az * axis[2]
                off2 = ax * ax + ay * ay + az * az - along * along
                light += torch_e * math.exp(-per_mm2 * off2)
            if net_e > 0.0:
                a = (px * sun_x[0] + py * sun_x[1] + pz * sun_x[2]) * per_mm
                b = (px * sun_y[0] + py * sun_y[1] + pz * sun_y[2]) * per_mm
                i, j = math.floor(a), math.floor(b)
                s, t = a - i, b - j
                i0, j0 = i % columns, j % rows
                i1, j1 = (i0 + 1) % columns, (j0 + 1) % rows
                # Bilinear in the net, less its mean, which the even light already contains.
                above = net[j0, i0] + s * (net[j0, i1] - net[j0, i0])
                below = net[j1, i0] + s * (net[j1, i1] - net[j1, i0])
                light += net_e * (above + t * (below - above) - 1.0)
            electrons[y, x] += pixels[y, x, GREY] * light
