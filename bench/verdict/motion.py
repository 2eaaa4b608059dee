"""Accuracy of the verdict on motion: scans are rejected if it harms them, kept if not, and never rejected at rest."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import StereoNoise
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.light.water import Water
from appliance.measure.motion.attempt import attempt
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.verdicts.motion.judge import MotionJudgement, judge_motion
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.kept_scans import CaseRecording, KeptScans, Scans, Take
from bench.verdict.motion_cases import FRAME_S, TEXTURES, TRUTH_SET, TURNS, Case, Frames, draw_case
from bench.verdict.motion_figures import HARMFUL, Row, figures, roc_table
from bench.verdict.motion_pictures import draw_maps, draw_roc, draw_scatter
from bench.verdict.motion_truth import errors_mm, noise_mm, rms_mm
from bench.verdict.parts import Say
from bench.verdict.worlds import ORDINARY, scans_of
from hw_sim.rendering.render import Renderer
from hw_sim.truth import draw_truth
from tests.support.judged import as_judged, judge_frames
from tests.support.truth import WATER, complete_calibration, true_calibration

SEEDS_PER_SEED = 1_000_000
FULL_PX = (1600, 1200)
OUT = Path("bench/out")
LEAST_POINTS = 500
"""Least number of points for measuring the added noise."""


@dataclass(frozen=True, slots=True)
class SceneResult:
    """One scene recorded at rest and moving."""

    case: Case
    noise_mm: float
    """Error of points by camera noise; NaN for too few points."""
    added: float
    """True added noise by the motion, as a fraction of the noise; NaN for too few points."""
    lost: float
    """Share of the points that are lost by the motion."""
    still: MotionJudgement
    moving: MotionJudgement
    compensated: float | None
    """Error of a rejected moving recording after compensation, over that at rest; ``None`` without compensation, NaN
    for too few points."""
    bright: NDArray[np.uint8]
    """(h, w): the left camera's bright frame of the moving recording."""

    def as_row(self) -> Row:
        """Return a row, JSON-ready; values that were not judged are null."""
        case = self.case
        return {
            "seed": case.seed,
            "kind": case.kind,
            "object": case.scene.object,
            "texture": case.scene.texture,
            "period_px": case.period_px,
            "classes": list(case.classes),
            "speed_mm_s": round(case.speed_mm_s, 3),
            "noise_mm": _rounded(self.noise_mm),
            "added_percent": _rounded(100.0 * self.added),
            "lost_percent": _rounded(100.0 * self.lost),
            "at_rest": _said(self.still),
            "moving": _said(self.moving),
            "compensated": self.compensated is not None,
            "compensated_over_rest": None if self.compensated is None else _rounded(self.compensated),
        }


def _said(judged: MotionJudgement) -> dict[str, Any]:
    return {
        "passed": judged.judgement.verdict.passed,
        "added_percent": None if judged.added is None else _rounded(100.0 * judged.added),
        "kind": judged.kind.value,
        "score": None if judged.scores.largest is None else _rounded(judged.scores.largest),
        "text": judged.judgement.verdict.text,
    }


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.4g}")


