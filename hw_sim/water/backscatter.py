"""Backscatter: projected light that the water sends straight into a camera.

Single scattering. Along each camera ray, the water inside the projector's beam sends back light in proportion to the
light that reaches it. Near the port the ray has not yet entered the beam; behind a surface there is no more water.
Backscatter is smooth, so it is computed on a coarse lattice of rays.
"""

# Symbols in the kernels:
#   depths    lengths along a camera ray, mm, at the middles of DEPTHS equal steps
#   place     column and row in the shrunk, padded light, and the share of white light that returns from there
#   u, v      pattern coordinate of the place; i, j, s, t integer and fractional part of it in the shrunk light
#   ends      length of each ray to the surface, NaN for none

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.geometry import MIDDLE_MM, Lamp
from hw_sim.optics.shadow import nearest
from hw_sim.optics.table import look_up
from hw_sim.optics.trace import HEIGHT, WIDTH

Array = NDArray[np.float64]

CELL_PX = 32
"""Lattice of camera rays, in px of 1600."""
DEPTHS = 128
FIRST_MM, LAST_MM = 120.0, 1000.0
SHRINK = 16
"""Edge, projector px, of the squares over which the light is averaged. Between them it is interpolated, so that
backscatter has no steps where a ray enters the beam."""


class Backscatter:
    """The backscatter in one camera of a rig, at rest or in motion: the beam moves with the camera."""

    def __init__(self, rays: Array, lamp: Lamp, attenuation_per_m: float) -> None:
        h, w = rays.shape[:2]
        cell = max(1, round(CELL_PX * w / 1600.0))
        self._rows = np.arange(cell // 2, h, cell)
        self._columns = np.arange(cell // 2, w, cell)
        self._shape = (h, w)
        self._depths_mm = FIRST_MM + (LAST_MM - FIRST_MM) * (np.arange(DEPTHS) + 0.5) / DEPTHS
        coarse = np.ascontiguousarray(rays[np.ix_(self._rows, self._columns)])
        self._places = np.empty((*coarse.shape[:2], DEPTHS, 3), np.float32)
        per_mm = attenuation_per_m / 1000.0
        _places(coarse, self._depths_mm, lamp.eye, lamp.table, lamp.window, lamp.depth_mm, per_mm, self._places)
        clear = np.empty((1, 1, DEPTHS, 3), np.float32)
        middle = coarse[len(self._rows) // 2, len(self._columns) // 2][None, None]
        _places(middle, self._depths_mm, lamp.eye, lamp.table, lamp.window, lamp.depth_mm, 0.0, clear)
        self._unit = float(clear[0, 0, self._depths_mm < MIDDLE_MM, 2].sum())
        """Sum of white light that comes back from perfectly clear water before the middle: the unit of the option."""

    @property
    def lit_water_mm(self) -> float:
        """Length of clear water in the beam before the middle on the middle ray, weighted with brightness."""
        return self._unit * float(self._depths_mm[1] - self._depths_mm[0])

    def seen(self, light: NDArray[np.float32], distance_mm: Array) -> NDArray[np.float32]:
        """Return the backscatter (h, w) float32 of the projected ``light`` (768, 1024).

        Its unit is the backscatter of white light on the middle ray.
        """
        size = (light.shape[1] // SHRINK, light.shape[0] // SHRINK)
        small = np.pad(np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA), np.float32), 1)
        ends = distance_mm[np.ix_(self._rows, self._columns)]
        coarse = np.empty(ends.shape, np.float32)
        _gather(self._places, self._depths_mm, ends, small, coarse)
        h, w = self._shape
        return np.asarray(cv2.resize(coarse / self._unit, (w, h), interpolation=cv2.INTER_LINEAR), np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _places(
    rays: Array, depths: Array, lamp: Array, table: Array, window: NDArray[np.float32], depth_mm: float,
    per_mm: float, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill ``out`` (rows, columns, DEPTHS, 3) with the place of each ray and depth."""
    for y in range(rays.shape[0]):
        for x in range(rays.shape[1]):
            ray = rays[y, x]
            for k in range(depths.size):
                px, py, pz = ray[0] + depths[k] * ray[3], ray[1] + depths[k] * ray[4], ray[2] + depths[k] * ray[5]
                u, v = look_up(lamp, table, px, py, pz)
                place = out[y, x, k]
                place[0], place[1], place[2] = 0.0, 0.0, 0.0
                # Centres of the shrunk pixels lie at integers, shifted by the dark pixel of padding.
                i, j = (u + 0.5) / SHRINK + 0.5, (v + 0.5) / SHRINK + 0.5
                if not (0.0 < i < lamp[WIDTH] / SHRINK + 1.0 and 0.0 < j < lamp[HEIGHT] / SHRINK + 1.0):
                    continue
                u, v = min(max(u, 0.0), lamp[WIDTH] - 1.0), min(max(v, 0.0), lamp[HEIGHT] - 1.0)
                start = window[nearest(v), nearest(u)]
                path = math.sqrt((px - start[0]) ** 2 + (py - start[1]) ** 2 + (pz - start[2]) ** 2)
                # Inverse squares from the apparent source, vignetting, Beer and Lambert on both ways.
                spread = (MIDDLE_MM + depth_mm) / (path + depth_mm)
                place[0], place[1] = i, j
                place[2] = spread * spread * start[3] * math.exp(-per_mm * (path + depths[k]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _gather(
    places: NDArray[np.float32], depths: Array, ends: Array, light: NDArray[np.float32], out: NDArray[np.float32]
) -> None:
    """Fill ``out`` (rows, columns) with the light that returns along each ray before its end."""
    step = depths[1] - depths[0]
    for y in range(ends.shape[0]):
        for x in range(ends.shape[1]):
            total = 0.0
            for k in range(depths.size):
                share = 1.0
                if ends[y, x] < depths[k] + 0.5 * step:  # false for NaN: no surface
                    # The surface cuts this step. Only the share before it counts, so that backscatter is smooth in
                    # depth.
                    share = (ends[y, x] - depths[k]) / step + 0.5
                    if share <= 0.0:
                        break
                place = places[y, x, k]
                if place[2] > 0.0:
                    i, j = int(place[0]), int(place[1])
                    s, t = place[0] - i, place[1] - j
                    # Bilinear in the shrunk light.
                    above = light[j, i] + s * (light[j, i + 1] - light[j, i])
                    below = light[j + 1, i] + s * (light[j + 1, i + 1] - light[j + 1, i])
                    total += share * place[2] * (above + t * (below - above))
            out[y, x] = total
