"""Completeness and noise with fringes of one direction over those of two, at rest, in the simulated world.

Sequences have our own four steps, and three, five and eight as of other rigs.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from appliance.base import silent
from appliance.desk.foreign.importing import read_foreign
from appliance.desk.foreign.points import find_points
from appliance.measure.light.sides import SIDES
from appliance.measure.points.first_direction import first_direction_cloud
from appliance.measure.points.one_direction import NoPoint
from appliance.measure.points.pipeline import Pipeline
from bench.result import Measurement
from bench.turbidity.scan import noise_of, set_water
from bench.verdict.kept_scans import kept_scan
from hw_sim.scene import Scene
from hw_sim.water.medium import turbid
from tests.support.foreign_sets import HIGH, Convention, ForeignSet, Pattern, even, make_set, sines, stripes
from tests.support.rendered import judge
from tests.support.truth import left_to_rig, true_calibration

FOLDER = Path(".cache/scenes")
TRUTH_SET, SEED, PERIOD_PX = "modelled", 12_007, 16
WIDTH_PX = 800
SCENES = {
    "pipe": Scene("pipe", texture="checker"),
    "shell": Scene("shell", texture="slight"),
    "stones": Scene("stones", texture="strong"),
    "shell in water of 0.6 /m": Scene("shell", texture="slight", water=turbid(0.6)),
}
STEPS = (3, 5, 8)
OTHERS_PERIOD_PX, OTHERS_BITS = 32, 6
OTHERS_ORDER = "bright dark sine-x*{steps} gray-x*6 sine-y*{steps} gray-y*6"
OTHERS_AXIS = '[{axis}]\nperiod_px = 32\nsteps = {steps}\ngray = "complementary"\n'
FAR_MM = 1.0
"""Distance from the surface from which on a point is no noise."""
WITHIN = 0.05
"""Largest share by which one direction may fall behind."""


def measure() -> Iterable[Measurement]:
    """Yield completeness against the truth, and noise against the true surface, with one and two directions."""
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
        cloud, matching = first_direction_cloud(scan.frames, scan.sequence, calibration, water, noise)
        cpu_s = time.process_time() - begun_s
        one_direction = judge(scan, cloud)
        yield Measurement(f"{name}: completeness, two directions", two.completeness_percent, "%")
        yield Measurement(f"{name}: completeness, one direction", one_direction.completeness_percent, "%")
        yield Measurement(
            f"{name}: one over two",
            one_direction.completeness_percent / two.completeness_percent,
            "",
            at_least=1.0 - WITHIN,
        )
        yield Measurement(f"{name}: noise, two directions", 1000.0 * two.rms_mm, "um")
        yield Measurement(f"{name}: noise, one direction", 1000.0 * one_direction.rms_mm, "um")
        yield Measurement(f"{name}: one over two", one_direction.rms_mm / two.rms_mm, "", at_most=1.0 + WITHIN)
        yield Measurement(f"{name}: farther off than 1 mm, two directions", two.outliers_ppm, "ppm")
        yield Measurement(f"{name}: farther off than 1 mm, one direction", one_direction.outliers_ppm, "ppm")
        yield Measurement(
            f"{name}: several crossings", 1e6 * matching.count(NoPoint.SEVERAL) / matching.reason.size, "ppm"
        )
        yield Measurement(f"{name}: CPU of decoding and matching, one direction", 1000.0 * cpu_s, "ms")
    for steps in STEPS:
        yield from _of_steps(steps)


def _of_steps(steps: int) -> Iterable[Measurement]:
    """Yield the figures of another rig's images with ``steps`` steps, in air, with and without the second direction."""
    convention = Convention(f"{steps} steps", partial(_patterns, steps), "", one_direction=False)
    with TemporaryDirectory() as folder:
        image_set = make_set(convention, Path(folder), WIDTH_PX, described=_described(steps, "xy"))
        complete, rms_mm, far_ppm = {}, {}, {}
        for name in ("xy", "x"):
            image_set.description.write_text(_described(steps, name), encoding="utf-8")
            complete[name], rms_mm[name], far_ppm[name] = _judged(image_set)
    yield Measurement(f"{steps} steps: completeness, two directions", complete["xy"], "%")
    yield Measurement(f"{steps} steps: completeness, one direction", complete["x"], "%")
    yield Measurement(f"{steps} steps: one over two", complete["x"] / complete["xy"], "", at_least=1.0 - WITHIN)
    yield Measurement(f"{steps} steps: noise, two directions", 1000.0 * rms_mm["xy"], "um")
    yield Measurement(f"{steps} steps: noise, one direction", 1000.0 * rms_mm["x"], "um")
    yield Measurement(f"{steps} steps: one over two", rms_mm["x"] / rms_mm["xy"], "", at_most=1.0 + WITHIN)
    yield Measurement(f"{steps} steps: farther off than 1 mm, two directions", far_ppm["xy"], "ppm")
    yield Measurement(f"{steps} steps: farther off than 1 mm, one direction", far_ppm["x"], "ppm")


def _patterns(steps: int) -> list[Pattern]:
    patterns = [even(HIGH), even(0)]
    for axis in "xy":
        patterns += [*sines(axis, OTHERS_PERIOD_PX, steps), *stripes(axis, OTHERS_PERIOD_PX / 2, OTHERS_BITS)]
    return patterns


def _described(steps: int, axes: str) -> str:
    order = OTHERS_ORDER.format(steps=steps)
    if axes == "x":
        order = order.replace("sine-y", "-").replace("gray-y", "-")
    return (
        f'[images]\nleft = "left/*.png"\nright = "right/*.png"\norder = "{order}"\n[projector]\nwidth_px = 1024\nheight_px = 768\n'
        + "".join(OTHERS_AXIS.format(axis=axis, steps=steps) for axis in axes)
        + '[cameras]\nfiles = ["stereo.yml"]\n'
    )


def _judged(image_set: ForeignSet) -> tuple[float, float, float]:
    """Return completeness in percent of the visible surface, RMS distance of points from it, and ppm of far points."""
    scan = read_foreign(image_set.description, silent)
    cloud = find_points(scan.description, scan.rig, scan.cameras["left"], scan.cameras["right"]).cloud
    visible = image_set.renderer.view("left", 0.0).seen_by_all
    points_mm = left_to_rig(image_set.renderer.truth, cloud.points_mm[cloud.mask])
    off_mm = np.abs(image_set.renderer.surface(0.0).distance_mm(points_mm))
    near = off_mm < FAR_MM
    complete = 100.0 * float((cloud.mask & visible).sum()) / float(visible.sum())
    return complete, float(np.sqrt(np.mean(np.square(off_mm[near])))), 1e6 * float(np.mean(~near))
