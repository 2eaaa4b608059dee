"""Noise of the points over the speed of motion, for both orders of the steps, in both worlds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from appliance.base import draw_curves
from appliance.measure.light.patterns import RISING_STEPS, STEPS, Direction, PatternSequence, build_sequence
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Pipeline
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.motion import cloud_of
from bench.verdict.motion_cases import FRAME_S, TRUTH_SET
from bench.verdict.motion_truth import errors_mm, rms_mm
from bench.verdict.outside import WIDTH_PX, put_outside, record_sequence, suited_s, water_of
from bench.verdict.parts import Say
from bench.verdict.worlds import ORDINARY, OUTSIDE, WORLDS
from hw_sim.objects.motion import Motion
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.truth import draw_truth
from tests.support.rendered import EXPOSURE_S, exposed, pictures
from tests.support.truth import WATER, complete_calibration

PERIOD_PX = 16
SPEEDS_MM_S = (0.0, 5.0, 10.0, 20.0, 30.0)
WAYS = {"along": (0.0, 0.0, 1.0), "across": (1.0, 0.0, 0.0)}
"""Of the instrument: along the line of sight, and across it."""
THINGS = {"bare": Scene("shell", texture="none"), "painted": Scene("pipe", texture="strong")}
ORDERS = {"0 90 180 270": RISING_STEPS, "0 90 270 180": STEPS}
RIGS = 2
SHOWN = "bare"
"""The thing in the picture."""
DIVER_MM_S = 20.0
PICTURE = Path("bench/out/motion-speed.png")

Case = tuple[str, str, str, float, str, int]
"""World, thing, way, speed, order, seed."""


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the figures of each speed before two rigs of ``seed``; ``scans`` is not used."""
    ways = [(direction, mm_s) for direction in WAYS for mm_s in SPEEDS_MM_S if mm_s > 0.0 or direction == "along"]
    cases: list[Case] = [
        (world, thing, direction, mm_s, order, seed + rig)
        for world, thing, (direction, mm_s), order, rig in itertools.product(WORLDS, THINGS, ways, ORDERS, range(RIGS))
    ]
    rows = []
    for number, row in enumerate(spread(_row, cases), 1):
        say(f"motion_speed: {number} of {len(cases)} scans", number / len(cases))
        rows.append(row)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    draw(PICTURE, rows)
    measured = [
        Measurement(
            f"{world}, {thing}, {direction} at {DIVER_MM_S:g} mm/s, steps {order}: noise over that at rest",
            over_rest(rows, world, thing, direction, DIVER_MM_S, order),
            "×",
            at_most=1.6 if (direction, thing, ORDERS[order]) == ("along", "bare", STEPS) else None,
        )
        for world, thing, direction, order in itertools.product(WORLDS, THINGS, WAYS, ORDERS)
    ]
    return measured, {"seed": seed, "rows": rows}


def _row(case: Case) -> dict[str, Any]:
    world, thing, direction, mm_s, order, seed = case
    right, down, away = WAYS[direction]
    motion = Motion(velocity_mm_s=(mm_s * right, mm_s * down, mm_s * away))
    scene = replace(THINGS[thing], motion=motion)
    sequence = build_sequence(PERIOD_PX, steps=ORDERS[order])
    noise_mm, points = (_outside if world == OUTSIDE else _ordinary)(scene, seed, sequence)
    return {
        "world": world, "thing": thing, "way": direction, "speed_mm_s": mm_s, "order": order, "seed": seed,
        "rms_um": 1e3 * noise_mm, "points": points,
    }  # fmt: skip


def _ordinary(scene: Scene, seed: int, sequence: PatternSequence) -> tuple[float, int]:
    renderer = Renderer(draw_truth(TRUTH_SET, seed, WIDTH_PX, WIDTH_PX * 3 // 4, scene.water.index), scene)
    return _error_mm(renderer, exposed(renderer, pictures(sequence), EXPOSURE_S, FRAME_S), sequence, WATER)


def _outside(scene: Scene, seed: int, sequence: PatternSequence) -> tuple[float, int]:
    world = put_outside(scene, seed, TRUTH_SET, hands=False)
    renderer = world.renderer()
    recorded = record_sequence(renderer, sequence, suited_s(renderer, 0.0, 1.0), 0.0)
    return _error_mm(renderer, recorded.noisy, sequence, water_of(world.rig))


def _error_mm(renderer: Renderer, frames: Any, sequence: PatternSequence, water: Water) -> tuple[float, int]:
    """Return the root mean square distance of the points to the surface, and how many there are."""
    at_s = float(np.mean(sequence.axis(Direction.X).sine)) * FRAME_S
    with Pipeline(complete_calibration(renderer.truth), water, sequence) as pipeline:
        cloud = cloud_of(pipeline, frames)
    return rms_mm(errors_mm(renderer, cloud, at_s)[0]), len(cloud.pixel)


def over_rest(rows: Sequence[dict[str, Any]], world: str, thing: str, direction: str, mm_s: float, order: str) -> float:
    """Return the root mean square over all rigs, over that of the same rigs at rest."""

    def of(direction: str, mm_s: float) -> float:
        keys = {"world": world, "thing": thing, "way": direction, "speed_mm_s": mm_s, "order": order}
        mine = [row["rms_um"] for row in rows if all(row[name] == value for name, value in keys.items())]
        return float(np.sqrt(np.mean(np.square(mine))))

    return of(direction, mm_s) / of("along", 0.0) if mm_s > 0.0 else 1.0


def draw(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a PNG: for each world the noise over that at rest against the speed."""
    panels = []
    for world in WORLDS:
        curves = {
            f"{direction}, {order}": (
                np.array(SPEEDS_MM_S),
                np.array([over_rest(rows, world, SHOWN, direction, mm_s, order) for mm_s in SPEEDS_MM_S]),
            )
            for direction, order in itertools.product(WAYS, ORDERS)
        }
        across = f"hands, mm/s ({'the world outside' if world == OUTSIDE else ORDINARY + ' world'})"
        encoded = draw_curves(curves, across, "noise of the points over that at rest")
        panels.append(np.asarray(cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR), np.uint8))
    if not cv2.imwrite(str(path), np.concatenate(panels, axis=1)):
        raise OSError(f"{path} cannot be written")
