"""Scans for measuring compensation: named motions before named objects, also in bad conditions, motions of growing
speed, and random ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.verdict.calibrations import TRUTH_SET
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid

WIDTH_PX, SMALL_PX = 800, 400
NAMED = {
    "a": Motion((6.0, 5.0, 6.2), tremor_mm=(0.2, 0.2, 0.2), rotation_deg_s=(1.0, -1.5, 1.0)),
    "b": Motion((0.0, 0.0, 20.0), (0.0, 0.0, 300.0)),
    "c": Motion((18.0, 15.0, 18.6), (120.0, 100.0, 124.0), rotation_deg_s=(2.0, -2.0, 1.5)),
}
"""(a) slow and trembling, (b) accelerating along the view, (c) fast and accelerating."""
OBJECTS = {"pipe": "checker", "plane": "strong", "shell": "slight"}
HARD = {
    "flicker": Scene("shell", texture="slight", ambient=0.1, daylight=Daylight(flicker_depth=0.5, flicker_hz=100.0)),
    "turbid": Scene("pipe", texture="strong", water=turbid(1.5)),
    "no paint": Scene("shell", texture="none"),
    "steps, labels": Scene("frustum", texture="labels"),
    "steps, checker": Scene("stones", texture="checker"),
}
SPEEDS_MM_S = (5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0)
WAYS = {"along": (1.0, 0.0, 0.0), "against": (-1.0, 0.0, 0.0), "axial": (0.0, 0.0, 1.0)}
"""Which way the instrument goes: ``along`` and ``against`` the x fringes, towards the object."""
SPEED_OBJECT = Scene("shell", texture="strong")

TEXTURES = ("none", "slight", "strong", "checker")
FASTEST_MM_S, MOST_MM_S2, MOST_TREMOR_MM, MOST_DEG_S = 25.0, 100.0, 0.25, 2.0
AT_REST = 0.2
"""Share of the draws at rest."""


@dataclass(frozen=True, slots=True)
class Case:
    """One scan; its twin at rest follows."""

    name: str
    scene: Scene
    seed: int
    """Of the rig, and of the noise. The rig is of ``TRUTH_SET``."""
    width_px: int = WIDTH_PX
    truth_set: str = TRUTH_SET

    @property
    def at_rest(self) -> bool:
        """True for a scan at rest."""
        return self.scene.motion.still

    @property
    def rest(self) -> Scene:
        """The same scene with hands at rest."""
        return replace(self.scene, motion=Motion())


def named_cases(seed: int) -> list[Case]:
    """Return the cases of every hand before every object."""
    return [
        Case(f"{hand}-{name}", Scene(name, texture=texture, motion=motion), seed)
        for hand, motion in NAMED.items()
        for name, texture in OBJECTS.items()
    ]


def hard_cases(seed: int) -> list[Case]:
    """Return the cases of every hand in every bad condition."""
    return [
        Case(f"{hand}-{name}", replace(scene, motion=motion), seed)
        for name, scene in HARD.items()
        for hand, motion in NAMED.items()
    ]


def speed_cases(seed: int, speeds_mm_s: Sequence[float] = SPEEDS_MM_S) -> list[Case]:
    """Return steady motions in small images: by name ``along 20`` and so on."""
    return [
        Case(
            f"{direction} {speed:g}",
            replace(SPEED_OBJECT, motion=Motion((x * speed, y * speed, z * speed))),
            seed,
            SMALL_PX,
        )
        for direction, (x, y, z) in WAYS.items()
        for speed in speeds_mm_s
    ]


def drawn_case(seed: int, number: int, rigs: int = 3) -> Case:
    """Return the ``number``-th random case of a seed in small images: motion, object, pose; one of ``rigs`` rigs in
    turn."""
    rng = np.random.default_rng([seed, 41, number])

    def vector(largest: float) -> tuple[float, float, float]:
        direction = rng.normal(size=3)
        x, y, z = (float(v) for v in direction / np.linalg.norm(direction) * rng.uniform(0.0, largest))
        return x, y, z

    velocity, acceleration, tremor = vector(FASTEST_MM_S), vector(MOST_MM_S2), vector(MOST_TREMOR_MM)
    motion = Motion(velocity, acceleration, tremor, float(rng.uniform(5.0, 9.0)), vector(MOST_DEG_S))
    if rng.uniform() < AT_REST:
        motion = Motion()
    name = str(rng.choice(["plane", "pipe", "shell", "frustum", "stones"]))
    scene = Scene(name, texture=str(rng.choice(TEXTURES)), motion=motion, ambient=float(rng.uniform(0.0, 0.1)))
    return Case(f"drawn {number}: {name}", scene, 100 * seed + number % rigs, SMALL_PX)
