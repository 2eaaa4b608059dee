"""Owns the scenes that distances are measured in: objects, textures, waters, ambient light, hands, and dots that are hidden."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.motion import Motion
from hw_sim.optics.points import project
from hw_sim.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig
from hw_sim.water import Water, turbid

Array = NDArray[np.float64]

OBJECTS = ("plane", "pipe", "frustum", "shell", "stones", "board", "ballbar")
TEXTURES = ("none", "slight", "strong", "checker")
WATERS = {"clear": Water(), "c = 1/m": turbid(1.0), "c = 2/m": turbid(2.0)}
AMBIENT = (0.02, 0.02, 0.1, 0.4)
EXPOSURE_S = 0.012
HIDDEN_SHARE = 0.2
MOVING_SHARE = 0.3
AWAY_MM = 400.0, 600.0
"""Of the object's middle; its surface can be nearer."""


@dataclass(frozen=True, slots=True)
class Case:
    scene: Scene
    water: str
    hidden: tuple[str, int] | None
    """Camera and pointer whose dot a weed hides."""


def drawn(rng: np.random.Generator, name: str | None = None) -> Case:
    """A scene at random."""
    water = str(rng.choice(list(WATERS)))
    name = str(rng.choice(OBJECTS)) if name is None else name
    x, y, z = rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0), rng.uniform(*AWAY_MM)
    turns = rng.uniform(-20.0, 20.0, 3)
    moving = rng.uniform() < MOVING_SHARE
    vx, vy, vz = (float(v) for v in rng.normal(0.0, 25.0, 3))
    motion = Motion(velocity_mm_s=(vx, vy, vz)) if moving else Motion()
    scene = Scene(
        object=name,
        pose=(float(x), float(y), float(z), float(turns[0]), float(turns[1]), float(turns[2])),
        texture=str(rng.choice(TEXTURES)),
        water=WATERS[water],
        ambient=float(rng.choice(AMBIENT)),
        motion=motion,
    )
    hidden = None
    if rng.uniform() < HIDDEN_SHARE:
        hidden = (str(rng.choice(("left", "right"))), int(rng.integers(2)))
    return Case(scene, water, hidden)


def true_dots(renderer: Renderer, truth: TrueRig, time_s: float) -> list[Array | None]:
    """Where the beams meet the object, rig frame of the truth; ``None``: they miss it."""
    surface, along = renderer.surface(time_s), np.arange(250.0, 800.0, 0.25)
    dots: list[Array | None] = []
    for laser in truth.lasers:
        way = np.array(laser.origin_mm) + along[:, None] * np.array(laser.direction)
        inside = np.flatnonzero(surface.distance_mm(way) < 0.0)
        dots.append(way[inside[0]] if len(inside) else None)
    return dots


def live_pair(
    renderer: Renderer, lasers: tuple[bool, bool], seed: int, light: NDArray[np.uint8], time_s: float = 0.0,
    exposure_s: float = EXPOSURE_S,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:  # fmt: skip
    """Both cameras' images in the live light."""
    left, right = (
        renderer.expose(side, [LightSlice(light, exposure_s)], time_s, exposure_s, 0.0, lasers, 2 * seed + number)
        for number, side in enumerate(("left", "right"))
    )
    return left, right


def hide(image: NDArray[np.uint8], truth: TrueRig, side: str, dot: Array) -> NDArray[np.uint8]:
    """The image with a dark weed before the dot."""
    u, v = project(truth, side, dot[None])[0]
    radius = round(0.035 * image.shape[1])
    return np.asarray(cv2.circle(image.copy(), (round(float(u)), round(float(v))), radius, 12, -1), np.uint8)


def seen(renderer: Renderer, truth: TrueRig, side: str, dot: Array, time_s: float) -> bool:
    """Whether a camera sees that point of the surface."""
    u, v = project(truth, side, dot[None])[0]
    points = renderer.view(side, time_s).points_rig_mm
    row, column = round(float(v)), round(float(u))
    if not (0 <= row < points.shape[0] and 0 <= column < points.shape[1]):
        return False
    near = points[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].reshape(-1, 3)
    return bool(np.nanmin(np.linalg.norm(near - dot, axis=1), initial=np.inf) < 2.0)
