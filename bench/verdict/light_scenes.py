"""Random scenes for the judge of light, by a seed, and their images by the simulated rig."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure, Span, ladder
from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.scan_images import ScanImages
from hw_sim.light.daylight import Daylight
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from tests.support.rendered import FRAME_S, RenderedScan, pictures

WIDTH_PX, HEIGHT_PX = 400, 300
STEPS = ladder(60.0, 500, 0.0, Span())
OBJECTS = ("plane", "ballbar", "frustum", "pipe", "shell", "stones")
TEXTURES = ("none", "slight", "strong", "checker")
SEQUENCE = build_sequence(16)


@dataclass(frozen=True)
class Case:
    """One scene before one hidden rig."""

    scene: Scene
    rig_seed: int
    name: str


def draw_case(rng: np.random.Generator) -> Case:
    """Draw object, pose, texture, water and steady ambient light."""
    kind, texture = str(rng.choice(OBJECTS)), str(rng.choice(TEXTURES))
    pose = (
        rng.uniform(-25, 25), rng.uniform(-20, 20), rng.uniform(430, 570),
        rng.uniform(-25, 25), rng.uniform(-25, 25), rng.uniform(-180, 180),
    )  # fmt: skip
    water = Water(attenuation_per_m=rng.uniform(0.1, 1.2), backscatter=10 ** rng.uniform(-3, -1.3))
    ambient = float(rng.choice([0.0, 10 ** rng.uniform(-2, -0.3)]))
    scene = Scene(object=kind, pose=pose, texture=texture, water=water, ambient=ambient)
    return Case(scene, int(rng.integers(1, 1 << 30)), f"{kind} {texture} at {pose[2]:.0f} mm, ambient {ambient:.2f}")


def draw_daylight(rng: np.random.Generator) -> tuple[Daylight, float, str]:
    """Draw a changing light, its level of ambient light, and its name."""
    kind = str(rng.choice(["flicker", "caustics", "torch"]))
    seed = int(rng.integers(1, 1 << 30))
    ambient = 10 ** rng.uniform(-1.7, -0.3)
    match kind:
        case "flicker":
            depth, hz = 10 ** rng.uniform(-1.3, 0.0), float(rng.choice([100.0, 120.0, rng.uniform(3.0, 300.0)]))
            return Daylight(flicker_depth=depth, flicker_hz=hz, seed=seed), ambient, f"{hz:.0f} Hz, depth {depth:.2f}"
        case "caustics":
            share, mesh_mm = 10 ** rng.uniform(-1.3, -0.1), rng.uniform(30.0, 120.0)
            light = Daylight(
                caustics=share, caustics_scale_mm=mesh_mm, caustics_speed_mm_s=rng.uniform(50.0, 800.0), seed=seed
            )
            return light, ambient, f"caustics {share:.2f} of {mesh_mm:.0f} mm"
        case _:
            bright, speed = 10 ** rng.uniform(-1.5, 0.0), 10 ** rng.uniform(1.0, 3.0)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            velocity = (speed * float(np.cos(angle)), speed * float(np.sin(angle)), 0.0)
            light = Daylight(
                torch=bright, torch_diameter_mm=rng.uniform(40.0, 150.0), torch_velocity_mm_s=velocity, seed=seed
            )
            return light, 0.02, f"torch {bright:.2f} at {speed:.0f} mm/s"


def renderer_of(case: Case) -> Renderer:
    truth = draw_truth("realistic", case.rig_seed, WIDTH_PX, HEIGHT_PX, case.scene.water.index)
    return Renderer(truth, case.scene)


def photograph(
    renderer: Renderer, exposure: Exposure, noise_seed: int, sides: tuple[str, ...] = ("left", "right")
) -> dict[str, NDArray[np.uint8]]:
    """Render all frames (n, h, w) of the sequence for each side."""

    def camera(side: str) -> NDArray[np.uint8]:
        time_s = exposure.time_us / 1e6
        shots = [
            renderer.expose(
                side, [LightSlice(shown, time_s)], 0.0, time_s, exposure.gain_db, (False, False),
                noise_seed + 2 * k + (side == "left"), k * FRAME_S,
            )
            for k, shown in enumerate(pictures(SEQUENCE))
        ]  # fmt: skip
        return np.stack(shots)

    with ThreadPoolExecutor(2) as pool:
        return dict(zip(sides, pool.map(camera, sides), strict=True))


def noise_at(exposure: Exposure) -> StereoNoise:
    """Return the noise of the simulated cameras by their rig file."""
    camera = camera_noise(13_000.0, 20.0, 2.0, exposure.gain_db)
    return StereoNoise(camera, camera)


def recorded(frames: dict[str, NDArray[np.uint8]], exposure: Exposure) -> ScanImages:
    return ScanImages(SEQUENCE, frames, {}, AcquisitionSettings(exposure, FRAME_S, noise_at(exposure)))


def scan_of(
    renderer: Renderer, frames: dict[str, NDArray[np.uint8]], sequence: PatternSequence = SEQUENCE
) -> RenderedScan:
    return RenderedScan(renderer, sequence, frames)


def without(scene: Scene, *, noise: bool = True, daylight: bool = True) -> Scene:
    """Return the scene without noise, or without changes of its light."""
    return replace(scene, noise=scene.noise and noise, daylight=scene.daylight if daylight else Daylight())
