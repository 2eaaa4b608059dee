"""Owns the heartbeat: one thread that gathers what happened, lets the machine decide, does what it wants, and draws.

The thread is the process's main one and the sole owner of GL. A heartbeat is paced by the display's vertical blank.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.design import METHOD as DRAWN
from appliance.capture.scan import Arming, ScanRecorder, ScanSettings
from appliance.capture.timeouts import Timeouts
from appliance.config import Rig
from appliance.instrument import exposure_of, exposures_of
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.alerts import lengths_doubtful
from appliance.machine.choices import Choices, offers_of
from appliance.machine.keys import meaning
from appliance.machine.states import Machine, Part, Settings, State, TemperatureLimits, boot
from appliance.machine.step import step
from appliance.machine.words import Language, Text
from appliance.patterns.sequence import PERIODS_PX, build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.sides import SIDES
from appliance.scan.verdict import Verdict
from appliance.screens.painter import Painter
from appliance.screens.views import Grade
from appliance.service.aiming import AimingController
from appliance.service.calibrating import CalibrationController
from appliance.service.device_supervisor import DeviceSupervisor
from appliance.service.devices import Devices
from appliance.service.gallery import GRADE, LENGTHS_DOUBTFUL, GalleryController
from appliance.service.menu_view import Facts
from appliance.service.patterns import Patterns
from appliance.service.ranging import RangingController
from appliance.service.scans import ScanController
from appliance.service.spoken import spoken
from appliance.service.view import Surroundings, grade, view_of
from appliance.service.watchdog import Watchdog
from appliance.storage.atomic import StorageError
from appliance.storage.choices import ChoicesFile
from appliance.storage.status import StatusFile
from drivers.api import (
    BoardBooted,
    BoardEvent,
    BoardLost,
    CardGone,
    Clock,
    DeviceError,
    Key,
    KeyEvent,
    KeyFreed,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)

log = logging.getLogger("kingfisher")

PRESENT_TIMEOUT_S, PRESENT_PERIODS = 0.5, 4
"""How long a picture may take to the diver's display: the longer of both."""
BEAT_WITHOUT_DISPLAY_S = 0.05
MAX_BOARD_EVENTS = 200
QUIT_TIMEOUT_S = 30.0


def standard_choices(rig: Rig) -> Choices:
    """What the rig file states of what the diver may choose."""
    water = rig.water
    return Choices(exposure_of(rig), rig.scan.period_px, water.salinity_psu, water.temperature_c, rig.display.language)


def machine_settings(rig: Rig, choices: Choices | None = None) -> Settings:
    """What the rig file says to the machine. ``choices``: what the diver chose before the start, if it is remembered."""
    limits = rig.limits
    choices = choices or standard_choices(rig)
    width_px, height_px = rig.projector.width_px, rig.projector.height_px
    offered = [period_px for period_px in PERIODS_PX if period_px <= min(width_px, height_px)]
    sequences = {period_px: len(build_sequence(period_px, width_px, height_px)) for period_px in offered}
    return Settings(
        choices=choices,
        offers=offers_of(standard_choices(rig), exposures_of(rig), tuple(sequences)),
        frames=sequences,
        refresh_hz=rig.projector.refresh_hz,
        capture_margin_s=Timeouts(rig.projector.refresh_hz).margin_s,
        temperatures={
            "case": TemperatureLimits(limits.case_warm_c, limits.case_hot_c, limits.case_off_c),
            "projector": TemperatureLimits(limits.projector_warm_c, limits.projector_hot_c, limits.projector_off_c),
        },
        supply_low_v=limits.supply_low_v,
    )


