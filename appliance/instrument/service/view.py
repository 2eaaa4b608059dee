"""View models of the screens, made from the state of machine and service.

view_of                               the view for a machine, with the labels of its keys
Facts, Surroundings                   data of the service for a view
menu_view, value_of, question_view    the pages of the menu, with texts and values of their rows
scan_faults                           faults of the scan in hand
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.calibrate import HELD
from appliance.instrument.machine import menu, safety, start, thermal
from appliance.instrument.machine.alerts import alert_of, lengths_doubtful
from appliance.instrument.machine.conditions import refusal
from appliance.instrument.machine.keys import labels
from appliance.instrument.machine.leading import alerts, guidance_text, on_screen, overlap_text
from appliance.instrument.machine.menu import Row
from appliance.instrument.machine.states import (
    Answer,
    Calibrating,
    Device,
    Machine,
    Menu,
    OffQuestion,
    Page,
    Part,
    Serving,
    State,
)
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.ranging.reach import Marks
from appliance.instrument.screens.views import (
    AimView,
    AnyView,
    CalibrateView,
    CoolingView,
    DeviceLine,
    GalleryView,
    Gauge,
    MenuRow,
    MenuView,
    ProgressView,
    ReviewView,
    SafeView,
    SavingView,
    SelfTestView,
    ShutdownView,
    StoredScan,
)
from appliance.instrument.service.scan_files import ScanInMemory
from appliance.measure import Fault, FaultCode, Grade, grade


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts about the instrument for the menu."""

    serial: str
    calibrated: Label
    """The day of the calibration; or the text that there is none."""


TITLES = {Page.MAIN: Text.MENU, Page.WATER: Text.WATER, Page.TRANSFER: Text.TRANSFER, Page.ABOUT: Text.ABOUT}
WORDS = {
    Row.EXPOSURE: Text.EXPOSURE,
    Row.PERIOD: Text.FRINGES,
    Row.WATER: Text.WATER,
    Row.CALIBRATION: Text.CALIBRATE,
    Row.GALLERY: Text.GALLERY,
    Row.OBJECT: Text.OBJECT,
    Row.LANGUAGE: Text.LANGUAGE,
    Row.ABOUT: Text.ABOUT,
    Row.POWER_OFF: Text.POWER_OFF,
    Row.WATER_KIND: Text.WATER_KIND,
    Row.WATER_TEMPERATURE: Text.WATER_TEMPERATURE,
    Row.TRANSFER: Text.TRANSFER,
    Row.TRANSFER_SWITCH: Text.TRANSFER,
    Row.ADDRESS: Text.ADDRESS,
    Row.KEYS: Text.TRANSFER_KEYS,
    Row.VERSION: Text.VERSION,
    Row.SERIAL_NUMBER: Text.SERIAL_NUMBER,
    Row.CALIBRATED: Text.CALIBRATED,
    Row.SALINITY: Text.SALINITY,
    Row.DISK: Text.DISK,
}
LANGUAGES = {"en": Text.ENGLISH, "de": Text.GERMAN}


ANSWERS = {Answer.STAY_ON: Text.STAY_ON, Answer.SWITCH_OFF: Text.SWITCH_OFF}


def question_view(machine: Machine, question: OffQuestion) -> MenuView:
    """Return the question whether to switch off: two answers, on the screen of any state."""
    rows = tuple(MenuRow(ANSWERS[answer]) for answer in Answer)
    selected = list(Answer).index(question.answer)
    # All alerts, since the screen of the state below may have left some out.
    return MenuView(title=Text.POWER_OFF_ASKED, rows=rows, selected=selected, alerts=alerts(machine))


def menu_view(machine: Machine, facts: Facts | None) -> MenuView:
    """Return the diver's page of the menu, with the value that is being changed."""
    position = machine.menu or Menu()
    rows = tuple(MenuRow(WORDS[row], value_of(row, machine, facts)) for row in menu.ROWS[position.page])
    changing = position.draft is not None
    return MenuView(
        title=TITLES[position.page], rows=rows, selected=position.row, changing=changing, alerts=on_screen(machine)
    )


FRINGES = {16: Text.FINE, 32: Text.MEDIUM, 64: Text.COARSE_FRINGES}


SERVING = {Serving.STARTING: Text.STARTING, Serving.ON: Text.ON, Serving.FAILED: Text.TRANSFER_FAILED}


