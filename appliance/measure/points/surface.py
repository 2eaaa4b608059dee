"""A cloud as a surface over the left camera's pixels, for comparison with another exposure.

The pixel that sees a point near the surface follows from the clouds themselves, whose points know their pixels: this
relation is smooth, refraction included, and is fitted by a cubic.

Symbols: a, b, t are x/z, y/z, 1/z of a point, less ``centre``, over ``spread``; ``terms`` their 17 products;
``projection`` turns them into column and row.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.points.table import Cloud

Array = NDArray[np.float64]
FIT_SAMPLES = 4_000
"""Number of points of either cloud to which the projection is fitted."""
NORMAL_MM = 1.2
"""Half of the base in mm over which the surface normal is computed; at least one pixel."""
MAX_BEND_MM = 0.4
"""Largest distance in mm of the middle of that base from the line between its ends: more is an edge."""
TERMS = 17
"""Number of terms of the cubic in x/z and y/z, with 1/z up to second order."""


class Surface(NamedTuple):
    """A surface as the kernels read it."""

    points_mm: NDArray[np.float32]
    """(n, 3)."""
    sigma_mm: NDArray[np.float32]
    point_index: NDArray[np.int32]
    """(h, w): index of the pixel's point, or -1."""
    projection: Array
    """(17, 2): coefficients of the column and row that see a point, by the terms of its direction."""
    centre: Array
    """(3,): mean of the directions; with ``spread`` it normalises the terms."""
    spread: Array
    step: int
    """Number of pixels that ``NORMAL_MM`` spans."""


class Below(NamedTuple):
    """The surface below each of n points."""

    normal: Array
    """(n, 3), of unit length."""
    apart_mm: Array
    """(n,): distance of the point along the normal."""
    sigma_mm: Array
    """(n,): standard deviation of the surface's point."""
    exists: NDArray[np.bool_]
    """(n,): there is a surface; otherwise the other arrays have no meaning there."""


