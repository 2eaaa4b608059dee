"""Random scenes: objects, poses, textures and waters that a diver may meet."""

from __future__ import annotations

import math

import numpy as np

from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.scene import Scene
from hw_sim.water.medium import Water

OBJECTS = ("pipe", "shell", "stones", "frustum", "plane")
TEXTURES = ("none", "slight", "strong")
POSE_RANGE = (10.0, 8.0, 25.0, 10.0, 12.0, 30.0)
"""± x, y, z in mm and turns about x, y, z in degrees."""


def drawn_scene(rng: np.random.Generator, water: Water) -> Scene:
    """Return a random object in ``water``."""
    thing = str(rng.choice(OBJECTS))
    x, y, z, rx, ry, rz = np.array(DEFAULT_POSE[thing]) + rng.uniform(-1.0, 1.0, 6) * POSE_RANGE
    pose = (float(x), float(y), float(z), float(rx), float(ry), float(rz))
    texture = str(rng.choice(TEXTURES))
    return Scene(object=thing, pose=pose, texture=texture, water=water, ambient=float(rng.uniform(0.0, 0.08)))


def drawn_water(rng: np.random.Generator) -> Water:
    """Return random water, from clear to almost opaque; veil and blur are independent of that."""
    return Water(
        attenuation_per_m=math.exp(rng.uniform(math.log(0.1), math.log(3.0))),
        backscatter=math.exp(rng.uniform(math.log(0.004), math.log(0.2))),
        blur_px_per_m=float(rng.uniform(0.3, 3.0)),
    )
