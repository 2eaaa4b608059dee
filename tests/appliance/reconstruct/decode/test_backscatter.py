"""Water that outshines the object makes no surfaces, and hides no more of the object than it must."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction
from appliance.processing.procedure import SequenceProcessor
from appliance.reconstruct.decode.backscatter import examine, fringe_scale
from appliance.reconstruct.decode.decoder import CameraDecoder, Mask
from appliance.reconstruct.pipeline import Pipeline
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure
from appliance.scan.noise import StereoNoise, camera_noise
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Imaging, Scene
from hw_sim.water.medium import Water
from tests.support.bias import depth_errors
from tests.support.rendered import RenderedScan, render_scan
from tests.support.truth import WATER, true_calibration

GAIN_DB = 13.0
NOISE = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, GAIN_DB)
MILK = Water(attenuation_per_m=3.0, backscatter=0.3, blur_px_per_m=2.25)
"""Before the far half of the plane, the veil is more than twice the object's light."""
THICK = replace(MILK, attenuation_per_m=3.8)
"""Fringes are left there of which noise hides the Gray bits, and the neighbours' bits, too."""
PLANE = (0.0, 0.0, 522.5, 10.0, -12.0, 0.0)
FAR_OFF_PX = 4.0


@dataclass(frozen=True)
class Read:
    decoder: CameraDecoder
    p_px: NDArray[np.float32]
    again: bool


@pytest.fixture(scope="module")
def milky() -> RenderedScan:
    scene = Scene(object="plane", pose=PLANE, texture="none", water=MILK, imaging=Imaging(response="linear"))
    return render_scan(scene, "modelled", 1, 400, 16, 0.0162, gain_db=GAIN_DB)


@pytest.fixture(scope="module")
def thick() -> RenderedScan:
    scene = Scene(object="plane", pose=PLANE, texture="none", water=THICK, imaging=Imaging(response="linear"))
    return render_scan(scene, "modelled", 1, 400, 16, 0.0162, gain_db=GAIN_DB)


@pytest.fixture(scope="module")
def clear() -> RenderedScan:
    return render_scan(Scene(object="stones", texture="strong"), "realistic", 1, 400, 16, 0.010)


def read(scan: RenderedScan, frames: NDArray[np.uint8]) -> Read:
    decoder = CameraDecoder(scan.sequence, frames.shape[2], frames.shape[1])
    for k in range(len(scan.sequence)):
        decoder.push(frames, k)
    before = decoder.p_px.copy()
    return Read(decoder, before, decoder.read_again_through_backscatter(frames, NOISE))


def off_px(scan: RenderedScan, p_px: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.abs(p_px - scan.renderer.view("left", 0.0).projector_px[..., 0])


def test_milk_makes_no_surfaces_and_leaves_nearly_all_of_the_plane(milky: RenderedScan) -> None:
    calibration = true_calibration(milky.renderer.truth)
    with Pipeline(calibration, WATER, milky.sequence, noise=StereoNoise(NOISE, NOISE)) as pipeline:
        for side, frames in milky.frames.items():
            for k in range(len(milky.sequence)):
                pipeline.push(side, frames, k)
        pipeline.coarse()
        cloud = pipeline.full()
    errors = depth_errors(milky.renderer, cloud)
    off = np.abs(np.nan_to_num(errors.along_ray_mm, nan=1e3))
    assert np.mean((off > 1.0) & (off > 5.0 * cloud.sigma_mm)) < 100e-6
    seen = milky.renderer.view("left", 0.0).seen_by_all
    assert np.count_nonzero(errors.seen) > 0.95 * np.count_nonzero(seen)


def test_the_middle_between_bright_and_dark_would_have_made_them(milky: RenderedScan) -> None:
    """What this is for: many coordinates are wrong before, next to none after."""
    left = read(milky, milky.frames["left"])
    assert left.again
    wrong_before = np.count_nonzero(off_px(milky, left.p_px) > FAR_OFF_PX)
    wrong_after = np.count_nonzero(off_px(milky, left.decoder.p_px) > FAR_OFF_PX)
    assert wrong_before > 5_000
    assert wrong_after < 0.002 * wrong_before
    assert np.isfinite(left.decoder.p_px).sum() > 1.1 * np.isfinite(left.p_px).sum()


def test_what_the_water_hides_is_no_movement(thick: RenderedScan) -> None:
    calibration = true_calibration(thick.renderer.truth)
    noise = StereoNoise(NOISE, NOISE)
    with Pipeline(calibration, WATER, thick.sequence, noise=noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, WATER)
        full = processor.process(thick.frames, AcquisitionSettings(Exposure(16_200, GAIN_DB), noise=noise))
        hidden = max(100.0 * np.mean(pipeline.decoded(side).mask == Mask.CONTRADICTION) for side in thick.frames)
        judged = {judgement.verdict.name: judgement for judgement in full.judgements}["motion"]
    assert hidden > 5.0
    assert judged.fault is None, judged.verdict.text
    lost_percent = judged.verdict.numbers["lost_percent"]
    assert lost_percent is not None
    # Noise in fringes of 5 grey values makes some contradictions; what the water hides is not among them.
    assert lost_percent < 0.5 * hidden


def test_clear_water_is_read_once(clear: RenderedScan) -> None:
    left = read(clear, clear.frames["left"])
    assert not left.again
    assert np.array_equal(left.p_px, left.decoder.p_px, equal_nan=True)


def test_paint_that_moves_in_clear_water_is_no_backscatter(clear: RenderedScan) -> None:
    """A scan that moved was read twice, for a tenth of a second and more: at borders of paint it is as if there were light beside the fringes."""
    moved = clear.frames["left"].copy()
    for k in (clear.sequence.bright, clear.sequence.dark):
        moved[k] = np.roll(moved[k], 4, axis=1)
    left = read(clear, moved)
    assert not left.again
    # There is much of it.
    bright, before = (frames[clear.sequence.bright].astype(np.int64) for frames in (moved, clear.frames["left"]))
    assert np.mean(np.abs(bright - before) > 20) > 0.05


@pytest.mark.parametrize("masked", [0, 1], ids=["all", "one-less"])
def test_the_scale_is_made_of_the_medians_of_both_ratios(milky: RenderedScan, masked: int) -> None:
    # So small a part of the image is looked at pixel by pixel.
    frames = np.ascontiguousarray(milky.frames["left"][:, 100:220, 150:270])
    across, grey = milky.sequence.axis(Direction.X), frames.astype(np.float64)
    i0, i1, i2, i3 = grey[list(across.sine)]
    bright, dark = grey[milky.sequence.bright], grey[milky.sequence.dark]
    double = np.hypot(i0 - i2, i3 - i1)
    swing = np.abs(2.0 * grey[list(across.gray[-3:])] - bright - dark).max(axis=0)
    clear = (double > 16.0) & (bright < 255.0)
    assert np.count_nonzero(clear) > 10_000
    mask = np.zeros(clear.shape, np.uint8)
    mask[tuple(np.argwhere(clear)[:masked].T)] = Mask.SHADOW
    clear &= mask == Mask.VALID
    scale = fringe_scale(examine(milky.sequence, frames, mask), NOISE)
    assert scale is not None
    assert scale.per_half_dn == pytest.approx(1.0 / np.median(double[clear] / np.maximum(swing[clear], 1.0)), rel=1e-6)
    light = (bright - dark)[clear] / np.maximum((i0 + i1 + i2 + i3 - 4.0 * dark)[clear], 1.0)
    assert scale.light_per_sines == pytest.approx(np.median(light), rel=1e-6)