def surface_of(cloud: Cloud, second_cloud: Cloud, shape: tuple[int, int]) -> Surface:
    """Return ``cloud`` (not empty) as a surface over the camera's (h, w) pixels.

    ``second_cloud``: another cloud of the scene, to whose pixels the projection is fitted, too.
    """
    index = np.full(shape[0] * shape[1], -1, np.int32)
    index[cloud.pixel] = np.arange(len(cloud.pixel), dtype=np.int32)
    parts = [(part, thinned(len(part.pixel), FIT_SAMPLES)) for part in (cloud, second_cloud)]
    points = np.concatenate([part.points_mm[k] for part, k in parts]).astype(np.float64)
    pixel = np.concatenate([part.pixel[k] for part, k in parts]).astype(np.int64)
    direction = np.stack([points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], 1.0 / points[:, 2]], 1)
    centre, spread = direction.mean(axis=0), direction.std(axis=0) + 1e-12
    pixels_px = np.stack([pixel % shape[1], pixel // shape[1]], 1).astype(np.float64)
    # Least squares of the pixels on the 17 terms.
    terms = np.empty((len(points), TERMS))
    for row, part in zip(terms, (direction - centre) / spread, strict=True):
        _terms(part[0], part[1], part[2], row)
    projection = np.ascontiguousarray(np.linalg.lstsq(terms, pixels_px, rcond=None)[0])
    middle = np.median(cloud.points_mm[thinned(len(cloud.pixel), 1000)], axis=0).astype(np.float64)
    surface = Surface(cloud.points_mm, cloud.sigma_mm, index.reshape(shape), projection, centre, spread, 1)
    # Pixels per mm in the middle of the cloud, along x.
    neighbours_px = pixels_of(surface, np.stack([middle, middle + np.array([1.0, 0.0, 0.0])]))
    per_mm = abs(float(neighbours_px[1, 0] - neighbours_px[0, 0]))
    return surface._replace(step=max(1, min(round(NORMAL_MM * per_mm), shape[1] // 8)))


def thinned(n: int, count: int) -> NDArray[np.int64]:
    """Return at most ``count`` of the numbers 0 … n - 1, evenly."""
    return np.unique(np.linspace(0, n - 1, min(n, count)).astype(np.int64)) if n else np.empty(0, np.int64)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _terms(a: float, b: float, t: float, out: Array) -> None:
    """Write the 17 terms of a direction (a, b) and an inverse depth t, all normalised."""
    out[0], out[1], out[2], out[3] = 1.0, a, b, t
    out[4], out[5], out[6], out[7], out[8], out[9] = a * a, a * b, b * b, a * t, b * t, t * t
    out[10], out[11], out[12], out[13] = a * a * a, a * a * b, a * b * b, b * b * b
    out[14], out[15], out[16] = a * a * t, a * b * t, b * b * t


@numba.njit(nogil=True, cache=True, error_model="numpy")
def pixel_of(surface: Surface, x: float, y: float, z: float, terms: Array) -> tuple[float, float]:
    """Return the column and row, in px, of a point; ``terms`` (17,) is scratch."""
    centre, spread = surface.centre, surface.spread
    _terms((x / z - centre[0]) / spread[0], (y / z - centre[1]) / spread[1], (1.0 / z - centre[2]) / spread[2], terms)
    column = row = 0.0
    for k in range(TERMS):
        column += terms[k] * surface.projection[k, 0]
        row += terms[k] * surface.projection[k, 1]
    return column, row


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _tangent(surface: Surface, row: int, column: int, down: int, across: int, out: Array) -> bool:
    """Write the surface's tangent (3,) at a pixel with a point to ``out``; False: none, or across an edge."""
    index_map, points = surface.point_index, surface.points_mm
    rows, columns = index_map.shape
    centre = index_map[row, column]
    before = after = np.int32(-1)
    if row >= down and column >= across:
        before = index_map[row - down, column - across]
    if row + down < rows and column + across < columns:
        after = index_map[row + down, column + across]
    if before < 0 and after < 0:
        return False
    # Difference of the ends, and the squared distance of their middle from the point.
    low, high = (before if before >= 0 else centre), (after if after >= 0 else centre)
    bend = 0.0
    for k in range(3):
        out[k] = np.float64(points[high, k]) - np.float64(points[low, k])
        bend += (0.5 * (np.float64(points[low, k]) + points[high, k]) - points[centre, k]) ** 2
    if before >= 0 and after >= 0:
        return bool(bend < MAX_BEND_MM**2)
    # One end is missing: a slope of more than 60 degrees may be across an edge.
    return bool(abs(out[2]) < 1.7 * math.sqrt(out[0] ** 2 + out[1] ** 2))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def normal_at(surface: Surface, row: int, column: int, a: Array, b: Array, normal: Array) -> bool:
    """Write the unit normal at a pixel with a point to ``normal`` (3,); False: there is none.

    ``a``, ``b`` (3,) are scratch.
    """
    step = surface.step
    if not (_tangent(surface, row, column, 0, step, a) and _tangent(surface, row, column, step, 0, b)):
        return False
    # Cross product of both tangents, of unit length.
    normal[0] = a[1] * b[2] - a[2] * b[1]
    normal[1] = a[2] * b[0] - a[0] * b[2]
    normal[2] = a[0] * b[1] - a[1] * b[0]
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length == 0.0:
        return False
    for k in range(3):
        normal[k] /= length
    return True


@numba.njit(nogil=True, cache=True, error_model="numpy")
def pixels_of(surface: Surface, points_mm: Array) -> Array:
    """Return the columns and rows (n, 2), in px, of ``points_mm`` (n, 3)."""
    pixels, terms = np.empty((len(points_mm), 2)), np.empty(TERMS)
    for k in range(len(points_mm)):
        pixels[k, 0], pixels[k, 1] = pixel_of(surface, points_mm[k, 0], points_mm[k, 1], points_mm[k, 2], terms)
    return pixels


@numba.njit(nogil=True, cache=True, error_model="numpy")
def below(surface: Surface, points_mm: Array) -> Below:
    """Return the part of ``surface`` below each of ``points_mm`` (n, 3)."""
    n = len(points_mm)
    rows, columns = surface.point_index.shape
    result = Below(np.empty((n, 3)), np.empty(n), np.empty(n), np.zeros(n, np.bool_))
    terms, a, b = np.empty(TERMS), np.empty(3), np.empty(3)
    for k in range(n):
        x, y, z = points_mm[k]
        u, v = pixel_of(surface, x, y, z, terms)
        if not (-0.5 < u < columns - 0.5 and -0.5 < v < rows - 0.5):
            continue
        # Distance along the normal of the pixel that sees the point.
        row, column = round(v), round(u)
        index = surface.point_index[row, column]
        if index < 0 or not normal_at(surface, row, column, a, b, result.normal[k]):
            continue
        apart = 0.0
        for axis in range(3):
            apart += result.normal[k, axis] * (points_mm[k, axis] - surface.points_mm[index, axis])
        result.apart_mm[k], result.sigma_mm[k], result.exists[k] = apart, surface.sigma_mm[index], True
    return result
