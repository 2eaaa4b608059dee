"""A scan as registration reads it: small plane patches on an image grid, and the camera's projection.

A patch is a square block of pixels, about a millimetre on the object. Its plane is the least-squares plane of its
points. Its distance is several times more certain than that of a point, and thousands of patches are enough to
register a scan.

Symbols: c, n, s  centre, unit normal towards the camera, standard deviation of the centre along the normal of a patch
         (gh, gw) rows and columns of patches; N  points in a block
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.points.organised import OrganisedCloud

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

PATCH_MM = 1.0
"""Side of a patch on an object in the middle of the volume, mm."""
FILLED = 0.75
"""Least share of a block's pixels with a point."""
MAX_ROUGH_MM = 0.12
"""Largest RMS distance of a block's points from their plane, beyond their noise: more is an edge, without a normal."""
MAX_BEND_MM = 0.8
"""Largest second difference of neighbouring centres that counts as curvature, not as an edge."""
ROUGH_COUNTS = 1.0
"""Variance of a rough patch's plane, over that of its points from it."""
MIN_COSINE = 0.25
"""Least cosine between a patch's normal and its ray: flatter ones are smeared."""
CORRELATED_PIXELS = 4.0
"""Number of points that count as one independent point, since neighbours share the noise of pixels."""
FLOOR_MM = 0.004
"""Standard deviation added to every patch, for curvature within it and interpolation between patches."""
BRIDGE_CELLS = 2.5
"""Standard deviation of the neighbourhood that bridges a hole, patches."""
HOLE_CELLS = 11
"""Holes up to so many patches across are bridged."""
MIN_AROUND = 0.15
"""Least weight of patches with points in that neighbourhood."""
MAX_AROUND_MM = 0.6
"""Largest standard deviation, over the neighbourhood's planes, of the depth that they give a hole."""
BRIDGED_SIGMA_MM = 0.5
"""Standard deviation of a bridged patch: so large that only its grey value counts."""
DEPTHS_MM = (330.0, 420.0, 520.0, 640.0, 780.0)
"""Depths of the standard housing between which the projection is interpolated."""


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """The projection of a point to its pixel, as a polynomial of direction and inverse depth.

    It includes refraction. The error is at most 0.1 px within the working volume: enough to find the patch below a
    point, whose plane then gives the distance.
    """

    terms: Array
    """(20, 2): coefficients of the cubic in (x/z, y/z, 1/z)."""
    centre: Array
    spread: Array
    size_px: tuple[int, int]
    """(h, w)."""
    volume: WorkingVolume = STANDARD
    """Range of the housing that it was fitted for."""

    def pixels(self, points_mm: Array) -> Array:
        """Return column and row (…, 2), px, of points (…, 3) in the camera's frame; NaN behind the camera."""
        z = points_mm[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = np.where(z > 1.0, 1.0 / z, np.nan)
        a = (points_mm[..., 0] * inverse - self.centre[0]) / self.spread[0]
        b = (points_mm[..., 1] * inverse - self.centre[1]) / self.spread[1]
        t = (inverse - self.centre[2]) / self.spread[2]
        return _cubic(a, b, t) @ self.terms


def _cubic(a: Array, b: Array, t: Array) -> Array:
    """Return the 20 products up to third order."""
    aa, bb, tt, ab = a * a, b * b, t * t, a * b
    return np.stack(
        [np.ones_like(a), a, b, t, aa, ab, bb, a * t, b * t, tt,
         aa * a, aa * b, a * bb, bb * b, aa * t, ab * t, bb * t, a * tt, b * tt, tt * t],
        axis=-1,
    )  # fmt: skip


def projection_of(camera: HousedCamera, water_index: float, volume: WorkingVolume = STANDARD) -> Projection:
    """Fit the projection of a camera in water to its refracted rays, over the depths of its housing."""
    depths_mm = [volume.scaled(depth) for depth in DEPTHS_MM]
    u, v = np.meshgrid(np.linspace(0, camera.width_px - 1, 24), np.linspace(0, camera.height_px - 1, 18))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    origin, direction = camera.rays(uv, water_index)
    points = np.concatenate(
        [origin + direction * ((depth - origin[:, 2]) / direction[:, 2])[:, None] for depth in depths_mm]
    )
    pixels_px = np.tile(uv, (len(depths_mm), 1))
    value = np.stack([points[:, 0] / points[:, 2], points[:, 1] / points[:, 2], 1.0 / points[:, 2]], axis=1)
    centre, spread = np.asarray(value.mean(axis=0)), np.asarray(value.std(axis=0))
    a, b, t = ((value - centre) / spread).T
    terms = np.asarray(np.linalg.lstsq(_cubic(a, b, t), pixels_px, rcond=None)[0], np.float64)
    return Projection(terms, centre, spread, (camera.height_px, camera.width_px), volume)


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """A scan as patches; arrays are (gh, gw, …), NaN where there is no patch."""

    centre_mm: Array
    normal: Array
    sigma_mm: Array
    """Standard deviation of the centre along the normal."""
    log_grey: Array
    """Natural logarithm of the mean grey value of the bright image; NaN where it is saturated or black."""
    grey_noise: Array
    """Standard deviation of ``log_grey`` by the sensor's noise."""
    block_px: int
    projection: Projection

    @property
    def valid(self) -> Bools:
        """Mask (gh, gw) of the cells that have a patch."""
        return np.isfinite(self.sigma_mm)

    def cells(self, points_mm: Array) -> Array:
        """Return (…, 2) column and row, fractional, on the patch grid for points (…, 3) in this scan's frame."""
        return (self.projection.pixels(points_mm) - 0.5 * (self.block_px - 1)) / self.block_px


def block_size_px(cloud: OrganisedCloud) -> int:
    """Return the side of a block of about ``PATCH_MM``, px, from the distances of neighbouring points."""
    points = cloud.points_mm
    step = np.linalg.norm(points[::7, 1::7][:, :200] - points[::7, :-1:7][:, :200], axis=-1)
    finite = step[np.isfinite(step)]
    return 4 if not finite.size else max(2, min(16, round(PATCH_MM / max(float(np.median(finite)), 0.05))))


def patches_of(cloud: OrganisedCloud, projection: Projection, block_px: int | None = None) -> Patches:
    """Cut ``cloud`` into patches of ``block_px`` pixels a side (``None``: of about ``PATCH_MM``)."""
    size = block_px or block_size_px(cloud)
    h, w = cloud.shape
    gh, gw = h // size, w // size

    def blocks(values: NDArray[np.generic]) -> Array:
        cut = values[: gh * size, : gw * size].astype(np.float64)
        return cut.reshape(gh, size, gw, size).transpose(0, 2, 1, 3).reshape(gh, gw, size * size)

    mask = blocks(cloud.mask) > 0.0
    count = mask.sum(axis=-1)
    enough = count >= FILLED * size * size
    weight = mask / np.maximum(count, 1)[..., None]
    xyz = [np.where(mask, blocks(cloud.points_mm[..., k]), 0.0) for k in range(3)]
    centre = np.stack([(weight * axis).sum(axis=-1) for axis in xyz], axis=-1)
    dx, dy, dz = (np.where(mask, axis - centre[..., k, None], 0.0) for k, axis in enumerate(xyz))
    # Least squares of depth on x and y: noise is along the ray, so x and y are almost free of it.
    sxx, sxy, syy = (dx * dx).sum(-1), (dx * dy).sum(-1), (dy * dy).sum(-1)
    sxz, syz = (dx * dz).sum(-1), (dy * dz).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = sxx * syy - sxy * sxy
        slope_x, slope_y = (sxz * syy - syz * sxy) / det, (syz * sxx - sxz * sxy) / det
        residual = np.where(mask, dz - slope_x[..., None] * dx - slope_y[..., None] * dy, 0.0)
        rough2 = (residual * residual).sum(-1) / np.maximum(count - 3, 1)
        normal = np.stack([slope_x, slope_y, -np.ones_like(slope_x)], axis=-1)
        length = np.linalg.norm(normal, axis=-1)
        normal /= length[..., None]
        away = -(normal * centre).sum(-1) / np.linalg.norm(centre, axis=-1)
        sigma2 = (weight * np.where(mask, blocks(cloud.sigma_mm), 0.0) ** 2).sum(-1)
        flat = np.sqrt(np.maximum(rough2 - sigma2, 0.0)) < MAX_ROUGH_MM
        # The noise along the ray, projected onto the normal.
        sigma = np.sqrt(sigma2 * CORRELATED_PIXELS / np.maximum(count, 1)) / length
        # Roughness beyond noise is shape, such as a weld or an edge: there the plane depends on how the blocks lie.
        shape2 = np.maximum(rough2 - sigma2 * (1.0 + 2.0 * np.sqrt(2.0 / np.maximum(count, 1))), 0.0)
        sigma = np.sqrt(sigma**2 + ROUGH_COUNTS * shape2)
    is_plane = enough & flat & (away > MIN_COSINE)
    grey = blocks(cloud.grey)
    well_exposed = (grey.max(-1) < 255) & (grey.mean(-1) > 6.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_grey = np.log(grey.mean(-1))
        # Photon noise of an 8-bit camera near full well: about half a grey value at 30, 1.6 at 250.
        noise = np.sqrt(0.25 + 0.01 * grey.mean(-1)) / grey.mean(-1) / size
    centre = np.where(is_plane[..., None], centre, np.nan)
    normal = np.where(is_plane[..., None], normal, np.nan)
    sigma = np.where(is_plane, np.hypot(sigma, FLOOR_MM), np.nan)
    centre = _on_the_surface(centre, normal)
    unbridged = _bridged(centre, normal, sigma, well_exposed)
    return Patches(
        centre_mm=centre,
        normal=normal,
        sigma_mm=sigma,
        log_grey=np.where(unbridged | ~well_exposed, np.nan, log_grey),
        grey_noise=np.where(unbridged | ~well_exposed, np.nan, noise),
        block_px=size,
        projection=projection,
    )


def _on_the_surface(centre: Array, normal: Array) -> Array:
    """Return the centres, moved from the mean of their points onto the surface.

    The mean over a side h of a surface of curvature κ lies κ h² / 24 inside of it; the second difference of the centres
    is κ h². On a weld of 4 mm radius that is 18 µm, more on the side that is seen obliquely. Uncorrected, it would
    shift every pair in the same direction.
    """
    inside = np.zeros(centre.shape[:2])
    for axis in (0, 1):
        c = np.moveaxis(centre, axis, 0)
        second = np.full(c.shape[:2], np.nan)
        second[1:-1] = ((c[2:] - 2.0 * c[1:-1] + c[:-2]) * np.moveaxis(normal, axis, 0)[1:-1]).sum(-1)
        # Across an edge the second difference is not curvature.
        inside += np.moveaxis(np.nan_to_num(np.where(np.abs(second) < MAX_BEND_MM, second, 0.0)), 0, axis)
    return np.asarray(centre - normal * (inside / 24.0)[..., None])


def _bridged(centre: Array, normal: Array, sigma: Array, well_exposed: Bools) -> Bools:
    """Give small holes the plane of their neighbourhood, in place; return where there is still no patch.

    Dark print has no points, yet its border is what fixes a flat board: its position follows from its neighbourhood,
    and its grey values are visible. The distance of a bridged patch has almost no weight. A plane n · p = n · c is h ·
    p = 1 with h = n / (n · c), and along a direction d the inverse depth is h · d: planes are averaged by their h.
    """
    good = np.isfinite(sigma)
    if np.count_nonzero(good) < 50:
        return ~good
    with np.errstate(invalid="ignore"):
        h = np.where(good[..., None], normal / (normal * centre).sum(-1)[..., None], 0.0)
    share = cv2.GaussianBlur(good.astype(np.float64), (0, 0), BRIDGE_CELLS)
    mean = cv2.GaussianBlur(h, (0, 0), BRIDGE_CELLS) / np.maximum(share, 1e-9)[..., None]
    # Directions of all cells, fitted to those of cells with points.
    gh, gw = good.shape
    v, u = np.mgrid[0:gh, 0:gw]
    terms = _cubic((u - gw / 2) / gw, (v - gh / 2) / gw, np.zeros(good.shape))
    centres_mm = centre[good]
    fit = np.linalg.lstsq(terms[good], centres_mm[:, :2] / centres_mm[:, 2:], rcond=None)[0]
    d = np.concatenate([terms @ fit, np.ones((gh, gw, 1))], axis=-1)
    inverse = (mean * d).sum(-1)
    # Only holes enclosed on all sides: beyond the object's border is background, which has grey values, too.
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (HOLE_CELLS, HOLE_CELLS))
    padded = cv2.copyMakeBorder(good.astype(np.uint8), *(HOLE_CELLS,) * 4, cv2.BORDER_REPLICATE)
    enclosed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc)[HOLE_CELLS:-HOLE_CELLS, HOLE_CELLS:-HOLE_CELLS] > 0
    # The depths that the surrounding planes give along this direction must agree; at a depth discontinuity they do not.
    second = np.zeros(good.shape)
    for i in range(3):
        for k in range(3):
            blurred = cv2.GaussianBlur(h[..., i] * h[..., k], (0, 0), BRIDGE_CELLS) / np.maximum(share, 1e-9)
            second += blurred * d[..., i] * d[..., k]
    with np.errstate(divide="ignore", invalid="ignore"):
        spread_mm = np.sqrt(np.maximum(second - inverse**2, 0.0)) / inverse**2
        hole = ~good & well_exposed & enclosed & (share > MIN_AROUND) & (spread_mm < MAX_AROUND_MM) & (inverse > 1e-3)
        centre[hole] = (d / inverse[..., None])[hole]
        normal[hole] = (mean / np.linalg.norm(mean, axis=-1)[..., None])[hole]
    # Where n · c is negative, the division has turned h away from the camera.
    away = (normal * centre).sum(-1) > 0.0
    normal[away] *= -1.0
    sigma[hole] = BRIDGED_SIGMA_MM
    return np.asarray(~(good | hole))


