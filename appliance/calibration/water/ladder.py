"""Owns the calibration ladder: every method behind one function, with one kind of answer.

From the pinhole that ignores the water to a free field of rays. ``BA_SPLINE`` is the one to use; the others show what each
step is worth, and the published ones what they reach.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.air.adjustment import AirCalibration, BoardView
from appliance.calibration.file import Calibration
from appliance.calibration.judgement import Estimate, systematic_px, warnings_about
from appliance.calibration.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibration.water.bundle import BundleSettings, Rung, adjust
from appliance.calibration.water.expected import Expected
from appliance.calibration.water.interface import SearchResult, SearchSettings, Valley, search_distances
from appliance.calibration.water.method import Method
from appliance.calibration.water.operator import search_with_operator
from appliance.calibration.water.pinhole import calibrate_pinhole_in_water, mapped_through_ports
from appliance.calibration.water.printed import PrintedCamera
from appliance.calibration.water.residuals import Residuals, residuals_of
from appliance.calibration.water.start import check_start
from appliance.optics.model import HousedCamera

__all__ = ["LadderResult", "LadderSettings", "Method", "calibrate"]

Array = NDArray[np.float64]
Progress = Callable[[str], None]


# The ladder of docs/calibration.md; every rung has all the freedom of the one below it.
RUNGS = {
    Method.BA_PORTS: Rung.PORTS,
    Method.BA_ALL: Rung.ALL,
    Method.BA_SPLINE: Rung.SPLINE,
    Method.RAY_FIELD: Rung.FIELD,
}
PRINTED_REACH_MM = 15.0
PRINTED_STEP_MM = 3.0
"""Misprints are mended, as far as they can be, by distances far from the true ones: a wider search before the others."""
FIELD_BARS, FIELD_PLANES = 4, 6
"""A field of rays from fewer follows them and nothing else."""


@dataclass(frozen=True, slots=True)
class LadderSettings:
    """Settings of those methods that have any."""

    bundle: BundleSettings = field(default_factory=BundleSettings)
    search: SearchSettings = field(default_factory=SearchSettings)


@dataclass(frozen=True, slots=True, eq=False)
class LadderResult:
    """A calibration, and what one should know before trusting it."""

    method: Method
    calibration: Calibration
    residuals: tuple[Residuals, ...]
    """Residuals of each recording, in px; the same measure for every method."""
    systematic_px: float
    """RMS of what remains after averaging the noise away over patches of the image."""
    estimates: tuple[Estimate, ...]
    """Adjusted parameters with prior and posterior uncertainty; empty where the method states none."""
    warnings: tuple[str, ...]
    valley: Valley | None = None
    """T over both distances, of the methods that search."""
    costs: tuple[float, ...] = ()
    """Costs before the first step and after each, of the adjustments."""
    expected: Expected | None = None
    """Errors to be expected of lengths and planes that were not recorded; ``None`` where the method does not tell."""

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Names of the parameters that stayed at their prior because the recordings say nothing about them."""
        return tuple(estimate.name for estimate in self.estimates if estimate.at_prior)

    @property
    def can_be_saved(self) -> bool:
        """Tell whether a calibration file can carry it."""
        return self.method is not Method.PAPER_RM_PRINTED


