"""What a whole sequence of both simulated cameras costs: 24 frames each, in two threads as in the world."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from bench.result import Measured
from hw_sim.motion import Motion
from hw_sim.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth

EXPOSURE_S = 0.012
FRAMES = 24
REST = Motion()
HAND = Motion(velocity_mm_s=(8.0, 0.0, 6.0), tremor_mm=(0.05, 0.05, 0.0))
"""A hand that drifts at 10 mm/s and trembles."""
MOST_S = {("full", "rest"): 5.0, ("full", "hand"): 30.0, ("small", "rest"): 0.5, ("small", "hand"): None}
"""On two idle cores: judged by the CPU time of both."""
CORES = 2


def measure() -> Iterator[Measured]:
    for name, size_px in (("full", (1600, 1200)), ("small", (400, 300))):
        truth = draw_truth("realistic", 1, *size_px, Scene(object="pipe").water.index)
        begun_s = time.perf_counter()
        renderer = Renderer(truth, Scene(object="pipe"))
        sequence(renderer, frames=1)
        yield Measured(f"{name}: renderer, and its first frames", time.perf_counter() - begun_s, "s")
        for motion_name, motion in (("rest", REST), ("hand", HAND)):
            renderer.scene = Scene(object="frustum", motion=motion)
            begun_s, begun_cpu_s = time.perf_counter(), time.process_time()
            sequence(renderer, FRAMES)
            wall_s, cpu_s = time.perf_counter() - begun_s, time.process_time() - begun_cpu_s
            yield Measured(f"{name}, {motion_name}: {FRAMES} frames of both", wall_s, "s")
            most_s = MOST_S[name, motion_name]
            yield Measured(
                f"{name}, {motion_name}: the same", cpu_s, "s CPU", at_most=None if most_s is None else CORES * most_s
            )


def sequence(renderer: Renderer, frames: int) -> None:
    """Both cameras' frames, each with a pattern of its own."""
    rng = np.random.default_rng(1)
    patterns = [np.kron(rng.integers(0, 255, (96, 128), np.uint8), np.ones((8, 8), np.uint8)) for _ in range(frames)]

    def record(camera: str) -> None:
        for k, pattern in enumerate(patterns):
            light = [LightSlice(pattern, EXPOSURE_S)]
            renderer.expose(camera, light, (k + 1) / 60.0, EXPOSURE_S, 0.0, (False, False), k)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(record, ("left", "right")))
