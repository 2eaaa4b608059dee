"""Owns the steps of the guided calibration in water that take long: to examine a recording, and to adjust.

The diver records the ball bar twice (M1, M2), a plane twice (M3, M4), and the bar once more (VERIFY); see
``guide.Step``.

    examine_recording         whether this stored scan may be used for that step, and if not, why (``RecordingCheck``)
    solve_calibration         adjustment to M1 to M4, and the bar's length of VERIFY before and after
    judge_bar, judge_plane    limits of pose, size and fit; the first one that is broken is reported
    start_of                  the calibration to begin with: a given file, else the one in air, else the one in use

The instrument runs the first two in a background process (``instrument/service/calibrating.py``). Each therefore takes
plain values and, as its last argument, a progress.

The limits of pose are wide enough for hand-held artefacts, and narrow enough that a recording fits one step only. The
bars must be tilted in depth, because the method needs different distances. Which end is nearer, and how the planes are
inclined, does not matter (``tests/appliance/calibrate/test_poses.py``). Angles are in the rig frame, which follows from the
calibration.
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
from appliance.calibrate.guide import HELD, USED, AdjustmentSummary, RecordingCheck, Refusal, Step, Verified
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
"""Tilts in depth of the bars that are adjusted to; the method wants 35°."""
LEVEL_DEG = 15.0
"""The bar of the verification is tilted in depth by no more."""
HALF_UP_DEG = 45.0
"""Angle against the horizontal below which a bar is lying, and above which it is upright."""
MOST_PLANE_TILT_DEG = 35.0
_PLANES_MM = MappingProxyType({Step.M3: (430.0, 470.0, 515.0), Step.M4: (530.0, 570.0, 620.0)})
"""Distances of the two planes from the standard housing's projection centres, along its axis: least, wanted and most.
"""
LEAST_FILL_PERCENT = 45.0
"""Share of the left picture that the plane must cover."""
RADIUS_OFF, LENGTH_OFF = 0.1, 0.03
"""Relative deviations of a ball's radius and of the bar's length from the certificate that are accepted before
calibration."""
MOST_RMS_MM = {"ball": 0.3, "plane": 0.6}
"""Uncalibrated ports bend a plane by tenths of a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundBar:
    """A ball bar as measured; left camera frame."""

    centres_mm: Array
    """(2, 3)."""
    radii_mm: tuple[float, float]
    rms_mm: float
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlane:
    """A plane as measured; left camera frame."""

    centre_mm: Array
    normal: Array
    """Away from the instrument."""
    rms_mm: float
    points: int
    fill_percent: float
    """Part of the left picture that it covers."""


@dataclass(frozen=True, slots=True)
class PlaneReach:
    """Place of a plane before the instrument, along its axis from between the projection centres."""

    nearest_mm: float
    wanted_mm: float
    farthest_mm: float


def plane_place(step: Step, volume: WorkingVolume) -> PlaneReach:
    """Return where the plane of ``step`` (M3 or M4) belongs before a housing of that volume; a bar, anywhere in it."""
    if step not in _PLANES_MM:
        return PlaneReach(volume.nearest_mm, volume.working_mm, volume.farthest_mm)
    return PlaneReach(*(volume.scaled(mm) for mm in _PLANES_MM[step]))


