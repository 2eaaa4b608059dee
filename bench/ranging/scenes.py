"""Owns the scenes that distances are measured in: objects, textures, waters, ambient light, hands, and dots that are hidden."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.motion import Motion, object_pose
from hw_sim.optics.view import Surface
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, project
from hw_sim.water.medium import Water, turbid

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
HELD = ((505.0, 0.0, 35.0, 12.0), (515.0, 0.0, -35.0, 90.0), (515.0, 0.0, 0.0, -45.0))
"""How the sketches of the calibration in water say that the ball bar is held: distance in mm, turns in degrees."""
HELD_WITHIN_MM, HELD_WITHIN_DEG = 20.0, 10.0
BEAM_SIGMA_MM = 0.9
"""Of a beam's light across it (``docs/protocols/world.md``)."""
AIMED_SD_MM = 2.0
"""How exactly a diver who looks at the dots brings one onto the bar's middle line, across it."""


@dataclass(frozen=True, slots=True)
class Case:
    scene: Scene
    water: str
    hidden: tuple[str, int] | None
    """Camera and pointer whose dot a weed hides."""


def drawn(rng: np.random.Generator, name: str | None = None, held: bool = False) -> Case:
    """A scene at random. ``held``: the ball bar as the sketches of the calibration in water show it, about so."""
    water = str(rng.choice(list(WATERS)))
    name = "ballbar" if held else str(rng.choice(OBJECTS)) if name is None else name
    x, y, z = rng.uniform(-8.0, 8.0), rng.uniform(-8.0, 8.0), rng.uniform(*AWAY_MM)
    turns = rng.uniform(-20.0, 20.0, 3)
    if held:
        away_mm, *sketched = HELD[int(rng.integers(len(HELD)))]
        z = away_mm + rng.uniform(-HELD_WITHIN_MM, HELD_WITHIN_MM)
        turns = np.array(sketched) + rng.uniform(-HELD_WITHIN_DEG, HELD_WITHIN_DEG, 3)
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
    """Where the beams meet the object, rig frame of the truth; where an edge cuts a beam whose axis passes by, the middle of
    the light that the object gets of it. ``None``: it gets none."""
    return [_lit(renderer, np.array(laser.origin_mm), np.array(laser.direction), time_s) for laser in truth.lasers]


def _lit(renderer: Renderer, start: Array, beam: Array, time_s: float) -> Array | None:
    x = np.cross([0.0, 1.0, 0.0], beam)
    x /= np.linalg.norm(x)
    y, surface, places, weights = np.cross(beam, x), renderer.surface(time_s), [], []
    for radius in BEAM_SIGMA_MM * np.arange(0.0, 2.6, 0.5):
        for angle in np.arange(0.0, 2.0 * np.pi, np.pi / 6.0) if radius else (0.0,):
            at = start + radius * (np.cos(angle) * x + np.sin(angle) * y)
            along_mm = _met(surface, at, beam)
            if along_mm is None:
                continue
            if not radius:
                return np.asarray(at + along_mm * beam)
            places.append(at + along_mm * beam)
            weights.append(radius * np.exp(-0.5 * (radius / BEAM_SIGMA_MM) ** 2))
    return np.average(places, axis=0, weights=weights) if places else None


def _met(surface: Surface, start: Array, beam: Array) -> float | None:
    """How far light goes until it meets the surface, mm."""
    coarse = np.arange(250.0, 800.0, 1.0)
    inside = np.flatnonzero(surface.distance_mm(start + coarse[:, None] * beam) < 0.0)
    if not len(inside):
        return None
    fine = coarse[inside[0]] + np.arange(-1.0, 0.01, 0.02)
    return float(fine[np.argmax(surface.distance_mm(start + fine[:, None] * beam) < 0.0)])


def aimed(case: Case, truth: TrueRig, rng: np.random.Generator, time_s: float) -> Case:
    """The same scene after the diver has brought the nearest dot onto the ball bar, at the moment of the images.

    The instrument is moved sideways as little as is needed for one of the beams to pass through the bar's middle line,
    but for what hands miss it by.
    """
    scene = case.scene
    R, t = object_pose(scene.start_pose, scene.motion, time_s)
    bar = R[:, 0]
    shifts = []
    for laser in truth.lasers:
        start, beam = np.array(laser.origin_mm), np.array(laser.direction)
        across = np.cross(bar, beam)
        across /= np.linalg.norm(across)
        shifts.append(float((start - t) @ across) * across)
    shift = min(shifts, key=lambda one: float(np.linalg.norm(one)))
    x, y, z, rx, ry, rz = scene.start_pose
    shift = shift + np.array([*rng.normal(0.0, AIMED_SD_MM, 2), 0.0])
    moved = (x + float(shift[0]), y + float(shift[1]), z, rx, ry, rz)
    return replace(case, scene=replace(scene, pose=moved))


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
