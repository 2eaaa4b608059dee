"""Owns every decision of the instrument: ``step(machine, event) -> (machine, effects)``, pure and total.

It does no I/O, never raises and never waits. Light is granted in one place (``_settle``), from the state and the
conditions after the event, so that no path to a new state can forget to switch it off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from appliance.capture.exposure import Exposure
from appliance.capture.fault import Fault, FaultCode
from appliance.machine import calibrate
from appliance.machine import effects as do
from appliance.machine import events as on
from appliance.machine.alerts import RULES
from appliance.machine.conditions import cleared, device_down, device_up, judge, raised
from appliance.machine.moves import Result, enter, home
from appliance.machine.permissions import interruption, may_lase, may_light, may_shine, other_exposure, refusal
from appliance.machine.states import (
    Device,
    Machine,
    Notice,
    NoticeKind,
    ScanInHand,
    State,
)
from drivers.api import Key

ENDED_BY_BACK = (State.CAPTURE, State.RECONSTRUCT, State.REVIEW, State.CALIBRATE)
SILENT_RETRIES = 1
"""Repetitions of a capture the diver does not hear of, for a late flip only."""


def step(machine: Machine, event: on.Event) -> Result:
    """The machine after ``event`` and what is to be done, in order. Total over states and events."""
    if machine.state is State.SHUTDOWN:
        return machine, ()
    after, wanted = _react(machine, event)
    if after.state is State.CAPTURE and machine.state is State.CAPTURE:
        reason = interruption(after)
        if reason is not None:
            after, wanted = _abandon_capture(after, Notice(reason, NoticeKind.FAILURE))
    if after.notice is not None and after.notice.kind is NoticeKind.REFUSAL and refusal(after) is None:
        after = replace(after, notice=None)  # the reason is gone; so is its message
    return _settle(machine, after, wanted)


def _react(machine: Machine, event: on.Event) -> Result:
    match event:
        case on.Tick(now_ns):
            return _tick(machine, now_ns)
        case on.KeyPressed(key):
            return _pressed(replace(machine, stuck=machine.stuck - {key}), meaning(machine, key))
        case on.KeyHeld(key):
            return _held(machine, meaning(machine, key))
        case on.KeyJammed(key):
            notice = Notice(Fault(FaultCode.KEY_STUCK, f"{key.value} key", device=f"key.{key.value}"), NoticeKind.NEWS)
            return replace(machine, stuck=machine.stuck | {key}, notice=notice), ()
        case on.DeviceUp(device):
            return device_up(machine, device), ()
        case on.DeviceDown(device, reason, code):
            return device_down(machine, device, reason, code), ()
        case on.BoardReset(cause):
            return _board_reset(machine, cause)
        case on.TelemetryArrived(telemetry):
            return judge(machine, telemetry), ()
        case on.ConditionRaised(fault):
            return raised(machine, fault), ()
        case on.ConditionCleared(code, name):
            return cleared(machine, code, name), ()
        case on.StorageCounted(scans, last_scan, scans_left):
            return _counted(machine, scans, last_scan, scans_left), ()
        case on.BootFinished():
            return (enter(machine, State.AIM), ()) if machine.state is State.BOOT else (machine, ())
        case on.CaptureFinished(number):
            return _capture_finished(machine, number)
        case on.CaptureFailed(number, fault):
            return _capture_failed(machine, number, fault)
        case on.RawStored(number):
            return calibrate.stored(_raw_stored(machine, number), number)
        case on.CoarseReady() | on.FullReady() | on.ReconstructionFailed():
            return _reconstruction(machine, event)
        case on.Judged(number, warnings, proposal):
            return _judged(machine, number, warnings, proposal), ()
        case on.Saved(number, scan_id):
            return _saved(machine, number, scan_id)
        case on.SaveFailed(number, fault):
            return _save_failed(machine, number, fault)
        case on.Rejected():
            return cleared(machine, FaultCode.NOT_SAVED), ()
        case on.TrialExamined(number, trial):
            return calibrate.examined(machine, number, trial)
        case on.SessionChanged(session):
            return calibrate.session_changed(machine, session)
        case on.CalibrationProgressed(progress):
            return calibrate.progressed(machine, progress), ()
        case on.CalibrationFailed(reason):
            return calibrate.failed(machine, reason)
        case on.Ranged(measured):
            return replace(machine, range=measured), ()
        case on.StopRequested():
            return _stop(machine)
        case _:
            assert_never(event)


# ---------------------------------------------------------------------------------- states and light


def _live(machine: Machine) -> tuple[do.GoLive, object] | None:
    """The live views wanted now, with what makes it necessary to ask again."""
    if machine.state is not State.AIM and not (machine.state is State.CALIBRATE and calibrate.records(machine)):
        return None
    cameras_and_lights = machine.up & {Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR}
    return do.GoLive(may_shine(machine), may_lase(machine), machine.exposure), (
        cameras_and_lights,
        machine.board_resets,
    )


def _settle(before: Machine, after: Machine, wanted: tuple[do.Effect, ...]) -> Result:
    """Add the effects on light and live views that follow from where the machine was and is."""
    first: list[do.Effect] = []
    last: list[do.Effect] = []
    if may_light(before) and not may_light(after):
        first.append(do.LightsOff())
    live_before, live_after = _live(before), _live(after)
    if live_after is None and live_before is not None:
        first.append(do.StopLive())
    elif live_after is not None and live_after != live_before:
        last.append(live_after[0])
    lasers = live_after is not None and live_after[0].lasers
    if lasers:
        after = replace(after, lasers_off_since_ns=None)
    else:
        since_ns = after.now_ns if after.lasers_off_since_ns is None else after.lasers_off_since_ns
        after = replace(after, lasers_off_since_ns=since_ns, range=None)  # what was measured ends with the light
    return after, (*first, *wanted, *last)


# -------------------------------------------------------------------------------------------- time


def _tick(machine: Machine, now_ns: int) -> Result:
    # A clock never runs backwards; a late message must not push a deadline away.
    machine = replace(machine, now_ns=max(now_ns, machine.now_ns))
    if machine.deadline_ns is None or machine.now_ns < machine.deadline_ns:
        return machine, ()
    match machine.state:
        case State.BOOT:
            return enter(machine, State.AIM), ()
        case State.CAPTURE:
            late = Fault(FaultCode.CAPTURE_TIMEOUT, f"no end after {machine.settings.capture_s:g} s")
            return _abandon_capture(machine, Notice(late, NoticeKind.FAILURE))
        case State.RECONSTRUCT:
            return _no_cloud(machine, _worker_late(machine))
        case State.SAVING:
            return _saving_late(machine)
        case State.CALIBRATE:
            return calibrate.late(machine)
        case State.AIM | State.REVIEW | State.SHUTDOWN:
            return replace(machine, deadline_ns=None), ()
        case _:
            assert_never(machine.state)


def _worker_late(machine: Machine) -> Fault:
    return Fault(FaultCode.RECONSTRUCTION_FAILED, f"no cloud after {machine.settings.reconstruct_s:g} s")


def _saving_late(machine: Machine) -> Result:
    scan = machine.scan
    if scan is not None and not scan.publishing:  # the diver kept it before the cloud was there
        machine, cancel = _no_cloud(machine, _worker_late(machine))
        return machine, cancel
    late = Fault(FaultCode.NOT_SAVED, f"the disk did not answer for {machine.settings.saving_s:g} s")
    return _unsaved(machine, late)


# -------------------------------------------------------------------------------------------- keys


def meaning(machine: Machine, key: Key) -> Key:
    """The key a press stands for: while SCAN is stuck UP takes over, while BACK is stuck DOWN does."""
    if key is Key.UP and Key.SCAN in machine.stuck:
        return Key.SCAN
    if key is Key.DOWN and Key.BACK in machine.stuck:
        return Key.BACK
    return key


def _pressed(machine: Machine, key: Key) -> Result:
    machine = replace(machine, notice=None, just_saved=None)
    if key is Key.BACK:
        machine = replace(machine, back_used=machine.state in ENDED_BY_BACK)
    match machine.state:
        case State.AIM:
            return _scan(machine) if key is Key.SCAN else (machine, ())
        case State.CAPTURE:
            return _abandon_capture(machine, None) if key is Key.BACK else (machine, ())
        case State.RECONSTRUCT:
            return _drop(machine, "repeated before the cloud was ready") if key is Key.BACK else (machine, ())
        case State.REVIEW:
            return _review_key(machine, key)
        case State.CALIBRATE:
            return _calibrate_key(machine, key)
        case State.BOOT | State.SAVING | State.SHUTDOWN:
            return machine, ()
        case _:
            assert_never(machine.state)


def _calibrate_key(machine: Machine, key: Key) -> Result:
    at = machine.calibrating
    if key is not Key.SCAN or at is None or at.task is not None or not calibrate.records(machine):
        return calibrate.pressed(machine, key)
    return _scan(replace(machine, calibrating=replace(at, latest=None, failed=None)))


def _held(machine: Machine, key: Key) -> Result:
    """Power off: BACK held in AIM (or while booting), unless that press already ended something.

    UP held in AIM leads to the calibration, DOWN held at its result to a new one.
    """
    if key is Key.UP and machine.state is State.AIM:
        return calibrate.begin(machine)
    if key is Key.DOWN and calibrate.may_begin_session(machine):
        return calibrate.begin_session(machine)
    if key is Key.BACK and machine.state in (State.AIM, State.BOOT) and not machine.back_used:
        return enter(machine, State.SHUTDOWN), (do.Quit(power_off=True),)
    return machine, ()


def _scan(machine: Machine) -> Result:
    reason = refusal(machine)
    if reason is not None:
        return replace(machine, notice=Notice(reason, NoticeKind.REFUSAL)), ()
    return _start_capture(replace(machine, retries=0))


def _review_key(machine: Machine, key: Key) -> Result:
    scan = machine.scan
    if scan is None:  # REVIEW without a scan cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    match key:
        case Key.SCAN:
            return _keep(machine, scan)
        case Key.BACK:
            return _drop(machine, "repeated by the diver")
        case Key.DOWN if (wanted := other_exposure(machine)) is not None:
            return replace(machine, exposure=wanted), ()
        case Key.UP | Key.DOWN:
            turn = scan.turn + (1 if key is Key.UP else -1)
            return replace(machine, scan=replace(scan, turn=turn)), ()
        case _:
            assert_never(key)


# ----------------------------------------------------------------------------------------- capture


def _start_capture(machine: Machine) -> Result:
    machine = replace(machine, captures=machine.captures + 1)
    machine = enter(machine, State.CAPTURE, machine.settings.capture_s)
    return machine, (do.Capture(machine.captures, machine.settings.period_px, machine.exposure),)


def _abandon_capture(machine: Machine, notice: Notice | None) -> Result:
    number = machine.captures
    return replace(home(machine), notice=notice), (do.AbortCapture(number),)


def _capture_finished(machine: Machine, number: int) -> Result:
    if machine.state is not State.CAPTURE or number != machine.captures:
        return machine, ()
    if machine.calibrating is not None:
        return calibrate.captured(machine, number)
    machine = enter(machine, State.RECONSTRUCT, machine.settings.reconstruct_s)
    machine = replace(machine, scan=ScanInHand(number, machine.exposure))
    return machine, (do.StoreRaw(number), do.StartReconstruction(number))


def _capture_failed(machine: Machine, number: int, fault: Fault) -> Result:
    if machine.state is not State.CAPTURE or number != machine.captures:
        return machine, ()
    if fault.code is FaultCode.LATE_FLIP and machine.retries < SILENT_RETRIES:
        return _start_capture(replace(machine, retries=machine.retries + 1))
    machine = replace(home(machine), notice=Notice(fault, NoticeKind.FAILURE))
    match fault.code:
        case FaultCode.LASER_ON:
            return raised(machine, Fault(fault.code, fault.detail)), ()
        case FaultCode.CAMERA_STUCK:
            stuck = next((device for device in Device if device.value == fault.device), None)
            return machine, (do.ReopenDevice(stuck),)
        case _:
            return machine, ()


# ------------------------------------------------------------------------------- cloud and decision


def _reconstruction(machine: Machine, event: on.CoarseReady | on.FullReady | on.ReconstructionFailed) -> Result:
    scan = machine.scan
    if scan is None or scan.number != event.number:
        return machine, ()
    match event:
        case on.CoarseReady():
            return _show(replace(machine, scan=replace(scan, coarse=event.summary)))
        case on.FullReady():
            return _show(replace(machine, scan=replace(scan, full=event.summary, failed=None)))
        case on.ReconstructionFailed():
            if RULES[event.fault.code].spoils_scan:
                dropped, effects = _drop(machine, event.fault.detail or event.fault.code.value)
                return replace(dropped, notice=Notice(event.fault, NoticeKind.FAILURE)), effects
            return _no_cloud(machine, event.fault, cancel=False)
        case _:
            assert_never(event)


def _judged(machine: Machine, number: int, warnings: tuple[Fault, ...], proposal: Exposure | None) -> Machine:
    if machine.scan is None or machine.scan.number != number:
        return machine
    return replace(machine, scan=replace(machine.scan, warnings=warnings, proposal=proposal))


def _show(machine: Machine) -> Result:
    """With news from the worker: to the review, or on with a save that waited for it."""
    scan = machine.scan
    if machine.state is State.RECONSTRUCT:
        return enter(machine, State.REVIEW), ()
    if machine.state is State.SAVING and scan is not None and scan.settled and not scan.publishing:
        return _publish(machine, scan)
    return machine, ()


def _no_cloud(machine: Machine, fault: Fault, *, cancel: bool = True) -> Result:
    """The worker failed: the raw frames can be kept without a cloud."""
    scan = machine.scan
    if scan is None:
        return enter(machine, State.AIM), ()
    machine, effects = _show(replace(machine, scan=replace(scan, failed=fault)))
    return machine, (do.CancelReconstruction(scan.number), *effects) if cancel else effects


def _keep(machine: Machine, scan: ScanInHand) -> Result:
    if scan.settled:
        return _publish(machine, scan)
    return enter(machine, State.SAVING, machine.settings.reconstruct_s), ()


def _publish(machine: Machine, scan: ScanInHand) -> Result:
    machine = enter(machine, State.SAVING, machine.settings.saving_s)
    return replace(machine, scan=replace(scan, publishing=True)), (do.Publish(scan.number),)


def _drop(machine: Machine, reason: str) -> Result:
    scan = machine.scan
    machine = enter(machine, State.AIM)
    if scan is None:
        return machine, ()
    cancel = () if scan.settled else (do.CancelReconstruction(scan.number),)
    return machine, (*cancel, do.Reject(scan.number, reason))


# ------------------------------------------------------------------------------------------ saving


def _raw_stored(machine: Machine, number: int) -> Machine:
    machine = cleared(machine, FaultCode.NOT_SAVED)
    if machine.scan is None or machine.scan.number != number:
        return machine
    return replace(machine, scan=replace(machine.scan, raw_durable=True))


def _saved(machine: Machine, number: int, scan_id: str) -> Result:
    machine = replace(cleared(machine, FaultCode.NOT_SAVED), last_scan=scan_id)
    if machine.scan is None or machine.scan.number != number:
        return machine, ()
    if machine.stopping:
        return enter(machine, State.SHUTDOWN), (do.Quit(power_off=False),)
    return replace(enter(machine, State.AIM), just_saved=scan_id, notice=None), ()


def _save_failed(machine: Machine, number: int, fault: Fault) -> Result:
    if machine.state is State.SAVING and machine.scan is not None and machine.scan.number == number:
        return _unsaved(machine, fault)
    return calibrate.not_saved(raised(machine, Fault(FaultCode.NOT_SAVED, fault.detail)), number, fault.detail)


def _unsaved(machine: Machine, fault: Fault) -> Result:
    """Back to the decision: OK tries again, BACK repeats the scan."""
    machine = raised(machine, Fault(FaultCode.NOT_SAVED, fault.detail))
    if machine.stopping:
        return enter(machine, State.SHUTDOWN), (do.Quit(power_off=False),)
    scan = machine.scan
    machine = enter(machine, State.REVIEW)
    return replace(machine, scan=None if scan is None else replace(scan, publishing=False)), ()


def _counted(machine: Machine, scans: int, last_scan: str | None, scans_left: int | None) -> Machine:
    machine = replace(machine, scans=scans, last_scan=last_scan, scans_left=scans_left)
    if scans_left is None:
        return machine
    if scans_left > 0:
        return cleared(machine, FaultCode.STORAGE_FULL)
    return raised(machine, Fault(FaultCode.STORAGE_FULL, "no room for another scan"))


# ---------------------------------------------------------------------------------- devices and end


def _board_reset(machine: Machine, cause: str) -> Result:
    machine = replace(machine, board_resets=machine.board_resets + 1)
    fault = Fault(FaultCode.BOARD_RESET, f"cause {cause}", device=Device.BOARD.value)
    if machine.state is State.CAPTURE:
        return _abandon_capture(machine, Notice(fault, NoticeKind.FAILURE))
    return replace(machine, notice=Notice(fault, NoticeKind.NEWS)), ()


def _stop(machine: Machine) -> Result:
    match machine.state:
        case State.SAVING:
            return replace(machine, stopping=True), ()
        case State.CAPTURE:
            stop: tuple[do.Effect, ...] = (do.AbortCapture(machine.captures),)
        case State.RECONSTRUCT | State.REVIEW if machine.scan is not None and not machine.scan.settled:
            stop = (do.CancelReconstruction(machine.scan.number),)
        case State.CALIBRATE:
            stop = calibrate.cancelled(machine, "switched off")
        case _:
            stop = ()
    return enter(machine, State.SHUTDOWN), (*stop, do.Quit(power_off=False))