def coarser(patches: Patches, factor: int) -> Patches:
    """Join ``factor`` × ``factor`` patches to one, for the search by shape."""
    gh, gw = (n // factor for n in patches.sigma_mm.shape)

    def joined(values: NDArray[Any]) -> NDArray[Any]:
        cut = values[: gh * factor, : gw * factor]
        trailing = cut.shape[2:]
        return cut.reshape(gh, factor, gw, factor, *trailing).swapaxes(1, 2).reshape(gh, gw, factor * factor, *trailing)

    valid = joined(patches.valid)
    few = valid.sum(-1) < 0.5 * factor * factor

    def mean(values: Array) -> Array:
        with np.errstate(invalid="ignore"):
            finite = np.isfinite(values)
            total = np.where(finite, values, 0.0).sum(axis=2)
            return np.asarray(total / np.maximum(finite.sum(axis=2), 1))

    normal = mean(joined(patches.normal))
    with np.errstate(divide="ignore", invalid="ignore"):
        normal /= np.linalg.norm(normal, axis=-1)[..., None]
    grey = joined(patches.log_grey)
    dark = np.isfinite(grey).sum(-1) < 0.5 * factor * factor
    return Patches(
        centre_mm=np.where(few[..., None], np.nan, mean(joined(patches.centre_mm))),
        normal=np.where(few[..., None], np.nan, normal),
        sigma_mm=np.where(few, np.nan, mean(joined(patches.sigma_mm))),
        log_grey=np.where(few | dark, np.nan, mean(grey)),
        grey_noise=np.where(few | dark, np.nan, mean(joined(patches.grey_noise)) / factor),
        block_px=patches.block_px * factor,
        projection=patches.projection,
    )
