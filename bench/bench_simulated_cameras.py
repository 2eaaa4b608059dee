"""What a frame of the simulated cameras costs, at rest and in motion, and how far its short cuts are from exact."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from bench.result import Measured
from hw_sim.motion import Motion
from hw_sim.optics.points import ray
from hw_sim.optics.table import fit_table, look_up_all
from hw_sim.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth

EXPOSURE_S = 0.012


def measure() -> Iterator[Measured]:
    scene = Scene(object="pipe")
    truth = draw_truth("realistic", 1, 1600, 1200, scene.water.index)
    light = [LightSlice(np.full((768, 1024), 200, np.uint8), EXPOSURE_S)]
    seeds = iter(range(1_000_000))

    def frame(r: Renderer, time_s: float = 0.0) -> None:
        r.expose("left", light, time_s, EXPOSURE_S, 0.0, (False, False), next(seeds))

    warm = Renderer(draw_truth("realistic", 1, 64, 48, scene.water.index), scene)
    frame(warm)
    yield Measured(
        "renderer and first frame, 1600 x 1200", cpu_ms(lambda: frame(Renderer(truth, scene))), "ms CPU", 3500
    )
    r = Renderer(truth, scene)
    frame(r)
    yield Measured("frame at rest", cpu_ms(lambda: frame(r), 8), "ms CPU", at_most=150.0)
    r.scene = Scene(object="pipe", motion=Motion(velocity_mm_s=(5.0, 0.0, 10.0)))
    times_s = iter(np.arange(1, 100) / 60.0)
    yield Measured("frame in motion", cpu_ms(lambda: frame(r, float(next(times_s))), 3), "ms CPU", at_most=1500.0)
    eye = truth.projector.packed(truth.n_water)
    uv = np.random.default_rng(1).uniform(0, [1023, 767], (50_000, 2))
    origin, direction = ray(truth, "projector", uv)
    points = origin + direction * np.random.default_rng(2).uniform(300.0, 700.0, (len(uv), 1))
    found = np.empty_like(uv)
    table = fit_table(eye)
    look_up_all(eye, table, points, found)
    yield Measured("projection by table, largest error", float(np.abs(found - uv).max()), "px", at_most=1e-4)
    spent = cpu_ms(lambda: look_up_all(eye, table, points, found), 5)
    yield Measured("projection by table", spent * 1e6 / len(uv), "ns", at_most=300.0)


def cpu_ms(action: Callable[[], object], repeats: int = 1) -> float:
    """Mean CPU time of this thread, ms."""
    begin = time.thread_time()
    for _ in range(repeats):
        action()
    return (time.thread_time() - begin) * 1000.0 / repeats
