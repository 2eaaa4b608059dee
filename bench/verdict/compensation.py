"""What undoing a hand's motion is worth: scans of moving hands against the same scans at rest.

A cloud is judged against the true surface at its own time, the middle of the x-sines. Three hands are always measured on
three objects: (a) slow and trembling, (b) accelerating along the view, (c) fast and accelerating. The others are drawn.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from appliance.compensation.attempt import attempt
from appliance.reconstruct.pipeline import Cloud, Pipeline
from bench.result import Measured
from bench.verdict.parts import Say
from bench.verdict.uncertainty import along_the_ray, spread
from hw_sim.motion import Motion
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, judge_at, recorded
from tests.support.rendered import render_scan
from tests.support.truth import WATER, true_calibration

WIDTH_PX = 800
NAMED = {
    "a": Motion((6.0, 5.0, 6.2), tremor_mm=(0.2, 0.2, 0.2), rotation_deg_s=(1.0, -1.5, 1.0)),
    "b": Motion((0.0, 0.0, 20.0), (0.0, 0.0, 300.0)),
    "c": Motion((18.0, 15.0, 18.6), (120.0, 100.0, 124.0), rotation_deg_s=(2.0, -2.0, 1.5)),
}
OBJECTS = {"pipe": "checker", "plane": "strong", "shell": "slight"}
TEXTURES = ("none", "slight", "strong", "checker")
FASTEST_MM_S, MOST_MM_S2, MOST_TREMOR_MM, MOST_DEG_S = 25.0, 100.0, 0.25, 2.0
AT_REST = 0.2
"""Share of the draws in which nothing moves."""
WORSE = 1.05


@dataclass(frozen=True, slots=True)
class Case:
    """One scan and its twin at rest."""

    name: str
    scene: Scene
    truth: str
    seed: int


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measured], dict[str, Any]]:
    """The nine named cases, and ``scans`` drawn ones."""
    cases = [
        Case(f"{hand}-{name}", Scene(name, texture=texture, motion=motion), "modelled", seed)
        for hand, motion in NAMED.items()
        for name, texture in OBJECTS.items()
    ]
    cases += [_draw(np.random.default_rng([seed, 41, k]), k) for k in range(scans)]
    rows = []
    for number, case in enumerate(cases):
        say(case.name, number / len(cases))
        rows.append(_judge(case))
    named, drawn = rows[: len(NAMED) * len(OBJECTS)], rows[len(NAMED) * len(OBJECTS) :]
    used = [row for row in drawn if row["used"]]
    refused = [row for row in drawn if not row["used"] and row["moved"]]
    worse = [row for row in rows if row["used"] and row["after"] > WORSE * max(row["before"], 1.0)]
    found = [
        Measured(
            f"hand {hand}: rms over at rest, worst of three", _worst(named, hand, "after"), "",
            at_most=1.2, key=f"compensation_{hand}",
        )
        for hand in NAMED
    ]  # fmt: skip
    found += [Measured(f"hand {hand}: the same, nothing done", _worst(named, hand, "before"), "") for hand in NAMED]
    found += [
        Measured("drawn, compensated: rms over at rest, median", _median(used, "after"), "", at_most=1.2)
        if used else Measured("drawn, compensated: rms over at rest, median", math.nan, "", why="none was drawn"),
        Measured("drawn, compensated: the same, nothing done", _median(used, "before"), "")
        if used else Measured("drawn, compensated: the same, nothing done", math.nan, "", why="none was drawn"),
        Measured("drawn, compensated: worst", max((row["after"] for row in used), default=math.nan), "",
                 why=None if used else "none was drawn"),
        Measured("drawn scans compensated", float(len(used)), "scans"),
        Measured("drawn scans to be repeated", float(len(refused)), "scans"),
        Measured("scans made worse", float(len(worse)), "scans", at_most=0.0, key="compensation_worse"),
        Measured("named, compensated: error in own sigmas (or its inverse), worst", _farthest(named), "", at_most=1.1),
        Measured("CPU time of an attempt, median", _median(rows, "cpu_s"), "s"),
    ]  # fmt: skip
    return found, {"width_px": WIDTH_PX, "named": named, "drawn": drawn}


def _draw(rng: np.random.Generator, number: int) -> Case:
    def vector(most: float) -> tuple[float, float, float]:
        direction = rng.normal(size=3)
        x, y, z = (float(v) for v in direction / np.linalg.norm(direction) * rng.uniform(0.0, most))
        return x, y, z

    motion = Motion(
        vector(FASTEST_MM_S),
        vector(MOST_MM_S2),
        vector(MOST_TREMOR_MM),
        float(rng.uniform(5.0, 9.0)),
        vector(MOST_DEG_S),
    )
    if rng.uniform() < AT_REST:
        motion = Motion()
    name = str(rng.choice(["plane", "pipe", "shell", "frustum", "stones"]))
    scene = Scene(name, texture=str(rng.choice(TEXTURES)), motion=motion, ambient=float(rng.uniform(0.0, 0.1)))
    return Case(f"drawn {number}: {name}", scene, "realistic", int(rng.integers(1 << 30)))


def _judge(case: Case) -> dict[str, Any]:
    scan = render_scan(case.scene, case.truth, case.seed, WIDTH_PX, 16, frame_s=FRAME_S)
    rest_scene = Scene(case.scene.object, texture=case.scene.texture, ambient=case.scene.ambient)
    calibration = true_calibration(scan.renderer.truth)
    rest = render_scan(rest_scene, case.truth, case.seed, WIDTH_PX, 16, frame_s=0.0)
    at_rest = judge_at(rest, _plain(rest, calibration)[1], 0.0)
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        _push(pipeline, scan.frames, len(scan.sequence))
        found = pipeline.find_full()
        plain = pipeline.table.cloud(found)
        begun_s = time.process_time()
        tried = attempt(pipeline, found, recorded(scan, pipeline), calibration, WATER)
        cpu_s = time.process_time() - begun_s
        motion = tried.motion
        time_s = motion.reference_s if motion is not None else 10.5 * FRAME_S
        before = judge_at(scan, plain, time_s)
        after, in_sigmas = before, None
        if tried.found is not None:
            cloud = pipeline.table.cloud(tried.found)
            after = judge_at(scan, cloud, time_s)
            in_sigmas = spread(along_the_ray(scan, cloud, time_s) / cloud.sigma_mm)["rms_trimmed"]
    return {
        "name": case.name, "texture": case.scene.texture, "moved": not case.scene.motion.still,
        "used": tried.found is not None, "why": tried.why, "cpu_s": cpu_s,
        "at_rest_mm": at_rest.rms_mm, "before": before.rms_mm / at_rest.rms_mm, "after": after.rms_mm / at_rest.rms_mm,
        "completeness_at_rest": at_rest.completeness_percent, "completeness_before": before.completeness_percent,
        "completeness_after": after.completeness_percent,
        "expected_before": None if motion is None else motion.error_before,
        "expected_after": tried.error_after, "in_sigmas": in_sigmas,
    }  # fmt: skip


def _push(pipeline: Pipeline, frames: Any, count: int) -> None:
    for side in ("left", "right"):
        for k in range(count):
            pipeline.push(side, frames[side], k)
    pipeline.find_coarse()


def _plain(scan: Any, calibration: Any) -> tuple[Pipeline, Cloud]:
    with Pipeline(calibration, WATER, scan.sequence) as pipeline:
        _push(pipeline, scan.frames, len(scan.sequence))
        return pipeline, pipeline.full()


def _worst(rows: list[dict[str, Any]], hand: str, what: str) -> float:
    return max(float(row[what]) for row in rows if row["name"].startswith(f"{hand}-"))


def _farthest(rows: list[dict[str, Any]]) -> float:
    known = [float(row["in_sigmas"]) for row in rows if row["in_sigmas"] is not None]
    return max((max(one, 1.0 / one) for one in known), default=math.nan)


def _median(rows: list[dict[str, Any]], what: str) -> float:
    return float(np.median([row[what] for row in rows])) if rows else math.nan
