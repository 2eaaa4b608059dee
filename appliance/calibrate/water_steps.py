"""Slow steps of the guided calibration in water: examining a recording, and the adjustment.

The diver records the ball bar twice (M1, M2), a plane twice (M3, M4), and the bar once more (VERIFY); see
``guide.Step``.

    examine_recording         whether a stored scan may be used for a step, and if not, why (``RecordingCheck``)
    solve_calibration         adjustment to M1 to M4, and the bar's length of VERIFY before and after
    judge_bar, judge_plane    limits of pose, size and fit; the first one that is broken is reported
    start_of                  the calibration to begin with: a given file, else the one in air, else the one in use

The instrument runs the first two in a background process (``instrument/service/calibrating.py``). Each therefore takes
plain values and, as its last argument, a progress.

The limits of pose are wide enough for hand-held artefacts, and narrow enough that a recording fits one step only. The
bars must be tilted in depth, because the method needs different distances. Which end is nearer, and how the planes are
inclined, does not matter (``tests/appliance/calibrate/test_poses.py``). Angles are in the rig frame, which follows from
the calibration.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from appliance import __version__
from appliance.base import Progress, silent
from appliance.calibrate.calibrations import Calibrations
from appliance.calibrate.guide import HELD, USED, AdjustmentSummary, LengthCheck, RecordingCheck, Refusal, Step
from appliance.calibrate.recordings import ArtefactKind, CertificateMissing, NotConverged, Recording, RecordingError
from appliance.calibrate.stored_recordings import cameras_of, recording_of_scan
from appliance.calibrate.water import report as report_of
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.extract import CALIBRATING_GAP_MM, BarCertificate, extract
from appliance.calibrate.water.method import Method
from appliance.calibrate.water.start import check_start
from appliance.measure import (
    BallBar,
    Calibration,
    CalibrationError,
    Cloud,
    FaultCode,
    NotFound,
    PlaneFit,
    QualityLimits,
    StereoRig,
    WorkingVolume,
    find_ball_bar,
    fit_plane,
)
from appliance.store import Instrument, Library, ReprocessedScan, Rig, StoredScan, load_calibration, reprocess_scan

Array = NDArray[np.float64]

BAR_TILT_DEG = (20.0, 50.0)
"""Allowed tilts in depth of the bars that the adjustment uses; 35° is best."""
LEVEL_DEG = 15.0
"""Largest tilt in depth of the bar of VERIFY."""
HALF_UP_DEG = 45.0
"""Angle from the horizontal below which a bar is lying, and above which it is upright."""
MOST_PLANE_TILT_DEG = 35.0
_PLANES_MM = MappingProxyType({Step.M3: (430.0, 470.0, 515.0), Step.M4: (530.0, 570.0, 620.0)})
"""Least, nominal and largest distance of each plane from the projection centres of the standard housing, along its
axis."""
LEAST_FILL_PERCENT = 45.0
"""Least share of the left image that the plane covers."""
RADIUS_OFF, LENGTH_OFF = 0.1, 0.03
"""Largest relative errors of a ball's radius and of the bar's length that are accepted before calibration."""
MOST_RMS_MM = {"ball": 0.3, "plane": 0.6}
"""Largest RMS residuals. Uncalibrated ports bend a plane by tenths of a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredBar:
    """Ball bar as measured, in the left camera frame."""

    centres_mm: Array
    """(2, 3)."""
    radii_mm: tuple[float, float]
    rms_mm: float
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlane:
    """Plane as measured, in the left camera frame."""

    centre_mm: Array
    normal: Array
    """Unit vector away from the instrument."""
    rms_mm: float
    points: int
    fill_percent: float
    """Share of the left image that the plane covers."""


@dataclass(frozen=True, slots=True)
class PlaneDistance:
    """Nominal distance and range of a plane, from the point between the projection centres."""

    nearest_mm: float
    nominal_mm: float
    farthest_mm: float


def plane_distance(step: Step, volume: WorkingVolume) -> PlaneDistance:
    """Return the distance of the plane of ``step`` (M3 or M4) in ``volume``.

    Of a bar, the whole depth of the volume.
    """
    if step not in _PLANES_MM:
        return PlaneDistance(volume.nearest_mm, volume.working_mm, volume.farthest_mm)
    return PlaneDistance(*(volume.scaled(mm) for mm in _PLANES_MM[step]))


