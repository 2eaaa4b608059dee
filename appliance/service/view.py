"""Owns the step from what the instrument knows to what its screen shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.calibration.guide import HELD
from appliance.capture.fault import Fault, FaultCode
from appliance.machine.alerts import RULES, alert_of, alerts
from appliance.machine.permissions import refusal
from appliance.machine.states import Calibrating, Device, Machine, State
from appliance.machine.texts import labels
from appliance.screens.views import (
    AimView,
    AnyView,
    BootView,
    CalibrateView,
    CaptureView,
    DeviceLine,
    DeviceResult,
    Grade,
    PointValue,
    ReconstructView,
    ReviewView,
    SavingView,
    ShutdownView,
)
from appliance.service.scans import ScanInWork

NO_POINTS = np.empty((0, 3), np.float32)
NO_VALUES = np.empty(0, np.float32)
GOOD_COVERAGE_PERCENT, GOOD_NOISE_MM = 60.0, 0.06
USABLE_COVERAGE_PERCENT, USABLE_NOISE_MM = 25.0, 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What a view needs besides the machine."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    temperature_c: float | None
    scan: ScanInWork | None
    frames: int
    frames_done: int


def view_of(machine: Machine, around: Surroundings) -> AnyView:
    """The screen for a machine, with what its keys mean now."""
    return replace(_view(machine, around), keys=labels(machine))


def _view(machine: Machine, around: Surroundings) -> AnyView:
    shown = alerts(machine)
    match machine.state:
        case State.BOOT:
            return BootView(devices=_lines(machine), version=appliance.__version__, alerts=shown)
        case State.AIM:
            if machine.just_saved is not None and machine.now_ns - machine.since_ns < 2_000_000_000:
                return SavingView(scan_id=machine.just_saved, saved=True, alerts=shown)
            return AimView(
                left=around.left if Device.CAMERA_LEFT in machine.up else None,
                right=around.right if Device.CAMERA_RIGHT in machine.up else None,
                scans_taken=machine.scans,
                scans_left=machine.scans_left,
                temperature_c=around.temperature_c,
                exposure=machine.exposure.label,
                scan_allowed=refusal(machine) is None,
                alerts=shown,
            )
        case State.CAPTURE:
            return CaptureView(frames_done=around.frames_done, frames=around.frames, alerts=shown)
        case State.RECONSTRUCT:
            return ReconstructView(progress=None, alerts=shown)
        case State.REVIEW:
            return _review(machine, around, machine.scan is not None and machine.scan.full is not None)
        case State.SAVING:
            return SavingView(scan_id=_next_id(around), saved=False, alerts=shown)
        case State.CALIBRATE:
            at = machine.calibrating or Calibrating(machine.session.next_step)
            return CalibrateView(
                at=at,
                session=machine.session,
                left=around.left if Device.CAMERA_LEFT in machine.up else None,
                right=around.right if Device.CAMERA_RIGHT in machine.up else None,
                scan_allowed=at.step not in HELD or refusal(machine) is None,
                # What calibrating is the remedy for need not be said while it is done.
                alerts=tuple(alert for alert in shown if alert.code is not FaultCode.UNCALIBRATED),
            )
        case State.SHUTDOWN:
            reason = next((alert_of(c) for c in machine.conditions), None)
            return ShutdownView(reason=reason, saving=machine.stopping)
        case _:
            assert_never(machine.state)


def _review(machine: Machine, around: Surroundings, full: bool) -> ReviewView:
    cloud = around.scan.cloud if around.scan is not None else None
    if cloud is None:
        return ReviewView(
            points_mm=NO_POINTS, values=NO_VALUES, value=PointValue.DEPTH, coarse=True, grade=Grade.BAD, points=0,
            coverage_percent=None, noise_mm=None, distance_mm=None, duration_s=None, alerts=alerts(machine),
        )  # fmt: skip
    # The coarse cloud is what a small screen can show; the numbers are those of the full one as soon as it is there.
    shown = around.scan.coarse if around.scan is not None and around.scan.coarse is not None else cloud
    s = cloud.summary
    duration_s = around.scan.times_s.get("full" if full else "coarse") if around.scan is not None else None
    return ReviewView(
        points_mm=shown.points_mm,
        values=shown.points_mm[:, 2],
        value=PointValue.DEPTH,
        coarse=not full,
        grade=_grade(s.coverage_percent, s.noise_mm, machine.scan.warnings if machine.scan is not None else ()),
        points=s.points,
        coverage_percent=s.coverage_percent,
        noise_mm=s.noise_mm,
        distance_mm=s.distance_mm,
        duration_s=duration_s,
        turn=machine.scan.turn if machine.scan is not None else 0,
        alerts=alerts(machine),
    )


def _grade(coverage_percent: float | None, noise_mm: float | None, warnings: tuple[Fault, ...]) -> Grade:
    if coverage_percent is None or noise_mm is None or any(RULES[w.code].spoils_points for w in warnings):
        return Grade.BAD
    if coverage_percent >= GOOD_COVERAGE_PERCENT and noise_mm <= GOOD_NOISE_MM:
        return Grade.GOOD
    if coverage_percent >= USABLE_COVERAGE_PERCENT and noise_mm <= USABLE_NOISE_MM:
        return Grade.USABLE
    return Grade.BAD


def _lines(machine: Machine) -> tuple[DeviceLine, ...]:
    lines = []
    for device in Device:
        if device in machine.up:
            lines.append(DeviceLine(device.value, DeviceResult.WORKS))
        elif device in machine.lost:
            lines.append(DeviceLine(device.value, DeviceResult.FAILED, machine.lost[device].detail))
        else:
            lines.append(DeviceLine(device.value, DeviceResult.WAITING))
    return tuple(lines)


def _next_id(around: Surroundings) -> str:
    pending = around.scan.pending if around.scan is not None else None
    return pending.scan_id if pending is not None else ""
