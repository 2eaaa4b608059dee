"""Figures of a bracket: points with the second exposure that the judge of light proposes, against each single exposure.

Each scene is scanned as by a diver: at the rig's exposure, then with the proposed second one, at rest and after a
movement of the hand. For comparison it is scanned once with the single exposure that EXPOSE would have set.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import NOMINAL, Exposure
from appliance.measure.news import FullCloud
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.procedure import SequenceProcessor
from bench.result import Measurement
from bench.verdict.light_scenes import STEPS, noise_at
from bench.verdict.parts import Say
from hw_sim.scene import Scene
from tests.support.rendered import RenderedScan, judge, render_scan
from tests.support.truth import WATER, true_calibration

OBJECTS = ("frustum", "stones", "plane")
MOVED_BY = (1.5, -1.0, 2.0, 0.3, -0.4, 0.5)
"""Motion between both sequences: mm and degrees."""
WIDTH_PX, PERIOD_PX = 400, 16
SCANS_PER_CASE = 4

Figures = tuple[float, float, float]
"""Completeness in percent, rms error in mm, outliers in ppm."""


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure white labels on black rubber.

    Every fourth scan of ``scans`` is a case with its own object, pose and rig.
    """
    rng = np.random.default_rng([seed, 61])
    count = max(1, scans // SCANS_PER_CASE)
    cases: list[dict[str, Any]] = []
    for k in range(count):
        name = OBJECTS[k % len(OBJECTS)]
        say(f"two exposures: {name}", k / count)
        cases.append(_case(name, int(rng.integers(1 << 30)), rng))
    offered = [case for case in cases if case["second"] is not None]
    merged = [(case, case[key]) for case in offered for key in ("at rest", "moved") if case[key] is not None]
    gained = [
        merged_figures[0] - max(single[0] for single in case["alone"].values()) for case, merged_figures in merged
    ]
    error = [merged_figures[1] / max(single[1] for single in case["alone"].values()) for case, merged_figures in merged]
    nothing = float("nan")
    share = 100.0 * len(merged) / (2 * len(offered)) if offered else nothing
    return [
        Measurement("scenes offered a second exposure", 100.0 * len(offered) / count, "%", at_least=100.0),
        Measurement("pairs merged", share, "%", at_least=100.0, key="pair_merged_percent"),
        Measurement(
            "surface gained over the best single exposure (least)", min(gained, default=nothing), "%", at_least=3.0
        ),
        Measurement(
            "error over that of the worst single exposure (most)", max(error, default=nothing), "", at_most=1.05
        ),
    ], {"pairs": cases}


def _case(name: str, seed: int, rng: np.random.Generator) -> dict[str, Any]:
    scene = Scene(object=name, texture="labels")
    start = tuple(float(x) for x in np.array(scene.start_pose) + rng.uniform(-1.0, 1.0, 6) * (8, 8, 15, 4, 4, 10))
    scene = replace(scene, pose=start)  # type: ignore[arg-type]
    gone = replace(scene, pose=tuple(float(x) for x in np.add(start, MOVED_BY)))  # type: ignore[arg-type]
    first = _render(scene, NOMINAL, seed)
    calibration = true_calibration(first.renderer.truth)
    case: dict[str, Any] = {"object": name, "pose": start, "second": None, "alone": {}}
    with Pipeline(calibration, WATER, first.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        full = _process(processor, first, NOMINAL)
        cloud = pipeline.table.cloud(full.cloud)
        (light,) = [judgement for judgement in full.judgements if judgement.verdict.name == "light"]
        case["alone"][NOMINAL.label] = _figures(first, cloud)
        if light.second is None:
            return case
        case["second"] = light.second.label
        held = processor.hold()
        for key, where in (("at rest", scene), ("moved", gone)):
            second = _render(where, light.second, seed)
            cloud = pipeline.table.cloud(_process(processor, second, light.second).cloud)
            if key == "at rest":
                case["alone"][light.second.label] = _figures(second, cloud)
            merged = processor.merge_with(held)
            verdict = merged.pair.verdict
            case[f"{key}: verdict"] = {"text": verdict.text, **verdict.numbers}
            case[key] = None if merged.cloud is None else _figures(first, pipeline.table.cloud(merged.cloud))
        if light.proposal is not None:
            single = _render(scene, light.proposal, seed)
            case["alone"][light.proposal.label] = _figures(
                single, pipeline.table.cloud(_process(processor, single, light.proposal).cloud)
            )
    return case


def _render(scene: Scene, exposure: Exposure, seed: int) -> RenderedScan:
    return render_scan(
        scene, "realistic", seed, WIDTH_PX, PERIOD_PX, exposure_s=exposure.time_us / 1e6, gain_db=exposure.gain_db
    )


def _process(processor: SequenceProcessor, scan: RenderedScan, exposure: Exposure) -> FullCloud:
    return processor.process(scan.frames, AcquisitionSettings(exposure, noise=noise_at(exposure), steps=STEPS))


def _figures(scan: RenderedScan, cloud: Cloud) -> Figures:
    accuracy = judge(scan, cloud)
    return accuracy.completeness_percent, accuracy.rms_mm, accuracy.outliers_ppm