def case_of(seed: int, number: int) -> Case:
    """Return scene ``number`` of a seed; kinds of motion and textures alternate, the others are drawn."""
    return draw_case(
        SEEDS_PER_SEED * seed + number, TURNS[number % len(TURNS)], TEXTURES[number // len(TURNS) % len(TEXTURES)]
    )


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` scenes of ``world``, each at rest and moving.

    Their frames are read from and stored in ``keep``.
    """
    scan_source = scans_of(world, keep)
    rows: list[Row] = []
    shown: dict[str, SceneResult] = {}
    cases = [case_of(seed, number) for number in range(scans)]
    say(f"motion: {scans} scenes", 0.0)
    for number, judged in enumerate(spread(partial(examine, scan_source=scan_source), cases), 1):
        say(f"motion: {number} of {scans} scenes", number / scans)
        rows.append(judged.as_row())
        # A scene near the limit is a better example than a clear one.
        nearest = shown.get(judged.case.kind)
        if judged.added > HARMFUL and (nearest is None or judged.added < nearest.added):
            shown[judged.case.kind] = judged
    cpu_ms = cpu_at_full_size_ms(cases[0], KeptScans(keep))
    OUT.mkdir(parents=True, exist_ok=True)
    draw_scatter(OUT / "motion-harm.png", rows)
    draw_roc(OUT / "motion-roc.png", rows)
    maps = [shown[kind] for kind in ("axial", "rotation", "lateral", "tremor") if kind in shown]
    if maps:
        titled = [(f"{j.case.kind}, {j.case.scene.texture} {j.case.scene.object}", j.bright, j.moving) for j in maps]
        draw_maps(OUT / "motion-maps.png", titled)
    return figures(rows, cpu_ms), {"scans": rows, "roc": roc_table(rows), "cpu_ms": cpu_ms}


def examine(case: Case, scan_source: Scans) -> SceneResult:
    """Judge both recordings of one scene with noise; the truth comes from those without."""
    recorded = {take: scan_source.recorded(case, take) for take in Take}
    standing, moved = (scan_source.renderer(case, take) for take in Take)
    calibration = complete_calibration(standing.truth)
    noise, water = scan_source.noise(case), scan_source.water(case)
    still, moving = (
        judge_frames(take_frames.noisy, calibration, case.period_px, case.gain_db, take_frames.exposure_s, noise, water)
        for take_frames in recorded.values()
    )
    noise_of_points_mm, added, lost = harm(case, standing, moved, recorded, water, noise)
    undone = None
    if moving.judgement.verdict.passed is False:
        undone = compensated(case, standing, moved, recorded, water, noise, moving.added)
    bright = recorded[Take.MOVING].noisy["left"][build_sequence(case.period_px).bright]
    return SceneResult(case, noise_of_points_mm, added, lost, still, moving, undone, bright)


def harm(
    case: Case,
    standing: Renderer,
    moved: Renderer,
    recorded: Mapping[Take, CaseRecording],
    water: Water,
    stated: StereoNoise,
) -> tuple[float, float, float]:
    """Return the noise of the points in mm, the true added noise as a fraction of it, and the lost share of points."""
    sequence = build_sequence(case.period_px)
    at_s = float(np.mean(sequence.axis(Direction.X).sine)) * FRAME_S
    with Pipeline(complete_calibration(standing.truth), water, sequence, noise=stated) as pipeline:
        rest_cloud = cloud_of(pipeline, recorded[Take.REST].clean)
        rest_mm, fit = errors_mm(standing, rest_cloud, 0.0)
        with_noise = cloud_of(pipeline, recorded[Take.REST].noisy)
        noise = noise_mm(rest_cloud, rest_mm, with_noise, errors_mm(standing, with_noise, 0.0, fit)[0])
        moving = cloud_of(pipeline, recorded[Take.MOVING].clean)
        moving_mm, _ = errors_mm(moved, moving, at_s)
    lost = 1.0 - len(moving.pixel) / max(len(rest_cloud.pixel), 1)
    if min(len(rest_cloud.pixel), len(with_noise.pixel), len(moving.pixel)) < LEAST_POINTS:
        return math.nan, math.nan, lost
    squared = max(rms_mm(moving_mm) ** 2 - rms_mm(rest_mm) ** 2, 0.0)
    return noise, math.sqrt(1.0 + squared / noise**2) - 1.0, lost


def compensated(
    case: Case,
    standing: Renderer,
    moved: Renderer,
    recorded: Mapping[Take, CaseRecording],
    water: Water,
    stated: StereoNoise,
    judged_to_add: float | None,
) -> float | None:
    """Return the error of the points of the moving recording after compensation, over that at rest, both with noise.

    ``None`` where compensation is not shown, NaN for too few points.
    """
    sequence, calibration = build_sequence(case.period_px), complete_calibration(standing.truth)
    with Pipeline(calibration, water, sequence, noise=stated) as pipeline:
        rest_cloud = cloud_of(pipeline, recorded[Take.REST].noisy)
        moving = recorded[Take.MOVING]
        images, _ = as_judged(pipeline, moving.noisy, case.gain_db, moving.exposure_s, stated)
        attempted = attempt(pipeline, pipeline.find_full(straightened=False), images, calibration, water, judged_to_add)
        if attempted.found is None:
            return None
        assert attempted.motion is not None, "what is shown has a moment that it belongs to"
        cloud = pipeline.table.cloud(attempted.found)
        if min(len(rest_cloud.pixel), len(cloud.pixel)) < LEAST_POINTS:
            return math.nan
        errors, at_rest = errors_mm(moved, cloud, attempted.motion.reference_s), errors_mm(standing, rest_cloud, 0.0)
    return rms_mm(errors[0]) / rms_mm(at_rest[0])


def cloud_of(pipeline: Pipeline, frames: Frames) -> Cloud:
    """Return the full cloud of the frames."""
    for side, stack in frames.items():
        for k in range(len(stack)):
            pipeline.push(side, stack, k)
    pipeline.coarse()
    return pipeline.full()


def cpu_at_full_size_ms(case: Case, scan_source: KeptScans, repeats: int = 7) -> float:
    """Return the median CPU time of a verdict on frames enlarged to full size."""
    clean = scan_source.frames(case, Take.REST)
    frames = {
        side: np.stack([cv2.resize(f, FULL_PX, interpolation=cv2.INTER_CUBIC) for f in stack])
        for side, stack in clean.items()
    }
    calibration = true_calibration(draw_truth(TRUTH_SET, case.seed, *FULL_PX, case.scene.water.index))
    times = []
    with Pipeline(calibration, WATER, build_sequence(case.period_px)) as pipeline:
        recorded, cloud = as_judged(pipeline, frames, case.gain_db, case.exposure_s)
        for _ in range(repeats + 1):
            begun = time.process_time()
            judge_motion(recorded, cloud, calibration.rig, WATER.index)
            times.append(1e3 * (time.process_time() - begun))
    return float(np.median(times[1:]))
