"""Image sets as they lie on strangers' disks: a ball before a tilted wall, seen by cameras and lit by a projector of OpenCV's model.

Nothing of the product and nothing of the simulated world is in it: rays are cut with a sphere and a plane, a camera pixel is the mean
of some rays of its own, and what the projector shows there is read from its image. So a set costs a second, and whatever a file's
name, a YAML key or a sequence may be elsewhere is written down here by hand.

Frames: the left camera's, mm, z forward. ``R`` and ``t_mm`` of a view map a point of that frame into the view's own: x' = R x + t.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

BALL_MM, BALL_RADIUS_MM = np.array([15.0, -10.0, 560.0]), 70.0
WALL = np.array([0.12, -0.08, 0.989])
WALL_MM = 640.0
"""Points x of the wall have WALL · x = WALL_MM."""
RAYS = 3
"""Rays of a camera pixel across and down."""
NO_TURN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class View:
    """A camera or a projector of OpenCV's model."""

    width_px: int
    height_px: int
    K: Array
    D: Array
    R: Array
    t_mm: Array

    @property
    def centre_mm(self) -> Array:
        return np.asarray(-self.R.T @ self.t_mm)


def view(
    width_px: int, height_px: int, f_px: float, at_mm: Sequence[float], turn: Sequence[float] = NO_TURN,
    c_px: tuple[float, float] | None = None, D: Sequence[float] = (0.0, 0.0, 0.0, 0.0, 0.0),
) -> View:  # fmt: skip
    """A view that stands at ``at_mm`` and is turned by the rotation vector ``turn``."""
    R = np.asarray(cv2.Rodrigues(np.array(turn, np.float64))[0], np.float64)
    cu, cv = c_px or (0.5 * width_px - 0.5, 0.5 * height_px - 0.5)
    K = np.array([[f_px, 0.0, cu], [0.0, f_px, cv], [0.0, 0.0, 1.0]])
    return View(width_px, height_px, K, np.array(D, np.float64), R, -R @ np.array(at_mm, np.float64))


def _first_hit(origin_mm: Array, directions: Array) -> Array:
    """Distances along unit rays (n, 3) to the ball or the wall."""
    to_wall = (WALL_MM - origin_mm @ WALL) / (directions @ WALL)
    from_ball = origin_mm - BALL_MM
    half = directions @ from_ball
    square = half**2 - (from_ball @ from_ball - BALL_RADIUS_MM**2)
    to_ball = np.where(square > 0.0, -half - np.sqrt(np.maximum(square, 0.0)), np.inf)
    return np.asarray(np.minimum(to_wall, np.where(to_ball > 0.0, to_ball, np.inf)))


def distance_mm(points_mm: Array) -> Array:
    """Distance of points (n, 3) from the nearer one of ball and wall."""
    points = np.asarray(points_mm, np.float64)
    off_ball = np.abs(np.linalg.norm(points - BALL_MM, axis=1) - BALL_RADIUS_MM)
    return np.asarray(np.minimum(off_ball, np.abs(points @ WALL - WALL_MM)))


@dataclass(frozen=True, eq=False)
class Lit:
    """Places on the projector that the rays of a camera's pixels see, (rays · h, w) each; and the share of light, 0 in the shadow."""

    column: NDArray[np.float32]
    row: NDArray[np.float32]
    shade: NDArray[np.float32]
    points_mm: Array
    """(h, w, 3): where the middle of each pixel's rays lies."""


def projected(seen_by: View, points_mm: Array) -> Array:
    """Pixels (n, 2) of points (n, 3), by OpenCV's model; its own function makes a matrix of slopes besides, and takes ten times as long."""
    x, y, z = seen_by.R @ points_mm.T + seen_by.t_mm[:, None]
    x, y, (k1, k2, p1, p2, k3) = x / z, y / z, seen_by.D
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    xy = np.stack([
        x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        np.ones_like(x),
    ])  # fmt: skip
    return np.asarray((seen_by.K @ xy)[:2].T)


def _paint(points_mm: Array, seed: int) -> Array:
    """Albedo of points (n, 3), 0.4 to 1: random in cells of 10 mm and of 3 mm, smooth between them."""
    paint = np.full(len(points_mm), 0.7)
    for cell_mm, depth in ((10.0, 0.18), (3.0, 0.12)):
        grid = np.random.default_rng([seed, int(cell_mm)]).uniform(-1.0, 1.0, (32, 32, 32))
        paint += depth * map_coordinates(grid, points_mm.T / cell_mm % 32.0, order=1, mode="grid-wrap")
    return paint


