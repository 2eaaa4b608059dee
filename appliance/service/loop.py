"""Owns the heartbeat: one thread that gathers what happened, lets the machine decide, does what it wants, and draws.

The thread is the process's main one and the sole owner of GL. A heartbeat is paced by the display's vertical blank.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from appliance.capture.exposure import Exposure
from appliance.capture.fault import Fault, FaultCode
from appliance.capture.grabber import Grabber
from appliance.capture.scan import CaptureReport, ScanRecorder, ScanSettings
from appliance.config import Rig
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.states import Machine, Settings, State, boot
from appliance.machine.step import step
from appliance.screens.painter import Painter
from appliance.service.calibrating import CalibrationDesk
from appliance.service.devices import SIDES, Devices
from appliance.service.instrument import exposure_of
from appliance.service.keeper import Keeper
from appliance.service.scans import ScanDesk
from appliance.service.view import Surroundings, view_of
from appliance.storage.status import StatusFile
from drivers.api import (
    Board,
    BoardBooted,
    BoardEvent,
    BoardLost,
    Clock,
    DeviceError,
    KeyEvent,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    Projector,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)

log = logging.getLogger("kingfisher")

PRESENT_TIMEOUT_S = 0.5
BEAT_WITHOUT_DISPLAY_S = 0.05
MAX_BOARD_EVENTS = 200
QUIT_TIMEOUT_S = 30.0


def machine_settings(rig: Rig) -> Settings:
    """What the rig file says to the machine."""
    limits = rig.limits
    return Settings(
        period_px=rig.scan.period_px,
        exposure=exposure_of(rig),
        case_warm_c=limits.case_warm_c,
        case_hot_c=limits.case_hot_c,
        projector_warm_c=limits.projector_warm_c,
        projector_hot_c=limits.projector_hot_c,
        supply_low_v=limits.supply_low_v,
    )


class Service:
    """The running instrument. ``run`` returns when it was switched off."""

    def __init__(
        self,
        rig: Rig,
        devices: Devices,
        desk: ScanDesk,
        calibrating: CalibrationDesk,
        painter: Painter,
        status: StatusFile,
        clock: Clock,
        conditions: tuple[Fault, ...],
        stop_reason: Callable[[], str | None],
    ) -> None:
        """``conditions`` hold from the start (uncalibrated …); ``stop_reason`` says why the process should end."""
        self._rig = rig
        self._devices = devices
        self._desk = desk
        self._calibrating = calibrating
        self._painter = painter
        self._status = status
        self._clock = clock
        self._stop_reason = stop_reason
        self.machine: Machine = boot(clock.now_ns(), machine_settings(rig))
        remembered = (desk.watch.fault,) if desk.watch.fault is not None else ()
        self._inbox: list[on.Event] = [on.ConditionRaised(fault) for fault in (*conditions, *remembered)]
        self._live: dict[str, NDArray[np.uint8]] = {}
        self._live_number = dict.fromkeys(SIDES, 0)
        self._telemetry: Telemetry | None = None
        self._picture: NDArray[np.uint8] | None = None
        self._boot_told = False
        self._stop_told = False
        self._quit: do.Quit | None = None

    def run(self) -> do.Quit:
        """Beat until the machine wants to quit, then finish what is being written."""
        self._desk.count()
        while self._quit is None:
            self.beat()
        end_ns = self._clock.now_ns() + int(QUIT_TIMEOUT_S * 1e9)
        while (self._desk.busy or self._calibrating.busy) and self._clock.now_ns() < end_ns:
            self.beat()
        self._status.update(self.machine, self._desk.worker.pid)
        return self._quit

    def beat(self) -> None:
        """One heartbeat."""
        for event in self._gather():
            self._handle(event)
        self._handle(on.Tick(self._clock.now_ns()))
        self._status.update(self.machine, self._desk.worker.pid)
        self._draw()

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
        if not self._boot_told and self._devices.all_tried and self._desk.worker_settled:
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
                return [on.TelemetryArrived(event)]
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
            elif before.state is State.CALIBRATE and self.machine.state is State.AIM:
                self._calibrating.cancel()  # its process takes memory
        if isinstance(event, on.DeviceUp):
            log.info("%s works", event.device.value)
        elif isinstance(event, on.DeviceDown | on.CaptureFailed | on.SaveFailed | on.ReconstructionFailed):
            log.warning("%s", event)
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
            case do.Capture():
                self._capture(effect)
            case do.AbortCapture():
                self._desk.drop()  # recording happens within one heartbeat; nothing runs any more
            case do.StoreRaw():
                self._desk.store_raw(effect.number)
            case do.StartReconstruction():
                self._desk.worker.finish()
            case do.CancelReconstruction():
                self._desk.worker.drop()
            case do.Publish():
                self._desk.publish(effect.number, None if self._picture is None else self._picture.copy())
            case do.Reject():
                self._desk.reject(effect.number, effect.reason)
            case do.ExamineTrial():
                self._calibrating.examine(effect.number, effect.step)
            case do.AcceptTrial():
                self._calibrating.accept(effect.number, effect.trial)
            case do.SolveCalibration():
                self._calibrating.solve()
            case do.UseSolved():
                self._calibrating.use_solved()
            case do.RestoreCalibration():
                self._calibrating.restore()
            case do.BeginSession():
                self._calibrating.begin()
            case do.CancelCalibration():
                self._calibrating.cancel()
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
        bright = self._desk.sequence.bright if wanted.light else len(self._desk.sequence)
        self._devices.expose(wanted.exposure)
        for keeper in self._devices.cameras.values():
            if keeper.value is not None:
                keeper.value.live()
        projector = self._devices.projector
        if projector.value is not None:
            with self._watching(projector):
                projector.value.show(bright)
        with self._watching(self._devices.board):
            board = self._devices.board.value
            if board is not None:
                board.stop()
                board.set_lasers(wanted.lasers, wanted.lasers)
                board.live(self._rig.board.live_every_vsyncs, self._rig.board.trigger_delay_us, wanted.exposure.time_us)

    def _dark(self) -> None:
        with self._watching(self._devices.projector):
            if self._devices.projector.value is not None:
                self._devices.projector.value.show(len(self._desk.sequence))
        with self._watching(self._devices.board):
            if self._devices.board.value is not None:
                self._devices.board.value.set_lasers(False, False)
                self._devices.board.value.stop()

    def _capture(self, wanted: do.Capture) -> None:
        number = wanted.number
        self._devices.expose(wanted.exposure)
        fault = self._desk.begin(number, wanted.exposure)
        grabbers = {side: keeper.value for side, keeper in self._devices.cameras.items()}
        board, projector = self._devices.board.value, self._devices.projector.value
        ready = {side: grabber for side, grabber in grabbers.items() if grabber is not None}
        if fault is None and (board is None or projector is None or len(ready) < len(SIDES)):
            fault = Fault(FaultCode.INTERNAL, "a capture was wanted without all devices")
        if fault is not None or board is None or projector is None:
            self._desk.drop()
            self._inbox.append(on.CaptureFailed(number, fault or Fault(FaultCode.INTERNAL, "no device")))
            return
        self._draw()
        report = self._record(ready, board, projector, wanted.exposure)
        for event in report.board_events:
            self._inbox += self._board_event(event)
        if report.fault is not None:
            self._desk.drop()
            self._inbox.append(on.CaptureFailed(number, report.fault))
            return
        self._desk.recorded(report, self._temperatures_c())
        self._inbox.append(on.CaptureFinished(number))

    def _record(
        self, grabbers: dict[str, Grabber], board: Board, projector: Projector, exposure: Exposure
    ) -> CaptureReport:
        settings = ScanSettings(
            refresh_hz=self._rig.projector.refresh_hz,
            exposure_us=exposure.time_us,
            trigger_delay_us=self._rig.board.trigger_delay_us,
        )
        recorder = ScanRecorder(grabbers, board, projector, self._clock, settings)
        return recorder.record(self._desk.sequence, self._desk.store, self._desk.worker.frame, self._abort)

    def _abort(self) -> Fault | None:
        reason = self._stop_reason()
        return None if reason is None else Fault(FaultCode.CAPTURE_TIMEOUT, f"stopped: {reason}")

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

    @contextmanager
    def _watching(self, keeper: Keeper[Any]) -> Iterator[None]:
        """A device that fails inside is lost, and that is an event like any other."""
        try:
            yield
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
            elif keeper.value is None:
                self._live.pop(side, None)
                self._live_number[side] = 0
        around = Surroundings(
            left=self._live.get("left"),
            right=self._live.get("right"),
            temperature_c=self._telemetry.temperature_case_c if self._telemetry is not None else None,
            scan=self._desk.scan,
            frames=len(self._desk.sequence),
            frames_done=0,
        )
        self._picture = self._painter.draw(view_of(self.machine, around), self._clock.now_ns() / 1e9)
        try:
            display.value.present(self._picture, PRESENT_TIMEOUT_S)
        except DeviceError as error:
            self._inbox += _one(display.lose(error.message))


def _one(event: on.DeviceDown | None) -> list[on.Event]:
    return [] if event is None else [event]
