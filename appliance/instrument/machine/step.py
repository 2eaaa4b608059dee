"""Owns every decision of the instrument: ``step(machine, event) -> (machine, effects)``, pure and total.

It does no I/O, never raises and never waits. The decisions themselves lie with their subjects: ``start``, ``keys``,
``asking``, ``acknowledge``, ``menu``, ``gallery``, ``scanning``, ``saving``, ``calibrate``, ``safety``. Light is
granted in one place (``_settle``), from the state and the conditions after the event, so that no path to a new state
can forget to switch it off.
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
    NOT_TOLD,
    Device,
    Ending,
    Failure,
    Machine,
    Notice,
    NoticeKind,
    PartTested,
    State,
    Transfer,
)
from appliance.instrument.ranging.reach import Reach, reach_of
from appliance.measure import Fault, FaultCode, LiveGuidance, News
from drivers.api import BoardBooted, KeyFreed, KeyLongPress, KeyPress, KeyStuck, Telemetry


def step(machine: Machine, event: on.Event) -> Result:
    """Return the machine after ``event`` and what is to be done, in order. Total over states and events."""
    if machine.state is State.SHUTDOWN:
        return machine, ()
    after, wanted = _react(machine, event)
    after, more = safety.forced(after)
    if after.insists_until_ns is not None and after.now_ns >= after.insists_until_ns:
        after = replace(after, insists_until_ns=None, notice=None)  # the question was not answered
    after = asking.without_acknowledged(asking.unanswered(after))
    return _settle(machine, _without_answered_refusal(after), (*wanted, *more))


def _without_answered_refusal(machine: Machine) -> Machine:
    """Take the message of a refusal away whose reason is gone, once it could be read."""
    notice = machine.notice
    if notice is None or notice.kind is not NoticeKind.REFUSAL or machine.now_ns < notice.readable_until_ns:
        return machine
    return machine if refusal(machine) is not None else replace(machine, notice=None)


def _react(machine: Machine, event: on.Event) -> Result:
    match event:
        case on.Tick(now_ns):
            return _tick(machine, now_ns)
        case KeyPress(key):
            # A key that is pressed is not stuck any more; what this press means was still said by the labels of
            # before.
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
            return thermal.felt(judge(machine, event), event), ()
        case on.ConditionRaised(fault):
            return raised(machine, fault), ()
        case on.ConditionCleared(code, name):
            return cleared(machine, code, name), ()
        case on.Told(fault):
            return replace(machine, notice=Notice(fault, NoticeKind.NEWS)), ()
        case on.StorageCounted(scans, last_scan, scans_left):
            return _counted(machine, scans, last_scan, scans_left), ()
        case on.ObjectsCounted(largest):
            return replace(machine, objects_used=largest), ()
        case Transfer():
            # What was told of a transfer that was switched off since is of no interest.
            return (replace(machine, transfer=event), ()) if machine.choices.transfer else (machine, ())
        case on.BootFinished():
            return start.booted(machine)
        case PartTested():
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
            return scanning.told(machine, number, fact)
        case LiveGuidance(guidance, taken_ns):
            # One that could not be told does not unsay the one before, which goes by its age.
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
        case on.Ranged(measured):
            # The word keeps a memory (hysteresis), so that it does not flicker where the distance lies at a
            # limit.
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
    """Return the live views wanted now, with what makes it necessary to ask again."""
    if machine.state is not State.AIM and not (machine.state is State.CALIBRATE and calibrate.records(machine)):
        return None
    # Part of the comparison only: a device that came back knows nothing of what was asked before, and is told
    # again.
    cameras_and_lights = machine.up & {Device.CAMERA_LEFT, Device.CAMERA_RIGHT, Device.BOARD, Device.PROJECTOR}
    light = may_shine(machine) and thermal.may_aim_lit(machine)
    return do.GoLive(light, may_lase(machine), machine.exposure), (
        cameras_and_lights,
        machine.board_resets,
    )


def _settle(before: Machine, after: Machine, wanted: tuple[do.Effect, ...]) -> Result:
    """Add what follows from where the machine was and is: light, live views, and choices that take effect."""
    first: list[do.Effect] = []
    last: list[do.Effect] = []
    live_before, live_after = _live(before), _live(after)
    # Off comes before everything else that this step does, on after it.
    if (may_light(before) and not may_light(after)) or (live_after is None and live_before is not None):
        first.append(do.Wish.DARK)
    if live_after is not None and live_after != live_before:
        last.append(live_after[0])
    if after.choices != before.choices:
        # Compared, not told by each key: whatever way a choice changed, it takes effect here.
        first.append(do.UseChoices(before.choices, after.choices))
    lasers = live_after is not None and live_after[0].lasers
    if lasers:
        after = replace(after, lasers_off_since_ns=None)
    else:
        since_ns = after.now_ns if after.lasers_off_since_ns is None else after.lasers_off_since_ns
        # What was measured ends with the light.
        after = replace(after, lasers_off_since_ns=since_ns, range=None, reach=Reach.UNKNOWN)
    if before.choices.object != after.choices.object:
        # What was said was said of the other object.
        after = replace(after, overlap_of=None, overlap=None, guidance=None)
    if before.choices.transfer and not after.choices.transfer:
        after = replace(after, transfer=NOT_TOLD)
    if after.guidance is not None and not guides(after):
        after = replace(after, guidance=None)
    lit = live_after is not None and live_after[0].light
    if lit is not after.thermal.lit:
        after = replace(after, thermal=replace(after.thermal, lit=lit))
    return after, (*first, *wanted, *last)


# -------------------------------------------------------------------------------------------- time


def _tick(machine: Machine, now_ns: int) -> Result:
    # A clock never runs backwards; a late message must not push a deadline away.
    machine = thermal.passed(replace(machine, now_ns=max(now_ns, machine.now_ns)), machine.now_ns)
    # Deadlines are looked at with the new time only, and each state has one at most.
    machine = start.passed_by(machine)
    if machine.deadline_ns is None or machine.now_ns < machine.deadline_ns:
        return saving.retry(machine)
    return by_state.late(machine)


def _counted(machine: Machine, scans: int, last_scan: str | None, scans_left: int | None) -> Machine:
    machine = replace(machine, scans=scans, last_scan=last_scan, scans_left=scans_left)
    # Unknown is not none: a disk that does not tell must not block scans.
    if scans_left is None:
        return machine
    if scans_left > 0:
        return cleared(machine, FaultCode.STORAGE_FULL)
    return raised(machine, Fault(FaultCode.STORAGE_FULL, "no room for another scan"))
