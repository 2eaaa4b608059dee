"""The service's cycle: gather events, let the machine decide, execute its effects, and draw.

It is the main thread of the process and the only owner of GL. The display's vertical blank paces it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import assert_never

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.alerts import lengths_doubtful
from appliance.instrument.machine.ashore import ASHORE
from appliance.instrument.machine.choices import Choices
from appliance.instrument.machine.conditions import LOST_CODES
from appliance.instrument.machine.keys import meaning
from appliance.instrument.machine.states import Machine, Part, PartResult, State, boot
from appliance.instrument.machine.step import step
from appliance.instrument.machine.words import Language, Text
from appliance.instrument.screens.painter import Painter
from appliance.instrument.service.inputs import Inputs
from appliance.instrument.service.parts import LiveViews, Parts, StartFacts
from appliance.instrument.service.recording import DrawnPatterns, SequenceRecorder
from appliance.instrument.service.settings import machine_settings
from appliance.instrument.service.status import StatusFile
from appliance.instrument.service.view import Facts, Surroundings, scan_faults, view_of
from appliance.instrument.service.watchdog import Watchdog
from appliance.measure import GRADE_NAME as GRADE
from appliance.measure import (
    LENGTHS_DOUBTFUL,
    Fault,
    FaultCode,
    FullCloud,
    Grade,
    News,
    PatternIdentity,
    ReconstructionFailure,
    Verdict,
    Verdicts,
    faults_in,
    grade,
)
from appliance.measure import METHOD as DRAWN
from appliance.store import Rig, StorageError
from drivers.api import Clock, Key, KeyPress

log = logging.getLogger("kingfisher")

PRESENT_TIMEOUT_S, PRESENT_PERIODS = 0.5, 4
"""Longest time to show a picture on the diver's display, in s and in periods: the longer of both holds."""
CYCLE_WITHOUT_DISPLAY_S = 0.05
QUIT_TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class Drawing:
    """Pictures of both displays, drawn by one graphics processor."""

    patterns: DrawnPatterns
    painter: Painter


