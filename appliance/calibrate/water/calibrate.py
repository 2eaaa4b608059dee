"""Water calibration by any method, with residuals and warnings that are comparable between methods."""

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
    """Calibrate in water from ``start``: lenses and extrinsics from air, nominal ports (``start_from_air``).

    Takes seconds; deterministic. Raises RecordingError for recordings that cannot be used or do not suffice, and for a
    start that cannot be one.
    """
    check_start(start)
    progress(f"calibrating: {method.value}")
    is_published = method is Method.PAPER
    result = calibrate_as_published(recordings, start) if is_published else adjust(recordings, start, method)
    # The same residuals for every method, also for PAPER, which minimises another sum: only so they can be compared.
    progress("computing the residuals")
    calibration, residuals = _measured(result.calibration, recordings)
    left_px, residual_px = (
        np.concatenate(parts) for parts in zip(*((r.left_px, r.residual_px) for r in residuals), strict=True)
    )
    systematic_px, warnings = warnings_about(
        left_px, residual_px, BundleSettings().noise_px, start.rig.left, (), (), is_refinable=True
    )
    return replace(
        result,
        calibration=calibration,
        # The bundle adjustment has its own warnings, which use its priors.
        warnings=result.warnings + warnings if is_published else result.warnings,
        residuals=residuals,
        systematic_px=systematic_px,
        before={name: _measured(model, recordings)[0] for name, model in result.before.items()},
    )


def _measured(calibration: Calibration, recordings: Sequence[Recording]) -> tuple[Calibration, tuple[Residuals, ...]]:
    """Return the calibration with the RMS of its residuals, and the residuals of each recording."""
    residuals = tuple(residuals_of(recording, calibration.rig) for recording in recordings)
    rms_px = float(np.sqrt(np.mean(np.concatenate([r.residual_px for r in residuals]) ** 2)))
    return replace(calibration, residual_px=rms_px), residuals