def value_of(row: Row, machine: Machine, facts: Facts | None) -> Label:
    """Return the value of a row; while it is being changed, the new one."""
    chosen = menu.shown(machine)
    match row:
        case Row.EXPOSURE:
            value: Label = chosen.exposure.label
        case Row.PERIOD:
            value = FRINGES.get(chosen.period_px, f"{chosen.period_px} px")
        case Row.WATER:
            value = (Text.SALT if chosen.salt else Text.FRESH, f"{chosen.water_c:g} °C")
        case Row.WATER_KIND:
            value = Text.SALT if chosen.salt else Text.FRESH
        case Row.WATER_TEMPERATURE:
            value = f"{chosen.water_c:g} °C"
        case Row.OBJECT:
            number = chosen.object
            began = number is not None and number > machine.choices.objects
            value = Text.NO_OBJECT if number is None else (str(number), Text.NEW) if began else str(number)
        case Row.LANGUAGE:
            value = LANGUAGES.get(chosen.language, Text.ENGLISH)
        case Row.TRANSFER:
            value = Text.ON if chosen.transfer else Text.OFF
        case Row.TRANSFER_SWITCH:
            begun = chosen.transfer and machine.choices.transfer
            word = SERVING[machine.transfer.serving] if begun else Text.ON
            value = word if chosen.transfer else Text.OFF
        case Row.ADDRESS if machine.transfer.serving is Serving.ON:
            value = machine.transfer.address or Text.NO_NETWORK
        case Row.KEYS if machine.transfer.serving is Serving.ON and machine.transfer.keys is not None:
            value = str(machine.transfer.keys) if machine.transfer.keys else Text.PLUG_STICK_IN
        case Row.VERSION:
            value = appliance.__version__
        case Row.DISK:
            left = "?" if machine.scans_left is None else str(machine.scans_left)
            value = (str(machine.scans), Text.TAKEN, f"· {left}", Text.LEFT_OVER)
        case Row.SERIAL_NUMBER if facts is not None:
            value = facts.serial
        case Row.CALIBRATED if facts is not None:
            value = facts.calibrated
        case Row.SALINITY:
            value = f"{chosen.salinity_psu:g} psu"
        case _:
            value = ""
    return value


NO_POINTS = np.empty((0, 3), np.float32)
NO_VALUES = np.empty(0, np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Data of the service for a view."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    temperature_c: float | None
    scan: ScanInMemory | None
    shown: StoredScan | None = None
    """The scan that the gallery has loaded."""
    facts: Facts | None = None
    marks: Marks | None = None
    """Positions where the laser dots will appear in the live images."""


def view_of(machine: Machine, around: Surroundings) -> AnyView:
    """Return the view for a machine, with the labels of its keys."""
    return replace(_view(machine, around), keys=labels(machine))


def _view(machine: Machine, around: Surroundings) -> AnyView:
    shown = on_screen(machine)
    if machine.off_question is not None:
        return question_view(machine, machine.off_question)
    match machine.state:
        case State.BOOT:
            return SelfTestView(devices=_lines(machine), version=appliance.__version__, opened=False, alerts=shown)
        case State.SELF_TEST:
            return SelfTestView(
                devices=(*_lines(machine), *_parts(machine)),
                version=appliance.__version__,
                finished=start.finished(machine),
                passed=start.passed(machine),
                alerts=shown,
            )
        case State.AIM:
            # SAVED stays for two seconds, or until a key: long enough to be read, without blocking.
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
                overlap=overlap_text(machine),
                guidance=guidance_text(machine),
                object=machine.choices.object,
                scan_allowed=refusal(machine) is None,
                alerts=shown,
            )
        case State.MENU:
            return menu_view(machine, around.facts)
        case State.GALLERY:
            return _gallery(machine, around.shown)
        case State.ARMED | State.CAPTURE | State.CHECK | State.RECONSTRUCT:
            return ProgressView(state=machine.state, alerts=shown)
        case State.REVIEW:
            return _review(machine, around, machine.scan is not None and machine.scan.full is not None)
        case State.SAVING:
            return SavingView(scan_id=_next_id(around), saved=False, alerts=shown)
        case State.CALIBRATE:
            position = machine.calibrating or Calibrating(machine.session.next_step)
            return CalibrateView(
                position=position,
                session=machine.session,
                left=around.left if Device.CAMERA_LEFT in machine.up else None,
                right=around.right if Device.CAMERA_RIGHT in machine.up else None,
                scan_allowed=position.step not in HELD or refusal(machine) is None,
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
            next_scan=_next_scan(machine), overlap=overlap_text(machine), points_mm=NO_POINTS, values=NO_VALUES, coarse=True, grade=Grade.BAD, points=0,
            coverage_percent=None, noise_mm=None, distance_mm=None, duration_s=None, alerts=on_screen(machine),
        )  # fmt: skip
    # A small screen can only show the coarse cloud; the numbers are those of the full one as soon as it is there.
    shown = around.scan.coarse if around.scan is not None and around.scan.coarse is not None else cloud
    s = cloud.summary
    duration_s = around.scan.times_s.get("full" if full else "coarse") if around.scan is not None else None
    return ReviewView(
        points_mm=shown.points_mm,
        # Coloured by distance: z of the left camera's frame.
        values=shown.points_mm[:, 2],
        coarse=not full,
        grade=grade(s.coverage_percent, s.noise_mm, scan_faults(machine)),
        lengths_doubtful=lengths_doubtful(machine),
        points=s.points,
        coverage_percent=s.coverage_percent,
        noise_mm=s.noise_mm,
        distance_mm=s.distance_mm,
        duration_s=duration_s,
        overlap=overlap_text(machine),
        next_scan=_next_scan(machine),
        turn_steps=machine.scan.turn_steps if machine.scan is not None else 0,
        alerts=on_screen(machine),
    )


