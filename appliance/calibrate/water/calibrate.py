"""Owns the calibration in water: every method behind one function, its result judged by one measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from appliance.base import Progress, silent
from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.artefact import Residuals, residuals_of
from appliance.calibrate.water.bundle import BundleSettings, adjust
from appliance.calibrate.water.judgement import warnings_about
from appliance.calibrate.water.method import Method, WaterResult
from appliance.calibrate.water.paper import calibrate_as_published
from appliance.calibrate.water.start import check_start
from appliance.measure import Calibration


def calibrate(
    method: Method,
    recordings: Sequence[Recording],
    start: Calibration,
    progress: Progress = silent,
) -> WaterResult:
    """Calibrate in water, from ``start``: lenses and pose from air, ports as drawn (``start_from_air``).

    Raises RecordingError for recordings that cannot be used or do not suffice, and for a start that is none. Seconds;
    deterministic.
    """
    check_start(start)
    progress(f"calibrating: {method.value}")
    published = method is Method.PAPER
    result = calibrate_as_published(recordings, start) if published else adjust(recordings, start, method)
    # One measure for every method, also for the one that minimises something else: only so they can be compared.
    progress("looking at what is left")
    calibration, residuals = _measured(result.calibration, recordings)
    at, miss = (np.concatenate(parts) for parts in zip(*((r.left_px, r.miss_px) for r in residuals), strict=True))
    rest, found = warnings_about(at, miss, BundleSettings().noise_px, start.rig.left, (), (), may_be_refined=True)
    return replace(
        result,
        calibration=calibration,
        # The bundle has warned already, with the priors that only it knows.
        warnings=result.warnings + found if published else result.warnings,
        residuals=residuals,
        systematic_px=rest,
        before={name: _measured(one, recordings)[0] for name, one in result.before.items()},
    )


def _measured(calibration: Calibration, recordings: Sequence[Recording]) -> tuple[Calibration, tuple[Residuals, ...]]:
    """Return the calibration with the residual that it leaves of all recordings, and those of each."""
    residuals = tuple(residuals_of(recording, calibration.rig) for recording in recordings)
    rms_px = float(np.sqrt(np.mean(np.concatenate([r.miss_px for r in residuals]) ** 2)))
    return replace(calibration, residual_px=rms_px), residuals
