"""The oracle of one direction: closed surfaces seen by exactly traced rays, and curves walked in depth in small steps, slow and obvious.

It shares the product's camera model and no more of what it judges: no lattice, no polynomial, no table, no interpolation between
pixels. The right image's coordinate at any place is that of the surface its ray meets first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.correction import ImageCorrection, node_count
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.rotation import matrix3, rotation_matrix

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sphere:
    centre_mm: tuple[float, float, float]
    radius_mm: float

    def hit(self, origin: Array, direction: Array) -> Array:
        """Ways along unit rays (n, 3) to the sphere; infinite where they miss it."""
        to = np.asarray(self.centre_mm) - origin
        middle = np.sum(to * direction, -1)
        inside = self.radius_mm**2 - np.sum(to * to, -1) + middle**2
        way = middle - np.sqrt(np.maximum(inside, 0.0))
        return np.where((inside > 0.0) & (way > 0.0), way, np.inf)


@dataclass(frozen=True)
class Sheet:
    """The part of the plane normal · X = offset whose points have x between two ends."""

    normal: tuple[float, float, float]
    offset_mm: float
    x_mm: tuple[float, float] = (-math.inf, math.inf)

    def hit(self, origin: Array, direction: Array) -> Array:
        normal = np.asarray(self.normal)
        way = (self.offset_mm - origin @ normal) / (direction @ normal)
        x = origin[..., 0] + way * direction[..., 0]
        return np.where((way > 0.0) & (x >= self.x_mm[0]) & (x <= self.x_mm[1]), way, np.inf)


Surfaces = Sequence[Sphere | Sheet]


@dataclass(frozen=True)
class Bench:
    """Two cameras and a projector in one medium; ``axis`` is the pattern coordinate that is used: 0 columns, 1 rows."""

    rig: StereoRig
    projector: HousedCamera
    index: float
    axis: int = 0


def first_hit(surfaces: Surfaces, camera: HousedCamera, index: float, uv_px: Array) -> Array:
    """Points (n, 3) that pixels (n, 2) see; NaN where they see nothing."""
    origin, direction = camera.rays(uv_px, index)
    way = np.min([surface.hit(origin, direction) for surface in surfaces], axis=0)
    return np.where(
        np.isfinite(way)[:, None], origin + np.where(np.isfinite(way), way, 0.0)[:, None] * direction, np.nan
    )


def coordinate(surfaces: Surfaces, bench: Bench, camera: HousedCamera, uv_px: Array) -> Array:
    """The pattern coordinate (n,) that pixels (n, 2) see; NaN where no light of the projector falls."""
    points = first_hit(surfaces, camera, bench.index, uv_px)
    pattern = bench.projector.project(points, bench.index)
    size = (bench.projector.width_px, bench.projector.height_px)
    with np.errstate(invalid="ignore"):
        inside = np.all((pattern > -0.5) & (pattern < np.asarray(size) - 0.5), axis=-1)
    lit = np.zeros(len(points), bool)
    lit[inside] = (
        np.linalg.norm(first_hit(surfaces, bench.projector, bench.index, pattern[inside]) - points[inside], axis=-1)
        < 1e-6
    )
    return np.where(lit, pattern[:, bench.axis], np.nan)


def pixels(camera: HousedCamera) -> Array:
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].reshape(2, -1)
    return np.stack([u, v], -1).astype(float)


def maps(surfaces: Surfaces, bench: Bench) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The coordinates of all pixels of both cameras, (h, w) float32."""
    left, right = (
        coordinate(surfaces, bench, camera, pixels(camera))
        .reshape(camera.height_px, camera.width_px)
        .astype(np.float32)
        for camera in (bench.rig.left, bench.rig.right)
    )
    return left, right


def walk(
    surfaces: Surfaces,
    bench: Bench,
    uv_px: Array,
    p_px: Array,
    z_mm: tuple[float, float],
    step_mm: float,
    jump_px: float,
) -> list[list[float]]:
    """All depths at which the points along each left pixel's ray (n, 2) are seen by the right camera with the coordinate ``p_px`` (n,).

    Walks in steps of ``step_mm`` and bisects each change of sign that is no jump.
    """
    right = bench.rig.right
    z = np.arange(z_mm[0], z_mm[1], step_mm)
    found: list[list[float]] = []
    for pixel, p in zip(uv_px, p_px, strict=True):
        origin, direction = bench.rig.left.rays(pixel, bench.index)

        def more(depth: Array, o: Array = origin, d: Array = direction, own: float = float(p)) -> Array:
            points = o + d * ((depth - o[2]) / d[2])[:, None]
            seen = right.project(points, bench.index)
            inside = np.all((seen >= -0.5) & (seen <= [right.width_px - 0.5, right.height_px - 0.5]), axis=-1)
            out = np.full(len(depth), np.nan)
            out[inside] = coordinate(surfaces, bench, right, seen[inside]) - own
            return out

        g = more(z)
        with np.errstate(invalid="ignore"):
            crosses = (g[:-1] * g[1:] <= 0.0) & (np.abs(g[1:] - g[:-1]) < jump_px)
        low, high, at_low = z[:-1][crosses], z[1:][crosses], g[:-1][crosses]
        for _ in range(40):
            middle = 0.5 * (low + high)
            same = more(middle) * at_low > 0.0
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        found.append([float(depth) for depth in 0.5 * (low + high)])
    return found


