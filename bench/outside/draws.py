"""Random scenes of this measurement: objects, poses, textures, water and light, several for each instrument.

The properties of an instrument (lens, plates, cameras, projector, mounts, clocks) are drawn once; water, surfaces,
motion and softness are drawn for each scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from bench.outside.world import SMALL_PX, World, world_with
from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.objects.soft import is_soft
from hw_sim.outside import ALL, Outside, draw_outside
from hw_sim.scene import Scene
from hw_sim.water.medium import Water

OBJECTS = ("plane", "frustum", "pipe", "shell", "stones", "ballbar")
TEXTURES = ("none", "slight", "strong", "checker")
OF_THE_INSTRUMENT = ("projector", "lens", "plates", "cameras", "mounts", "clocks")
SCENES_PER_RIG = 10
AWAY = (12.0, 10.0, 22.0, 10.0, 10.0, 20.0)
"""± x, y, z in mm and turns about x, y, z in degrees around an object's usual pose."""
LEAST_PER_M, MOST_PER_M = 0.2, 2.0
LEAST_VEIL_M, MOST_VEIL_M = 0.005, 0.05
"""Backscatter in water of 1 /m: from that of natural water to the veil of stirred sediment."""
COOLEST_C, WARMEST_C = 20.0, 45.0
"""Of the case while scanning."""
SEEDS_PER_SEED = 100_000


def scene_world(
    seed: int, number: int, families: Sequence[str] = ALL, size_px: tuple[int, int] = SMALL_PX, soft: bool = True
) -> World:
    """Return scene ``number`` of ``seed``: the same object, water and light whichever ``families`` are on.

    ``soft``: one scene of ten has an object that is not rigid, where all families are on.
    """
    rig_seed = SEEDS_PER_SEED * seed + number // SCENES_PER_RIG
    own_seed = SEEDS_PER_SEED * seed + number + SEEDS_PER_SEED // 2
    chosen = tuple(families)
    if soft and chosen == ALL and is_soft(own_seed):
        chosen = (*chosen, "soft")
    rng = np.random.default_rng([rig_seed, 31])
    case_c = float(rng.uniform(COOLEST_C, WARMEST_C))
    return world_with(
        drawn_scene(own_seed, number), joined(rig_seed, own_seed, chosen), own_seed, chosen,
        rig_seed=rig_seed, size_px=size_px, case_c=case_c,
    )  # fmt: skip


def joined(rig_seed: int, scene_seed: int, families: Sequence[str]) -> Outside:
    """Return the strengths of ``families``: an instrument's drawn by ``rig_seed``, those of a scene by ``own_seed``."""
    of_rig, of_scene = draw_outside(rig_seed, families), draw_outside(scene_seed, families)
    scene_strengths = {
        strength.name: getattr(of_scene, strength.name)
        for strength in fields(Outside)
        if strength.name not in OF_THE_INSTRUMENT
    }
    return replace(of_rig, **scene_strengths)


def drawn_scene(seed: int, number: int) -> Scene:
    """Return a scene without families: objects take turns, all else is drawn by ``seed``."""
    rng = np.random.default_rng([seed, 30])
    thing = OBJECTS[number % len(OBJECTS)]
    x, y, z, rx, ry, rz = (float(v) for v in np.array(DEFAULT_POSE[thing]) + rng.uniform(-1.0, 1.0, 6) * AWAY)
    per_m = float(rng.uniform(LEAST_PER_M, MOST_PER_M))
    veil_m = float(np.exp(rng.uniform(np.log(LEAST_VEIL_M), np.log(MOST_VEIL_M))))
    return Scene(
        object=thing,
        pose=(x, y, z, rx, ry, rz),
        texture=str(rng.choice(TEXTURES)),
        water=Water(
            attenuation_per_m=per_m, backscatter=veil_m * per_m, blur_px_per_m=float(rng.uniform(0.1, 0.6)) * per_m
        ),
        ambient=float(10.0 ** rng.uniform(-3.0, -1.0)),
    )