def rig_axes(rig: StereoRig) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and origin of the rig frame in the left camera frame: columns right, down, forward."""
    right = np.asarray(rig.right.translation_mm)
    x = right / np.linalg.norm(right)
    z = np.array([0.0, 0.0, 1.0]) + np.asarray(rig.right.rotation)[:, 2]
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1), 0.5 * right


def judge_bar(step: Step, bar: FoundBar, rig: StereoRig, length_mm: float, radius_mm: float) -> RecordingCheck:
    """Judge whether a bar will do for ``step`` (M1, M2 or VERIFY)."""
    axes, _ = rig_axes(rig)
    # Angles in the rig frame: the left camera's own frame is turned by the toe-in.
    along = (bar.centres_mm[1] - bar.centres_mm[0]) @ axes
    length = float(np.linalg.norm(along))
    rise_deg = _degrees(abs(along[1]), abs(along[0]))
    tilt_deg = _degrees(abs(along[2]), float(np.hypot(along[0], along[1])))
    upright = rise_deg > HALF_UP_DEG
    worst_radius = max(bar.radii_mm, key=lambda r: abs(r - radius_mm))
    said = f"bar {length:.3f} mm, {tilt_deg:.1f}° in depth, {rise_deg:.0f}° against the horizontal"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, bar.points, said)

    # Wrong things first, then wrong poses: advice about the pose of something else would be of no use.
    if abs(worst_radius - radius_mm) > RADIUS_OFF * radius_mm:
        return check(Refusal.WRONG_SIZE, worst_radius)
    if abs(length - length_mm) > LENGTH_OFF * length_mm:
        return check(Refusal.WRONG_SIZE, length)
    if bar.rms_mm > MOST_RMS_MM["ball"]:
        return check(Refusal.BAD_FIT, bar.rms_mm)
    if step is Step.VERIFY:
        return check(Refusal.TILT_LESS, tilt_deg) if tilt_deg > LEVEL_DEG else check(None, bar.rms_mm)
    if upright != (step is Step.M2):
        return check(Refusal.STAND_UP if step is Step.M2 else Refusal.LAY_DOWN, rise_deg)
    low, high = BAR_TILT_DEG
    if tilt_deg < low:
        return check(Refusal.TILT_MORE, tilt_deg)
    if tilt_deg > high:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, bar.rms_mm)


def judge_plane(step: Step, plane: FoundPlane, rig: StereoRig) -> RecordingCheck:
    """Judge whether a plane will do for ``step`` (M3 or M4)."""
    axes, origin = rig_axes(rig)
    distance_mm = float(((plane.centre_mm - origin) @ axes)[2])
    normal = plane.normal @ axes
    tilt_deg = _degrees(float(np.hypot(normal[0], normal[1])), normal[2])
    said = f"plane {distance_mm:.0f} mm away, tilted by {tilt_deg:.1f}°, over {plane.fill_percent:.0f} % of the picture"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, plane.points, said)

    if plane.rms_mm > MOST_RMS_MM["plane"]:
        return check(Refusal.BAD_FIT, plane.rms_mm)
    where = plane_place(step, rig.volume)
    near, far = where.nearest_mm, where.farthest_mm
    if distance_mm < near:
        return check(Refusal.TOO_NEAR, distance_mm)
    if distance_mm > far:
        return check(Refusal.TOO_FAR, distance_mm)
    if plane.fill_percent < LEAST_FILL_PERCENT:
        return check(Refusal.NOT_FILLED, plane.fill_percent)
    if tilt_deg > MOST_PLANE_TILT_DEG:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, plane.rms_mm)


def _degrees(opposite: float, adjacent: float) -> float:
    return float(np.degrees(np.arctan2(opposite, adjacent)))


def start_of(rig: Rig, path: Path | None = None) -> Calibration:
    """Return what a calibration in water begins with: ``path``, else the calibration in air, else the one in use.

    Raises CalibrationError for a file that cannot be used, RecordingError for one in use that is no start.
    """
    in_air = Instrument(rig).air_file
    if path is not None:
        start = Instrument(rig).with_volume(load_calibration(path))
        problem = Instrument(rig).of_another(
            start
        )  # the size is compared with that of the scans, and so are the cameras
    elif in_air.exists():
        start = Instrument(rig).with_volume(load_calibration(in_air))
        problem = Instrument(rig).misfit(start)
    else:
        start, problem = Instrument(rig).calibration()[0], None
    if problem is not None:
        raise CalibrationError(f"{path or in_air}: {problem}; calibrate in air, or take another file")
    check_start(start)
    return start


def refuse_drawing(rig: Rig, path: Path | None) -> None:
    """Raises CalibrationError where calibrating in water would begin with the drawing without anybody having said so."""
    if path is None and not (Instrument(rig).air_file).exists() and not (Instrument(rig).calibration_file).exists():
        raise CalibrationError(
            f"{Instrument(rig).air_file}: missing; calibrate in air (`kingfisher calibration air`), or give with "
            "--calibration FILE "
            "what to begin with, be it the drawing (`kingfisher calibration show nominal --out FILE`)"
        )


VERIFY_GAP_MM = 20.0
"""Largest ray gap of a point that verifies, as in ``kingfisher evaluate``: the calibration of before must not hide its
own worst points."""


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """The files that a calibration in water starts from and is compared with."""

    start: Calibration
    """Lenses and pose from air, ports as drawn; else the calibration in use."""
    before: Calibration
    """Calibration that the instrument measured with until now."""
    before_hash: str | None
    """Hash of the file of ``before``; ``None``: it is the drawing."""
    rig: Rig
    bar: BarCertificate
    """Certificate of the ball bar; its radius is stated."""


@dataclass(frozen=True, slots=True)
class Examined:
    """A recording, judged; with what it says about lengths if it verifies."""

    check: RecordingCheck
    verified: Verified | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The calibration that the recordings gave."""

    calibration: Calibration
    solved: AdjustmentSummary
    verified: Verified | None
    """Length check of it; ``None`` where there was no recording for one."""
    report: Mapping[str, bytes]
    """Files for the office, by name: what was adjusted, what is left, what the recordings could see."""


