"""What the verdict on movement is worth: refused when it harms, kept when it does not, and never a scan at rest."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence, build_sequence
from appliance.reconstruct.decode import CameraDecoder
from appliance.reconstruct.noise import StereoNoise, camera_noise
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.verdict.motion import MotionJudgement, judge_motion
from appliance.verdict.recorded import Recorded
from bench.result import Measured
from bench.verdict.motion_cases import FRAME_S, KINDS, TEXTURES, TRUTH_SET, Case, Frames, draw_case, record, render
from bench.verdict.motion_pictures import draw_maps, draw_roc, draw_scatter, roc_table
from bench.verdict.motion_truth import errors_mm, noise_mm, rms_mm
from bench.verdict.parts import Say
from hw_sim.render import Renderer
from hw_sim.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.truth import draw_truth
from tests.support.truth import WATER, true_calibration

GAINS_DB = (0.0, 6.0)
"""Each scene is recorded with both: the same movement, another noise."""
HARMFUL, HARMLESS, LOST = 0.10, 0.05, 0.10
"""Noise added, as a fraction; and a share of the points whose loss is harm, too."""
SEEDS_PER_SEED = 1_000_000
FULL_PX = (1600, 1200)
OUT = Path("bench/out")


@dataclass(frozen=True, slots=True)
class Judged:
    """One scene recorded once at rest and once moving, with the same noise."""

    seed: int
    kind: str
    texture: str
    thing: str
    speed_mm_s: float
    gain_db: float
    added: float
    """Truly, as a fraction of the noise."""
    noise_mm: float
    lost: float
    """Share of the points that the movement costs: they contradict themselves and are left out."""
    still: MotionJudgement
    moving: MotionJudgement
    bright: NDArray[np.uint8]
    """(h, w): the left camera's bright frame of the moving recording."""

    def as_dict(self) -> dict[str, Any]:
        """Ready for JSON; what was not judged is null."""

        def of(one: MotionJudgement) -> dict[str, Any]:
            return {
                "passed": one.judgement.verdict.passed,
                "added_percent": None if one.added is None else 100.0 * one.added,
                "kind": one.kind.value,
                "score": one.scores.largest,
                "axial_mm_s": one.axial_mm_s,
                "lateral_mm_s": one.lateral_mm_s,
                "text": one.judgement.verdict.text,
            }

        return {
            "seed": self.seed,
            "kind": self.kind,
            "texture": self.texture,
            "object": self.thing,
            "speed_mm_s": self.speed_mm_s,
            "gain_db": self.gain_db,
            "added_percent": 100.0 * self.added,
            "noise_mm": self.noise_mm,
            "lost_percent": 100.0 * self.lost,
            "at_rest": of(self.still),
            "moving": of(self.moving),
        }


def case_of(seed: int, number: int) -> Case:
    """The ``number``-th scene of a seed: kinds of movement and textures take turns, all else is drawn."""
    return draw_case(
        SEEDS_PER_SEED * seed + number, KINDS[number % len(KINDS)], TEXTURES[number // len(KINDS) % len(TEXTURES)]
    )


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measured], dict[str, Any]]:
    """``scans`` scenes, each at rest and moving, with two gains."""
    judged: list[Judged] = []
    for number in range(scans):
        say(f"motion: scene {number + 1} of {scans}", number / scans)
        case = case_of(seed, number)
        judged += examine(case, render(case, False).frames, render(case, True).frames)
    cpu_ms = cpu_at_full_size_ms(case_of(seed, 0))
    data = [one.as_dict() for one in judged]
    draw(judged)
    return figures(judged, cpu_ms), {"scans": data, "roc": roc_table(data), "cpu_ms": cpu_ms}


def draw(judged: Sequence[Judged]) -> None:
    """The pictures of docs/motion.md, into ``OUT``."""
    OUT.mkdir(parents=True, exist_ok=True)
    data = [one.as_dict() for one in judged]
    draw_scatter(OUT / "motion-harm.png", data)
    draw_roc(OUT / "motion-roc.png", data)
    shown = []
    for kind in ("axial", "rotation", "lateral"):
        mine = [one for one in judged if one.kind == kind and one.added > HARMFUL and one.gain_db == 0.0]
        # The one nearest to the limit tells more than a gross one.
        mine.sort(key=lambda one: one.added)
        shown += [(f"{one.kind}, {one.texture} {one.thing}", one.bright, one.moving) for one in mine[:1]]
    if shown:
        draw_maps(OUT / "motion-maps.png", shown)


