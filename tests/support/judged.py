"""Makes a recorded sequence of a clean one, and hands it to a judge as the worker does."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdicts.motion.judge import MotionJudgement, judge_motion
from hw_sim.rendering.sensor import E_PER_DN, FULL_WELL_E, OFFSET_DN, READ_NOISE_E, Sensor
from tests.support.moved import FRAME_S
from tests.support.synthetic import push_all
from tests.support.truth import WATER

Frames = Mapping[str, NDArray[np.uint8]]


def record(clean: Frames, gain_db: float, camera_seed: int, noise_seed: int) -> dict[str, NDArray[np.uint8]]:
    """Add the cameras' noise to frames (n, h, w) uint8 that were rendered without it."""
    per_dn = E_PER_DN * 10.0 ** (-gain_db / 20.0)
    recorded = {}
    for number, (side, frames) in enumerate(clean.items()):
        count, height, width = frames.shape
        sensor = Sensor(width, height, 2 * camera_seed + number, True)
        out = np.empty_like(frames)
        for k in range(count):
            electrons = (frames[k].astype(np.float32) - OFFSET_DN) * np.float32(per_dn)
            # What is saturated stays so: how far beyond, the frame does not say.
            electrons[frames[k] == 255] *= np.float32(1.2)
            out[k] = sensor.read_out(electrons, gain_db, 1_000_000 * noise_seed + 2 * k + number)
        recorded[side] = out
    return recorded


def data_sheet_noise(gain_db: float) -> StereoNoise:
    """Return the noise of the ordinary simulated cameras, as their data sheet states it."""
    camera = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, gain_db)
    return StereoNoise(camera, camera)


def as_judged(
    pipeline: Pipeline, frames: Frames, gain_db: float, exposure_s: float, noise: StereoNoise | None = None
) -> tuple[ScanImages, Cloud]:
    """Return what a judge is given after the last frame; it is valid until the next sequence. ``noise``: the cameras', the
    ordinary ones' by default."""
    noise = noise or data_sheet_noise(gain_db)
    exposure = Exposure(round(1e6 * exposure_s), gain_db)
    pipeline.expect(noise)
    pipeline.reset()
    push_all(pipeline, frames)
    cloud = pipeline.coarse()
    decoded = {side: pipeline.decoded(side) for side in frames}
    return ScanImages(pipeline.sequence, frames, decoded, AcquisitionSettings(exposure, FRAME_S, noise)), cloud


def judge_frames(
    frames: Frames,
    calibration: Calibration,
    period_px: int,
    gain_db: float,
    exposure_s: float,
    noise: StereoNoise | None = None,
    water: Water = WATER,
) -> MotionJudgement:
    """Judge the movement as the worker does, with the data sheet of the simulated cameras unless ``noise`` is given."""
    with Pipeline(calibration, water, build_sequence(period_px)) as pipeline:
        images, cloud = as_judged(pipeline, frames, gain_db, exposure_s, noise)
        return judge_motion(images, cloud, calibration.rig, water.index)