def rig_axes(rig: StereoRig) -> tuple[Array, Array]:
    """Return rotation (3, 3) and origin of the rig frame in the left camera frame.

    The columns are right, down, forward.
    """
    right = np.asarray(rig.right.translation_mm)
    x = right / np.linalg.norm(right)
    z = np.array([0.0, 0.0, 1.0]) + np.asarray(rig.right.rotation)[:, 2]
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1), 0.5 * right


def judge_bar(step: Step, bar: MeasuredBar, rig: StereoRig, length_mm: float, radius_mm: float) -> RecordingCheck:
    """Judge whether a bar can be used for ``step`` (M1, M2 or VERIFY)."""
    axes, _ = rig_axes(rig)
    # Angles are taken in the rig frame, because the left camera frame is turned by the toe-in.
    bar_vector = (bar.centres_mm[1] - bar.centres_mm[0]) @ axes
    length = float(np.linalg.norm(bar_vector))
    rise_deg = _degrees(abs(bar_vector[1]), abs(bar_vector[0]))
    tilt_deg = _degrees(abs(bar_vector[2]), float(np.hypot(bar_vector[0], bar_vector[1])))
    is_upright = rise_deg > HALF_UP_DEG
    worst_radius = max(bar.radii_mm, key=lambda r: abs(r - radius_mm))
    detail = f"bar {length:.3f} mm, {tilt_deg:.1f}° in depth, {rise_deg:.0f}° against the horizontal"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, bar.points, detail)

    # Sizes are judged before poses: advice on the pose of another object would be of no use.
    if abs(worst_radius - radius_mm) > RADIUS_OFF * radius_mm:
        return check(Refusal.WRONG_SIZE, worst_radius)
    if abs(length - length_mm) > LENGTH_OFF * length_mm:
        return check(Refusal.WRONG_SIZE, length)
    if bar.rms_mm > MOST_RMS_MM["ball"]:
        return check(Refusal.BAD_FIT, bar.rms_mm)
    if step is Step.VERIFY:
        return check(Refusal.TILT_LESS, tilt_deg) if tilt_deg > LEVEL_DEG else check(None, bar.rms_mm)
    if is_upright != (step is Step.M2):
        return check(Refusal.STAND_UP if step is Step.M2 else Refusal.LAY_DOWN, rise_deg)
    min_tilt_deg, max_tilt_deg = BAR_TILT_DEG
    if tilt_deg < min_tilt_deg:
        return check(Refusal.TILT_MORE, tilt_deg)
    if tilt_deg > max_tilt_deg:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, bar.rms_mm)


def judge_plane(step: Step, plane: MeasuredPlane, rig: StereoRig) -> RecordingCheck:
    """Judge whether a plane can be used for ``step`` (M3 or M4)."""
    axes, origin = rig_axes(rig)
    distance_mm = float(((plane.centre_mm - origin) @ axes)[2])
    normal = plane.normal @ axes
    tilt_deg = _degrees(float(np.hypot(normal[0], normal[1])), normal[2])
    detail = f"plane {distance_mm:.0f} mm away, tilted by {tilt_deg:.1f}°, over {plane.fill_percent:.0f} % of the image"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, plane.points, detail)

    if plane.rms_mm > MOST_RMS_MM["plane"]:
        return check(Refusal.BAD_FIT, plane.rms_mm)
    allowed = plane_distance(step, rig.volume)
    nearest_mm, farthest_mm = allowed.nearest_mm, allowed.farthest_mm
    if distance_mm < nearest_mm:
        return check(Refusal.TOO_NEAR, distance_mm)
    if distance_mm > farthest_mm:
        return check(Refusal.TOO_FAR, distance_mm)
    if plane.fill_percent < LEAST_FILL_PERCENT:
        return check(Refusal.NOT_FILLED, plane.fill_percent)
    if tilt_deg > MOST_PLANE_TILT_DEG:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, plane.rms_mm)


def _degrees(opposite: float, adjacent: float) -> float:
    return float(np.degrees(np.arctan2(opposite, adjacent)))


