"""What the verdict on movement is worth: refused when it harms, kept when it does not, and never a scan at rest."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, build_sequence
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.verdict.motion.judge import MotionJudgement, judge_motion
from bench.result import Measured
from bench.spread import spread
from bench.verdict.kept_scans import KeptScans, Take
from bench.verdict.motion_cases import (
    FRAME_S,
    TEXTURES,
    TRUTH_SET,
    TURNS,
    Case,
    Frames,
    draw_case,
    without_fish,
)
from bench.verdict.motion_figures import HARMFUL, Row, figures, roc_table
from bench.verdict.motion_pictures import draw_maps, draw_roc, draw_scatter
from bench.verdict.motion_truth import errors_mm, noise_mm, rms_mm
from bench.verdict.parts import Say
from hw_sim.rendering.render import Renderer
from hw_sim.truth import draw_truth
from tests.support.judged import as_judged, judge_frames, record
from tests.support.truth import WATER, complete_calibration, true_calibration

SEEDS_PER_SEED = 1_000_000
FULL_PX = (1600, 1200)
OUT = Path("bench/out")
LEAST_POINTS = 500
"""Fewer say nothing of what was added to them."""


@dataclass(frozen=True, slots=True)
class Judged:
    """One scene recorded at rest and moving."""

    case: Case
    noise_mm: float
    """What the cameras' noise moves points by; NaN: too few points to tell."""
    added: float
    """By the movement, truly, as a fraction of the noise; NaN: as above."""
    lost: float
    """Share of the points that the movement costs: they contradict themselves and are left out."""
    still: MotionJudgement
    moving: MotionJudgement
    bright: NDArray[np.uint8]
    """(h, w): the left camera's bright frame of the moving recording."""

    def as_row(self) -> Row:
        """Ready for JSON; what was not judged is null."""
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
        }


def _said(one: MotionJudgement) -> dict[str, Any]:
    return {
        "passed": one.judgement.verdict.passed,
        "added_percent": None if one.added is None else _rounded(100.0 * one.added),
        "kind": one.kind.value,
        "score": None if one.scores.largest is None else _rounded(one.scores.largest),
        "text": one.judgement.verdict.text,
    }


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else float(f"{value:.4g}")


def case_of(seed: int, number: int) -> Case:
    """The ``number``-th scene of a seed: kinds of movement and textures take turns, all else is drawn."""
    return draw_case(
        SEEDS_PER_SEED * seed + number, TURNS[number % len(TURNS)], TEXTURES[number // len(TURNS) % len(TEXTURES)]
    )


def measure(scans: int, seed: int, say: Say, keep: Path | None = None) -> tuple[list[Measured], dict[str, Any]]:
    """``scans`` scenes, each at rest and moving; their frames come from ``keep`` and are kept there."""
    kept = KeptScans(keep)
    rows: list[Row] = []
    shown: dict[str, Judged] = {}
    cases = [case_of(seed, number) for number in range(scans)]
    say(f"motion: {scans} scenes", 0.0)
    for number, judged in enumerate(spread(partial(examine, kept=kept), cases), 1):
        say(f"motion: {number} of {scans} scenes", number / scans)
        rows.append(judged.as_row())
        # The one nearest to the limit tells more than a gross one.
        nearest = shown.get(judged.case.kind)
        if judged.added > HARMFUL and (nearest is None or judged.added < nearest.added):
            shown[judged.case.kind] = judged
    cpu_ms = cpu_at_full_size_ms(cases[0], kept)
    OUT.mkdir(parents=True, exist_ok=True)
    draw_scatter(OUT / "motion-harm.png", rows)
    draw_roc(OUT / "motion-roc.png", rows)
    maps = [shown[kind] for kind in ("axial", "rotation", "lateral", "tremor") if kind in shown]
    if maps:
        titled = [(f"{j.case.kind}, {j.case.scene.texture} {j.case.scene.object}", j.bright, j.moving) for j in maps]
        draw_maps(OUT / "motion-maps.png", titled)
    return figures(rows, cpu_ms), {"scans": rows, "roc": roc_table(rows), "cpu_ms": cpu_ms}


def examine(case: Case, kept: KeptScans) -> Judged:
    """Both recordings of one scene, with noise put on and judged; the truth from those without."""
    clean = {take: kept.frames(case, take) for take in Take}
    height, width = clean[Take.REST]["left"].shape[1:]
    truth = draw_truth(TRUTH_SET, case.seed, width, height, case.scene.water.index)
    calibration = complete_calibration(truth)
    sequence = build_sequence(case.period_px)
    recorded = {take: record(frames, case.gain_db, case.seed, 1 + n) for n, (take, frames) in enumerate(clean.items())}
    noise, added, lost = harm(case, truth_renderer(case, width, height), clean, recorded[Take.REST])
    still, moving = (
        judge_frames(recorded[take], calibration, case.period_px, case.gain_db, case.exposure_s) for take in Take
    )
    return Judged(case, noise, added, lost, still, moving, recorded[Take.MOVING]["left"][sequence.bright])


def truth_renderer(case: Case, width: int, height: int) -> Renderer:
    """Of the case at rest."""
    truth = draw_truth(TRUTH_SET, case.seed, width, height, case.scene.water.index)
    return Renderer(truth, without_fish(case.scene))


def harm(case: Case, standing: Renderer, clean: Mapping[Take, Frames], noisy: Frames) -> tuple[float, float, float]:
    """The noise of the points in mm, what the movement truly adds as a fraction of it, and the share of points it costs."""
    sequence = build_sequence(case.period_px)
    at_s = float(np.mean(sequence.axis(Direction.X).sine)) * FRAME_S
    moved = Renderer(standing.truth, replace(case.scene, motion=case.motion))
    with Pipeline(complete_calibration(standing.truth), WATER, sequence) as pipeline:
        rest = cloud_of(pipeline, clean[Take.REST])
        rest_mm, fit = errors_mm(standing, rest, 0.0)
        with_noise = cloud_of(pipeline, noisy)
        noise = noise_mm(rest, rest_mm, with_noise, errors_mm(standing, with_noise, 0.0, fit)[0])
        moving = cloud_of(pipeline, clean[Take.MOVING])
        moving_mm, _ = errors_mm(moved, moving, at_s)
    lost = 1.0 - len(moving.pixel) / max(len(rest.pixel), 1)
    if min(len(rest.pixel), len(with_noise.pixel), len(moving.pixel)) < LEAST_POINTS:
        return math.nan, math.nan, lost
    squared = max(rms_mm(moving_mm) ** 2 - rms_mm(rest_mm) ** 2, 0.0)
    return noise, math.sqrt(1.0 + squared / noise**2) - 1.0, lost


def cloud_of(pipeline: Pipeline, frames: Frames) -> Cloud:
    """The full cloud."""
    for side, stack in frames.items():
        for k in range(len(stack)):
            pipeline.push(side, stack, k)
    pipeline.coarse()
    return pipeline.full()


def cpu_at_full_size_ms(case: Case, kept: KeptScans, repeats: int = 7) -> float:
    """Median CPU time of a verdict on frames enlarged to full size."""
    clean = kept.frames(case, Take.REST)
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