def figures(judged: Sequence[Judged], cpu_ms: float) -> list[Measured]:
    """What the targets ask for."""
    rest = [one.still.judgement.verdict.passed for one in judged]
    harmful = [one for one in judged if one.added > HARMFUL]
    harmless = [one for one in judged if one.added < HARMLESS and one.lost < LOST]
    refused = [one for one in judged if one.moving.judgement.verdict.passed is False]
    ratio = [
        math.log((1e-3 + (one.moving.added or 0.0)) / (1e-3 + one.added)) for one in judged if 0.03 < one.added < 0.3
    ]
    return [
        Measured("motion: scans at rest that were refused", sum(p is False for p in rest), f"of {len(rest)}", at_most=0),
        Measured(
            f"motion: refused, of those that add over 10 % ({len(harmful)})", _percent(harmful, refused), "%",
            at_least=99.0 if harmful else None, why=None if harmful else "none did"
        ),
        Measured(
            f"motion: refused, of those that add under 5 % and keep 90 % of the points ({len(harmless)})", _percent(harmless, refused), "%",
            at_most=0.0 if harmless else None, why=None if harmless else "none did"
        ),
        Measured(
            f"motion: predicted over true addition near the limit ({len(ratio)})",
            math.exp(float(np.median(ratio))) if ratio else math.nan,
            "",
            why=None if ratio else "none between 3 and 30 %",
            spread=tuple(np.exp(np.percentile(ratio, (10.0, 90.0)))) if ratio else None,
        ),
        Measured("motion: CPU of a verdict on 2 x 24 frames of 1600 x 1200", cpu_ms, "ms", at_most=60.0),
    ]  # fmt: skip


def _percent(asked: Sequence[Judged], refused: Iterable[Judged]) -> float:
    ids = {id(one) for one in refused}
    return 100.0 * sum(id(one) in ids for one in asked) / len(asked) if asked else math.nan


def examine(case: Case, still: Frames, moving: Frames) -> list[Judged]:
    """Both recordings of one scene, without noise, with each gain's noise put on and judged."""
    height, width = still["left"].shape[1:]
    truth = draw_truth(TRUTH_SET, case.seed, width, height, case.scene.water.index)
    calibration = true_calibration(truth)
    sequence = build_sequence(case.period_px)
    at_s = float(np.mean(sequence.axis(Direction.X).sine)) * FRAME_S
    rng = np.random.default_rng([case.seed, 7])
    judged = []
    with Pipeline(calibration, WATER, sequence) as pipeline:
        rest = Renderer(truth, case.scene)
        clean = _cloud(pipeline, still)
        clean_mm, fit = errors_mm(rest, clean, 0.0)
        moved = _cloud(pipeline, moving)
        moved_mm, _ = errors_mm(Renderer(truth, replace(case.scene, motion=case.motion)), moved, at_s)
        lost = 1.0 - len(moved.pixel) / max(len(clean.pixel), 1)
        motion_mm2 = max(rms_mm(moved_mm) ** 2 - rms_mm(clean_mm) ** 2, 0.0)
        for number, gain_db in enumerate(GAINS_DB):
            flicker = float(rng.choice([0.0, rng.uniform(0.1, 0.9)]))
            one = replace(case, gain_db=gain_db, flicker_depth=flicker)
            recorded = [record(one, frames, sequence.dark, 1 + number) for frames in (still, moving)]
            noisy = _cloud(pipeline, recorded[0])
            noise = noise_mm(clean, clean_mm, noisy, errors_mm(rest, noisy, 0.0, fit)[0])
            said = [
                judge_motion(as_recorded(frames, sequence, gain_db, case.exposure_s), calibration.rig, WATER.index)
                for frames in recorded
            ]
            added = math.sqrt(1.0 + motion_mm2 / noise**2) - 1.0
            judged.append(
                Judged(
                    case.seed, case.kind, case.scene.texture, case.scene.object, case.speed_mm_s, gain_db, added, noise, lost,
                    said[0], said[1], recorded[1]["left"][sequence.bright],
                )
            )  # fmt: skip
    return judged


def as_recorded(frames: Frames, sequence: PatternSequence, gain_db: float, exposure_s: float) -> Recorded:
    """Decoded, with the data sheet of the simulated cameras."""
    noise = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, gain_db)
    decoded = {side: decode(stack, sequence) for side, stack in frames.items()}
    return Recorded(sequence, frames, decoded, StereoNoise(noise, noise), FRAME_S, exposure_s)


def decode(frames: NDArray[np.uint8], sequence: PatternSequence) -> CameraDecoder:
    """One camera's frames."""
    decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
    for k in range(len(sequence)):
        decoder.push(frames, k)
    decoder.finish()
    return decoder


def _cloud(pipeline: Pipeline, frames: Mapping[str, NDArray[np.uint8]]) -> Cloud:
    for side, stack in frames.items():
        for k in range(len(stack)):
            pipeline.push(side, stack, k)
    pipeline.coarse()
    return pipeline.full()


def cpu_at_full_size_ms(case: Case, repeats: int = 7) -> float:
    """Median CPU time of a verdict on frames enlarged to full size."""
    clean = render(case, False).frames
    sequence = build_sequence(case.period_px)
    frames = {
        side: np.stack([cv2.resize(f, FULL_PX, interpolation=cv2.INTER_CUBIC) for f in stack])
        for side, stack in clean.items()
    }
    rig = true_calibration(draw_truth(TRUTH_SET, case.seed, *FULL_PX, case.scene.water.index)).rig
    recorded = as_recorded(frames, sequence, 0.0, case.exposure_s)
    times = []
    for _ in range(repeats + 1):
        begun = time.process_time()
        judge_motion(recorded, rig, WATER.index)
        times.append(1e3 * (time.process_time() - begun))
    return float(np.median(times[1:]))
