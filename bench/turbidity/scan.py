"""One simulated scan in stated water with the true calibration, and its errors."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import Mask
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import PatternSequence, build_sequence
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water as SetWater
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdicts.water.judge import WaterJudgement, judge_water
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.rendering.sensor import FULL_WELL_E, OFFSET_DN, READ_NOISE_E
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth
from tests.support.bias import DepthErrors, depth_errors
from tests.support.rendered import pictures
from tests.support.truth import WATER, true_calibration

PERIOD_PX = 16
FRAME_S = 1.0 / 60.0
LONGEST_S = 0.0162
"""Exposure that a frame of 60 Hz has room for."""
MOST_GAIN_DB = 24.0
AIM_DN = 225.0
"""Where a chosen exposure puts the brightest of the bright frame."""
BRIGHTEST = 99.5
"""Percentile that counts as the brightest."""
WRONG_MM, WRONG_SIGMAS = 1.0, 5.0


@dataclass(frozen=True, slots=True)
class Shutter:
    """How the cameras are set."""

    exposure_s: float = 0.012
    gain_db: float = 0.0


@dataclass(frozen=True, slots=True)
class JudgedScan:
    """A simulated scan, reconstructed and judged."""

    renderer: Renderer
    sequence: PatternSequence
    frames: dict[str, NDArray[np.uint8]]
    shutter: Shutter
    cloud: Cloud
    judgement: WaterJudgement
    errors: DepthErrors
    judging_cpu_s: float
    decoded: NDArray[np.bool_]
    """(h, w): the left camera's pixels with coordinates."""

    @property
    def completeness(self) -> float:
        """Return points as a share of the surface that both cameras and the projector see."""
        visible = self.renderer.view("left", 0.0).seen_by_all
        return float(np.count_nonzero(self.errors.seen)) / float(np.count_nonzero(visible))

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """(n,): points that are farther from the truth than ``WRONG_MM`` and than ``WRONG_SIGMAS``."""
        off = np.abs(np.nan_to_num(self.errors.along_ray_mm, nan=1e3))
        return np.asarray((off > WRONG_MM) & (off > WRONG_SIGMAS * self.cloud.sigma_mm))


def rig_in(water: SetWater, truth_set: str, seed: int, width_px: int) -> TrueRig:
    """Draw a hidden rig in water of that index."""
    return draw_truth(truth_set, seed, width_px, width_px * 3 // 4, water.index)


def set_water(scene: Scene) -> SetWater:
    """Return the water that the diver enters for the scene: the true one."""
    return SetWater(scene.water.temperature_c, scene.water.salinity_psu, WATER.wavelength_nm)


def noise_of(gain_db: float) -> StereoNoise:
    """Return the noise of the simulated cameras by their data sheet."""
    noise = camera_noise(FULL_WELL_E, READ_NOISE_E, OFFSET_DN, gain_db)
    return StereoNoise(noise, noise)


def expose(
    renderer: Renderer, sequence: PatternSequence, shutter: Shutter, only: int | None = None
) -> dict[str, NDArray[np.uint8]]:
    """Return both cameras' frames (n, h, w), of all patterns or of one."""
    shown = list(enumerate(pictures(sequence)))
    chosen = shown if only is None else [shown[only]]
    return {
        side: np.stack(
            [
                renderer.expose(
                    side,
                    [LightSlice(picture, shutter.exposure_s)],
                    k * FRAME_S,
                    shutter.exposure_s,
                    shutter.gain_db,
                    (False, False),
                    2 * k + (side == "left"),
                )
                for k, picture in chosen
            ]
        )
        for side in SIDES
    }


def chosen_shutter(renderer: Renderer, sequence: PatternSequence, most_gain_db: float) -> Shutter:
    """Return the exposure, with gain if the longest is too short, for which the brightest pixels have ``AIM_DN``."""
    shutter = Shutter(0.004)
    for _ in range(4):
        brightest_dn = float(np.percentile(expose(renderer, sequence, shutter, sequence.bright)["left"], BRIGHTEST))
        factor = (AIM_DN - OFFSET_DN) / max(brightest_dn - OFFSET_DN, 0.3)
        if brightest_dn >= 254.0:
            factor = 0.4
        light = shutter.exposure_s * 10.0 ** (shutter.gain_db / 20.0) * factor
        exposure_s = min(light, LONGEST_S)
        gain_db = min(max(20.0 * float(np.log10(light / exposure_s)), 0.0), most_gain_db)
        shutter = Shutter(exposure_s, gain_db)
        if abs(factor - 1.0) < 0.03:
            break
    return shutter


def take(renderer: Renderer, shutter: Shutter | None = None, most_gain_db: float = 0.0) -> JudgedScan:
    """Scan the scene of ``renderer``; without ``shutter``, with a suitable exposure."""
    sequence = build_sequence(PERIOD_PX)
    chosen = shutter or chosen_shutter(renderer, sequence, most_gain_db)
    return finish(renderer, sequence, expose(renderer, sequence, chosen), chosen)


def finish(
    renderer: Renderer, sequence: PatternSequence, frames: dict[str, NDArray[np.uint8]], shutter: Shutter
) -> JudgedScan:
    """Reconstruct and judge ``frames``."""
    water = set_water(renderer.scene)
    calibration = replace(true_calibration(renderer.truth), water=water)
    noise = noise_of(shutter.gain_db)
    with Pipeline(calibration, water, sequence, noise=noise) as pipeline:
        for side in SIDES:
            for k in range(len(sequence)):
                pipeline.push(side, frames[side], k)
        coarse = pipeline.coarse()
        decoded = {side: pipeline.decoded(side) for side in SIDES}
        exposure = Exposure(round(1e6 * shutter.exposure_s), shutter.gain_db)
        recorded = ScanImages(sequence, frames, decoded, AcquisitionSettings(exposure, FRAME_S, noise))
        begun = time.process_time()
        judgement = judge_water(recorded, coarse, calibration.rig, water.index)
        judging_cpu_s = time.process_time() - begun
        cloud = pipeline.full()
        valid = decoded["left"].mask == Mask.VALID
    errors = depth_errors(renderer, cloud)
    return JudgedScan(renderer, sequence, frames, shutter, cloud, judgement, errors, judging_cpu_s, valid)
