"""Owns the way from power-on to AIM: what the self-test waits for, what it lets pass, and what it stops at."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine.conditions import device_down, refusal
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Device, Machine, Part, PartTested, State, seconds_ns
from appliance.instrument.machine.words import Text
from drivers.api import Key


def booted(machine: Machine) -> Result:
    """Go on to the self-test, as every device was tried once."""
    if machine.state is not State.BOOT:
        return machine, ()
    return enter(machine, State.SELF_TEST, machine.settings.self_test_s), ()


def tested(machine: Machine, result: PartTested) -> Machine:
    """Take over a part's result, which may come again and be another."""
    return replace(machine, parts={**machine.parts, result.part: result})


def busy(machine: Machine, part: Part) -> Machine:
    """Let the self-test wait for a part that gets on: a slow processor has not failed."""
    deadline_ns = machine.deadline_ns
    if machine.state is not State.SELF_TEST or part in machine.parts or deadline_ns is None:
        return machine
    # Never less than what was granted before: a sign of life must not shorten the wait.
    return replace(machine, deadline_ns=max(deadline_ns, machine.now_ns + seconds_ns(machine.settings.busy_s)))


def finished(machine: Machine) -> bool:
    """Tell whether every device and part has a result."""
    # Lost is a result like any other; only silence is waited for.
    heard = all(device in machine.up or device in machine.lost for device in Device)
    return heard and all(part in machine.parts for part in Part)


def stops(machine: Machine) -> bool:
    """Tell whether something failed that a scan needs: the diver must have seen it."""
    storage = machine.parts.get(Part.STORAGE)
    return refusal(machine) is not None or (storage is not None and not storage.passed)


def passed(machine: Machine) -> bool:
    """Tell whether everything works."""
    return finished(machine) and not machine.lost and all(test.passed for test in machine.parts.values())


def waits_for_ok(machine: Machine) -> bool:
    """Tell whether the diver is asked to go on in spite of what failed."""
    return machine.state is State.SELF_TEST and finished(machine) and stops(machine)


def pressed(machine: Machine, key: Key) -> Result:
    """SCAN (OK) goes on in spite of what failed, and so does BACK."""
    if waits_for_ok(machine) and key in (Key.SCAN, Key.BACK):
        return enter(machine, State.AIM), ()
    return machine, ()


def passed_by(machine: Machine) -> Machine:
    """Go to AIM, once everything has a result that was shown long enough."""
    if machine.state is not State.SELF_TEST or not finished(machine):
        return machine
    settings = machine.settings
    if stops(machine):
        # Without keys nobody could press OK, and an instrument that waits for it would never get to its live
        # pictures.
        if Device.KEYS in machine.up:
            return replace(machine, deadline_ns=None)
        shown_s = settings.keyless_s
    else:
        shown_s = settings.passed_s if passed(machine) else settings.limited_s
    return enter(machine, State.AIM) if machine.now_ns - machine.since_ns >= seconds_ns(shown_s) else machine


def late(machine: Machine) -> Result:
    """Count everything that has not answered by now as failed."""
    if machine.state is State.BOOT:
        return enter(machine, State.SELF_TEST, machine.settings.self_test_s), ()
    # A device or part that speaks up later is taken over all the same: `device_up` and `tested` ask for no state.
    for device in Device:
        if device not in machine.up and device not in machine.lost:
            machine = device_down(machine, device, Text.NO_ANSWER.english, None)
    silent = {part: PartTested(part, False, Text.NO_ANSWER) for part in Part if part not in machine.parts}
    # Shown from now on, for as long as any other result.
    return enter(replace(machine, parts={**machine.parts, **silent}), State.SELF_TEST), ()