def basis_of(rig: Rig) -> Basis:
    """Return what is known of this instrument now.

    Raises RecordingError without a certificate or without anything to start from, CalibrationError for a file in air
    that cannot be used.
    """
    bar = rig.ball_bar
    if bar is None:
        raise CertificateMissing("no certificate of the ball bar; give [ball_bar] in the rig file")
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    current, _ = Instrument(rig).calibration()
    session = calibrations.session()
    # Once the solved calibration is in use, the one to compare it with is the kept file.
    kept = calibrations.kept(session) if session.in_use else None
    certificate = BarCertificate(bar.length_mm, bar.length_sd_mm, bar.radius_mm, bar.radius_sd_mm)
    before_hash = calibrations.in_use if kept is None else kept.hash
    return Basis(start_of(rig), kept or current, before_hash, rig, certificate)


def examine_recording(rig: Rig, step: Step, folder: Path, report: Progress) -> Examined:
    """Judge a stored scan as a recording of ``step``.

    VERIFY judges with what was solved, or else with the calibration in use. Raises RecordingError, ScanError,
    CalibrationError.
    """
    basis = basis_of(rig)
    scan = StoredScan.load(folder)
    if step is Step.VERIFY:
        solved = _solved(rig)
        checked = basis.before if solved is None else solved
        fairly = _fairly(scan, checked, basis)
        spoilt = _spoilt(step, fairly)
        if spoilt is not None:
            return Examined(spoilt)
        bar = find_ball_bar(fairly.cloud)
        check = _judged_bar(step, bar, fairly.cloud, checked, basis.bar)
        if check.refusal is not None or isinstance(bar, NotFound):
            return Examined(check)
        return Examined(check, _measured(bar, basis) if solved is None else _compared(scan, bar, basis))
    widely = _wide(scan, basis)
    spoilt = _spoilt(step, widely)
    if spoilt is not None:
        return Examined(spoilt)
    pipeline, cloud, water = widely.pipeline, widely.cloud, widely.water
    if HELD[step] is ArtefactKind.BALL_BAR:
        check = _judged_bar(step, find_ball_bar(cloud), cloud, basis.start, basis.bar)
    else:
        check = _judged_plane(step, fit_plane(cloud), cloud, basis.start)
    if check.refusal is not None:
        return Examined(check)
    certificate = basis.bar if HELD[step] is ArtefactKind.BALL_BAR else None
    left, right = pipeline.decoded("left"), pipeline.decoded("right")
    # Extracted for its count only, and again when it is solved: a recording that would fail then is refused while the
    # artefact is still in the water.
    recording = extract(step.value, certificate, cloud, left, right, basis.start, water)
    if isinstance(recording, NotFound):
        return Examined(replace(check, refusal=Refusal.FEW_POINTS, number=None, detail=recording.reason))
    return Examined(replace(check, points=len(recording.left_px)))


def _spoilt(step: Step, seen: ReprocessedScan) -> RecordingCheck | None:
    """Return the refusal of a recording whose points would be wrong, whatever it shows."""
    fault = seen.unfit
    if fault is None:
        return None
    # Compensated points may be looked at, but the decoded maps, which calibrate, are still those of the motion.
    if fault.code in (FaultCode.MOVED, FaultCode.COMPENSATED):
        return RecordingCheck(step, Refusal.MOVED, fault.numbers.get("shift_px"), detail=fault.detail)
    return RecordingCheck(step, Refusal.WRONG_PATTERN, None, detail=f"{fault.code.value}: {fault.detail}")


def solve_calibration(rig: Rig, date: str, report: Progress) -> Solution:
    """Adjust to the scans of the session; compare with the one of VERIFY where there is one.

    ``date`` is ISO 8601. Raises RecordingError, ScanError, CalibrationError, UnknownScan.
    """
    basis = basis_of(rig)
    library = Library(rig.storage.root)
    trials = Calibrations(rig.storage.root, rig.rig.serial).session().trials
    folders = {check.step: library.entry(check.scan_id).folder for check in trials if check.scan_id is not None}
    missing = [step.value for step in USED if step not in folders]
    if missing:
        raise RecordingError(f"no recording of {', '.join(missing)}; record it", about=missing[0])
    # An adjustment would bend the lenses of other cameras until they fit, and not say so.
    serials = cameras_of((folders[step] for step in USED), basis.start)
    recordings = []
    for k, step in enumerate(USED):
        report(f"recording {step.value}", 0.15 * k)
        recordings.append(_recording(step, folders[step], basis))
    report("adjusting", 0.6)
    # The spline frees lenses and pose as well, held by their covariance from air; without that, only the ports are
    # adjusted.
    method = Method.PORTS if basis.start.air_covariance is None else Method.SPLINE
    result = calibrate(method, recordings, basis.start)
    report("checking", 0.9)
    calibration = replace(result.calibration, made_at=date, camera_serials=serials)
    result = replace(result, calibration=calibration)
    if calibration.residual_px is None:
        raise NotConverged(f"{method.value} says nothing about what is left; use another method")
    solved = AdjustmentSummary(calibration.method, calibration.residual_px, result.warnings, calibration.hash)
    verified = None
    if Step.VERIFY in folders:
        scan = StoredScan.load(folders[Step.VERIFY])
        bar = find_ball_bar(_fair(scan, calibration, basis))
        verified = None if isinstance(bar, NotFound) else _compared(scan, bar, basis)
    about = {"rig_serial": rig.rig.serial, "made_at": date, "software_version": __version__}
    files = {
        "report.html": report_of.as_html(result, basis.start, about, {}).encode(),
        "report.json": json.dumps(report_of.as_json(result, basis.start, about, {}), indent=1).encode(),
    }
    return Solution(calibration, solved, verified, files)


