"""What passes by during a scan makes no points, and a scan that nothing passed by loses none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.decode.specks import mask_specks
from appliance.reconstruct.pipeline import Cloud, Pipeline
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.noise import TYPICAL
from appliance.scan.sides import SIDES
from hw_sim.scene import Imaging, Scene
from tests.support.bias import depth_errors
from tests.support.rendered import RenderedScan, render_scan
from tests.support.specks import add_specks
from tests.support.truth import WATER, true_calibration

WRONG_MM = 1.0


@dataclass(frozen=True)
class Points:
    cloud: Cloud
    masked: int
    wrong: float
    """Share of the points."""


@pytest.fixture(scope="module")
def clean() -> RenderedScan:
    return render_scan(Scene(object="plane", texture="strong"), "modelled", 3, 400, 16, 0.010)


def reconstructed(scan: RenderedScan, masking: bool) -> Points:
    with Pipeline(true_calibration(scan.renderer.truth), WATER, scan.sequence) as pipeline:
        for side in SIDES:
            for k in range(len(scan.sequence)):
                pipeline.push(side, scan.frames[side], k)
        pipeline.coarse()
        masked = 0
        if masking:
            for side in SIDES:
                masked += mask_specks(scan.sequence, scan.frames[side], pipeline.decoded(side), TYPICAL)
        cloud = pipeline.full()
    off = np.abs(np.nan_to_num(depth_errors(scan.renderer, cloud).along_ray_mm, nan=1e3))
    return Points(cloud, masked, float(np.mean(off > WRONG_MM)) if off.size else 0.0)


def test_specks_lose_their_points_and_others_keep_theirs(clean: RenderedScan) -> None:
    rng = np.random.default_rng(1)
    frames = {side: add_specks(clean.frames[side], clean.sequence, 100, rng) for side in SIDES}
    dirty = RenderedScan(clean.renderer, clean.sequence, frames)
    before, after = reconstructed(dirty, False), reconstructed(dirty, True)
    assert before.wrong > 300e-6
    assert after.wrong < 0.25 * before.wrong
    assert len(after.cloud.pixel) > 0.92 * len(before.cloud.pixel)


def test_a_clean_scan_loses_nothing(clean: RenderedScan) -> None:
    before, after = reconstructed(clean, False), reconstructed(clean, True)
    assert after.masked < 1e-4 * len(before.cloud.pixel)
    assert len(after.cloud.pixel) > 0.9999 * len(before.cloud.pixel)


def test_neither_a_bent_response_nor_brighter_daylight_is_a_speck(clean: RenderedScan) -> None:
    gamma = render_scan(
        Scene(object="plane", texture="strong", imaging=Imaging(response="gamma")), "modelled", 3, 400, 16, 0.010
    )
    frames = {side: gamma.frames[side].copy() for side in SIDES}
    for k in gamma.sequence.axis(gamma.sequence.patterns[-1].direction).sine[:2]:
        for side in SIDES:
            frames[side][k] = np.minimum(frames[side][k].astype(np.int32) + 4, 255)
    points = reconstructed(RenderedScan(gamma.renderer, gamma.sequence, frames), True)
    assert points.masked < 1e-3 * len(points.cloud.pixel)


def test_nothing_decoded_is_nothing_masked(clean: RenderedScan) -> None:
    dark = {side: np.full_like(clean.frames[side], 2) for side in SIDES}
    assert reconstructed(RenderedScan(clean.renderer, clean.sequence, dark), True).masked == 0


def test_the_instrument_masks_them_between_the_judges_and_the_full_cloud(clean: RenderedScan) -> None:
    calibration = true_calibration(clean.renderer.truth)
    rng = np.random.default_rng(1)
    dirty = {side: add_specks(clean.frames[side], clean.sequence, 100, rng) for side in SIDES}
    points = {}
    with Pipeline(calibration, WATER, clean.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        for name, frames in (("dirty", dirty), ("clean", clean.frames)):
            points[name] = processor.process(frames, AcquisitionSettings()).found.summary.points
    assert points["dirty"] == len(reconstructed(RenderedScan(clean.renderer, clean.sequence, dirty), True).cloud.pixel)
    assert points["clean"] == len(reconstructed(clean, False).cloud.pixel)
