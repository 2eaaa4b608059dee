"""Owns the decision on compensation: a scan's motion is estimated, and undone where that makes the scan clearly better, and useful."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from appliance.calibration.file import Calibration
from appliance.compensation.estimate import MotionEstimate, estimate
from appliance.compensation.redecode import compensate
from appliance.optics.water import Water
from appliance.reconstruct.images import ScanImages
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.rows import LeftMaps
from appliance.reconstruct.sigma import four_step_variance_px2
from appliance.reconstruct.table import Found
from appliance.scan.noise import CameraNoise

LEAST_KEPT = 0.8
"""Share of the plain cloud's points below which a compensated cloud is not shown in its place."""
GOOD_ERROR = 1.25
"""An error up to here, over that of a scan at rest, is as good as at rest."""
NEARLY_EQUAL = 1.05
"""Factor by which such a scan may err more than before: where only borders of albedo suffer, ripple says nothing of them."""
USEFUL_ERROR = 3.0
"""Error over that of a scan at rest beyond which the scan is better repeated, whatever it was before."""
CLEAR_GAIN = 0.75
"""Share of the error before that is left at most, where it does not become as good as at rest."""

LEAST_STEP_DEG = 15.0
"""Least advance of a point's phase from sine to sine: below, no method tells its phase, and of a faster hand, points are taken for
those a fringe beside."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """The outcome of an attempt to compensate."""

    motion: MotionEstimate | None
    """``None``: too little was seen to estimate one."""
    found: Found | None
    """The compensated cloud, in the pipeline's table; ``None``: the plain one is to be found anew, the table's points mean nothing."""
    why: str
    """One sentence for the manifest."""
    error_after: float | None = None
    """Expected error of the median compensated point, by its own sigma, against a scan at rest; ``None``: none were made."""


def attempt(pipeline: Pipeline, plain: Found, images: ScanImages, calibration: Calibration, water: Water) -> Attempt:
    """Compensate a scan if that makes it better, after ``pipeline.find_full`` gave ``plain``.

    ``calibration`` and ``water`` are those of the pipeline. Its table then holds the compensated cloud where there is one to be shown;
    where there is none, whoever asked finds the plain one anew, straightened as it is shown.
    """
    sample = pipeline.sample(pipeline.coarse_stride)
    try:
        motion = estimate(images, calibration, water, sample.points_mm, sample.pixel)
    except ValueError as error:
        return Attempt(None, None, f"Motion was not estimated: {error}.")
    if not motion.moved:
        return Attempt(motion, None, "Nothing moved that would show.")
    if not motion.converged:
        return Attempt(motion, None, "The motion could not be told from the frames.")
    if motion.step_deg < LEAST_STEP_DEG:
        return Attempt(
            motion, None, f"Points moved along with the fringes: phases advanced by {motion.step_deg:.0f} of 90°."
        )
    maps = compensate(images, calibration, water, motion)
    found = pipeline.find_replaced(maps["left"], maps["right"])
    error_after = _median_error(pipeline, found, maps["left"], images.noise.left)
    kept = found.summary.points / max(plain.summary.points, 1)
    if is_better(motion.error_before, error_after) and kept >= LEAST_KEPT:
        why = f"Motion of {motion.texture_px:.1f} px during the x fringes was undone; points err {error_after:.1f} times as at rest."
        return Attempt(motion, found, why, error_after)
    if kept < LEAST_KEPT:
        why = f"Compensation would lose {100.0 * (1.0 - kept):.0f} % of the points."
    else:
        why = f"Compensated, points would err {error_after:.1f} times as at rest."
    return Attempt(motion, None, why, error_after)


def is_better(error_before: float, error_after: float) -> bool:
    """Return whether points with ``error_after`` are to be shown in place of those with ``error_before``.

    Both are in units of the error of a scan at rest. Such a scan is graded by its own noise.
    """
    if error_after <= GOOD_ERROR and error_after <= NEARLY_EQUAL * error_before:
        return True
    return error_after <= USEFUL_ERROR and error_after <= CLEAR_GAIN * error_before


def _median_error(pipeline: Pipeline, found: Found, maps: LeftMaps, noise: CameraNoise) -> float:
    """Return the median ratio of each point's standard deviation to that by four steps of 90° in the same light.

    ``noise`` is the left camera's. Infinite without points.
    """
    points, period_px = pipeline.table.points, pipeline.sequence.period_px
    variance_px2, offset_dn = maps.variance_px2.ravel(), maps.gray_threshold.ravel()
    ratios = [
        variance_px2[points.pixel[first:stop]]
        / four_step_variance_px2(
            0.5 * points.modulation_half_dn[first:stop].astype(np.float32),
            offset_dn[points.pixel[first:stop]].astype(np.float32),
            noise,
            period_px,
        )
        for first, stop in found.pieces
    ]
    known = np.concatenate(ratios)
    return math.sqrt(float(np.median(known))) if known.size else math.inf
