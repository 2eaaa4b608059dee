"""Owns the way from decoded foreign images to points: two directions by the instrument's own kernels, one along epipolar curves.

A projector that was calibrated takes the right camera's place: its "image" has, at each pixel, the coordinates of that pixel.

Symbols: the pattern's coordinates are scaled so that one camera pixel sees about as much of the pattern as on the instrument, for
which the search for neighbours was made; no point depends on their scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.camera import CleanAxis, DecodedCamera, clean
from appliance.foreign.cameras import ForeignRig
from appliance.foreign.description import Description
from appliance.foreign.phase import Floats
from appliance.foreign.problem import ForeignError
from appliance.optics.epipolar import CurveError
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.rays import ray_lattice, usual_step_px
from appliance.reconstruct.match import fill_inverse_map, right_maps
from appliance.reconstruct.one_direction import UNCHECKED, OneDirectionError, OneDirectionLimits, match_along_curves
from appliance.reconstruct.organised import OrganisedCloud, organised
from appliance.reconstruct.quality import summarise
from appliance.reconstruct.rows import LeftMaps, reconstruct_rows, scratch_rows
from appliance.reconstruct.scratch import MAX_WIDTH_PX
from appliance.reconstruct.select import PointLimits
from appliance.reconstruct.sigma import sigma_factors
from appliance.reconstruct.table import Found, PointTable
from appliance.reconstruct.triangulate import rays_of
from appliance.scan.noise import TYPICAL_PAIR

USUAL_STEP_PX = 0.63
"""Change of a coordinate from one pixel to the next on the instrument, for images 1600 px wide."""
GAP_PIXELS, SIGMA_PIXELS, STEP_PIXELS = 2.5, 3.0, 9.4
"""Largest ray gap and expected error of a point, and step in depth to a neighbour, over the size of a pixel on the object."""
LEAST_NEIGHBOURS = 5
NEAR_OF_CROSSING, FAR_OF_CROSSING = 0.3, 4.0
NEAR_BASELINES, FAR_BASELINES = 1.0, 60.0
"""Depths that are searched where nothing is said: about where the cameras' axes cross, or from so many baselines to so many."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCloud:
    """The points of a foreign set on the left image's pixels."""

    cloud: OrganisedCloud
    unchecked: str | None
    """Warning about points that nothing has checked; ``None``: the rays' gaps have."""
    depths_mm: tuple[float, float]
    """Depths that were searched."""
    lit: int
    """Number of left pixels with coordinates."""

    @property
    def points(self) -> int:
        """Number of points."""
        return int(np.count_nonzero(self.cloud.mask))


def depths_of(description: Description, rig: StereoRig, index: float) -> tuple[float, float]:
    """Return nearest and farthest depth in mm to be searched: what the description says, else what the cameras look at."""
    baseline_mm = math.hypot(*rig.right.translation_mm)
    try:
        crossing_mm = float(rig.volume_centre_mm(index)[2])
    except ValueError:
        crossing_mm = math.inf
    if NEAR_BASELINES * baseline_mm < crossing_mm < FAR_BASELINES * baseline_mm:
        near_mm, far_mm = NEAR_OF_CROSSING * crossing_mm, FAR_OF_CROSSING * crossing_mm
    else:
        near_mm, far_mm = NEAR_BASELINES * baseline_mm, FAR_BASELINES * baseline_mm
    windows_mm = max(_front_mm(rig.left), _front_mm(rig.right))
    return description.near_mm or max(near_mm, 1.05 * windows_mm), description.far_mm or max(far_mm, 2.0 * windows_mm)


def find_points(
    description: Description, rig: ForeignRig, left: DecodedCamera, right: DecodedCamera | None
) -> ForeignCloud:
    """Find the points; without ``right``, the rig's right camera is a projector. Raises ForeignError."""
    mine = {axis.name: clean(left.placed[axis.name]) for axis in description.axes}
    other = _projector(rig.rig.right) if right is None else {
        axis.name: clean(right.placed[axis.name]) for axis in description.axes
    }  # fmt: skip
    depths_mm = depths_of(description, rig.rig, rig.index)
    lit = int(np.count_nonzero(np.logical_and.reduce([np.isfinite(one.coordinate_px) for one in mine.values()])))
    if description.one_direction:
        cloud = _one_direction(rig, left, next(iter(mine.values())), other[description.axes[0].name], depths_mm)
        return ForeignCloud(cloud, UNCHECKED, depths_mm, lit)
    return ForeignCloud(_two_directions(rig, left, mine, other, depths_mm), None, depths_mm, lit)


def _one_direction(
    rig: ForeignRig, left: DecodedCamera, mine: CleanAxis, other: CleanAxis, depths_mm: tuple[float, float]
) -> OrganisedCloud:
    pixel_mm = _pixel_mm(rig.rig.left, _plane_mm(depths_mm))
    try:
        found = match_along_curves(
            mine.coordinate_px, other.coordinate_px, rig.rig, rig.index, depths_mm, (mine.sigma_px, other.sigma_px),
            OneDirectionLimits(max_sigma_mm=SIGMA_PIXELS * pixel_mm),
        )  # fmt: skip
    except (OneDirectionError, CurveError) as error:
        raise ForeignError(f"{error}; depths are set by range.near_mm and range.far_mm") from error
    modulation = next(iter(left.placed.values())).modulation
    there = found.mask
    missing = np.float32(np.nan)
    return OrganisedCloud(
        found.points_mm, found.sigma_mm, np.where(there, modulation * np.float32(255.0 / left.images.white), missing),
        np.full(there.shape, missing), left.grey,
    )  # fmt: skip


