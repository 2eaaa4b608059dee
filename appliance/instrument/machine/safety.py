"""Forced actions: SAFE, COOLING, the end of a recording, saving and switching off.

``forced`` checks the machine after every event, so that each action comes with the event that caused it.
"""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import calibrate, saving, scanning
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.conditions import interruption, too_hot_to_shine
from appliance.instrument.machine.moves import RECORDING, Result, enter
from appliance.instrument.machine.states import Device, Ending, Machine, Notice, NoticeKind, State, seconds_ns
from appliance.measure import Fault, FaultCode
from drivers.api import Key

COOLS_DOWN = (FaultCode.HOT, FaultCode.TOO_HOT)
"""Faults that forbid light, but end by themselves in the dark; the others that forbid it lead to SAFE."""
ENDS_THE_DIVE = (FaultCode.TOO_HOT, FaultCode.SUPPLY_LOW)


def forced(machine: Machine) -> Result:
    """Return the machine after the actions that its conditions force, and their effects."""
    if machine.state is State.SHUTDOWN:
        return machine, ()
    # In the order of severity: dark for good, the end of a recording, cooling, switching off. Each sees the machine
    # after the one before.
    cause = unsafe(machine)
    if cause is not None and machine.state is not State.SAFE:
        return _to_safe(machine, cause)
    effects: tuple[do.Effect, ...] = ()
    if machine.state in RECORDING and (reason := interruption(machine)) is not None:
        machine, effects = scanning.abandon(machine, Notice(reason, NoticeKind.FAILURE))
    if cause is None and machine.state is State.SAFE:
        machine = _out_of_safe(machine)
    machine = _cooling(machine)
    machine, more = _ordered_off(machine)
    return machine, (*effects, *more)


def unsafe(machine: Machine) -> Fault | None:
    """Return the fault for which the instrument must stay dark until it was inspected."""
    return next((c for c in machine.conditions if RULES[c.code].forbids_light and c.code not in COOLS_DOWN), None)


def _to_safe(machine: Machine, cause: Fault) -> Result:
    """Go dark, in one step. A recorded scan without a decision is saved: the diver is not asked."""
    effects: tuple[do.Effect, ...] = ()
    scan = machine.scan
    if machine.state in RECORDING:
        effects = (do.Wish.ABORT_CAPTURE,)
    elif machine.state is State.CALIBRATE:
        effects = calibrate.cancelled(machine, cause.detail or cause.code.value)
    deadline_ns = machine.deadline_ns
    machine = replace(enter(machine, State.SAFE), notice=None, just_saved=None)
    if scan is None:
        return machine, effects
    if scan.publishing:  # it goes on, and with the time it had
        return replace(machine, deadline_ns=deadline_ns), effects
    machine, more = saving.keep(machine, scan)
    return machine, (*effects, *more)


def _out_of_safe(machine: Machine) -> Machine:
    """Leave SAFE, whose cause has gone; for a scan that was not saved, the diver decides again."""
    scan = machine.scan
    if scan is None:
        return enter(machine, State.AIM)
    if scan.settled and not scan.publishing and machine.stopping is None:
        return enter(machine, State.REVIEW)
    return machine


def _cooling(machine: Machine) -> Machine:
    hot = too_hot_to_shine(machine)
    if not hot:
        machine = replace(machine, cooling_left=False)
        return enter(machine, State.AIM) if machine.state is State.COOLING else machine
    if machine.state is State.AIM and not machine.cooling_left:
        return enter(machine, State.COOLING)
    return machine


def cooling_key(machine: Machine, key: Key) -> Result:
    """Handle a key in COOLING: BACK leads to a dark AIM, from where SCAN leads here again."""
    if key is Key.BACK:
        return replace(enter(machine, State.AIM), cooling_left=True), ()
    return machine, ()


def safe_key(machine: Machine, key: Key) -> Result:
    """Handle a key in SAFE: SCAN (OK) repeats a save that the disk refused."""
    scan = machine.scan
    if key is Key.SCAN and scan is not None and scan.settled and not scan.publishing:
        return saving.keep(machine, scan)
    return machine, ()


# --------------------------------------------------------------------------------------- the end


def _ordered_off(machine: Machine) -> Result:
    """Save and switch off: after a while with a low supply, at once with too much heat."""
    if machine.stopping is not None:
        return machine, ()
    cause = next((c for code in ENDS_THE_DIVE for c in machine.conditions if c.code is code), None)
    if cause is None:
        return replace(machine, off_ns=None), ()
    wait_s = machine.settings.supply_off_s if cause.code is FaultCode.SUPPLY_LOW else 0.0
    off_ns = machine.now_ns + seconds_ns(wait_s)
    # The earliest time of all causes holds, as long as one of them lasts.
    if machine.off_ns is not None:
        off_ns = min(off_ns, machine.off_ns)  # too much heat does not wait out a low supply's time
    machine = replace(machine, off_ns=off_ns)
    if machine.now_ns < off_ns:
        return machine, ()
    return stop(replace(machine, ended_by=cause), Ending.POWER_OFF)


def stop(machine: Machine, how: Ending) -> Result:
    """End the dive or the service.

    A scan that the diver kept is saved first; if a fault ends the dive, so is one without a decision.
    """
    scan = machine.scan
    # The diver cannot be asked when a fault ends the dive: a recorded scan is kept rather than lost.
    if scan is not None and (scan.is_kept or machine.ended_by is not None):
        machine = replace(machine, stopping=how)
        if scan.publishing or (scan.is_kept and not scan.settled):
            return machine, ()
        return saving.keep(machine, scan)
    match machine.state:
        case State.ARMED | State.CAPTURE:
            effects: tuple[do.Effect, ...] = (do.Wish.ABORT_CAPTURE,)
        case State.CHECK | State.RECONSTRUCT | State.REVIEW if scan is not None and not scan.settled:
            effects = (do.Wish.CANCEL_RECONSTRUCTION,)
        case State.CALIBRATE:
            effects = calibrate.cancelled(machine, "switched off")
        case _:
            effects = ()
    return enter(machine, State.SHUTDOWN), (*effects, do.Quit(how is Ending.POWER_OFF))


# --------------------------------------------------------------------------------------- the board


def board_reset(machine: Machine, cause: str) -> Result:
    """Handle a restart of the board: live views and lasers are set again (``step``), a recording is lost."""
    machine = replace(machine, board_resets=machine.board_resets + 1)
    fault = Fault(FaultCode.BOARD_RESET, f"cause {cause}", device=Device.BOARD.value)
    if machine.state in RECORDING:
        return scanning.abandon(machine, Notice(fault, NoticeKind.FAILURE))
    return replace(machine, notice=Notice(fault, NoticeKind.NEWS)), ()
