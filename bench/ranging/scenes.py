"""Scenes for ranging: objects, textures, waters, ambient light, motion, and hidden dots."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.motion import Motion, object_pose
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, project
from hw_sim.water.medium import Water, turbid

Array = NDArray[np.float64]

OBJECTS = ("plane", "pipe", "frustum", "shell", "stones", "board", "ballbar")
TEXTURES = ("none", "slight", "strong", "checker")
WATERS = {"clear": Water(), "c = 1/m": turbid(1.0), "c = 2/m": turbid(2.0)}
AMBIENT = (0.02, 0.02, 0.1, 0.4)
HIDDEN_SHARE = 0.2
MOVING_SHARE = 0.3
AWAY_MM = 400.0, 600.0
"""Of the object's middle; its surface can be nearer."""
HELD = ((505.0, 0.0, 35.0, 12.0), (515.0, 0.0, -35.0, 90.0), (515.0, 0.0, 0.0, -45.0))
"""Poses of the ball bar in the sketches of the calibration in water: distance in mm, rotations in degrees."""
HELD_WITHIN_MM, HELD_WITHIN_DEG = 20.0, 10.0
AIMED_SD_MM = 2.0
"""Standard deviation across the bar of a dot that a diver brings onto its middle line."""


@dataclass(frozen=True, slots=True)
class Case:
    scene: Scene
    water: str
    hidden: tuple[str, int] | None
    """Camera and pointer whose dot a weed hides."""


def drawn(rng: np.random.Generator, name: str | None = None, held: bool = False) -> Case:
    """Draw a random scene; with ``held``, of the ball bar roughly as in the sketches of the calibration in water."""
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


def aimed(case: Case, truth: TrueRig, rng: np.random.Generator, time_s: float) -> Case:
    """Return the scene after the diver has brought the nearest dot onto the ball bar, at the moment of the images.

    The instrument is moved sideways by as little as brings one of the beams onto the bar's middle line, with the error
    of a hand.
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
    shift = min(shifts, key=lambda shift_mm: float(np.linalg.norm(shift_mm)))
    x, y, z, rx, ry, rz = scene.start_pose
    shift = shift + np.array([*rng.normal(0.0, AIMED_SD_MM, 2), 0.0])
    moved = (x + float(shift[0]), y + float(shift[1]), z, rx, ry, rz)
    return replace(case, scene=replace(scene, pose=moved))


def is_visible(renderer: Renderer, truth: TrueRig, side: str, dot: Array, time_s: float) -> bool:
    """Return True if a camera sees a point of the surface."""
    u, v = project(truth, side, dot[None])[0]
    points = renderer.view(side, time_s).points_rig_mm
    row, column = round(float(v)), round(float(u))
    if not (0 <= row < points.shape[0] and 0 <= column < points.shape[1]):
        return False
    near = points[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].reshape(-1, 3)
    return bool(np.nanmin(np.linalg.norm(near - dot, axis=1), initial=np.inf) < 2.0)
