"""Scans straight from the simulated cameras, without devices and service: for judging reconstruction alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.patterns import Direction, PatternSequence, build_sequence
from appliance.measure.light.response import Response
from appliance.measure.light.sides import SIDES
from appliance.measure.points.pipeline import Cloud, Pipeline
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth
from tests.support.synthetic import push_all
from tests.support.truth import WATER, left_to_rig, true_calibration

EXPOSURE_S = 0.012
FRAME_S = 1.0 / 60.0
"""Between frames by the clock of daylight and drift, where the hands are at rest."""


@dataclass(frozen=True)
class RenderedScan:
    renderer: Renderer
    sequence: PatternSequence
    frames: Mapping[str, NDArray[np.uint8]]
    exposure_s: float = EXPOSURE_S
    frame_s: float = 0.0

    def hidden(self, camera: str) -> NDArray[np.bool_]:
        """(frames, h, w): where drift hides the object from ``camera``."""
        return np.stack(
            [
                self.renderer.hidden_by_drift(camera, k * self.frame_s, k * (self.frame_s or FRAME_S), self.exposure_s)
                for k in range(len(self.sequence))
            ]
        )


def pictures(sequence: PatternSequence, response: Response | None = None) -> list[NDArray[np.uint8]]:
    """The patterns as the projector shows them."""
    shape = (sequence.height_px, sequence.width_px)
    tables = [(p.direction, p.codes(response)) for p in sequence.patterns]
    return [
        np.ascontiguousarray(np.broadcast_to(codes[None, :] if d is Direction.X else codes[:, None], shape))
        for d, codes in tables
    ]


def exposed(
    renderer: Renderer, shown: Sequence[NDArray[np.uint8]], exposure_s: float, frame_s: float = 0.0, gain_db: float = 0.0, seed: int = 0
) -> dict[str, NDArray[np.uint8]]:  # fmt: skip
    """Both cameras' frames (n, h, w) of patterns, ``frame_s`` after one another (0: the hands are at rest, and the frames
    ``FRAME_S`` apart by the clock of daylight and drift)."""

    def camera(side: str) -> NDArray[np.uint8]:
        shots = []
        for k, one in enumerate(shown):
            light, noise = [LightSlice(one, exposure_s)], seed + 2 * k + (side == "left")
            at_s, clock_s = k * frame_s, k * (frame_s or FRAME_S)
            shots.append(renderer.expose(side, light, at_s, exposure_s, gain_db, (False, False), noise, clock_s))
        return np.stack(shots)

    with ThreadPoolExecutor(2) as pool:
        return dict(zip(SIDES, pool.map(camera, SIDES), strict=True))


def render_scan(
    scene: Scene, truth_set: str, seed: int, width_px: int, period_px: int, exposure_s: float = EXPOSURE_S, height_px: int | None = None,
    response: Response | None = None, frame_s: float = 0.0, gain_db: float = 0.0, change: Callable[[TrueRig], TrueRig] | None = None,
) -> RenderedScan:  # fmt: skip
    """Both cameras' frames of a scene, timed as those that are ``exposed``.

    A smaller ``height_px`` is a strip out of the middle; ``response``: the projector's, that the patterns are drawn for;
    ``change``: what became of the drawn rig since.
    """
    truth = draw_truth(truth_set, seed, width_px, height_px or width_px * 3 // 4, scene.water.index)
    renderer, sequence = Renderer(truth if change is None else change(truth), scene), build_sequence(period_px)
    frames = exposed(renderer, pictures(sequence, response), exposure_s, frame_s, gain_db)
    return RenderedScan(renderer, sequence, frames, exposure_s, frame_s)


def reconstruct(scan: RenderedScan, calibration: Calibration | None = None) -> tuple[Pipeline, Cloud]:
    """Coarse and full; with the calibration that states the truth unless another is given."""
    pipeline = Pipeline(calibration or true_calibration(scan.renderer.truth), WATER, scan.sequence)
    push_all(pipeline, scan.frames)
    pipeline.coarse()
    return pipeline, pipeline.full()


@dataclass(frozen=True)
class Accuracy:
    completeness_percent: float
    outliers_ppm: float
    rms_mm: float


def judge(scan: RenderedScan, cloud: Cloud, time_s: float = 0.0) -> Accuracy:
    """A cloud against the true surface at ``time_s``, and against what all three eyes truly see of it then."""
    seen = scan.renderer.view("left", time_s).seen_by_all.ravel()
    found = np.zeros(seen.size, bool)
    found[cloud.pixel] = True
    distance = scan.renderer.surface(time_s).distance_mm(left_to_rig(scan.renderer.truth, cloud.points_mm))
    return Accuracy(
        100.0 * float((found & seen).sum()) / float(seen.sum()),
        1e6 * float(np.mean(np.abs(distance) > 1.0)),
        float(np.sqrt(np.mean(distance**2))),
    )