class Service:
    """The running instrument. ``run`` returns when it was switched off."""

    def __init__(
        self,
        rig: Rig,
        parts: Parts,
        drawing: Drawing,
        status: StatusFile,
        clock: Clock,
        beginning: StartFacts,
        stop_reason: Callable[[], str | None],
    ) -> None:
        """Set the instrument up; ``stop_reason`` returns why the process should end, or ``None``."""
        chosen, lost = beginning.choices.read()
        self._rig = rig
        self._parts = parts
        self._choices = beginning.choices
        self._painter = drawing.painter
        self._status = status
        self._clock = clock
        self._stop_reason = stop_reason
        self.machine: Machine = boot(
            clock.now_ns(), machine_settings(rig, replace(chosen, transfer=parts.transfer.is_on))
        )
        self._inbox: list[on.Event] = []
        """Events for the next cycle.

        All parts add to the same list: it is emptied, never replaced.
        """
        self._inputs = Inputs(parts.devices, parts.ranging)
        self._live = LiveViews(rig, parts, self._inbox)
        self._recorder = SequenceRecorder(rig, parts, drawing.patterns, self._inputs, clock, self._inbox)
        raised = [*beginning.conditions, parts.scans.watch.fault, lost]
        self._inbox += [on.ConditionRaised(fault) for fault in raised if fault is not None]
        self._inbox += [on.FaultReported(fault) for fault in beginning.news]
        uncalibrated = any(fault.code is FaultCode.UNCALIBRATED for fault in beginning.conditions)
        self._inbox.append(PartResult(Part.CALIBRATION, not uncalibrated, Text.NOT_MEASURED if uncalibrated else ""))
        scans, calibrating = parts.scans, parts.calibrating
        self._wishes: Mapping[do.Wish, Callable[[], None]] = {
            do.Wish.DARK: self._live.end,
            do.Wish.ABORT_CAPTURE: self._recorder.let_go,
            do.Wish.RECONSTRUCT: scans.worker.finish,
            do.Wish.CANCEL_RECONSTRUCTION: scans.worker.drop,
            do.Wish.SOLVE_CALIBRATION: calibrating.solve,
            do.Wish.USE_SOLVED: calibrating.use_solved,
            do.Wish.RESTORE_KEPT: calibrating.restore,
            do.Wish.BEGIN_SESSION: calibrating.begin,
            do.Wish.CANCEL_CALIBRATION: calibrating.cancel,
            do.Wish.LIST_GALLERY: parts.gallery.list_scans,
        }
        self._drawn: State | None = None
        """The state that the diver's display shows."""
        self._boot_reported = False
        self._stop_reported = False
        self._quit: do.Quit | None = None

    def run(self, watchdog: Watchdog) -> do.Quit:
        """Run cycles until the machine wants to quit, then finish pending writes."""

        def cycle() -> None:
            self.run_cycle()
            watchdog.report_cycle(self.machine, worker_answers=self._parts.scans.worker.answers)

        self._parts.scans.test_storage()
        self._parts.scans.count_objects()
        while self._quit is None:
            cycle()
        watchdog.stopping()
        end_ns = self._clock.now_ns() + int(QUIT_TIMEOUT_S * 1e9)
        # The cycle goes on: SAVING stays on the screen, and the watchdog does not take a slow disk for a hang.
        while (self._parts.scans.busy or self._parts.calibrating.busy) and self._clock.now_ns() < end_ns:
            cycle()
        self._write_status()
        return self._quit

    def run_cycle(self) -> None:
        """Run one cycle. It waits only for the display and, during a sequence, for the projector."""
        for event in self._gather():
            self._handle(event)
        # The tick comes after the events, so that an answer in time precedes its deadline.
        self._handle(on.Tick(self._clock.now_ns()))
        # After the tick, so that requests of this cycle begin in it.
        for event in self._recorder.go_on():
            self._handle(event)
        self._write_status()
        self._draw()

    def _write_status(self) -> None:
        gallery = self.machine.gallery
        shown = None if gallery is None else self._parts.gallery.status_of(gallery.scan_id)
        self._status.update(self.machine, self._parts.scans.worker.pid, shown)

    # --------------------------------------------------------------------------------- what happened

    def _gather(self) -> list[on.Event]:
        # Events of the last cycle come first, since they are older.
        events = list(self._inbox)
        self._inbox.clear()
        parts = self._parts
        events += parts.devices.poll()
        events += self._inputs.poll()
        events += parts.scans.poll()
        events += parts.calibrating.poll()
        events += parts.gallery.poll()
        events += parts.ranging.poll()
        events += parts.aiming.poll()
        events += parts.transfer.poll(self._clock.now_ns(), is_on=self.machine.choices.transfer)
        events += self._live.switch_lasers_on()
        if not self._boot_reported and parts.devices.all_tried:
            self._boot_reported = True
            events.append(on.BootFinished())
        if self._stop_reason() is not None and not self._stop_reported:
            self._stop_reported = True
            events.append(on.StopRequested())
        return events

    def _handle(self, event: on.Event) -> None:
        before = self.machine
        self.machine, effects = step(before, event)
        if self.machine.state is not before.state:
            log.info("%s → %s (%s)", before.state.value, self.machine.state.value, type(event).__name__)
            if self.machine.state is State.CALIBRATE:
                self._parts.calibrating.warm()
            elif before.state is State.CALIBRATE and self.machine.calibrating is None:
                self._parts.calibrating.cancel()  # its process takes memory
            # The preview is read back from GL, in this thread, while the painter still has the cloud; only if the
            # cloud was drawn.
            if before.state is State.REVIEW and self._drawn is State.REVIEW:
                self._parts.scans.preview = self._painter.preview()
        line = log_line(event)
        if line is not None:
            log.log(*line)
        for effect in effects:
            self._execute(effect)

    # --------------------------------------------------------------------------------- what is wanted

    def _execute(self, effect: do.Effect) -> None:
        match effect:
            case do.Wish():
                self._wishes[effect]()
            case do.GoLive():
                aiming = self.machine.state is State.AIM
                self._live.begin(effect, aiming=aiming, belongs_to=self.machine.choices.object)
            case do.Arm():
                self._recorder.request(effect)
            case do.Capture():
                # The event is left for the next cycle, since more effects are still to be executed.
                self._inbox.append(self._recorder.play(effect.number, self._draw, self._abort))
            case do.StoreRaw():
                self._parts.scans.store_raw(effect.number)
            case do.Publish():
                self._publish(effect.number)
            case do.Reject():
                self._parts.scans.reject(effect.number, effect.reason)
            case do.CheckRecording():
                self._parts.calibrating.examine(effect.number, effect.step)
            case do.AcceptRecording():
                self._parts.calibrating.accept(effect.number, effect.check)
            case do.UseChoices():
                self._use(effect.before, effect.now)
            case do.ShowGalleryScan():
                self._parts.gallery.show(effect.scan_id)
            case do.ReopenDevice():
                for side, camera in self._parts.devices.cameras.items():
                    if effect.device is None or effect.device.value == f"camera.{side}":
                        self._inbox += camera.lose("opened again, since its images do not follow the patterns")
            case do.Quit():
                self._live.end()
                self._quit = effect
            case _:
                assert_never(effect)

    def _abort(self) -> Fault | None:
        """Return why the playing sequence must end, for the system or the diver; ``None``: it goes on."""
        reason = self._stop_reason()
        if reason is not None:
            return Fault(FaultCode.CAPTURE_TIMEOUT, f"stopped: {reason}")
        pressed = self._inputs.keys()
        self._inbox += pressed  # the machine gets every key, also those that do not end the sequence
        if any(isinstance(e, KeyPress) and meaning(self.machine, e.key) is Key.BACK for e in pressed):
            return Fault(FaultCode.CAPTURE_TIMEOUT, "stopped by the diver")
        return None

    def _use(self, before: Choices, now: Choices) -> None:
        """Apply choices and store them."""
        if now.period_px != before.period_px:
            self._recorder.request_period(now.period_px)
        if (now.salinity_psu, now.water_c) != (before.salinity_psu, before.water_c):
            self._parts.scans.use_water(now.salinity_psu, now.water_c)
        if now.transfer is not before.transfer:
            self._parts.transfer.switch(now.transfer)
        self._parts.scans.submit(partial(self._remember, now))

    def _remember(self, choices: Choices) -> None:
        try:
            self._choices.write(choices)
        except StorageError as error:
            log.warning("the settings hold until the next start only: %s", error)

    def _publish(self, number: int) -> None:
        scan = self._parts.scans.scan
        summary = scan.full.summary if scan is not None and scan.full is not None else None
        verdict = None
        if summary is not None:
            # The grade that the diver saw is stored with the scan, whatever limits hold later.
            word = grade(summary.coverage_percent, summary.noise_mm, scan_faults(self.machine))
            numbers = {LENGTHS_DOUBTFUL: float(lengths_doubtful(self.machine))}
            verdict = Verdict(GRADE, word is not Grade.BAD, numbers, word.value)
        self._parts.scans.publish(number, self._parts.scans.preview, verdict)

    def _facts(self) -> Facts:
        calibration = self._parts.scans.calibration
        return Facts(
            serial=self._rig.rig.serial,
            calibrated=Text.FROM_DRAWING if calibration.method == DRAWN else calibration.made_at[:10],
        )

    # --------------------------------------------------------------------------------- what is shown

    def _draw(self) -> None:
        display = self._parts.devices.display
        if display.value is None:
            # Without a display the cycle has no pace: this pause keeps it from using a full processor.
            self._clock.sleep_s(CYCLE_WITHOUT_DISPLAY_S)
            return
        self._live.take()
        telemetry = self._inputs.telemetry
        around = Surroundings(
            left=self._live.images.get("left"),
            right=self._live.images.get("right"),
            temperature_c=telemetry.temperature_case_c if telemetry is not None else None,
            scan=self._parts.scans.scan,
            shown=self._parts.gallery.shown,
            facts=self._facts(),
            marks=self._parts.ranging.marks,
        )
        # Set for each picture, so that a language chosen in the menu shows at once.
        self._painter.language = Language(self.machine.choices.language)
        picture = self._painter.draw(view_of(self.machine, around), self._clock.now_ns() / 1e9)
        self._drawn = self.machine.state
        limit_s = max(PRESENT_TIMEOUT_S, PRESENT_PERIODS / self._rig.display.refresh_hz)
        with display.watched(self._inbox):
            display.value.present(picture, limit_s)