def _next_scan(machine: Machine) -> str | None:
    """Return the exposure of the next scan if the diver has changed it in this review."""
    scan = machine.scan
    changed = scan is not None and scan.added is None and scan.exposure != machine.exposure
    return machine.exposure.label if changed else None


def scan_faults(machine: Machine) -> frozenset[FaultCode]:
    """Return the faults of the scan in hand."""
    return frozenset() if machine.scan is None else frozenset(fault.code for fault in machine.scan.warnings)


def _gauge(machine: Machine) -> Gauge | None:
    """Return the reading of the laser dots; ``None`` while the lasers are off or a camera is lost.

    No scan is possible then, whatever the distance.
    """
    if machine.lasers_off_since_ns is not None or not {Device.CAMERA_LEFT, Device.CAMERA_RIGHT} <= machine.up:
        return None
    measured = machine.range
    if measured is None:
        return Gauge(None, None, machine.reach, machine.settings.volume)
    return Gauge(measured.distance_mm, measured.tilt_deg, machine.reach, machine.settings.volume)


def _cooling(machine: Machine) -> CoolingView:
    """Return the view with the temperature that is farthest above its target."""
    hot = [c for c in machine.conditions if c.code in safety.COOLS_DOWN and "temperature_c" in c.numbers]
    worst = max(hot, key=lambda c: c.numbers["temperature_c"] - c.numbers.get("below_c", 0.0), default=None)
    return CoolingView(
        temperature_c=None if worst is None else worst.numbers["temperature_c"],
        limit_c=worst.numbers.get("below_c", 0.0) if worst is not None else machine.settings.temperatures["case"].hot_c,
        remaining_s=thermal.remaining_s(machine),
        alerts=on_screen(machine),
    )


def _gallery(machine: Machine, shown: StoredScan | None) -> GalleryView:
    gallery = machine.gallery
    if gallery is None or not gallery.scans or gallery.scan_id is None:
        return GalleryView(alerts=on_screen(machine))
    scan = shown if shown is not None and shown.scan_id == gallery.scan_id else StoredScan(gallery.scan_id)
    return GalleryView(scan=scan, index=gallery.index, count=len(gallery.scans), alerts=on_screen(machine))


def _parts(machine: Machine) -> tuple[DeviceLine, ...]:
    tests = ((part, machine.parts.get(part)) for part in Part)
    return tuple(
        DeviceLine(part.value, None if test is None else test.passed, "" if test is None else test.detail)
        for part, test in tests
    )


def _lines(machine: Machine) -> tuple[DeviceLine, ...]:
    lines = []
    for device in Device:
        lost = machine.lost.get(device)
        works = True if device in machine.up else None if lost is None else False
        lines.append(DeviceLine(device.value, works, "" if lost is None else alert_of(lost)))
    return tuple(lines)


def _next_id(around: Surroundings) -> str:
    pending = around.scan.pending if around.scan is not None else None
    return pending.scan_id if pending is not None else ""
