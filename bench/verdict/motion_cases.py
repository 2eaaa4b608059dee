"""Scans for the verdicts on motion and identity: object, water, light, motion and settings.

A case follows from its seed. It is rendered without noise, at rest and moving, so that the effect of motion on a cloud
can be separated from noise, which is added to the same frames afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hw_sim.light.daylight import Daylight
from hw_sim.objects.motion import Motion
from hw_sim.scene import Imaging, Scene
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water, turbid

FRAME_S = 1.0 / 60.0
TRUTH_SET = "realistic"
KINDS = ("lateral", "axial", "rotation", "tremor", "acceleration", "fish")
TURNS = (*KINDS[:5], *KINDS[:4], "fish")
"""Order of the kinds. Acceleration and fish before hands at rest are half as frequent as the others."""
TEXTURES = ("none", "slight", "strong", "checker")
OBJECTS = ("plane", "frustum", "pipe", "shell", "stones", "ballbar")
PERIODS_PX = (16, 32, 64)
DARK_S = 0.004
"""Exposures below this, at 0 dB, count as dark."""
TURBID_PER_M = 1.0
Frames = Mapping[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class Case:
    """One scene and one motion of the hands."""

    seed: int
    scene: Scene
    """At rest, without noise, with all that is in the water and light."""
    motion: Motion
    kind: str
    speed_mm_s: float
    """Of the movement: greatest speed at the middle of the volume; of a rotation, 100 mm beside it."""
    period_px: int
    exposure_s: float
    gain_db: float

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes of the case, by its special properties."""
        scene = self.scene
        return (
            f"texture {scene.texture}",
            f"period {self.period_px}",
            *(("dark",) if self.exposure_s * 10.0 ** (self.gain_db / 20.0) < DARK_S else ()),
            *(("turbid",) if scene.water.attenuation_per_m > TURBID_PER_M else ()),
            *(("flicker",) if scene.daylight.flicker_depth else ()),
            *(("waves",) if scene.daylight.caustics else ()),
            *(("fish",) if scene.drift.fish else ()),
            *(("specks",) if scene.drift.specks else ()),
            *(("small",) if scene.object == "ballbar" else ()),
        )


def draw_case(seed: int, kind: str | None = None, texture: str | None = None, period_px: int | None = None) -> Case:
    """Return a random case, or one with the given kind of motion, texture or period."""
    rng = np.random.default_rng([seed, 2025])
    which = str(rng.choice(OBJECTS, p=[0.2, 0.18, 0.18, 0.18, 0.18, 0.08]))
    rotation_deg = rng.uniform(-22.0, 22.0, 3)
    middle = np.array([rng.uniform(-25, 25), rng.uniform(-18, 18), rng.uniform(490, 570)])
    drawn_texture, drawn_kind = str(rng.choice(TEXTURES)), str(rng.choice(TURNS))
    texture, kind = texture or drawn_texture, kind or drawn_kind
    drawn_period = int(rng.choice(PERIODS_PX, p=[0.7, 0.15, 0.15]))
    gain_db = float(rng.choice([0.0, 0.0, 6.0, 10.0]))
    bright = rng.uniform(0.6, 1.25) if rng.random() < 0.85 else 10.0 ** rng.uniform(-1.0, -0.4)
    scene = Scene(
        object=which,
        pose=(*_triple(middle), *_triple(rotation_deg)),
        texture=texture,
        water=_draw_water(rng),
        ambient=float(10.0 ** rng.uniform(-3.0, -0.8)),
        noise=False,
        imaging=Imaging(response=str(rng.choice(["measured", "linear", "gamma"], p=[0.5, 0.3, 0.2]))),
        daylight=_draw_daylight(rng, seed),
        drift=_draw_drift(rng, kind, seed),
    )
    motion, speed = _draw_motion(rng, kind)
    return Case(
        seed, scene, motion, kind, speed, period_px or drawn_period,
        exposure_s=float(0.012 * 10.0 ** (-gain_db / 20.0) * bright),
        gain_db=gain_db,
    )  # fmt: skip


