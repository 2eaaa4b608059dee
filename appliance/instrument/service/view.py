"""Owns the step from what the instrument knows to what its screen shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.calibrate import HELD
from appliance.instrument.machine import safety, start, thermal
from appliance.instrument.machine.alerts import alert_of, lengths_doubtful
from appliance.instrument.machine.guiding import guidance_said
from appliance.instrument.machine.leading import on_screen
from appliance.instrument.machine.overlaps import overlap_said
from appliance.instrument.machine.permissions import refusal
from appliance.instrument.machine.states import Calibrating, Device, Machine, Part, State
from appliance.instrument.machine.texts import labels
from appliance.instrument.machine.words import Text
from appliance.instrument.ranging.marks import Marks
from appliance.instrument.screens.views import (
    AimView,
    AnyView,
    ArmedView,
    BootView,
    CalibrateView,
    CaptureView,
    CheckView,
    CoolingView,
    DeviceLine,
    DeviceResult,
    GalleryView,
    Gauge,
    ReconstructView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
)
from appliance.instrument.service.gallery import Shown
from appliance.instrument.service.menu_view import Facts, menu_view, question_view
from appliance.instrument.service.scan_in_memory import ScanInMemory
from appliance.measure import Fault, FaultCode, Grade, grade

NO_POINTS = np.empty((0, 3), np.float32)
NO_VALUES = np.empty(0, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The things that a view needs besides the machine."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    temperature_c: float | None
    scan: ScanInMemory | None
    shown: Shown | None = None
    """The scan that the gallery has loaded."""
    facts: Facts | None = None
    marks: Marks | None = None
    """The places where the laser dots are going to be seen in the live pictures."""


def view_of(machine: Machine, around: Surroundings) -> AnyView:
    """Return the screen for a machine, with what its keys mean now."""
    return replace(_view(machine, around), keys=labels(machine))


def _view(machine: Machine, around: Surroundings) -> AnyView:
    shown = on_screen(machine)
    if machine.off_question is not None:
        return question_view(machine, machine.off_question)
    match machine.state:
        case State.BOOT:
            return BootView(devices=_lines(machine), version=appliance.__version__, alerts=shown)
        case State.SELF_TEST:
            return SelfTestView(
                devices=(*_lines(machine), *_parts(machine)),
                version=appliance.__version__,
                finished=start.finished(machine),
                passed=start.passed(machine),
                alerts=shown,
            )
        case State.AIM:
            # SAVED stays for two seconds, or until a key: long enough to be read, without being waited for.
            if machine.just_saved is not None and machine.now_ns - machine.since_ns < 2_000_000_000:
                return SavingView(scan_id=machine.just_saved, saved=True, alerts=shown)
            return AimView(
                left=around.left if Device.CAMERA_LEFT in machine.up else None,
                right=around.right if Device.CAMERA_RIGHT in machine.up else None,
                scans_taken=machine.scans,
                scans_left=machine.scans_left,
                temperature_c=around.temperature_c,
                exposure=machine.exposure.label,
                gauge=_gauge(machine),
                marks=around.marks,
                water=Text.SALT if machine.choices.salt else Text.FRESH,
                overlap=overlap_said(machine),
                guidance=guidance_said(machine),
                object=machine.choices.object,
                scan_allowed=refusal(machine) is None,
                alerts=shown,
            )
        case State.MENU:
            return menu_view(machine, around.facts)
        case State.GALLERY:
            return _gallery(machine, around.shown)
        case State.ARMED:
            return ArmedView(alerts=shown)
        case State.CAPTURE:
            return CaptureView(alerts=shown)
        case State.CHECK:
            return CheckView(alerts=shown)
        case State.RECONSTRUCT:
            return ReconstructView(alerts=shown)
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
                marks=around.marks,
                gauge=_gauge(machine),
                volume=machine.settings.volume,
                alerts=shown,
            )
        case State.COOLING:
            return _cooling(machine)
        case State.SAFE:
            cause = safety.unsafe(machine) or Fault(FaultCode.INTERNAL, "SAFE without a cause")
            return SafeView(alert=alert_of(cause), saved=machine.scan is None, alerts=shown)
        case State.SHUTDOWN:
            reason = None if machine.ended_by is None else alert_of(machine.ended_by)
            return ShutdownView(reason=reason, saving=machine.stopping is not None)
        case _:
            assert_never(machine.state)


def _review(machine: Machine, around: Surroundings, full: bool) -> ReviewView:
    cloud = around.scan.cloud if around.scan is not None else None
    if cloud is None:
        return ReviewView(
            next_scan=_next_scan(machine), overlap=overlap_said(machine), points_mm=NO_POINTS, values=NO_VALUES, coarse=True, grade=Grade.BAD, points=0,
            coverage_percent=None, noise_mm=None, distance_mm=None, duration_s=None, alerts=on_screen(machine),
        )  # fmt: skip
    # The coarse cloud is what a small screen can show; the numbers are those of the full one as soon as it is there.
    shown = around.scan.coarse if around.scan is not None and around.scan.coarse is not None else cloud
    s = cloud.summary
    duration_s = around.scan.times_s.get("full" if full else "coarse") if around.scan is not None else None
    return ReviewView(
        points_mm=shown.points_mm,
        # Coloured by distance: z of the left camera's frame.
        values=shown.points_mm[:, 2],
        coarse=not full,
        grade=grade(s.coverage_percent, s.noise_mm, held_against(machine)),
        lengths_doubtful=lengths_doubtful(machine),
        points=s.points,
        coverage_percent=s.coverage_percent,
        noise_mm=s.noise_mm,
        distance_mm=s.distance_mm,
        duration_s=duration_s,
        overlap=overlap_said(machine),
        next_scan=_next_scan(machine),
        turn=machine.scan.turn if machine.scan is not None else 0,
        alerts=on_screen(machine),
    )


def _next_scan(machine: Machine) -> str | None:
    """Return the exposure of the next scan where the diver has changed it over this one."""
    scan = machine.scan
    changed = scan is not None and scan.added is None and scan.exposure != machine.exposure
    return machine.exposure.label if changed else None


def held_against(machine: Machine) -> frozenset[FaultCode]:
    """Return what is held against the scan in hand."""
    return frozenset() if machine.scan is None else frozenset(fault.code for fault in machine.scan.warnings)


def _gauge(machine: Machine) -> Gauge | None:
    """Return the reading of the laser dots; ``None`` while the lasers are not on, or a camera is gone: no scan can be taken from
    there, however far it is."""
    if machine.lasers_off_since_ns is not None or not {Device.CAMERA_LEFT, Device.CAMERA_RIGHT} <= machine.up:
        return None
    measured = machine.range
    if measured is None:
        return Gauge(None, None, machine.reach, machine.settings.volume)
    return Gauge(measured.distance_mm, measured.tilt_deg, machine.reach, machine.settings.volume)


def _cooling(machine: Machine) -> CoolingView:
    """Return the temperature that is farthest above what it must fall to."""
    hot = [c for c in machine.conditions if c.code in safety.COOLS_DOWN and "temperature_c" in c.numbers]
    worst = max(hot, key=lambda c: c.numbers["temperature_c"] - c.numbers.get("below_c", 0.0), default=None)
    return CoolingView(
        temperature_c=None if worst is None else worst.numbers["temperature_c"],
        limit_c=worst.numbers.get("below_c", 0.0) if worst is not None else machine.settings.temperatures["case"].hot_c,
        remaining_s=thermal.remaining_s(machine),
        alerts=on_screen(machine),
    )


def _gallery(machine: Machine, shown: Shown | None) -> GalleryView:
    at = machine.gallery
    if at is None or not at.scans or at.scan_id is None:
        return GalleryView(alerts=on_screen(machine))
    scan = shown if shown is not None and shown.scan_id == at.scan_id else Shown(at.scan_id, damaged=False)
    return GalleryView(
        scan_id=scan.scan_id,
        index=at.index,
        count=len(at.scans),
        preview=scan.preview,
        grade=scan.grade,
        corrected=scan.corrected,
        lengths_doubtful=scan.lengths_doubtful,
        points=scan.points,
        coverage_percent=scan.coverage_percent,
        noise_mm=scan.noise_mm,
        distance_mm=scan.distance_mm,
        taken=scan.taken,
        damaged=scan.damaged,
        alerts=on_screen(machine),
    )


def _parts(machine: Machine) -> tuple[DeviceLine, ...]:
    lines = []
    for part in Part:
        test = machine.parts.get(part)
        result = DeviceResult.WAITING if test is None else DeviceResult.WORKS if test.passed else DeviceResult.FAILED
        lines.append(DeviceLine(part.value, result, "" if test is None else test.detail))
    return tuple(lines)


def _lines(machine: Machine) -> tuple[DeviceLine, ...]:
    lines = []
    for device in Device:
        if device in machine.up:
            lines.append(DeviceLine(device.value, DeviceResult.WORKS))
        elif device in machine.lost:
            lines.append(DeviceLine(device.value, DeviceResult.FAILED, alert_of(machine.lost[device])))
        else:
            lines.append(DeviceLine(device.value, DeviceResult.WAITING))
    return tuple(lines)


def _next_id(around: Surroundings) -> str:
    pending = around.scan.pending if around.scan is not None else None
    return pending.scan_id if pending is not None else ""
