"""Owns what an ideal camera measures of balls and boxes: organised clouds with noise drawn along the rays, whose truth is a formula."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.points.organised import OrganisedCloud

Vectors = NDArray[np.float64]


@dataclass(frozen=True)
class Ball:
    centre_mm: tuple[float, float, float]
    radius_mm: float

    def hit(self, origin: Vectors, rays: Vectors) -> Vectors:
        """Ways along unit rays to the ball; infinite where they miss it."""
        to = origin - np.asarray(self.centre_mm)
        b = rays @ to
        inside = b**2 - (to @ to - self.radius_mm**2)
        return np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0.0)), np.inf)

    def off(self, points: Vectors) -> Vectors:
        """How far points lie outside of the ball."""
        return np.asarray(np.linalg.norm(points - np.asarray(self.centre_mm), axis=-1) - self.radius_mm)


@dataclass(frozen=True)
class Box:
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    def hit(self, origin: Vectors, rays: Vectors) -> Vectors:
        with np.errstate(divide="ignore", invalid="ignore"):
            one = (np.asarray(self.low_mm) - origin) / rays
            other = (np.asarray(self.high_mm) - origin) / rays
        enter = np.minimum(one, other).max(axis=-1)
        leave = np.maximum(one, other).min(axis=-1)
        return np.where((enter <= leave) & (enter > 0), enter, np.inf)


@dataclass(frozen=True)
class Pose:
    """Points p of a camera are at rotation · p + translation in the object's frame."""

    rotation: Vectors
    translation_mm: Vectors

    def moved(self, by_mm: Vectors | tuple[float, float, float]) -> Pose:
        return Pose(self.rotation, self.translation_mm + np.asarray(by_mm))


def looking(eye_mm: Sequence[float], at_mm: Sequence[float] = (0.0, 0.0, 0.0)) -> Pose:
    """A camera at ``eye_mm`` whose z axis goes through ``at_mm``; its x axis is horizontal as far as that is possible."""
    eye, at = np.asarray(eye_mm, float), np.asarray(at_mm, float)
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross([0.0, 0.0, 1.0] if abs(z[2]) < 0.9 else [0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return Pose(np.stack([x, np.cross(z, x), z], axis=1), eye)


def around(count: int, distance_mm: float, height_mm: float = 0.0) -> list[Pose]:
    """Cameras on a circle about the origin's z axis that look at the origin."""
    angles = [2.0 * math.pi * k / count for k in range(count)]
    return [looking((distance_mm * math.cos(a), distance_mm * math.sin(a), height_mm)) for a in angles]


def seen(
    solids: Sequence[Ball | Box],
    pose: Pose,
    seed: int,
    size_px: tuple[int, int] = (200, 150),
    pitch: float = 0.0004,
    noise_mm: float = 0.02,
    steepest: float = 80.0,
) -> OrganisedCloud:
    """What a camera at ``pose`` measures, (h, w); ``pitch``: tangent of the angle between neighbours. Of a ball, nothing that
    is seen at more than ``steepest`` degrees."""
    w, h = size_px
    v, u = np.mgrid[0:h, 0:w].astype(float)
    rays = np.stack([(u - (w - 1) / 2) * pitch, (v - (h - 1) / 2) * pitch, np.ones_like(u)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    world = rays @ pose.rotation.T
    way = np.full((h, w), np.inf)
    for solid in solids:
        hit = solid.hit(pose.translation_mm, world)
        if isinstance(solid, Ball):
            out = (pose.translation_mm + world * np.where(np.isfinite(hit), hit, 0.0)[..., None]) - solid.centre_mm
            cos = -np.einsum("yxk,yxk->yx", out, world) / solid.radius_mm
            hit = np.where(cos > math.cos(math.radians(steepest)), hit, np.inf)
        way = np.minimum(way, hit)
    rng = np.random.default_rng(seed)
    points = rays * (way + noise_mm * rng.standard_normal((h, w)))[..., None]
    points[~np.isfinite(way)] = np.nan
    there = np.isfinite(way)
    column = np.where(there, np.float32(1.0), np.float32(np.nan))
    return OrganisedCloud(
        points_mm=points.astype(np.float32),
        sigma_mm=column * np.float32(max(noise_mm, 1e-3)),
        modulation_dn=column * np.float32(40.0),
        ray_gap_mm=column * np.float32(0.01),
        grey=((u.astype(int) * 7 + v.astype(int) * 3) % 200 + 20).astype(np.uint8),
    )
