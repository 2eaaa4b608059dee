"""Owns one simulated scan under stated conditions, with the true calibration, and what is read off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.projector_response import CameraImages, MeasuredResponse, measure_response
from appliance.measure.accept.flatness import cubic_of
from appliance.measure.light.response import Response
from appliance.measure.points.pipeline import Cloud, Pipeline
from hw_sim.scene import Scene
from tests.support.bias import DepthErrors, coordinate_errors, depth_errors, ripple, rms
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

Pose = tuple[float, float, float, float, float, float]

TRUTH, SEED = "modelled", 3
"""A rig of realistic amounts that the product's model can express: its true calibration leaves only what images add."""
WIDTH_PX, STRIP_PX, WHOLE_PX = 1600, 240, 1200
MIDDLE: Pose = (0.0, 0.0, 522.5, 0.0, 0.0, 0.0)
TILTED: Pose = (0.0, 0.0, 522.5, 0.0, 35.0, 0.0)
NEAR: Pose = (0.0, 0.0, 470.0, 0.0, 0.0, 0.0)
FAR: Pose = (0.0, 0.0, 585.0, 0.0, 0.0, 0.0)
EXPOSURE_S = {MIDDLE: 0.012, TILTED: 0.012, NEAR: 0.0095, FAR: 0.012}
"""The instrument's own; nearer than the working distance it would be saturated."""
WILD_MM = 0.4
"""Ten sigmas of 16-px fringes, more for longer ones: farther from the truth is a pixel on the object's edge."""
UM = 1000.0


@dataclass(frozen=True, slots=True)
class Taken:
    """A scan, decoded and reconstructed."""

    scan: RenderedScan
    pipeline: Pipeline
    cloud: Cloud
    errors: DepthErrors

    @property
    def judged(self) -> NDArray[np.bool_]:
        """(n,): points whose true point all eyes see."""
        wild_mm = WILD_MM * self.scan.sequence.period_px / 16.0
        return self.errors.seen & (np.abs(self.errors.along_ray_mm) < wild_mm)


@dataclass(frozen=True, slots=True)
class Read:
    """What is read off a scan of a plane."""

    coordinate_ripple_px: float
    """Amplitude at four cycles a period of the left camera's pattern coordinate, pattern px."""
    difference_px: float
    """The same of left less right: what does not cancel by itself."""
    depth_ripple_um: float
    """The same along the rays, of points."""
    smooth_um: float
    """RMS of a cubic in the pattern coordinates fitted to the errors along the rays: what would bend a plane."""
    rms_um: float
    sigma_ratio: float
    """RMS of errors in expected errors."""
    modulation_dn: float


def take(
    scene: Scene,
    period_px: int = 16,
    exposure_s: float = 0.012,
    response: Response | None = None,
    height_px: int = STRIP_PX,
    corrected: bool = False,
) -> Taken:
    """Scan a scene; a strip from the middle of the images unless ``height_px`` says more.

    ``corrected``: with the first-order correction of paint.
    """
    from bench.phase_bias.paint import correct

    scan = render_scan(scene, TRUTH, SEED, WIDTH_PX, period_px, exposure_s, height_px=height_px, response=response)
    with Pipeline(true_calibration(scan.renderer.truth), WATER, scan.sequence) as pipeline:
        for k in range(len(scan.sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, k)
        if corrected:
            for side, frames in scan.frames.items():
                correct(pipeline.decoded(side), frames[scan.sequence.bright], frames[scan.sequence.dark])
        pipeline.coarse()
        cloud = pipeline.full()
    return Taken(scan, pipeline, cloud, depth_errors(scan.renderer, cloud))


def read(taken: Taken) -> Read:
    """Everything that is read off a plane."""
    period_px = taken.scan.sequence.period_px
    by_side = []
    for side in ("left", "right"):
        one = coordinate_errors(taken.scan.renderer, taken.pipeline, side)
        by_side.append(ripple(one.error_px[:, 0], one.true_px[:, 0], period_px))
    keep = taken.judged
    along, true = taken.errors.along_ray_mm[keep], taken.errors.true_px[keep]
    return Read(
        by_side[0],
        abs(by_side[0] - by_side[1]),
        UM * ripple(along, true[:, 0], period_px),
        UM * rms(cubic_of(true, along)),
        UM * rms(along),
        rms(along / taken.cloud.sigma_mm[keep]),
        float(np.median(taken.cloud.modulation_dn)),
    )


def response_seen(taken: Taken) -> MeasuredResponse:
    """The projector's response as that scan tells it."""
    maps = {side: taken.pipeline.decoded(side) for side in taken.scan.frames}
    seen = [CameraImages(taken.scan.frames[side], one.p_px, one.q_px) for side, one in maps.items()]
    return measure_response(taken.scan.sequence, seen)
