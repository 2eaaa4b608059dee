"""Owns the try: a scan's motion is estimated, and undone where that makes it as good as one at rest."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.calibration.file import Calibration
from appliance.compensation.compensate import compensate
from appliance.compensation.estimate import MotionEstimate, Scanned, estimate
from appliance.optics.water import Water
from appliance.reconstruct.pipeline import Pipeline
from appliance.reconstruct.table import Found

LEAST_KEPT = 0.8
"""Of the plain cloud's points; a compensated cloud with fewer is not shown in its place."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """What came of it."""

    motion: MotionEstimate | None
    """``None``: too little was seen to estimate one."""
    found: Found | None
    """The compensated cloud, in the pipeline's table; ``None``: the plain one is there, and stays what it is."""
    why: str
    """One sentence for the manifest."""


def attempt(pipeline: Pipeline, plain: Found, scanned: Scanned, calibration: Calibration, water: Water) -> Attempt:
    """After ``pipeline.find_full`` gave ``plain``; ``calibration`` and ``water`` are those of the pipeline."""
    sample = pipeline.sample(pipeline.coarse_stride)
    try:
        motion = estimate(scanned, calibration, water, sample.points_mm, sample.pixel)
    except ValueError as error:
        return Attempt(None, None, f"Motion was not estimated: {error}.")
    if not motion.moved:
        return Attempt(motion, None, "Nothing moved that would show.")
    if not motion.helps:
        if not motion.converged:
            return Attempt(motion, None, "The motion could not be told from the frames.")
        return Attempt(motion, None, f"Compensated, points would err {motion.error_after:.1f} times as at rest.")
    made = compensate(scanned, calibration, water, motion)
    found = pipeline.find_replaced(made.maps["left"], made.maps["right"], made.sigma_factor)
    if found.summary.points < LEAST_KEPT * plain.summary.points:
        lost = 1.0 - found.summary.points / plain.summary.points
        pipeline.find_full()
        return Attempt(motion, None, f"Compensation would lose {100.0 * lost:.0f} % of the points.")
    return Attempt(motion, found, f"Motion of {motion.texture_px:.1f} px during the x fringes was undone.")
