"""A simulated projector's response is found in a scan, and patterns drawn for it have no ripple left worth mentioning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.calibrate.projector_response import CameraImages, MeasuredResponse, ResponseError, measure_response
from appliance.measure.light.response import Response, phase_error_rad
from appliance.measure.points.pipeline import Pipeline
from hw_sim.objects.motion import Motion
from hw_sim.optics.projector import response as true_response
from hw_sim.scene import Imaging, Scene
from tests.support.bias import coordinate_errors, depth_errors, ripple
from tests.support.rendered import RenderedScan, reconstruct, render_scan
from tests.support.truth import WATER, true_calibration

PERIOD_PX = 64


@dataclass(frozen=True)
class Bent:
    """What a scan of a plane says, and how far its coordinates and depths are from the truth, as ripple of a period."""

    said: MeasuredResponse
    coordinate_px: float
    depth_mm: float


def record(kind: str, response: Response | None = None, noise: bool = True) -> Bent:
    scene = Scene(object="plane", noise=noise, imaging=Imaging(kind))
    scan = render_scan(scene, "modelled", 3, 400, PERIOD_PX, response=response)
    with Pipeline(true_calibration(scan.renderer.truth), WATER, scan.sequence) as pipeline:
        for k in range(len(scan.sequence)):
            for side, frames in scan.frames.items():
                pipeline.push(side, frames, k)
        # As decoded: the full cloud takes out of the coordinates what the response bends them by.
        pipeline.coarse()
        left = coordinate_errors(scan.renderer, pipeline, "left")
        cloud = pipeline.table.cloud(pipeline.find_full(straightened=False))
    depth = depth_errors(scan.renderer, cloud)
    inner = depth.seen & (np.abs(depth.along_ray_mm) < 1.0)
    return Bent(
        measure_response(scan.sequence, seen(scan, pipeline), response),
        ripple(left.error_px[:, 0], left.true_px[:, 0], PERIOD_PX),
        ripple(depth.along_ray_mm[inner], depth.true_px[inner, 0], PERIOD_PX),
    )


def seen(scan: RenderedScan, pipeline: Pipeline | None = None) -> list[CameraImages]:
    """What the cameras decoded; of a ``pipeline`` that has had the scan, or of one of its own."""
    pipeline = pipeline or reconstruct(scan)[0]
    maps = {side: pipeline.decoded(side) for side in scan.frames}
    return [CameraImages(scan.frames[side], one.p_px, one.q_px) for side, one in maps.items()]


def true_light(kind: str) -> np.ndarray:
    light = true_response(kind).astype(float)[8:248]
    return np.asarray((light - light[0]) / (light[-1] - light[0]))


@pytest.fixture(scope="module")
def bent() -> Bent:
    return record("measured")


@pytest.fixture(scope="module")
def straight(bent: Bent) -> Bent:
    """Recorded with patterns that are drawn for the response which was found."""
    return record("measured", bent.said.response)


def test_the_response_is_that_of_the_projector(bent: Bent) -> None:
    found = bent.said.response.light(np.arange(8.0, 248.0))
    assert np.abs(found - true_light("measured")).max() < 0.005
    assert found[120] - 0.5 < -0.05, "it is no straight line"


def test_fringes_drawn_for_it_have_a_third_of_harmonics_and_ripple_at_most(bent: Bent, straight: Bent) -> None:
    assert abs(bent.said.fringe_harmonics[3] / bent.said.fringe_harmonics[1]) > 0.03
    assert abs(straight.said.fringe_harmonics[3]) < abs(bent.said.fringe_harmonics[3]) / 3.0
    assert straight.said.phase_error_rad < bent.said.phase_error_rad / 3.0
    assert bent.coordinate_px > 0.2
    assert straight.coordinate_px < bent.coordinate_px / 3.0
    codes = np.arange(8.0, 248.0)
    assert np.abs(straight.said.response.light(codes) - bent.said.response.light(codes)).max() < 0.005


def test_a_linear_projector_is_left_alone() -> None:
    plain = record("linear", noise=False)
    assert phase_error_rad(plain.said.response.harmonics) < 0.004, "what rounding to codes makes"
    drawn = record("linear", plain.said.response, noise=False)
    assert drawn.coordinate_px < plain.coordinate_px + 0.005
    assert drawn.depth_mm < plain.depth_mm + 0.001


def test_a_scan_that_cannot_tell_says_why() -> None:
    moving = Motion(velocity_mm_s=(0.0, 0.0, 40.0))
    for scene, width_px, period_px, exposure_s, frame_s, words in (
        (Scene("plane"), 160, 16, 0.012, 0.0, "16 px; allowed are 32 px"),
        (Scene("plane"), 200, PERIOD_PX, 0.001, 0.0, "^0 pixels"),
        (Scene("plane", motion=moving), 200, PERIOD_PX, 0.012, 1.0 / 60.0, "still"),
    ):
        scan = render_scan(scene, "modelled", 3, width_px, period_px, exposure_s, frame_s=frame_s)
        with pytest.raises(ResponseError, match=words):
            measure_response(scan.sequence, seen(scan))
