"""Does one direction of fringes measure as completely and as finely as two on scenes at rest? Scans of the simulated world, both ways."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from appliance.reconstruct.first_direction import first_direction_cloud
from appliance.reconstruct.one_direction import NoPoint
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.sides import SIDES
from bench.result import Measured
from bench.turbidity.scan import noise_of, set_water
from bench.verdict.kept_scans import kept_scan
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support.rendered import judge
from tests.support.truth import true_calibration

FOLDER = Path(".cache/scenes")
TRUTH_SET, SEED, PERIOD_PX = "modelled", 12_007, 16
WIDTH_PX = 800
SCENES = {
    "pipe": Scene("pipe", texture="checker"),
    "shell": Scene("shell", texture="slight"),
    "stones": Scene("stones", texture="strong"),
    "shell in water of 0.6 /m": Scene("shell", texture="slight", water=turbid(0.6)),
}
WITHIN = 0.05
"""Largest share by which one direction may fall behind."""


def measure() -> Iterable[Measured]:
    """Completeness against what both cameras and the projector truly see, and noise against the true surface, of both ways."""
    noise = noise_of(0.0)
    for name, scene in SCENES.items():
        scan = kept_scan(FOLDER, scene, TRUTH_SET, SEED, WIDTH_PX, PERIOD_PX, 0.0)
        water = set_water(scene)
        calibration = replace(true_calibration(scan.renderer.truth), water=water)
        with Pipeline(calibration, water, scan.sequence, noise=noise) as pipeline:
            for side in SIDES:
                for index in range(len(scan.sequence)):
                    pipeline.push(side, scan.frames[side], index)
            pipeline.coarse()
            two = judge(scan, pipeline.full())
        begun_s = time.process_time()
        cloud, found = first_direction_cloud(scan.frames, scan.sequence, calibration, water, noise)
        cpu_s = time.process_time() - begun_s
        one = judge(scan, cloud)
        yield Measured(f"{name}: completeness, two directions", two.completeness_percent, "%")
        yield Measured(f"{name}: completeness, one direction", one.completeness_percent, "%")
        yield Measured(
            f"{name}: one over two", one.completeness_percent / two.completeness_percent, "", at_least=1.0 - WITHIN
        )
        yield Measured(f"{name}: noise, two directions", 1000.0 * two.rms_mm, "um")
        yield Measured(f"{name}: noise, one direction", 1000.0 * one.rms_mm, "um")
        yield Measured(f"{name}: one over two", one.rms_mm / two.rms_mm, "", at_most=1.0 + WITHIN)
        yield Measured(f"{name}: farther off than 1 mm, two directions", two.outliers_ppm, "ppm")
        yield Measured(f"{name}: farther off than 1 mm, one direction", one.outliers_ppm, "ppm")
        yield Measured(f"{name}: several crossings", 1e6 * found.count(NoPoint.SEVERAL) / found.reason.size, "ppm")
        yield Measured(f"{name}: CPU of decoding and matching, one direction", 1000.0 * cpu_s, "ms")