def _facing(
    place_mm: tuple[float, float, float], target_mm: tuple[float, float, float], turn_deg: float = 0.0
) -> Array:
    """The rotation of a camera at a place whose axis goes through ``target_mm``; its x axis lies level but for ``turn_deg``."""
    z = np.subtract(target_mm, place_mm)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.asarray(
        np.stack([x, np.cross(z, x), z], axis=1) @ rotation_matrix(np.array([0.0, 0.0, math.radians(turn_deg)]))
    )


def _at(
    camera: HousedCamera,
    place_mm: tuple[float, float, float],
    target_mm: tuple[float, float, float],
    turn_deg: float = 0.0,
) -> HousedCamera:
    return HousedCamera(
        camera.width_px, camera.height_px, camera.lens, camera.port, matrix3(_facing(place_mm, target_mm, turn_deg)), place_mm,
        camera.correction, camera.ray_shift, camera.lens_in_water,
    )  # fmt: skip


PERPENDICULAR = Port((0.0, 0.0, 1.0), 30.0, 5.0, 1.77)
TARGET_MM = (0.0, 0.0, 520.0)
PROJECTOR = HousedCamera(1024, 768, Lens((1564.8, 1564.8), (511.5, 383.5)), PERPENDICULAR)


def as_drawn(width_px: int = 240, height_px: int = 180) -> Bench:
    """The middle of the product's images: its pixels and angles, few of them. The left camera looks straight ahead."""
    camera = HousedCamera(
        width_px, height_px, Lens((2555.6, 2555.6), (0.5 * width_px - 0.5, 0.5 * height_px - 0.5)), PERPENDICULAR
    )
    right = _at(camera, (220.0, 0.0, 48.0), TARGET_MM)
    return Bench(StereoRig(camera, right), _at(PROJECTOR, (110.0, 0.0, 24.0), TARGET_MM), 1.335)


def as_built() -> Bench:
    """Tilted ports, distorted lenses, an image correction and a ray shift, and cameras of different size."""
    rng = np.random.default_rng(11)

    def built(width_px: int, height_px: int, tilt: tuple[float, float]) -> HousedCamera:
        normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
        # Of an image of 1600 px: what is left of it has coordinates of its own, and the same distortion about its own middle.
        lens = Lens((2549.0, 2552.5), (0.5 * width_px + 3.2, 0.5 * height_px - 5.1), (-0.19, 0.31, 4e-4, -3e-4, 0.0))
        shift = 0.05 * rng.standard_normal(2 * node_count((2, 2)))
        beside = 0.01 * rng.standard_normal(2 * node_count((2, 2)))
        return HousedCamera(
            width_px, height_px, lens, Port((float(normal[0]), float(normal[1]), float(normal[2])), 31.2, 5.02, 1.767),
            correction=ImageCorrection(width_px, height_px, (2, 2), tuple(float(one) for one in shift)),
            ray_shift=RayShift(width_px, height_px, (2, 2), tuple(float(one) for one in beside)),
        )  # fmt: skip

    right = _at(built(260, 170, (-0.006, 0.009)), (221.3, 1.2, 47.1), TARGET_MM, 0.6)
    return Bench(
        StereoRig(built(240, 180, (0.008, -0.005)), right), _at(PROJECTOR, (108.0, 14.0, 25.0), TARGET_MM), 1.3412
    )


def stacked() -> Bench:
    """The right camera above the left one, behind ports, and fringes of rows."""
    drawn = as_drawn()
    right = _at(drawn.rig.right, (0.0, 220.0, 48.0), TARGET_MM)
    return Bench(StereoRig(drawn.rig.left, right), _at(PROJECTOR, (0.0, 110.0, 24.0), TARGET_MM), 1.335, axis=1)