def log_line(event: on.Event) -> tuple[int, str] | None:
    """Return level and text of a log line; ``None``: the event needs none.

    States show it, or it comes all the time.
    """
    match event:
        case on.DeviceUp(device):
            return logging.INFO, f"{device.value} works"
        case on.DeviceDown(device, reason, code):
            named = "" if code is None else f" ({code.value})"
            return logging.WARNING, f"{device.value} lost{named}: {reason}{_ashore(code or LOST_CODES[device])}"
        case on.CaptureFailed(number, fault):
            return logging.WARNING, f"scan {number} of this start failed: {fault_text(fault)}"
        case on.SaveFailed(number, fault):
            return logging.WARNING, f"scan {number} of this start is not saved: {fault_text(fault)}"
        case News(number, ReconstructionFailure(fault)):
            return logging.WARNING, f"scan {number} of this start was not reconstructed: {fault_text(fault)}"
        case News(number, PatternIdentity(judgement)) if judgement.fault is not None:
            return logging.WARNING, f"scan {number} of this start was not reconstructed: {fault_text(judgement.fault)}"
        case News(number, Verdicts(judgements) | FullCloud(_, judgements)) if warnings := faults_in(judgements):
            # The screen only has room for the fault's name; the log has the details.
            return (
                logging.INFO,
                f"scan {number} of this start: {'; '.join(fault_text(warning) for warning in warnings)}",
            )
        case _:
            return None


def fault_text(fault: Fault) -> str:
    """Return code, device, detail and numbers of a fault in one line."""
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in fault.numbers.items())
    device = "" if fault.device is None else f" of {fault.device}"
    detail = "; ".join(filter(None, (fault.detail, numbers)))
    return f"{fault.code.value}{device}" + (f": {detail}" if detail else "") + _ashore(fault.code)


def _ashore(code: FaultCode) -> str:
    return f"; ashore: {ASHORE[code]}" if code in ASHORE else ""