def _draw_water(rng: np.random.Generator) -> Water:
    clear = Water(
        attenuation_per_m=float(rng.uniform(0.2, TURBID_PER_M)),
        backscatter=float(10.0 ** rng.uniform(-3.0, -1.3)),
        blur_px_per_m=float(rng.uniform(0.1, 0.6)),
    )
    dirty = turbid(float(rng.uniform(1.5, 4.0)))
    return dirty if rng.random() < 0.2 else clear


def _draw_daylight(rng: np.random.Generator, seed: int) -> Daylight:
    """Draw ambient light: steady in half of all scenes, else mostly a mains lamp, sometimes clouds or waves."""
    what = str(rng.choice(["steady", "lamp", "clouds", "waves"], p=[0.5, 0.35, 0.09, 0.06]))
    depth, lamp_hz = float(rng.uniform(0.1, 0.9)), float(rng.choice([100.0, 120.0]) * rng.uniform(0.998, 1.002))
    clouds_hz, net = float(rng.uniform(1.0, 3.0)), float(rng.uniform(0.1, 0.4))
    match what:
        case "lamp":
            return Daylight(flicker_depth=depth, flicker_hz=lamp_hz, seed=seed)
        case "clouds":
            return Daylight(flicker_depth=0.3 * depth, flicker_hz=clouds_hz, seed=seed)
        case "waves":
            return Daylight(caustics=net, seed=seed)
    return Daylight(seed=seed)


def _draw_drift(rng: np.random.Generator, kind: str, seed: int) -> Drift:
    """Draw drift: an eighth of all scenes has snow, some of these bubbles; fish are a kind of motion."""
    snow = float(10.0 ** rng.uniform(0.5, 2.3))
    bubbles = int(rng.integers(0, 20)) if rng.random() < 0.3 else 0
    current = _triple(rng.normal(0.0, 20.0, 3))
    fish = int(rng.integers(1, 4))
    if kind == "fish":
        return Drift(fish=fish, seed=seed)
    return Drift(snow, bubbles, current_mm_s=current, seed=seed) if rng.random() < 0.12 else Drift(seed=seed)


def _draw_motion(rng: np.random.Generator, kind: str) -> tuple[Motion, float]:
    """Draw a motion and its speed in mm/s; amounts are log-uniform from harmless to large."""
    around = rng.uniform(0.0, 2.0 * np.pi)
    across = np.array([np.cos(around), np.sin(around), 0.0])
    any_way = rng.standard_normal(3)
    any_way /= np.linalg.norm(any_way)
    share = rng.uniform()
    sign = rng.choice([-1.0, 1.0])
    hz = float(rng.uniform(4.0, 12.0))
    match kind:
        case "lateral":
            speed = 10.0 ** (-0.2 + 2.1 * share)
            return Motion(velocity_mm_s=_triple(speed * across)), speed
        case "axial":
            speed = 10.0 ** (-0.6 + 1.9 * share)
            return Motion(velocity_mm_s=(0.0, 0.0, float(sign * speed))), speed
        case "rotation":
            speed = 10.0 ** (-0.4 + 2.0 * share)
            return Motion(rotation_deg_s=_triple(np.degrees(speed / 100.0) * any_way)), speed
        case "tremor":
            speed = 10.0 ** (-0.4 + 2.1 * share)
            return Motion(tremor_mm=_triple(speed / (2.0 * np.pi * hz) * any_way), tremor_hz=hz), speed
        case "acceleration":
            speed = 10.0 ** (-0.4 + 2.0 * share)
            begin = rng.uniform(-0.6, 0.6) * speed
            # The greatest speed is reached at the end of the 0.4 s.
            acceleration = (speed - begin) / 0.4
            return Motion(
                velocity_mm_s=_triple(begin * any_way), acceleration_mm_s2=_triple(acceleration * any_way)
            ), speed
        case "fish":
            return Motion(), 0.0
    raise ValueError(f"kind of motion '{kind}'; allowed are {', '.join(KINDS)}")


def _triple(v: NDArray[np.floating]) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def without_fish(scene: Scene) -> Scene:
    """Return the scene without its fish."""
    return replace(scene, drift=replace(scene.drift, fish=0))
