"""The cloud of the first direction alone, by epipolar matching, with the limits of every cloud."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudSummary
from appliance.measure.decode.decoder import CameraDecoder, edge_limits_px
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.water import Water
from appliance.measure.points.one_direction import OneDirectionLimits, UncheckedPoints, match_along_curves
from appliance.measure.points.quality import QualityLimits
from appliance.measure.points.sigma import four_step_variance_px2
from appliance.measure.points.table import Cloud


def first_direction_cloud(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    calibration: Calibration,
    water: Water,
    noise: StereoNoise,
    limits: QualityLimits | None = None,
) -> tuple[Cloud, UncheckedPoints]:
    """Return the unchecked cloud of a sequence's frames up to the last of X, and why pixels have no point.

    ``frames``: by side, (n, h, w) uint8, n at least up to the last frame of X; later ones are ignored. The ray gaps are
    NaN, since one direction has none. The error due to the projector's response remains; it moves both cameras'
    coordinates alike. Raises ValueError for too few frames, OneDirectionError.
    """
    volume = calibration.rig.volume
    scaled_limits = (limits or QualityLimits()).of(volume)
    needed = sequence.axis(Direction.X).last + 1
    decoded = {side: _decoded(frames[side], sequence, needed) for side in SIDES}
    left = decoded["left"]
    jump_px, bend_px = edge_limits_px(sequence.period_px, left.p_px.shape[1], sequence.width_px)
    matched = match_along_curves(
        left.p_px,
        decoded["right"].p_px,
        calibration.rig,
        water.index,
        (scaled_limits.min_depth_mm, scaled_limits.max_depth_mm),
        (
            _noise_px(left, of_side(noise, "left"), sequence.period_px),
            _noise_px(decoded["right"], of_side(noise, "right"), sequence.period_px),
        ),
        OneDirectionLimits(
            float(jump_px),
            float(bend_px),
            scaled_limits.max_sigma_mm,
            volume.scaled(scaled_limits.max_step_mm) * 1600.0 / left.p_px.shape[1],
            scaled_limits.min_neighbours,
        ),
    )
    pixel = np.flatnonzero(matched.mask).astype(np.uint32)
    cloud = Cloud(
        points_mm=matched.points_mm.reshape(-1, 3)[pixel],
        intensity=frames["left"][sequence.bright].reshape(-1)[pixel],
        modulation_dn=left.modulation_half_dn.reshape(-1)[pixel] * np.float32(0.5),
        ray_gap_mm=np.full(len(pixel), np.nan, np.float32),
        sigma_mm=matched.sigma_mm.reshape(-1)[pixel],
        pixel=pixel,
        summary=CloudSummary(len(pixel), None, None, None, None),
    )
    return replace(cloud, summary=_summary(cloud, left.illuminated_pixels)), matched


def _decoded(frames: NDArray[np.uint8], sequence: PatternSequence, needed: int) -> CameraDecoder:
    """Return the decoder of one camera after the last frame of X."""
    if len(frames) < needed:
        raise ValueError(f"{len(frames)} frames were recorded; the first direction has {needed}")
    decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
    for index in range(needed):
        decoder.push(frames, index)
    return decoder


def _noise_px(decoder: CameraDecoder, noise: CameraNoise, period_px: int) -> NDArray[np.float32]:
    """Return the standard deviation (h, w) of a camera's coordinates; the largest one without fringes."""
    # Grey values in DN; a pixel without modulation has no coordinate, so its noise is not used.
    modulation = np.maximum(decoder.modulation_half_dn, 1).astype(np.float32) * np.float32(0.5)
    offset = decoder.gray_threshold.astype(np.float32) * np.float32(decoder.offset_per_threshold)
    return np.sqrt(four_step_variance_px2(modulation, offset, noise, period_px))


def _summary(cloud: Cloud, illuminated_pixels: int) -> CloudSummary:
    """Return the numbers of the cloud as ``quality.summarise`` does, without a gap."""
    n = len(cloud.pixel)
    coverage = 100.0 * n / illuminated_pixels if illuminated_pixels else None
    if n == 0:
        return CloudSummary(0, coverage, None, None, None)
    return CloudSummary(n, coverage, float(np.median(cloud.points_mm[:, 2])), float(np.median(cloud.sigma_mm)), None)
