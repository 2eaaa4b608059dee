"""Points from the pattern coordinate maps of two images, for imports of other rigs' images.

Both directions must have been projected; ``one_direction.py`` is for one. Matching and triangulation are the
instrument's kernels.

Scale: the coordinates are scaled so that a camera pixel sees about as much of the pattern as on the instrument, for
which the search for neighbours was made. No point depends on the scale.

CoordinateMap         coordinates of one direction in one image
points_of_maps        the points of two images
pixels_without_ray    the mask of pixels that the ray lattice does not cover
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.noise import TYPICAL_PAIR
from appliance.measure.light.rays import ray_lattice, usual_step_px
from appliance.measure.points.match import fill_inverse_map, right_maps
from appliance.measure.points.organised import OrganisedCloud, no_points
from appliance.measure.points.rows import LeftMaps, reconstruct_rows, scratch_rows
from appliance.measure.points.select import PointLimits
from appliance.measure.points.sigma import sigma_factors
from appliance.measure.points.table import PointTable
from appliance.measure.points.triangulate import rays_of

Floats = NDArray[np.float32]

USUAL_STEP_PX = 0.63
"""Change of a coordinate from one pixel to the next on the instrument, for images 1600 px wide."""
STRIP_PX = 512
"""Number of left columns that are reconstructed together: less than ``scratch.MAX_WIDTH_PX``, so that copies are small.
"""
_ALL = PointLimits(*np.array([np.inf, np.inf, -np.inf, np.inf, np.inf, 0.0], np.float32))
"""Limits that every point keeps; the caller applies the real ones."""


@dataclass(frozen=True, slots=True, eq=False)
class CoordinateMap:
    """Coordinates of one direction of the pattern in one image, without edges, with their noise."""

    coordinate_px: Floats
    """(h, w) float32; NaN where there is no coordinate."""
    sigma_px: Floats
    """(h, w) float32: standard deviation by noise, in px of the pattern."""
    step_px: float
    """Typical change from a pixel to the next, in either direction of the image."""


def points_of_maps(
    rig: StereoRig,
    index: float,
    left: Mapping[str, CoordinateMap],
    right: Mapping[str, CoordinateMap],
    grey: NDArray[np.uint8],
    modulation_dn: Floats,
    depths_mm: tuple[float, float],
) -> OrganisedCloud:
    """Return the points where rays meet, without any limit.

    ``left``, ``right``: keyed ``x`` and ``y``. ``index``: the water's refractive index. ``grey``, ``modulation_dn``:
    (h, w) of the left image. ``depths_mm``: nearest and farthest depth; the rays are most accurate between them.
    """
    low_px, size_px = [], []
    for name in "xy":
        coordinates_px = [maps[name].coordinate_px for maps in (left, right)]
        low_px.append(min(float(np.nanmin(values)) for values in coordinates_px))
        size_px.append(max(float(np.nanmax(values)) for values in coordinates_px) - low_px[-1])
    # The scale gives a pixel as much of the pattern as on the instrument, but no more nodes than the map can fill.
    scale = min(
        USUAL_STEP_PX * 1600.0 / rig.right.width_px / max(right["x"].step_px, right["y"].step_px),
        4.0 * math.sqrt(rig.right.width_px * rig.right.height_px / (size_px[0] * size_px[1] + 1.0)),
    )
    p2, q2, variance2 = _scaled(right, low_px, scale)
    full_modulation = np.full(p2.shape, np.uint8(255))
    lookup = right_maps(p2, q2, full_modulation, int(scale * size_px[0]) + 2, int(scale * size_px[1]) + 2, variance2)
    fill_inverse_map(lookup, 1)
    plane_mm = math.sqrt(depths_mm[0] * depths_mm[1])
    # The series of a ray needs three rows of nodes.
    step_px = min(min(usual_step_px(camera), camera.height_px - 1) for camera in (rig.left, rig.right))
    first_rays, second_rays = (
        ray_lattice(camera, index, plane_mm, step_px, partial=True) for camera in (rig.left, rig.right)
    )
    rays = rays_of(first_rays, second_rays, rig.left.width_px)
    cloud = no_points(grey)
    height = grey.shape[0]
    table, scratch = PointTable(height * (STRIP_PX + 2)), scratch_rows()
    factors = sigma_factors(16, TYPICAL_PAIR)  # only for footprints: the maps have their variances
    for first in range(0, grey.shape[1], STRIP_PX):
        # One more column on either side, since the standard deviation needs the neighbours.
        begin = max(first - 1, 0)
        columns = np.s_[..., begin : first + STRIP_PX + 1]
        bright = np.ascontiguousarray(grey[columns])
        half = np.clip(np.rint(2.0 * modulation_dn[columns]), 0.0, 255.0).astype(np.uint8)
        strip_rays = rays._replace(left=np.ascontiguousarray(rays.left[columns]))
        p, q, variance = _scaled(left, low_px, scale, columns)
        illuminated = np.tile(np.array([0, p.shape[1]], np.int32), (height, 1))
        strip = LeftMaps(p, q, half, bright, bright, illuminated, np.float32(1.0), variance)
        count = int(reconstruct_rows(strip, lookup, strip_rays, _ALL, factors, 0, height, 1, scratch, table.points, 0))
        points = table.points
        # From flat indices in the strip to rows and columns of the image.
        row, column = np.divmod(points.pixel[:count], p.shape[1])
        inner = np.flatnonzero((column + begin >= first) & (column + begin < first + STRIP_PX))
        target = row[inner], column[inner] + begin
        cloud.points_mm[target], cloud.sigma_mm[target] = points.xyz_mm[inner], points.sigma_mm[inner]
        cloud.ray_gap_mm[target] = points.gap_mm[inner]
        cloud.modulation_dn[target] = np.float32(0.5) * points.modulation_half_dn[inner]
    return cloud


def pixels_without_ray(camera: HousedCamera, index: float) -> NDArray[np.bool_]:
    """Return a mask (h, w) of the pixels that have no ray.

    The cells of the lattice decide, whole cells at a time.
    """
    lattice = ray_lattice(camera, index, 0.0, partial=True)
    lost = np.isnan(lattice.nodes[..., 2])
    cells = lost[1:, 1:] | lost[1:, :-1] | lost[:-1, 1:] | lost[:-1, :-1]
    return cells.repeat(lattice.step_px, 0).repeat(lattice.step_px, 1)[: camera.height_px, : camera.width_px]


def _scaled(
    maps: Mapping[str, CoordinateMap], low_px: list[float], scale: float, part: Any = ...
) -> tuple[Floats, Floats, Floats]:
    """Return p and q from their least value on, scaled, and their mean variance; NaN if either is missing."""
    coordinate_maps = [maps[name] for name in "xy"]
    p, q = (
        (coordinate_map.coordinate_px[part] - np.float32(low)) * np.float32(scale)
        for coordinate_map, low in zip(coordinate_maps, low_px, strict=True)
    )
    missing = np.isnan(p) | np.isnan(q)
    p[missing], q[missing] = np.nan, np.nan
    spread = np.hypot(*(coordinate_map.sigma_px[part] for coordinate_map in coordinate_maps))
    return p, q, np.square(spread, out=spread) * np.float32(0.5 * scale**2)