class Service:
    """The running instrument. ``run`` returns when it was switched off."""

    def __init__(
        self,
        rig: Rig,
        devices: Devices,
        desk: ScanController,
        calibrating: CalibrationController,
        gallery: GalleryController,
        ranging: RangingController,
        aiming: AimingController,
        patterns: Patterns,
        painter: Painter,
        status: StatusFile,
        clock: Clock,
        choices: ChoicesFile,
        conditions: tuple[Fault, ...],
        news: tuple[Fault, ...],
        stop_reason: Callable[[], str | None],
    ) -> None:
        """``conditions`` hold from the start (uncalibrated …), ``news`` is told once; ``stop_reason`` says why the process
        should end."""
        chosen, lost = choices.read()
        self._rig = rig
        self._devices = devices
        self._desk = desk
        self._calibrating = calibrating
        self._gallery = gallery
        self._ranging = ranging
        self._aiming = aiming
        self._patterns = patterns
        self._choices = choices
        self._painter = painter
        self._status = status
        self._clock = clock
        self._stop_reason = stop_reason
        self.machine: Machine = boot(clock.now_ns(), machine_settings(rig, chosen))
        raised = [fault for fault in (*conditions, desk.watch.fault, lost) if fault is not None]
        self._inbox: list[on.Event] = [on.ConditionRaised(fault) for fault in raised]
        self._inbox += [on.Told(fault) for fault in news]
        uncalibrated = next((fault for fault in conditions if fault.code is FaultCode.UNCALIBRATED), None)
        self._inbox.append(
            on.PartTested(Part.CALIBRATION, uncalibrated is None, "" if uncalibrated is None else Text.NOT_MEASURED)
        )
        self._arm_wanted: do.Arm | None = None
        self._arming: Arming | None = None
        self._period_wanted: int | None = None
        self._live: dict[str, NDArray[np.uint8]] = {}
        self._live_number = dict.fromkeys(SIDES, 0)
        self._telemetry: Telemetry | None = None
        self._picture: NDArray[np.uint8] | None = None
        self._drawn: State | None = None
        """What ``_picture`` shows."""
        self._preview: NDArray[np.uint8] | None = None
        """The scan's cloud as it was reviewed; ``None`` before."""
        self._boot_told = False
        self._stop_told = False
        self._quit: do.Quit | None = None

    def run(self, supervision: Watchdog) -> do.Quit:
        """Beat until the machine wants to quit, then finish what is being written."""

        def beat() -> None:
            self.beat()
            supervision.beaten(self.machine, worker_answers=self._desk.worker.answers)

        self._desk.test_storage()
        while self._quit is None:
            beat()
        supervision.stopping()
        end_ns = self._clock.now_ns() + int(QUIT_TIMEOUT_S * 1e9)
        while (self._desk.busy or self._calibrating.busy) and self._clock.now_ns() < end_ns:
            beat()
        self._tell_status()
        return self._quit

    def beat(self) -> None:
        """One heartbeat. It waits for the display and, while patterns are played, for the projector; for nothing else."""
        for event in self._gather():
            self._handle(event)
        self._handle(on.Tick(self._clock.now_ns()))
        for event in self._make_ready():
            self._handle(event)
        self._tell_status()
        self._draw()

    def _tell_status(self) -> None:
        at = self.machine.gallery
        shown = None if at is None else self._gallery.told(at.scan_id)
        self._status.update(self.machine, self._desk.worker.pid, shown)

    # --------------------------------------------------------------------------------- what happened

    def _gather(self) -> list[on.Event]:
        events, self._inbox = self._inbox, []
        events += self._devices.poll()
        reader = self._devices.keys.value
        if reader is not None:
            for key in reader.take():
                events += self._key(key)
        board = self._devices.board.value
        if board is not None:
            for _ in range(MAX_BOARD_EVENTS):
                report = board.next_event(0.0)
                if report is None:
                    break
                events += self._board_event(report)
        events += self._desk.poll()
        events += self._calibrating.poll()
        events += self._gallery.poll()
        events += self._ranging.poll()
        events += self._aiming.poll()
        events += self._lasers_on()
        if not self._boot_told and self._devices.all_tried:
            self._boot_told = True
            events.append(on.BootFinished())
        reason = self._stop_reason()
        if reason is not None and not self._stop_told:
            self._stop_told = True
            events.append(on.StopRequested(reason))
        return events

    def _key(self, event: KeyEvent) -> list[on.Event]:
        match event:
            case KeyPress():
                return [on.KeyPressed(event.key)]
            case KeyLongPress():
                return [on.KeyHeld(event.key)]
            case KeyStuck():
                return [on.KeyJammed(event.key)]
            case KeyFreed():
                return [on.KeyFreed(event.key)]
            case KeyRelease():
                return []
            case KeysLost():
                return _one(self._devices.keys.lose(event.reason))
            case _:
                assert_never(event)

    def _board_event(self, event: BoardEvent) -> list[on.Event]:
        match event:
            case Telemetry():
                self._telemetry = event
                return [on.TelemetryArrived(event), *self._ranging.heard(event.lasers)]
            case BoardBooted():
                return [on.BoardReset(event.cause)]
            case BoardLost():
                return _one(self._devices.board.lose(event.reason))
            case VsyncLost():
                log.warning("the board sees no vertical sync from the projector's video")
                return []
            case Pulse() | PulsesDone():
                return []  # of a sequence that was given up
            case _:
                assert_never(event)

    def _handle(self, event: on.Event) -> None:
        before = self.machine
        self.machine, wanted = step(before, event)
        if self.machine.state is not before.state:
            log.info("%s → %s (%s)", before.state.value, self.machine.state.value, type(event).__name__)
            if self.machine.state is State.CALIBRATE:
                self._calibrating.warm()
            elif before.state is State.CALIBRATE and self.machine.calibrating is None:
                self._calibrating.cancel()  # its process takes memory
            if before.state is State.REVIEW and self._drawn is State.REVIEW:
                self._preview = self._painter.preview()
        said = spoken(event)
        if said is not None:
            log.log(*said)
        for effect in wanted:
            self._execute(effect)

    # --------------------------------------------------------------------------------- what is wanted

    def _execute(self, effect: do.Effect) -> None:
        match effect:
            case do.GoLive():
                self._go_live(effect)
            case do.StopLive():
                self._dark()
            case do.LightsOff():
                self._dark()
            case do.Arm():
                self._arm_wanted = effect
            case do.Capture():
                self._capture(effect)
            case do.AbortCapture():
                self._let_go()
            case do.StoreRaw():
                self._desk.store_raw(effect.number)
            case do.StartReconstruction():
                self._desk.worker.finish()
            case do.CancelReconstruction():
                self._desk.worker.drop()
            case do.Publish():
                self._publish(effect.number)
            case do.Reject():
                self._desk.reject(effect.number, effect.reason)
            case do.CheckRecording():
                self._calibrating.examine(effect.number, effect.step)
            case do.AcceptRecording():
                self._calibrating.accept(effect.number, effect.check)
            case do.SolveCalibration():
                self._calibrating.solve()
            case do.UseSolved():
                self._calibrating.use_solved()
            case do.RestoreKeptCalibration():
                self._calibrating.restore()
            case do.BeginSession():
                self._calibrating.begin()
            case do.CancelCalibration():
                self._calibrating.cancel()
            case do.RememberChoices():
                self._desk.submit(partial(self._remember, effect.choices))
            case do.UsePeriod():
                self._period_wanted = effect.period_px
            case do.UseWater():
                self._desk.use_water(effect.salinity_psu, effect.temperature_c)
            case do.ListGallery():
                self._gallery.list_scans()
            case do.ShowGalleryScan():
                self._gallery.show(effect.scan_id)
            case do.ReopenDevice():
                for side, keeper in self._devices.cameras.items():
                    if effect.device is None or effect.device.value == f"camera.{side}":
                        self._inbox += _one(keeper.lose("opened again: its images do not follow the patterns"))
            case do.Quit():
                self._dark()
                self._quit = effect
            case _:
                assert_never(effect)

    def _go_live(self, wanted: do.GoLive) -> None:
        shown = len(self._desk.sequence) + (1 if wanted.light else 0)  # behind the patterns: dark, live light
        self._devices.expose(wanted.exposure)
        for keeper in self._devices.cameras.values():
            if keeper.value is not None:
                keeper.value.live()
        projector = self._devices.projector
        if projector.value is not None:
            with self._watching(projector):
                projector.value.show(shown)
        with self._watching(self._devices.board):
            board = self._devices.board.value
            if board is not None:
                board.stop()
                board.set_lasers(False, False)
                board.live(self._rig.board.live_every_vsyncs, self._rig.board.trigger_delay_us, wanted.exposure.time_us)

        calibration, index = self._desk.calibration, self._desk.water.index
        self._ranging.live(wanted.lasers, calibration, index)
        self._inbox += self._aiming.live(wanted.light and self.machine.state is State.AIM, calibration, index)

    def _lasers_on(self) -> list[on.Event]:
        """Switch the lasers on as soon as the live images were seen without them."""
        board = self._devices.board.value
        if board is None or not self._ranging.wants_lasers:
            return []
        events: list[on.Event] = []
        with self._watching(self._devices.board):
            events += self._ranging.switched_on(board.set_lasers(True, True))
        return events

    def _dark(self) -> None:
        self._ranging.stop()
        self._inbox += self._aiming.stop()
        with self._watching(self._devices.projector):
            if self._devices.projector.value is not None:
                self._devices.projector.value.show(len(self._desk.sequence))
        with self._watching(self._devices.board):
            if self._devices.board.value is not None:
                self._devices.board.value.set_lasers(False, False)
                self._devices.board.value.stop()

    def _make_ready(self) -> list[on.Event]:
        """Go on with what a scan needs before its first pattern, without waiting."""
        self._change_period()
        wanted = self._arm_wanted
        if wanted is None or (self._arming is None and not self._begin_arming(wanted)):
            return []
        arming = self._arming
        if arming is None or not arming.poll():
            return []
        self._arm_wanted = None
        for event in arming.events:
            self._inbox += self._board_event(event)
        arming.events.clear()
        if arming.fault is None:
            return [on.Armed(wanted.number)]
        self._let_go()
        return [on.CaptureFailed(wanted.number, arming.fault)]

    def _begin_arming(self, wanted: do.Arm) -> bool:
        if self._period_wanted is not None or not self._desk.settled:
            return False  # the machine gives up when this takes too long
        self._preview = None
        self._devices.expose(wanted.exposure)
        begin = self._desk.begin_second if wanted.second else self._desk.begin
        fault = begin(wanted.number, wanted.exposure)
        recorder = self._recorder(wanted.exposure)
        if fault is None and recorder is None:
            fault = Fault(FaultCode.INTERNAL, "a capture was wanted without all devices")
        if fault is not None or recorder is None:
            self._let_go()
            self._inbox.append(on.CaptureFailed(wanted.number, fault or Fault(FaultCode.INTERNAL, "no device")))
            return False
        self._arming = recorder.arm(
            self._desk.sequence, self._desk.store, self._desk.worker.frame, second=wanted.second
        )
        return True

    def _let_go(self) -> None:
        """No scan follows from what was made ready. What is recorded is recorded within one heartbeat: nothing runs."""
        arming, self._arming, self._arm_wanted = self._arming, None, None
        if arming is not None:
            arming.let_go()
        self._desk.drop()

    def _capture(self, wanted: do.Capture) -> None:
        arming, self._arming = self._arming, None
        scan = self._desk.scan
        recorder = self._recorder((scan.second or scan).exposure) if scan is not None else None
        if arming is None or recorder is None:
            self._let_go()
            self._inbox.append(on.CaptureFailed(wanted.number, Fault(FaultCode.INTERNAL, "nothing was armed")))
            return
        self._draw()
        report = recorder.play(self._desk.sequence, arming, self._abort)
        for event in report.board_events:
            self._inbox += self._board_event(event)
        fault = report.fault or self._lasers_seen()
        if fault is not None:
            self._desk.drop()
            self._inbox.append(on.CaptureFailed(wanted.number, fault))
            return
        self._desk.recorded(report, self._temperatures_c())
        self._inbox.append(on.CaptureFinished(wanted.number))

    def _recorder(self, exposure: Exposure) -> ScanRecorder | None:
        """With the devices as they are; ``None`` without all of them."""
        grabbers = {side: keeper.value for side, keeper in self._devices.cameras.items()}
        ready = {side: grabber for side, grabber in grabbers.items() if grabber is not None}
        board, projector = self._devices.board.value, self._devices.projector.value
        if board is None or projector is None or len(ready) < len(SIDES):
            return None
        settings = ScanSettings(
            refresh_hz=self._rig.projector.refresh_hz,
            exposure_us=exposure.time_us,
            trigger_delay_us=self._rig.board.trigger_delay_us,
        )
        return ScanRecorder(ready, board, projector, self._clock, settings)

    def _lasers_seen(self) -> Fault | None:
        """The images' own proof that the lasers were off, besides the board's."""
        sequence, store = self._desk.sequence, self._desk.store
        bright, dark = ({side: store.frames(side)[k] for side in SIDES} for k in (sequence.bright, sequence.dark))
        return self._ranging.shining(bright, dark)

    def _abort(self) -> Fault | None:
        """Asked at every vertical blank of a sequence: whether the diver or the system wants its end."""
        reason = self._stop_reason()
        if reason is not None:
            return Fault(FaultCode.CAPTURE_TIMEOUT, f"stopped: {reason}")
        reader = self._devices.keys.value
        pressed = [event for key in reader.take() for event in self._key(key)] if reader is not None else []
        self._inbox += pressed
        if any(isinstance(e, on.KeyPressed) and meaning(self.machine, e.key) is Key.BACK for e in pressed):
            return Fault(FaultCode.CAPTURE_TIMEOUT, "stopped by the diver")
        return None

    def _change_period(self) -> None:
        """Patterns, frame memory and worker of another period, once nothing of the last scan is on its way any more."""
        if self._period_wanted is None or self._desk.busy or self._arming is not None:
            return
        period_px, self._period_wanted = self._period_wanted, None
        if period_px == self._desk.sequence.period_px:
            return
        self._desk.use_sequence(self._patterns.use(period_px))
        with self._watching(self._devices.projector):
            if self._devices.projector.value is not None:
                self._patterns.load(self._devices.projector.value)

    def _remember(self, choices: Choices) -> None:
        try:
            self._choices.write(choices)
        except StorageError as error:
            log.warning("the choices hold until the next start only: %s", error)

    def _publish(self, number: int) -> None:
        scan = self._desk.scan
        summary = scan.full.summary if scan is not None and scan.full is not None else None
        warnings = self.machine.scan.warnings if self.machine.scan is not None else ()
        word = (
            grade(None, None, warnings)
            if summary is None
            else grade(summary.coverage_percent, summary.noise_mm, warnings)
        )
        numbers = {LENGTHS_DOUBTFUL: float(lengths_doubtful(self.machine))}
        verdict = None if summary is None else Verdict(GRADE, word is not Grade.BAD, numbers, word.value)
        self._desk.publish(number, self._preview, verdict)

    def _temperatures_c(self) -> dict[str, float | None]:
        t = self._telemetry
        values: dict[str, float | None] = {
            "projector": t.temperature_projector_c if t else None,
            "case": t.temperature_case_c if t else None,
            "board": t.temperature_board_c if t else None,
        }
        for side, keeper in self._devices.cameras.items():
            values[f"camera_{side}"] = keeper.value.temperature_c if keeper.value is not None else None
        return values

    def _facts(self) -> Facts:
        calibration = self._desk.calibration
        return Facts(
            serial=self._rig.rig.serial,
            calibrated=Text.FROM_DRAWING if calibration.method == DRAWN else calibration.made_at[:10],
        )

    @contextmanager
    def _watching(self, keeper: DeviceSupervisor[Any]) -> Iterator[None]:
        """A device that fails inside is lost, and that is an event like any other. Raises CardGone: GL is lost with it, and
        comes back in another process only."""
        try:
            yield
        except CardGone:
            raise
        except DeviceError as error:
            self._inbox += _one(keeper.lose(error.message))

    # --------------------------------------------------------------------------------- what is shown

    def _draw(self) -> None:
        display = self._devices.display
        if display.value is None:
            self._clock.sleep_s(BEAT_WITHOUT_DISPLAY_S)
            return
        for side, keeper in self._devices.cameras.items():
            latest = keeper.value.latest(self._live_number[side]) if keeper.value is not None else None
            if latest is not None:
                self._live_number[side], self._live[side] = latest
                self._ranging.see(side, latest[1])
                self._aiming.see(side, *latest)
            elif keeper.value is None:
                self._live.pop(side, None)
                self._live_number[side] = 0
        around = Surroundings(
            left=self._live.get("left"),
            right=self._live.get("right"),
            temperature_c=self._telemetry.temperature_case_c if self._telemetry is not None else None,
            scan=self._desk.scan,
            shown=self._gallery.shown,
            facts=self._facts(),
            marks=self._ranging.marks,
        )
        self._painter.language = Language(self.machine.choices.language)
        self._picture = self._painter.draw(view_of(self.machine, around), self._clock.now_ns() / 1e9)
        self._drawn = self.machine.state
        limit_s = max(PRESENT_TIMEOUT_S, PRESENT_PERIODS / self._rig.display.refresh_hz)
        with self._watching(display):
            display.value.present(self._picture, limit_s)


def _one(event: on.DeviceDown | None) -> list[on.Event]:
    return [] if event is None else [event]