def _two_directions(
    rig: ForeignRig,
    left: DecodedCamera,
    mine: Mapping[str, CleanAxis],
    other: Mapping[str, CleanAxis],
    depths_mm: tuple[float, float],
) -> OrganisedCloud:
    cameras = rig.rig.left, rig.rig.right
    if max(camera.width_px for camera in cameras) > MAX_WIDTH_PX:
        raise ForeignError(
            f"an image is {max(camera.width_px for camera in cameras)} px wide; allowed for two directions are {MAX_WIDTH_PX} px; "
            "make the images smaller, or describe one direction only"
        )
    height, width = left.grey.shape
    # So large is the pattern that one pixel sees as much of it as on the instrument.
    scale = USUAL_STEP_PX * 1600.0 / cameras[1].width_px / max(other["x"].step_px, other["y"].step_px)
    scaled = [_scaled(maps, scale) for maps in (mine, other)]
    # float32 like the maps: kernels are compiled for these.
    low = np.float32(min(np.nanmin(one, initial=np.inf) for maps in scaled for one in maps[:2]))
    if not np.isfinite(low):
        raise ForeignError("no pixel of one camera has both coordinates; see what is said of the conventions")
    size_px = [int(max(np.nanmax(maps[k], initial=0.0) for maps in scaled) - low) + 2 for k in (0, 1)]
    (p1, q1, variance1), (p2, q2, variance2) = ((p - low, q - low, variance) for p, q, variance in scaled)
    half_dn = _half_dn(left)
    seen = np.full(p2.shape, np.uint8(255))
    maps = right_maps(p2, q2, seen, size_px[0], size_px[1], variance2)
    fill_inverse_map(maps, 1)
    lit = np.zeros((height, 2), np.int32)
    known = np.isfinite(p1) & np.isfinite(q1)
    lit[:, 0], lit[:, 1] = known.argmax(axis=1), width - known[:, ::-1].argmax(axis=1)
    lit[~known.any(axis=1)] = 0
    left_maps = LeftMaps(p1, q1, half_dn, left.grey, left.grey, lit, np.float32(1.0), variance1)
    plane_mm = _plane_mm(depths_mm)
    step_px = min(usual_step_px(camera) for camera in cameras)
    try:
        first, second = (ray_lattice(camera, rig.index, plane_mm, step_px) for camera in cameras)
    except ValueError as error:
        raise ForeignError(f"cameras: {error}") from error
    rays = rays_of(first, second, width)
    table = PointTable(width * height)
    factors = sigma_factors(16, TYPICAL_PAIR)  # for its footprints alone: noise is the maps' own
    pieces = ((0, 0),)
    pixel_mm = _pixel_mm(cameras[0], plane_mm)
    # Twice: how far away the object is, and so how large a pixel on it, is known after the first time.
    for _ in range(2):
        limits = PointLimits(
            np.float32(GAP_PIXELS * pixel_mm),
            np.float32(SIGMA_PIXELS * pixel_mm),
            np.float32(depths_mm[0]),
            np.float32(depths_mm[1]),
            np.float32(STEP_PIXELS * pixel_mm),
            np.float32(LEAST_NEIGHBOURS),
        )
        count = int(
            reconstruct_rows(left_maps, maps, rays, limits, factors, 0, height, 1, scratch_rows(), table.points, 0)
        )
        pieces = ((0, count),)
        if count:
            pixel_mm = _pixel_mm(cameras[0], float(np.median(table.points.xyz_mm[:count, 2])))
    found = Found(pieces, summarise(int(known.sum()), table.points, pieces))
    return organised(table.cloud(found), left.grey)


def _scaled(maps: Mapping[str, CleanAxis], scale: float) -> tuple[Floats, Floats, Floats]:
    """Return both coordinates, NaN where one is missing, and the mean of their variances, in scaled px."""
    p, q = (maps[name].coordinate_px * np.float32(scale) for name in "xy")
    missing = np.isnan(p) | np.isnan(q)
    p[missing], q[missing] = np.nan, np.nan
    variance = np.float32(0.5 * scale**2) * (maps["x"].sigma_px ** 2 + maps["y"].sigma_px ** 2)
    return p, q, np.asarray(variance, np.float32)


def _projector(projector: HousedCamera) -> dict[str, CleanAxis]:
    """Return what a projector "sees": its own coordinates, without noise."""
    v, u = np.mgrid[0 : projector.height_px, 0 : projector.width_px].astype(np.float32)
    none = np.zeros_like(u)
    return {"x": CleanAxis(u, none, 1.0), "y": CleanAxis(v, none, 1.0)}


def _half_dn(camera: DecodedCamera) -> NDArray[np.uint8]:
    modulation = np.minimum.reduce([one.modulation for one in camera.placed.values()])
    return np.asarray(np.clip(np.rint(modulation * np.float32(510.0 / camera.images.white)), 0.0, 255.0), np.uint8)


def _front_mm(camera: HousedCamera) -> float:
    """Return the depth of the outer face of a camera's window."""
    port = 0.0 if camera.lens_in_water else camera.port.distance_mm + camera.port.thickness_mm
    return camera.translation_mm[2] + port + 1.0


def _plane_mm(depths_mm: tuple[float, float]) -> float:
    """Return the depth in the middle of the range, by its logarithm."""
    return math.sqrt(depths_mm[0] * depths_mm[1])


def _pixel_mm(camera: HousedCamera, depth_mm: float) -> float:
    """Return the size of a pixel on an object at that depth."""
    return depth_mm / camera.lens.f_px[0]
