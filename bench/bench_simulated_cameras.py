"""Cost of images by the simulated cameras, 24 of both, at rest and in motion, and the error of their approximation."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from bench.result import Measurement
from hw_sim.objects.motion import Motion
from hw_sim.optics.table import fit_table, look_up_all
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth, ray

EXPOSURE_S = 0.012
FRAMES = 24
CORES = 2
FULL, SMALL = (1600, 1200), (400, 300)
HAND = Motion(velocity_mm_s=(8.0, 0.0, 6.0), tremor_mm=(0.05, 0.05, 0.0))
"""Hand with a drift of 10 mm/s and tremor."""
FIRST = Scene(object="plane")
AT_REST, MOVING = Scene(object="pipe"), Scene(object="pipe", motion=HAND)
MOVING_STONES = Scene(object="stones", motion=HAND)
"""The object whose surface is the dearest."""


@dataclass(frozen=True, slots=True)
class ActionTime:
    """Time of an action."""

    wall_s: float
    cpu_s: float
    """Of the whole process."""
    longest_thread_s: float

    @property
    def two_cores_s(self) -> float:
        """Wall time on two idle cores."""
        return max(self.cpu_s / CORES, self.longest_thread_s)


def measure() -> Iterator[Measurement]:
    record(Renderer(draw_truth("realistic", 1, 64, 48, FIRST.water.index), MOVING), frames=1)  # loads the kernels
    for size, size_px, at_most_s in (
        ("1600 x 1200", FULL, {"at rest": 5.0, "moving": 30.0, "moving stones": 30.0}),
        ("400 x 300", SMALL, {"at rest": 0.5, "moving": 3.0, "moving stones": 5.0}),
    ):
        truth = draw_truth("realistic", 1, *size_px, FIRST.water.index)
        before_s, before_cpu_s = time.perf_counter(), time.process_time()
        renderer = Renderer(truth, FIRST)
        first = record(renderer, frames=1)
        begun = ActionTime(time.perf_counter() - before_s, time.process_time() - before_cpu_s, 0.0)
        yield Measurement(f"{size}, rig and first frames", begun.cpu_s, "s CPU", at_most=8.0)
        yield Measurement(f"{size}, rig and first frames", begun.wall_s, "s")
        yield Measurement(f"{size}, of these the frames", first.cpu_s, "s CPU")
        for name, scene in (("at rest", AT_REST), ("moving", MOVING), ("moving stones", MOVING_STONES)):
            renderer.scene = scene
            spent = record(renderer, FRAMES)
            sequence = f"{size}, {name}, {FRAMES} of both"
            yield Measurement(sequence, spent.cpu_s, "s CPU")
            yield Measurement(sequence, spent.wall_s, "s")
            yield Measurement(f"{sequence}, idle cores", spent.two_cores_s, "s", at_most=at_most_s[name])
    yield from projection()


def record(renderer: Renderer, frames: int) -> ActionTime:
    """Render frames of both cameras in two threads as in the world, each with its own pattern."""
    rng = np.random.default_rng(1)
    patterns = [np.kron(rng.integers(0, 255, (96, 128), np.uint8), np.ones((8, 8), np.uint8)) for _ in range(frames)]

    def expose(camera: str, k: int) -> float:
        begun_s = time.thread_time()
        light = [LightSlice(patterns[k], EXPOSURE_S)]
        renderer.expose(camera, light, (k + 1) / 60.0, EXPOSURE_S, 0.0, (False, False), k)
        return time.thread_time() - begun_s

    before_s, before_cpu_s = time.perf_counter(), time.process_time()
    with ThreadPoolExecutor(1) as left, ThreadPoolExecutor(1) as right:
        pending = [(left.submit(expose, "left", k), right.submit(expose, "right", k)) for k in range(frames)]
        threads_s = np.array([(a.result(), b.result()) for a, b in pending]).sum(axis=0)
    return ActionTime(time.perf_counter() - before_s, time.process_time() - before_cpu_s, float(threads_s.max()))


def projection() -> Iterator[Measurement]:
    """Yield the error and the time of projection by table against exact tracing."""
    truth = draw_truth("realistic", 1, *FULL, FIRST.water.index)
    eye = truth.projector.packed(truth.n_water)
    uv = np.random.default_rng(1).uniform(0, [1023, 767], (50_000, 2))
    origin, direction = ray(truth, "projector", uv)
    points = origin + direction * np.random.default_rng(2).uniform(300.0, 700.0, (len(uv), 1))
    pixels = np.empty_like(uv)
    table = fit_table(eye)
    look_up_all(eye, table, points, pixels)
    yield Measurement("projection by table, largest error", float(np.abs(pixels - uv).max()), "px", at_most=1e-4)
    begun_s = time.thread_time()
    for _ in range(5):
        look_up_all(eye, table, points, pixels)
    yield Measurement("projection by table", (time.thread_time() - begun_s) * 1e9 / (5 * len(uv)), "ns", at_most=300.0)