def _recording(step: Step, folder: Path, basis: Basis) -> Recording:
    certificate = basis.bar if HELD[step] is ArtefactKind.BALL_BAR else None
    recording = recording_of_scan(folder, certificate, basis.start, basis.rig, silent)
    if isinstance(recording, NotFound):
        reason = f"{step.value}, scan {folder.name}: {recording.reason}; record {step.value} again"
        raise RecordingError(reason, about=step.value)
    return replace(recording, name=f"{step.value}, scan {folder.name}")


def _solved(rig: Rig) -> Calibration | None:
    """Return what the session solved; ``None`` where nothing is."""
    calibrations = Calibrations(rig.storage.root, rig.rig.serial)
    return None if calibrations.session().solved is None else load_calibration(calibrations.solved)


def _compared(scan: StoredScan, bar: BallBar, basis: Basis) -> Verified:
    """Return the bar's length with the new calibration and with the one of before."""
    old = find_ball_bar(_fair(scan, basis.before, basis))
    before = None if isinstance(old, NotFound) else _error(old, basis)
    return Verified(before, _error(bar, basis), _uncertainty(bar, basis), basis.before_hash)


def _measured(bar: BallBar, basis: Basis) -> Verified:
    """Return the bar's length with the calibration in use: nothing is solved."""
    return Verified(_error(bar, basis), None, _uncertainty(bar, basis), basis.before_hash)


def _error(bar: BallBar, basis: Basis) -> float:
    return (bar.length_mm - basis.bar.length_mm) / basis.bar.length_mm


def _uncertainty(bar: BallBar, basis: Basis) -> float:
    return float(np.hypot(bar.sigma_length_mm, basis.bar.length_sd_mm)) / basis.bar.length_mm


def _judged_bar(
    step: Step, bar: BallBar | NotFound, cloud: Cloud, calibration: Calibration, certificate: BarCertificate
) -> RecordingCheck:
    if isinstance(bar, NotFound):
        return RecordingCheck(step, Refusal.NOT_FOUND, None, cloud.summary.points, bar.reason)
    if certificate.radius_mm is None:
        raise CertificateMissing("the ball bar's radius is not stated; give ball_bar.radius_mm in the rig file")
    balls = (bar.first, bar.second)
    found = FoundBar(
        np.array([ball.sphere.centre_mm for ball in balls]),
        (bar.first.sphere.radius_mm, bar.second.sphere.radius_mm),
        max(ball.used.rms_mm for ball in balls),
        sum(ball.used.count for ball in balls),
    )
    return judge_bar(step, found, calibration.rig, certificate.length_mm, certificate.radius_mm)


def _judged_plane(step: Step, plane: PlaneFit | NotFound, cloud: Cloud, calibration: Calibration) -> RecordingCheck:
    if isinstance(plane, NotFound):
        return RecordingCheck(step, Refusal.NOT_FOUND, None, cloud.summary.points, plane.reason)
    camera = calibration.rig.left
    found = FoundPlane(
        np.array(plane.plane.centre_mm),
        np.array(plane.plane.normal),
        plane.used.rms_mm,
        plane.used.count,
        100.0 * plane.used.count / (camera.width_px * camera.height_px),
    )
    return judge_plane(step, found, calibration.rig)


def _wide(scan: StoredScan, basis: Basis) -> ReprocessedScan:
    """Reprocess with room for rays that miss each other because nobody knows the ports."""
    settings = Instrument(basis.rig).settings_of_scan(scan.manifest.record)
    return reprocess_scan(scan, basis.start, settings, silent, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM))


def _fairly(scan: StoredScan, calibration: Calibration, basis: Basis) -> ReprocessedScan:
    settings = Instrument(basis.rig).settings_of_scan(scan.manifest.record)
    return reprocess_scan(scan, calibration, settings, silent, QualityLimits(max_gap_mm=VERIFY_GAP_MM))


def _fair(scan: StoredScan, calibration: Calibration, basis: Basis) -> Cloud:
    """Return the cloud with room for the errors of any calibration, so that all are judged by the same points."""
    return _fairly(scan, calibration, basis).cloud
