"""Owns the decision on compensation: a scan's motion is estimated, and undone where that makes the scan clearly better,
and useful."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudLocation
from appliance.measure.light.patterns import RISING_STEPS
from appliance.measure.light.water import Water
from appliance.measure.motion.estimate import MotionEstimate, estimate
from appliance.measure.motion.redecode import compensate
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.scan_images import ScanImages

LEAST_KEPT = 0.8
"""Share of the plain cloud's points below which a compensated cloud is not shown in its place."""
MOST_ERROR = 1.0
"""Expected error over that of a scan at rest up to which a compensated scan is shown. The true one may be a fifth larger: the
largest of 25 scans in development was 1.19 times the expected one."""
LEAST_STEP_DEG = 15.0
"""Least advance of a point's phase from sine to sine: below, no method tells its phase, and of a faster hand, points
are taken for those a fringe beside."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """The outcome of an attempt to compensate."""

    motion: MotionEstimate | None
    """``None``: too little was seen to estimate one."""
    found: CloudLocation | None
    """The compensated cloud, in the pipeline's table; ``None``: the plain one is to be found anew, the table's points
    mean nothing."""
    why: str
    """One sentence for the manifest."""
    error_before: float | None = None
    """Expected error when nothing is done, against that of a scan at rest; ``None``: no motion was estimated."""
    error_after: float | None = None
    """Expected error of the compensated points, root mean square of their own sigmas, against a scan at rest; ``None``:
    none were made."""


def attempt(
    pipeline: Pipeline,
    plain: CloudLocation,
    images: ScanImages,
    calibration: Calibration,
    water: Water,
    added: float | None = None,
) -> Attempt:
    """Compensate a scan if that makes it better, after ``pipeline.find_full`` gave ``plain``.

    ``added`` is what the verdict on movement says that the movement adds to the noise, as a fraction of it. Where the
    steps rise, the estimate itself tells the ripple, which is nearly all of it; in the other order there is none.
    ``calibration`` and ``water`` are those of the pipeline. Its table then holds the compensated cloud where there is
    one to be shown; where there is none, whoever asked finds the plain one anew, straightened as it is shown.
    """
    sample = pipeline.sample(pipeline.coarse_stride)
    try:
        motion = estimate(images, calibration, water, sample.points_mm, sample.pixel)
    except ValueError as error:
        return Attempt(None, None, f"Motion was not estimated: {error}.")
    rising = images.sequence.steps == RISING_STEPS
    error_before = motion.error_before if added is None or rising else 1.0 + added
    if not motion.moved:
        return Attempt(motion, None, "No visible motion.", error_before)
    if not motion.converged:
        return Attempt(motion, None, "The motion cannot be estimated from the frames.", error_before)
    if motion.step_deg < LEAST_STEP_DEG:
        return Attempt(
            motion,
            None,
            f"Points moved along with the fringes: phases advanced by {motion.step_deg:.0f} of 90°.",
            error_before,
        )
    at_rest_mm = _sigmas_mm(pipeline, plain)
    maps = compensate(images, calibration, water, motion)
    found = pipeline.find_replaced(maps["left"], maps["right"])
    error_after = _over(_sigmas_mm(pipeline, found), at_rest_mm)
    kept = found.summary.points / max(plain.summary.points, 1)
    if error_after <= MOST_ERROR and kept >= LEAST_KEPT:
        why = (
            f"Motion of {motion.texture_px:.1f} px during the x fringes was compensated; the points' errors are "
            f"{error_after:.1f} times those at rest."
        )
        return Attempt(motion, found, why, error_before, error_after)
    if kept < LEAST_KEPT:
        why = f"Compensation would lose {100.0 * (1.0 - kept):.0f} % of the points."
    else:
        why = (
            f"Compensated, the points' errors would be {error_after:.2f} times those at rest; allowed are up to "
            f"{MOST_ERROR:g} times; repeat the scan."
        )
    return Attempt(motion, None, why, error_before, error_after)


def _sigmas_mm(pipeline: Pipeline, found: CloudLocation) -> NDArray[np.float32]:
    """Return a copy of the expected errors of the cloud in the pipeline's table, by left pixel (h, w); 0 where there is
    no point."""
    points, shape = pipeline.table.points, pipeline.decoded("left").p_px.shape
    sigma_mm = np.zeros(shape, np.float32)
    for first, stop in found.pieces:
        sigma_mm.reshape(-1)[points.pixel[first:stop]] = points.sigma_mm[first:stop]
    return sigma_mm


def _over(after_mm: NDArray[np.float32], at_rest_mm: NDArray[np.float32]) -> float:
    """Return the root mean square of ``after_mm`` (h, w) over that of ``at_rest_mm``, at the pixels that have a point
    in both, as have their four neighbours; infinite without any.

    The plain cloud states the noise of a scan at rest, for its sigmas know nothing of motion. The median point of
    printed squares lies inside of one; those at borders, which reading between pixels spoils, make the error. What lies
    beside a missing pixel expects the error of an object's edge. Compensation leaves out many single pixels, where Gray
    images contradict each other, beside which there is no edge: it would be thought six times as noisy there as it is.
    """
    there = (after_mm > 0.0) & (at_rest_mm > 0.0)
    both = np.zeros_like(there)
    both[1:-1, 1:-1] = there[1:-1, 1:-1] & there[:-2, 1:-1] & there[2:, 1:-1] & there[1:-1, :-2] & there[1:-1, 2:]
    if not both.any():
        return math.inf
    after, at_rest = (float(np.mean(np.square(one[both], dtype=np.float64))) for one in (after_mm, at_rest_mm))
    return math.sqrt(after / at_rest)
