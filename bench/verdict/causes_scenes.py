"""Scenes for the naming of causes: a good base, and the factors that spoil it.

A base is an object in clear water at the right distance, held still and exposed to suit it. Four factors spoil it: hands,
water, light and distance. A scene is a base with a level of each factor; so the same scene with one factor removed is a scene
of the same kind, and what a factor truly costs is the difference between the two.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from appliance.measure.light.exposure import Exposure, Span, ladder
from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.objects.shapes import DEFAULT_POSE
from hw_sim.scene import Scene
from hw_sim.water.medium import Water, turbid

STEPS = ladder(60.0, 500, 0.0, Span())
WIDTH_PX, HEIGHT_PX, PERIOD_PX = 400, 300, 16
FRAME_S = 1.0 / 60.0
OBJECTS = ("pipe", "shell", "stones", "frustum", "plane")
TEXTURES = ("slight", "strong", "checker")
JITTER = (8.0, 8.0, 12.0, 8.0, 8.0, 20.0)
"""± x, y, z in mm and turns about x, y, z in degrees around an object's usual pose."""
NONE = "none"
_ROOT2, _ROOT3 = 0.5**0.5, 3.0**-0.5
DIRECTIONS = MappingProxyType(
    {
        "x": (1.0, 0.0, 0.0),
        "y": (0.0, 1.0, 0.0),
        "z": (0.0, 0.0, 1.0),
        "xy": (_ROOT2, -_ROOT2, 0.0),
        "xyz": (-_ROOT3, _ROOT3, -_ROOT3),
    }
)
SPEEDS_MM_S = (5.0, 20.0, 60.0)
HANDS = (NONE, *(f"{speed:g} {name}" for speed in SPEEDS_MM_S for name in DIRECTIONS), "tremor")
WATERS = MappingProxyType(
    {
        NONE: Water(),
        "coast": turbid(1.0),
        "harbour": turbid(2.0),
        "milk": turbid(3.5),
        "thick": turbid(5.5),
        "silt": Water(attenuation_per_m=2.0, backscatter=0.4, blur_px_per_m=1.0),
        "black": Water(attenuation_per_m=6.0, backscatter=0.5),
    }
)
LIGHTS = (NONE, "dim", "dimmer", "over", "flicker", "flood")
DISTANCES = (NONE, "near", "far", "nothing")
NEARER_MM, FARTHER_MM, AWAY_MM = 190.0, 230.0, 5000.0
"""Shift of the object nearer, farther, and sideways out of sight."""
FACTORS = ("hands", "water", "light", "distance")
HANDS_ALONE, PAIRS, TRIPLES = 5, 20, 2


@dataclass(frozen=True, slots=True)
class Base:
    """A good scene, before one hidden rig."""

    rig_seed: int
    scene: Scene
    flicker_hz: float
    flicker_depth: float
    tremor_hz: float


@dataclass(frozen=True, slots=True)
class FactorLevels:
    """A level of each factor; ``NONE`` is that of the base."""

    hands: str = NONE
    water: str = NONE
    light: str = NONE
    distance: str = NONE

    @property
    def present(self) -> tuple[str, ...]:
        """Factors that differ from the base."""
        return tuple(factor for factor in FACTORS if getattr(self, factor) != NONE)

    def without(self, factor: str) -> FactorLevels:
        """Return the levels with ``factor`` as in a base."""
        return replace(self, **{factor: NONE})

    def alone(self, factor: str) -> FactorLevels:
        """Return the level of ``factor`` alone."""
        return replace(FactorLevels(), **{factor: getattr(self, factor)})

    @property
    def name(self) -> str:
        """Name of the scene by its factors, for instance ``hands 20 x, water milk``."""
        return ", ".join(f"{factor} {getattr(self, factor)}" for factor in self.present) or "nothing"


