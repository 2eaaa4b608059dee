"""Owns the scans that the motion verdict is measured with: what lies before the instrument, how it is held, what it records.

A case follows from its seed. It is rendered without noise, at rest and moving, so that what motion adds to a cloud can be
separated from noise; noise and flickering daylight are then put onto the same frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hw_sim.imaging import Imaging
from hw_sim.motion import Motion
from hw_sim.scene import Scene
from hw_sim.sensor import E_PER_DN, OFFSET_DN, Sensor
from hw_sim.water import Water
from tests.support.rendered import RenderedScan, render_scan

FRAME_S = 1.0 / 60.0
TRUTH_SET = "modelled"
KINDS = ("lateral", "axial", "rotation", "tremor", "acceleration")
TEXTURES = ("none", "slight", "strong", "checker")
OBJECTS = ("plane", "frustum", "pipe", "shell", "stones")
Frames = Mapping[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class Case:
    """One scene and one movement of the hands."""

    seed: int
    scene: Scene
    """At rest, without noise."""
    motion: Motion
    kind: str
    speed_mm_s: float
    """Of the movement: greatest speed at the middle of the volume; of a rotation, 100 mm beside it."""
    period_px: int
    exposure_s: float
    gain_db: float
    flicker_depth: float
    """Of the daylight, which is ``scene.ambient`` on average."""
    flicker_hz: float
    drift: float
    """How much brighter the daylight is after the sequence, as a fraction."""


def draw_case(seed: int, kind: str | None = None, texture: str | None = None, period_px: int = 16) -> Case:
    """Everything at random, or the kind of movement and the texture given."""
    rng = np.random.default_rng([seed, 2024])
    which = str(rng.choice(OBJECTS))
    turn = rng.uniform(-22.0, 22.0, 3)
    middle = np.array([rng.uniform(-25, 25), rng.uniform(-18, 18), rng.uniform(490, 570)])
    drawn_texture, drawn_kind = str(rng.choice(TEXTURES)), str(rng.choice(KINDS))
    texture, kind = texture or drawn_texture, kind or drawn_kind
    gain_db = float(rng.choice([0.0, 0.0, 6.0, 10.0]))
    exposure_s = float(0.012 * 10.0 ** (-gain_db / 20.0) * rng.uniform(0.6, 1.25))
    water = Water(
        attenuation_per_m=float(rng.uniform(0.2, 1.2)),
        backscatter=float(10.0 ** rng.uniform(-3.0, -1.3)),
        blur_px_per_m=float(rng.uniform(0.1, 0.6)),
    )
    scene = Scene(
        object=which,
        pose=(*_triple(middle), *_triple(turn)),
        texture=texture,
        water=water,
        ambient=float(10.0 ** rng.uniform(-3.0, -0.8)),
        noise=False,
        imaging=Imaging(response=str(rng.choice(["measured", "linear", "gamma"], p=[0.5, 0.3, 0.2]))),
    )
    motion, speed = _draw_motion(rng, kind)
    return Case(
        seed, scene, motion, kind, speed, period_px, exposure_s, gain_db,
        flicker_depth=float(rng.choice([0.0, rng.uniform(0.1, 0.9)])),
        flicker_hz=float(rng.choice([100.0, 120.0]) * rng.uniform(0.998, 1.002)),
        drift=float(rng.uniform(-0.2, 0.2)),
    )  # fmt: skip


def _draw_motion(rng: np.random.Generator, kind: str) -> tuple[Motion, float]:
    """And its speed in mm/s; amounts are log-uniform from harmless to gross."""
    around = rng.uniform(0.0, 2.0 * np.pi)
    across = np.array([np.cos(around), np.sin(around), 0.0])
    any_way = rng.standard_normal(3)
    any_way /= np.linalg.norm(any_way)
    share = rng.uniform()
    sign = rng.choice([-1.0, 1.0])
    hz = float(rng.uniform(4.0, 12.0))
    match kind:
        case "lateral":
            speed = 10.0 ** (-0.5 + 2.4 * share)
            return Motion(velocity_mm_s=_triple(speed * across)), speed
        case "axial":
            speed = 10.0 ** (-1.0 + 2.4 * share)
            return Motion(velocity_mm_s=(0.0, 0.0, float(sign * speed))), speed
        case "rotation":
            speed = 10.0 ** (-0.7 + 2.4 * share)
            return Motion(rotation_deg_s=_triple(np.degrees(speed / 100.0) * any_way)), speed
        case "tremor":
            speed = 10.0 ** (-0.7 + 2.4 * share)
            return Motion(tremor_mm=_triple(speed / (2.0 * np.pi * hz) * any_way), tremor_hz=hz), speed
        case "acceleration":
            speed = 10.0 ** (-0.7 + 2.4 * share)
            begin = rng.uniform(-0.6, 0.6) * speed
            # The greatest speed is reached at the end of the 0.4 s.
            acceleration = (speed - begin) / 0.4
            return Motion(
                velocity_mm_s=_triple(begin * any_way), acceleration_mm_s2=_triple(acceleration * any_way)
            ), speed
    raise ValueError(f"kind of motion '{kind}'; allowed are {', '.join(KINDS)}")


def _triple(v: NDArray[np.floating]) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def render(case: Case, moving: bool, width_px: int = 400) -> RenderedScan:
    """Both cameras' frames without noise and flicker, at rest or moving."""
    scene = replace(case.scene, motion=case.motion) if moving else case.scene
    return render_scan(
        scene, TRUTH_SET, case.seed, width_px, case.period_px, case.exposure_s, frame_s=FRAME_S, gain_db=case.gain_db
    )


def record(case: Case, clean: Frames, dark: int, noise_seed: int) -> dict[str, NDArray[np.uint8]]:
    """Frames (n, h, w) uint8 with the daylight's flicker and with the cameras' noise."""
    per_dn = E_PER_DN * 10.0 ** (-case.gain_db / 20.0)
    recorded = {}
    for number, (side, frames) in enumerate(clean.items()):
        count, height, width = frames.shape
        sensor = Sensor(width, height, 2 * case.seed + number, True)
        daylight = np.maximum(frames[dark].astype(np.float32) - OFFSET_DN, 0.0)
        out = np.empty_like(frames)
        for k in range(count):
            extra = np.float32(brightness(case, k) - 1.0)
            electrons = (frames[k].astype(np.float32) - OFFSET_DN + extra * daylight) * np.float32(per_dn)
            # What is saturated stays so: how far beyond, the frame does not say.
            electrons[frames[k] == 255] *= np.float32(1.2)
            out[k] = sensor.read_out(electrons, case.gain_db, 1_000_000 * noise_seed + 2 * k + number)
        recorded[side] = out
    return recorded


def brightness(case: Case, frame: int) -> float:
    """Mean of the daylight over an exposure, relative to its average."""
    rate = 2.0 * np.pi * case.flicker_hz
    half = 0.5 * rate * case.exposure_s
    phase = rate * frame * FRAME_S + 0.1 * (case.seed % 60)
    flicker = case.flicker_depth * np.sin(half) / half * np.sin(phase)
    return float((1.0 + flicker) * (1.0 + case.drift * frame / 24.0))