def start_of(rig: Rig, path: Path | None = None) -> Calibration:
    """Return the calibration from which an adjustment in water starts.

    That is ``path``, else the air calibration, else the one in use. Raises CalibrationError for a file that cannot be
    used, RecordingError for one in use that is no start.
    """
    in_air = Instrument(rig).air_file
    if path is not None:
        start = Instrument(rig).with_volume(load_calibration(path))
        # Size and cameras are compared later, with those of the scans.
        problem = Instrument(rig).of_another(start)
    elif in_air.exists():
        start = Instrument(rig).with_volume(load_calibration(in_air))
        problem = Instrument(rig).misfit(start)
    else:
        start, problem = Instrument(rig).calibration()[0], None
    if problem is not None:
        raise CalibrationError(f"{path or in_air}: {problem}; calibrate in air, or give another file")
    check_start(start)
    return start


def reject_nominal_start(rig: Rig, path: Path | None) -> None:
    """Raise CalibrationError where an adjustment would start from the nominal rig without an explicit request."""
    if path is None and not (Instrument(rig).air_file).exists() and not (Instrument(rig).calibration_file).exists():
        raise CalibrationError(
            f"{Instrument(rig).air_file}: missing; calibrate in air (`kingfisher calibration air`), or give "
            "a start with --calibration FILE, for example the nominal one (`kingfisher calibration show "
            "nominal --out FILE`)"
        )


VERIFY_GAP_MM = 20.0
"""Largest ray gap of a point in a length check, as in ``kingfisher evaluate``: a smaller limit would hide
the worst points of the former calibration."""


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """Files that a calibration in water starts from and is compared with."""

    start: Calibration
    """Lenses and pose from air, nominal ports; else the calibration in use."""
    before: Calibration
    """Calibration with which the instrument has measured until now."""
    before_hash: str | None
    """Hash of the file of ``before``; ``None`` for the nominal one."""
    rig: Rig
    bar: BarCertificate
    """Certificate of the ball bar, with its radius."""


