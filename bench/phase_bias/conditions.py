"""One simulated scan under stated conditions with the true calibration, and its errors."""

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
"""A realistic rig within the product's model: with its true calibration, only errors of the images remain."""
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
class ReconstructedScan:
    """A scan, decoded and reconstructed."""

    scan: RenderedScan
    pipeline: Pipeline
    cloud: Cloud
    errors: DepthErrors

    @property
    def is_visible(self) -> NDArray[np.bool_]:
        """(n,): points whose true point all eyes see."""
        wild_mm = WILD_MM * self.scan.sequence.period_px / 16.0
        return self.errors.seen & (np.abs(self.errors.along_ray_mm) < wild_mm)


@dataclass(frozen=True, slots=True)
class Read:
    """Errors of one scan of a plane."""

    coordinate_ripple_px: float
    """Amplitude at four cycles a period of the left camera's pattern coordinate, pattern px."""
    difference_px: float
    """Amplitude of left minus right, which does not cancel in the correspondence."""
    depth_ripple_um: float
    """Amplitude of the points' errors along the rays."""
    smooth_um: float
    """RMS of a cubic in the pattern coordinates fitted to the errors along the rays: the bending of a plane."""
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
) -> ReconstructedScan:
    """Scan a scene; a strip from the middle of the images unless ``height_px`` is larger.

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
    return ReconstructedScan(scan, pipeline, cloud, depth_errors(scan.renderer, cloud))


def read(scan: ReconstructedScan) -> Read:
    """Return the errors of a scan of a plane."""
    period_px = scan.scan.sequence.period_px
    by_side = []
    for side in ("left", "right"):
        coordinates = coordinate_errors(scan.scan.renderer, scan.pipeline, side)
        by_side.append(ripple(coordinates.error_px[:, 0], coordinates.true_px[:, 0], period_px))
    keep = scan.is_visible
    along, true = scan.errors.along_ray_mm[keep], scan.errors.true_px[keep]
    return Read(
        by_side[0],
        abs(by_side[0] - by_side[1]),
        UM * ripple(along, true[:, 0], period_px),
        UM * rms(cubic_of(true, along)),
        UM * rms(along),
        rms(along / scan.cloud.sigma_mm[keep]),
        float(np.median(scan.cloud.modulation_dn)),
    )


def response_seen(scan: ReconstructedScan) -> MeasuredResponse:
    """Return the projector's response as measured from that scan."""
    maps = {side: scan.pipeline.decoded(side) for side in scan.scan.frames}
    images = [CameraImages(scan.scan.frames[side], decoded.p_px, decoded.q_px) for side, decoded in maps.items()]
    return measure_response(scan.scan.sequence, images)