@lru_cache(maxsize=16)
def lit(camera: View, projector: View, texture: int | None = None) -> Lit:
    """Cut the rays of all pixels with the scene and look what the projector shows there; the thing is white, or painted by the seed ``texture``."""
    inner = (np.arange(RAYS) + 0.5) / RAYS - 0.5
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(np.float64)
    uv = np.stack([np.stack([u + du, v + dv], -1) for dv in inner for du in inner]).reshape(-1, 1, 2)
    xy = cv2.undistortPoints(np.ascontiguousarray(uv), camera.K, camera.D).reshape(-1, 2)
    rays = np.concatenate([xy, np.ones((len(xy), 1))], 1) @ camera.R
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = camera.centre_mm + rays * _first_hit(camera.centre_mm, rays)[:, None]
    beams = points - projector.centre_mm
    length = np.linalg.norm(beams, axis=1)
    shadow = _first_hit(projector.centre_mm, beams / length[:, None]) < length - 0.05
    seen = projected(projector, points)
    shape = (RAYS * RAYS * camera.height_px, camera.width_px)
    column, row = (seen[:, k].astype(np.float32).reshape(shape) for k in (0, 1))
    shade = np.where(shadow, 0.0, (560.0 / length) ** 2)
    if texture is not None:
        shade = shade * _paint(points, texture)
    middle = points.reshape(RAYS * RAYS, camera.height_px, camera.width_px, 3)[RAYS * RAYS // 2]
    return Lit(column, row, shade.astype(np.float32).reshape(shape), middle)


def photographs(
    camera: View,
    projector: View,
    patterns: Iterable[Image],
    seed: int,
    gain: float = 0.8,
    noise: float = 0.8,
    texture: int | None = None,
) -> list[Image]:
    """Grey pictures of projected patterns, with ambient light and noise."""
    there = lit(camera, projector, texture)
    random = np.random.default_rng(seed)
    shots = []
    for pattern in patterns:
        # Between the projector's pixels the light is mixed: no lens draws their borders.
        light = there.shade * cv2.remap(pattern, there.column, there.row, cv2.INTER_LINEAR).astype(np.float32)
        grey = 6.0 + gain * light.reshape(RAYS * RAYS, camera.height_px, camera.width_px).mean(0)
        grey = grey + random.normal(0.0, noise, grey.shape)
        shots.append(np.clip(np.rint(grey), 0, 255).astype(np.uint8))
    return shots


# ------------------------------------------------------------------------------------------------------ patterns


def along(codes: Array, axis: str, size_px: tuple[int, int]) -> Image:
    width_px, height_px = size_px
    grey = np.clip(np.rint(codes), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(grey[None, :] if axis == "x" else grey[:, None], (height_px, width_px)))


def flat(code: int, size_px: tuple[int, int]) -> Image:
    return np.full((size_px[1], size_px[0]), code, np.uint8)


def gray(axis: str, size_px: tuple[int, int], bits: int, stripe_px: float = 1.0, offset_px: float = 0.0) -> list[Image]:
    """Images of a Gray code, coarsest first; bright is a bit that is set."""
    edge = np.arange(size_px["xy".index(axis)]) + 0.5
    number = np.floor((edge - offset_px) / stripe_px).astype(int)
    code = number ^ (number >> 1)
    return [along(250.0 * ((code >> bit) & 1), axis, size_px) for bit in reversed(range(bits))]


def with_inverses(images: Sequence[Image], code: int = 250) -> list[Image]:
    return [one for image in images for one in (image, (code - image).astype(np.uint8))]


def sine(axis: str, size_px: tuple[int, int], period_px: float, steps_deg: Sequence[float]) -> list[Image]:
    phase = 2 * np.pi * (np.arange(size_px["xy".index(axis)]) + 0.5) / period_px
    return [along(128.0 + 118.0 * np.cos(phase + np.deg2rad(step)), axis, size_px) for step in steps_deg]


# --------------------------------------------------------------------------------------------------------- rigs


@dataclass(frozen=True, eq=False)
class Bench:
    """A laboratory's rig."""

    left: View
    right: View
    projector: View

    @property
    def R(self) -> Array:  # noqa: N802 (OpenCV's name)
        return self.right.R

    @property
    def T(self) -> Array:  # noqa: N802 (OpenCV's name)
        return self.right.t_mm


@lru_cache(maxsize=8)
def pair(width_px: int = 320, projector_px: tuple[int, int] = (1024, 768)) -> Bench:
    """Two cameras that look towards each other, and a projector between them, above."""
    f_px, height_px = 1.35 * width_px, width_px * 3 // 4
    return Bench(
        view(width_px, height_px, f_px, (0.0, 0.0, 0.0), D=(-0.08, 0.03, 0.0005, -0.0004, 0.0)),
        view(width_px, height_px, 1.02 * f_px, (150.0, 3.0, 6.0), (0.01, 0.25, 0.01), D=(-0.06, 0.02, 0.0, 0.0, 0.0)),
        view(*projector_px, 1.25 * projector_px[0], (70.0, -40.0, -10.0), (0.06, 0.12, 0.0)),
    )


@lru_cache(maxsize=8)
def with_projector(width_px: int = 320, projector_px: tuple[int, int] = (1024, 768)) -> Bench:
    """One camera, and a projector whose axis leaves at its lower edge, as office projectors do."""
    height_px = width_px * 3 // 4
    c_px = (0.5 * projector_px[0], 1.02 * projector_px[1])
    projector = view(
        *projector_px,
        1.6 * projector_px[0],
        (160.0, 90.0, 0.0),
        (0.10, 0.26, 0.0),
        c_px=c_px,
        D=(0.01, -0.02, 0.0, 0.0, 0.0),
    )
    camera = view(width_px, height_px, 1.6 * width_px, (0.0, 0.0, 0.0), D=(-0.08, 0.03, 0.0005, -0.0004, 0.0))
    return Bench(camera, projector, projector)


def yaml(path: Path, **values: Any) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()


def save(path: Path, image: NDArray[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def without_distortion(bench: Bench) -> Bench:
    """The same rig with pinholes."""
    left, right, projector = (
        replace(one, D=np.zeros_like(one.D)) for one in (bench.left, bench.right, bench.projector)
    )
    return Bench(left, right, projector)