@dataclass(frozen=True, slots=True)
class Examination:
    """Judgement of a recording, and of VERIFY the length check."""

    check: RecordingCheck
    verified: LengthCheck | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Calibration that follows from the recordings."""

    calibration: Calibration
    solved: AdjustmentSummary
    verified: LengthCheck | None
    """Its length check; ``None`` without a recording of VERIFY."""
    report: Mapping[str, bytes]
    """Files of the report, by name: adjusted parameters, residuals, and which parameters were observable."""


def basis_of(rig: Rig) -> Basis:
    """Return the calibrations and the certificate of this instrument as they are now.

    Raises RecordingError without a certificate or without a start, CalibrationError for an air calibration that cannot
    be used.
    """
    bar = rig.ball_bar
    if bar is None:
        raise CertificateMissing("no certificate of the ball bar; give [ball_bar] in the rig file")
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    current, _ = Instrument(rig).calibration()
    session = calibrations.session()
    # Once the solved calibration is in use, it is compared with the kept file.
    kept_calibration = calibrations.previous(session) if session.in_use else None
    certificate = BarCertificate(bar.length_mm, bar.length_sd_mm, bar.radius_mm, bar.radius_sd_mm)
    before_hash = calibrations.in_use if kept_calibration is None else kept_calibration.hash
    return Basis(start_of(rig), kept_calibration or current, before_hash, rig, certificate)


def examine_recording(rig: Rig, step: Step, folder: Path, report: Progress) -> Examination:
    """Judge a stored scan as a recording of ``step``.

    VERIFY judges with the solved calibration, or else with the one in use. Raises RecordingError, ScanError,
    CalibrationError.
    """
    basis = basis_of(rig)
    scan = StoredScan.load(folder)
    if step is Step.VERIFY:
        solved = _solved_calibration(rig)
        calibration = basis.before if solved is None else solved
        reprocessed = _reprocess_for_check(scan, calibration, basis)
        rejection = _unusable(step, reprocessed)
        if rejection is not None:
            return Examination(rejection)
        bar = find_ball_bar(reprocessed.cloud)
        check = _check_bar(step, bar, reprocessed.cloud, calibration, basis.bar)
        if check.refusal is not None or isinstance(bar, NotFound):
            return Examination(check)
        return Examination(check, _measure_length(bar, basis) if solved is None else _compare_lengths(scan, bar, basis))
    reprocessed_for_adjustment = _reprocess_for_adjustment(scan, basis)
    rejection = _unusable(step, reprocessed_for_adjustment)
    if rejection is not None:
        return Examination(rejection)
    pipeline, cloud, water = (
        reprocessed_for_adjustment.pipeline,
        reprocessed_for_adjustment.cloud,
        reprocessed_for_adjustment.water,
    )
    if HELD[step] is ArtefactKind.BALL_BAR:
        check = _check_bar(step, find_ball_bar(cloud), cloud, basis.start, basis.bar)
    else:
        check = _check_plane(step, fit_plane(cloud), cloud, basis.start)
    if check.refusal is not None:
        return Examination(check)
    certificate = basis.bar if HELD[step] is ArtefactKind.BALL_BAR else None
    left, right = pipeline.decoded("left"), pipeline.decoded("right")
    # Only the number of points is used; the adjustment extracts them again. So a recording that would fail then is
    # rejected while the artefact is still in the water.
    recording = extract(step.value, certificate, cloud, left, right, basis.start, water)
    if isinstance(recording, NotFound):
        return Examination(replace(check, refusal=Refusal.FEW_POINTS, number=None, detail=recording.reason))
    return Examination(replace(check, points=len(recording.left_px)))


def _unusable(step: Step, reprocessed: ReprocessedScan) -> RecordingCheck | None:
    """Return the rejection of a recording whose points would be wrong for any artefact; ``None`` if usable."""
    fault = reprocessed.unfit
    if fault is None:
        return None
    # Compensated points can be viewed, but the maps that a calibration uses are still those of the moving instrument.
    if fault.code in (FaultCode.MOVED, FaultCode.COMPENSATED):
        return RecordingCheck(step, Refusal.MOVED, fault.numbers.get("shift_px"), detail=fault.detail)
    return RecordingCheck(step, Refusal.WRONG_PATTERN, None, detail=f"{fault.code.value}: {fault.detail}")


def solve_calibration(rig: Rig, date: str, report: Progress) -> Solution:
    """Adjust to the session's recordings, and check the bar's length of VERIFY where it was recorded.

    ``date`` is ISO 8601. Raises RecordingError, ScanError, CalibrationError, UnknownScan.
    """
    basis = basis_of(rig)
    library = Library(rig.storage.root)
    trials = Calibrations(rig.storage.root, rig.rig.serial).session().trials
    folders = {check.step: library.entry(check.scan_id).folder for check in trials if check.scan_id is not None}
    missing = [step.value for step in USED if step not in folders]
    if missing:
        raise RecordingError(f"no recording of {', '.join(missing)}; record it", subject=missing[0])
    # The adjustment would change lenses until scans of other cameras fit, without any sign.
    serials = cameras_of((folders[step] for step in USED), basis.start)
    recordings = []
    for k, step in enumerate(USED):
        report(f"recording {step.value}", 0.15 * k)
        recordings.append(_load_recording(step, folders[step], basis))
    report("adjusting", 0.6)
    # SPLINE also adjusts lenses and pose, with their covariance from air as prior; without one, only the ports are
    # adjusted.
    method = Method.PORTS if basis.start.air_covariance is None else Method.SPLINE
    result = calibrate(method, recordings, basis.start)
    report("checking", 0.9)
    calibration = replace(result.calibration, made_at=date, camera_serials=serials)
    result = replace(result, calibration=calibration)
    if calibration.residual_px is None:
        raise NotConverged(f"{method.value} has no residuals; use another method")
    solved = AdjustmentSummary(calibration.method, calibration.residual_px, result.warnings, calibration.hash)
    verified = None
    if Step.VERIFY in folders:
        scan = StoredScan.load(folders[Step.VERIFY])
        bar = find_ball_bar(_cloud_for_check(scan, calibration, basis))
        verified = None if isinstance(bar, NotFound) else _compare_lengths(scan, bar, basis)
    facts = {"rig_serial": rig.rig.serial, "made_at": date, "software_version": __version__}
    files = {
        "report.html": report_of.as_html(result, basis.start, facts, {}).encode(),
        "report.json": json.dumps(report_of.as_json(result, basis.start, facts, {}), indent=1).encode(),
    }
    return Solution(calibration, solved, verified, files)


def _load_recording(step: Step, folder: Path, basis: Basis) -> Recording:
    certificate = basis.bar if HELD[step] is ArtefactKind.BALL_BAR else None
    recording = recording_of_scan(folder, certificate, basis.start, basis.rig, silent)
    if isinstance(recording, NotFound):
        reason = f"{step.value}, scan {folder.name}: {recording.reason}; record {step.value} again"
        raise RecordingError(reason, subject=step.value)
    return replace(recording, name=f"{step.value}, scan {folder.name}")


def _solved_calibration(rig: Rig) -> Calibration | None:
    """Return the calibration that the session solved; ``None`` before."""
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    return None if calibrations.session().solved is None else load_calibration(calibrations.solved)


def _compare_lengths(scan: StoredScan, bar: BallBar, basis: Basis) -> LengthCheck:
    """Return the length check of the bar with the solved and the former calibration."""
    old = find_ball_bar(_cloud_for_check(scan, basis.before, basis))
    before = None if isinstance(old, NotFound) else _length_error(old, basis)
    return LengthCheck(before, _length_error(bar, basis), _length_uncertainty(bar, basis), basis.before_hash)


def _measure_length(bar: BallBar, basis: Basis) -> LengthCheck:
    """Return the length check of the bar with the calibration in use, before any solution."""
    return LengthCheck(_length_error(bar, basis), None, _length_uncertainty(bar, basis), basis.before_hash)


def _length_error(bar: BallBar, basis: Basis) -> float:
    return (bar.length_mm - basis.bar.length_mm) / basis.bar.length_mm


def _length_uncertainty(bar: BallBar, basis: Basis) -> float:
    return float(np.hypot(bar.sigma_length_mm, basis.bar.length_sd_mm)) / basis.bar.length_mm


def _check_bar(
    step: Step, bar: BallBar | NotFound, cloud: Cloud, calibration: Calibration, certificate: BarCertificate
) -> RecordingCheck:
    if isinstance(bar, NotFound):
        return RecordingCheck(step, Refusal.NOT_FOUND, None, cloud.summary.points, bar.reason)
    if certificate.radius_mm is None:
        raise CertificateMissing("the ball bar's radius is not stated; give ball_bar.radius_mm in the rig file")
    balls = (bar.first, bar.second)
    measured = MeasuredBar(
        np.array([ball.sphere.centre_mm for ball in balls]),
        (bar.first.sphere.radius_mm, bar.second.sphere.radius_mm),
        max(ball.used.rms_mm for ball in balls),
        sum(ball.used.count for ball in balls),
    )
    return judge_bar(step, measured, calibration.rig, certificate.length_mm, certificate.radius_mm)


def _check_plane(step: Step, plane: PlaneFit | NotFound, cloud: Cloud, calibration: Calibration) -> RecordingCheck:
    if isinstance(plane, NotFound):
        return RecordingCheck(step, Refusal.NOT_FOUND, None, cloud.summary.points, plane.reason)
    camera = calibration.rig.left
    measured = MeasuredPlane(
        np.array(plane.plane.centre_mm),
        np.array(plane.plane.normal),
        plane.used.rms_mm,
        plane.used.count,
        100.0 * plane.used.count / (camera.width_px * camera.height_px),
    )
    return judge_plane(step, measured, calibration.rig)


def _reprocess_for_adjustment(scan: StoredScan, basis: Basis) -> ReprocessedScan:
    """Reprocess with a wide limit of the ray gap, because the ports are not calibrated yet."""
    settings = Instrument(basis.rig).settings_of_scan(scan.manifest.record)
    return reprocess_scan(scan, basis.start, settings, silent, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM))


def _reprocess_for_check(scan: StoredScan, calibration: Calibration, basis: Basis) -> ReprocessedScan:
    settings = Instrument(basis.rig).settings_of_scan(scan.manifest.record)
    return reprocess_scan(scan, calibration, settings, silent, QualityLimits(max_gap_mm=VERIFY_GAP_MM))


def _cloud_for_check(scan: StoredScan, calibration: Calibration, basis: Basis) -> Cloud:
    """Return the cloud within a limit of the ray gap that is wide enough for all calibrations that are compared."""
    return _reprocess_for_check(scan, calibration, basis).cloud