def calibrate(
    method: Method,
    recordings: Sequence[Recording],
    start: Calibration,
    air: AirCalibration | None = None,
    settings: LadderSettings | None = None,
    progress: Progress | None = None,
    boards: Sequence[BoardView] = (),
) -> LadderResult:
    """Calibrate in water, from ``start``: lenses and pose from air, ports as drawn (``start_from_air``).

    The covariance that BA_ALL and above need comes from ``air``, or from ``start``, which carries it. ``boards`` are views
    of a board in this water, for PM_WATER only. Raises RecordingError for recordings that cannot be used or do not
    suffice, AirCalibrationError for boards that do not. Seconds; deterministic.
    """
    chosen = settings or LadderSettings()
    say = progress or _silent
    check_start(start)
    say(f"calibrating: {method.value}")
    estimates: tuple[Estimate, ...] = ()
    warnings: tuple[str, ...] = ()
    valley: Valley | None = None
    costs: tuple[float, ...] = ()
    ahead: Expected | None = None
    match method:
        case Method.PM_MAPPED:
            # A pinhole holds in one water only: that of the recordings, which is the one to be measured in.
            water = recordings[0].water if recordings else start.water
            calibration = mapped_through_ports(start, water)
        case Method.PM_WATER:
            water = recordings[0].water if recordings else start.water
            size = start.rig.left.width_px, start.rig.left.height_px
            calibration = calibrate_pinhole_in_water(boards, start.rig_serial, water, *size)
        case Method.RM | Method.RMD | Method.PAPER_RM_PRINTED:
            searched = _searched(method, recordings, start, chosen.search)
            calibration, warnings, valley = searched.calibration, searched.warnings, searched.valley
        case _:
            covariance = air.covariance if air is not None else _covariance_of(start)
            if covariance is None and method is not Method.BA_PORTS:
                raise RecordingError(
                    f"the start ({start.method}) has no covariance from air, which {method.value} needs; start from the "
                    f"calibration in air, or use {Method.BA_PORTS.value}"
                )
            adjusted = adjust(recordings, start, RUNGS[method], covariance, chosen.bundle)
            calibration, estimates, costs = adjusted.calibration, adjusted.estimates, adjusted.costs
            warnings, ahead = adjusted.warnings, adjusted.expected
    # One measure for every method, also for those that minimise something else: only so the rungs can be compared.
    say("looking at what is left")
    residuals = tuple(residuals_of(r, calibration.rig, chosen.bundle.points_per_recording) for r in recordings)
    left_over = 0.0
    if residuals:
        at, miss = (np.concatenate(parts) for parts in zip(*((r.left_px, r.miss_px) for r in residuals), strict=True))
        left_over = systematic_px(at, miss, start.rig.left)
        rms = float(np.sqrt(np.mean(miss**2)))
        calibration = replace(calibration, residual_px=rms)
        # The bundle has warned already, with the priors that only it knows.
        if method not in RUNGS:
            _, found = warnings_about(at, miss, chosen.bundle.noise_px, start.rig.left, (), (), may_be_refined=True)
            warnings += found
    warnings += _about_amount(method, recordings)
    return LadderResult(method, calibration, residuals, left_over, estimates, warnings, valley, costs, ahead)


def _silent(_: str) -> None:
    pass


def _covariance_of(start: Calibration) -> Array | None:
    return None if start.air_covariance is None else np.array(start.air_covariance)


def _searched(
    method: Method, recordings: Sequence[Recording], start: Calibration, settings: SearchSettings
) -> SearchResult:
    if method is Method.RM:
        return search_distances(recordings, start, settings)
    if method is Method.RMD:
        return search_with_operator(recordings, start, settings)
    # Eq. 1 as printed is for comparison: its distances are far from the true ones, so it needs a wider search.
    rig = replace(start.rig, left=_printed(start.rig.left), right=_printed(start.rig.right))
    wide = replace(settings, reach_mm=PRINTED_REACH_MM, steps_mm=(PRINTED_STEP_MM, *settings.steps_mm))
    found = search_distances(recordings, replace(start, rig=rig), wide)
    return replace(found, calibration=replace(found.calibration, method="search of distances, Eq. 1 as printed"))


def _printed(camera: HousedCamera) -> PrintedCamera:
    return PrintedCamera(
        camera.width_px,
        camera.height_px,
        camera.lens,
        camera.port,
        camera.rotation,
        camera.translation_mm,
        camera.correction,
    )


def _about_amount(method: Method, recordings: Sequence[Recording]) -> tuple[str, ...]:
    bars = sum(r.kind is ArtefactKind.BALL_BAR for r in recordings)
    planes = len(recordings) - bars
    if method is Method.RAY_FIELD and (bars < FIELD_BARS or planes < FIELD_PLANES):
        said = (
            f"a field of rays from {bars} bars and {planes} planes follows these recordings only; record at least "
            f"{FIELD_BARS} bars and {FIELD_PLANES} planes all over the volume, or use {Method.BA_SPLINE.value}"
        )
    elif method in RUNGS and (bars < 2 or planes < 1):
        said = (
            f"{bars} bars and {planes} planes: a scale from one bar in one direction, or tilts without a plane, are "
            f"weakly held; record two bars, turned and leaning, and two planes, near and far"
        )
    else:
        return ()
    return (said,)