def draw_base(seed: int, number: int) -> Base:
    """Draw object, pose, texture and rig; the bases of one seed are numbered from 0."""
    rng = np.random.default_rng([seed, number, 77])
    thing, texture = str(rng.choice(OBJECTS)), str(rng.choice(TEXTURES))
    pose = np.array(DEFAULT_POSE[thing]) + rng.uniform(-1.0, 1.0, 6) * JITTER
    x, y, z, rx, ry, rz = (float(value) for value in pose)
    scene = Scene(
        object=thing, pose=(x, y, z, rx, ry, rz), texture=texture, ambient=float(10.0 ** rng.uniform(-2.5, -1.3))
    )
    # A lamp is seen as a beat of the frames with its light: at 120 Hz and 60 frames it could stand still.
    hz = float(rng.choice([100.0, 96.7, 113.1, 3.1]))
    depth, tremor_hz = float(rng.uniform(0.6, 0.95)), float(rng.uniform(5.0, 11.0))
    return Base(int(rng.integers(1, 10**9)), scene, hz, depth, tremor_hz)


def scene_of(base: Base, levels: FactorLevels) -> Scene:
    """Return the scene before the instrument."""
    scene = replace(base.scene, motion=_motion(base, levels.hands), water=WATERS[levels.water])
    x, y, z, *rotation_deg = base.scene.start_pose
    match levels.distance:
        case "near":
            scene = replace(scene, pose=(x, y, z - NEARER_MM, rotation_deg[0], rotation_deg[1], rotation_deg[2]))
        case "far":
            scene = replace(scene, pose=(x, y, z + FARTHER_MM, rotation_deg[0], rotation_deg[1], rotation_deg[2]))
        case "nothing":
            scene = replace(scene, pose=(x + AWAY_MM, y, z, rotation_deg[0], rotation_deg[1], rotation_deg[2]))
    match levels.light:
        case "flicker":
            daylight = Daylight(flicker_depth=base.flicker_depth, flicker_hz=base.flicker_hz, seed=base.rig_seed)
            scene = replace(scene, ambient=0.2, daylight=daylight)
        case "flood":
            scene = replace(scene, ambient=3.0)
    return scene


def exposure_of(levels: FactorLevels) -> Exposure:
    """Return the exposure: the usual one except where light is the factor."""
    match levels.light:
        case "dim":
            return Exposure(500)
        case "dimmer":
            return Exposure(200)
        case "over":
            return STEPS[-1]
    return Exposure(12_000)


def _motion(base: Base, hands: str) -> Motion:
    if hands == NONE:
        return Motion()
    if hands == "tremor":
        # 20 mm/s at the most, which is a bad day.
        amount = 20.0 / (2.0 * np.pi * base.tremor_hz)
        return Motion(tremor_mm=(amount * _ROOT3,) * 3, tremor_hz=base.tremor_hz)
    speed, direction = hands.split(" ")
    x, y, z = (float(speed) * part for part in DIRECTIONS[direction])
    return Motion(velocity_mm_s=(x, y, z))


def grid_of(seed: int, number: int, pairs: int = PAIRS, triples: int = TRIPLES) -> tuple[FactorLevels, ...]:
    """Return the levels for one base: none, each alone, random pairs, and triples with all their pairs.

    Of motion, only ``HANDS_ALONE`` random levels stand alone. So every scene without one of its factors is in the grid,
    too.
    """
    rng = np.random.default_rng([seed, number, 78])
    levels = {
        "hands": tuple(str(level) for level in rng.choice(HANDS[1:], HANDS_ALONE, replace=False)),
        "water": tuple(WATERS)[1:],
        "light": LIGHTS[1:],
        "distance": DISTANCES[1:],
    }
    grid = [FactorLevels(), *(_with_factors({factor: level}) for factor in FACTORS for level in levels[factor])]
    for count, many in ((2, pairs), (3, triples)):
        for _ in range(many):
            chosen = [str(factor) for factor in rng.choice(FACTORS, count, replace=False)]
            combination = _with_factors({factor: str(rng.choice(levels[factor])) for factor in chosen})
            grid += [*(combination.without(factor) for factor in chosen), combination]
    return tuple(dict.fromkeys(grid))


def _with_factors(levels: dict[str, str]) -> FactorLevels:
    return replace(FactorLevels(), **levels)
