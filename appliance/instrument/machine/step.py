"""The machine's transition function: ``step(machine, event) -> (machine, effects)``, pure and total.

It does no I/O, never raises and never waits. The decisions are made in the modules of their subjects: ``start``,
``keys``, ``asking``, ``menu``, ``gallery``, ``scanning``, ``saving``, ``calibrate``, ``safety``. Light is granted in
one place (``_settle``), from the state and the conditions after the event, so that no path to a new state can forget to
switch it off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from appliance.calibrate import Session
from appliance.instrument.machine import (
    asking,
    by_state,
    calibrate,
    gallery,
    keys,
    safety,
    saving,
    scanning,
    start,
    thermal,
)
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.machine.conditions import (
    cleared,
    device_down,
    device_up,
    judge,
    may_lase,
    may_light,
    may_shine,
    raised,
    refusal,
)
from appliance.instrument.machine.leading import guides
from appliance.instrument.machine.moves import Result
from appliance.instrument.machine.states import (
    TRANSFER_UNKNOWN,
    Device,
    Ending,
    Failure,
    Machine,
    Notice,
    NoticeKind,
    PartResult,
    State,
    Transfer,
)
from appliance.instrument.ranging.reach import Reach, reach_of
from appliance.measure import Fault, FaultCode, LiveGuidance, News
from drivers.api import BoardBooted, KeyFreed, KeyLongPress, KeyPress, KeyStuck, Telemetry


def step(machine: Machine, event: on.Event) -> Result:
    """Return the machine after ``event``, and the effects in order. Total over states and events."""
    if machine.state is State.SHUTDOWN:
        return machine, ()
    after, effects = _react(machine, event)
    after, more = safety.forced(after)
    if after.insists_until_ns is not None and after.now_ns >= after.insists_until_ns:
        after = replace(after, insists_until_ns=None, notice=None)  # the question was not answered
    after = asking.without_acknowledged(asking.unanswered(after))
    return _settle(machine, _without_outdated_refusal(after), (*effects, *more))


def _without_outdated_refusal(machine: Machine) -> Machine:
    """Remove the notice of a refusal once its reason is gone and it could be read."""
    notice = machine.notice
    if notice is None or notice.kind is not NoticeKind.REFUSAL or machine.now_ns < notice.readable_until_ns:
        return machine
    return machine if refusal(machine) is not None else replace(machine, notice=None)


def _react(machine: Machine, event: on.Event) -> Result:
    match event:
        case on.Tick(now_ns):
            return _tick(machine, now_ns)
        case KeyPress(key):
            # A key that is pressed is no longer stuck, but this press still has the meaning of the labels before.
            return keys.pressed(replace(machine, stuck=machine.stuck - {key}), keys.meaning(machine, key))
        case KeyLongPress(key):
            return keys.held(machine, keys.meaning(machine, key))
        case KeyStuck(key):
            return replace(machine, stuck=machine.stuck | {key}), ()
        case KeyFreed(key):
            return replace(machine, stuck=machine.stuck - {key}), ()
        case on.DeviceUp(device):
            return device_up(machine, device), ()
        case on.DeviceDown(device, reason, code):
            return device_down(machine, device, reason, code), ()
        case BoardBooted():
            return safety.board_reset(machine, event.cause)
        case Telemetry():
            return thermal.judge_temperatures(judge(machine, event), event), ()
        case on.ConditionRaised(fault):
            return raised(machine, fault), ()
        case on.ConditionCleared(code, name):
            return cleared(machine, code, name), ()
        case on.FaultReported(fault):
            return replace(machine, notice=Notice(fault, NoticeKind.NEWS)), ()
        case on.StorageCounted(scans, last_scan, scans_left):
            return _update_storage(machine, scans, last_scan, scans_left), ()
        case on.ObjectsCounted(largest):
            return replace(machine, objects_used=largest), ()
        case Transfer():
            # Reports of a transfer that was switched off meanwhile are ignored.
            return (replace(machine, transfer=event), ()) if machine.choices.transfer else (machine, ())
        case on.BootFinished():
            return start.booted(machine)
        case PartResult():
            return start.tested(machine, event), ()
        case on.PartBusy(part):
            return start.busy(machine, part), ()
        case on.Armed(number):
            return scanning.armed(machine, number)
        case on.CaptureFinished(number):
            return scanning.finished(machine, number)
        case on.CaptureFailed(number, fault):
            return scanning.failed(machine, number, fault)
        case on.RawStored(number):
            return calibrate.stored(saving.raw_stored(machine, number), number)
        case News(number, fact):
            return scanning.apply_fact(machine, number, fact)
        case LiveGuidance(guidance, taken_ns):
            # Without a new guidance the former one stays until it is too old.
            return (machine if guidance is None else replace(machine, guidance=guidance, guided_ns=taken_ns)), ()
        case on.Saved(number, scan_id):
            return saving.saved(machine, number, scan_id)
        case on.SaveFailed(number, fault):
            return saving.failed(machine, number, fault)
        case on.TrialExamined(number, check):
            return calibrate.examined(machine, number, check)
        case Session():
            return calibrate.session_changed(machine, event)
        case on.CalibrationProgressed(progress):
            return calibrate.progressed(machine, progress), ()
        case Failure():
            return calibrate.failed(machine, event)
        case on.RangeMeasured(measured):
            # With hysteresis, so that the advice does not flicker where the distance is at a limit.
            return replace(
                machine, range=measured, reach=reach_of(measured, machine.reach, machine.settings.volume)
            ), ()
        case on.ScansListed(scans):
            return gallery.listed(machine, scans)
        case on.StopRequested():
            return safety.stop(machine, Ending.STOP)
        case _:
            assert_never(event)


# ---------------------------------------------------------------------------------- states and light


def _live(machine: Machine) -> tuple[do.GoLive, object] | None:
    """Return the live views needed now, and the state in which that order must be repeated."""
    if machine.state is not State.AIM and not (machine.state is State.CALIBRATE and calibrate.records(machine)):
        return None
    # For comparison only: a device that came back does not know the former order, so it is repeated.
    cameras_and_lights = machine.up & {Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR}
    light = may_shine(machine) and thermal.may_aim_lit(machine)
    return do.GoLive(light, may_lase(machine), machine.exposure), (
        cameras_and_lights,
        machine.board_resets,
    )


def _settle(before: Machine, after: Machine, effects: tuple[do.Effect, ...]) -> Result:
    """Add the effects of the transition: light, live views, and choices that take effect."""
    first: list[do.Effect] = []
    last: list[do.Effect] = []
    live_before, live_after = _live(before), _live(after)
    # Light goes off before the other effects of this step, and on after them.
    if (may_light(before) and not may_light(after)) or (live_after is None and live_before is not None):
        first.append(do.Wish.DARK)
    if live_after is not None and live_after != live_before:
        last.append(live_after[0])
    if after.choices != before.choices:
        # Compared, so that a choice takes effect here however it was changed.
        first.append(do.UseChoices(before.choices, after.choices))
    lasers = live_after is not None and live_after[0].lasers
    if lasers:
        after = replace(after, lasers_off_since_ns=None)
    else:
        since_ns = after.now_ns if after.lasers_off_since_ns is None else after.lasers_off_since_ns
        # Without lasers the distance is not known.
        after = replace(after, lasers_off_since_ns=since_ns, range=None, reach=Reach.UNKNOWN)
    if before.choices.object != after.choices.object:
        # Overlap and guidance referred to the other object.
        after = replace(after, overlap_of=None, overlap=None, guidance=None)
    if before.choices.transfer and not after.choices.transfer:
        after = replace(after, transfer=TRANSFER_UNKNOWN)
    if after.guidance is not None and not guides(after):
        after = replace(after, guidance=None)
    is_lit = live_after is not None and live_after[0].light
    if is_lit is not after.thermal.is_lit:
        after = replace(after, thermal=replace(after.thermal, is_lit=is_lit))
    return after, (*first, *effects, *last)


# -------------------------------------------------------------------------------------------- time


def _tick(machine: Machine, now_ns: int) -> Result:
    # A clock never runs backwards; a late message must not push a deadline away.
    machine = thermal.gather_light(replace(machine, now_ns=max(now_ns, machine.now_ns)), machine.now_ns)
    # Deadlines are checked with the new time only; each state has at most one.
    machine = start.leave_if_shown(machine)
    if machine.deadline_ns is None or machine.now_ns < machine.deadline_ns:
        return saving.retry(machine)
    return by_state.late(machine)


def _update_storage(machine: Machine, scans: int, last_scan: str | None, scans_left: int | None) -> Machine:
    machine = replace(machine, scans=scans, last_scan=last_scan, scans_left=scans_left)
    # Unknown is not zero: a disk that does not report its space must not block scans.
    if scans_left is None:
        return machine
    if scans_left > 0:
        return cleared(machine, FaultCode.STORAGE_FULL)
    return raised(machine, Fault(FaultCode.STORAGE_FULL, "no room for another scan"))
