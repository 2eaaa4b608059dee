"""The way from power-on to AIM: the results that the self-test waits for, and the faults it stops at."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine.conditions import device_down, refusal
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Device, Machine, Part, PartResult, State, seconds_ns
from appliance.instrument.machine.words import Text
from drivers.api import Key


def booted(machine: Machine) -> Result:
    """Go on to the self-test, as every device was tried once."""
    if machine.state is not State.BOOT:
        return machine, ()
    return enter(machine, State.SELF_TEST, machine.settings.self_test_s), ()


def tested(machine: Machine, result: PartResult) -> Machine:
    """Record a part's result, which may come again and differ."""
    return replace(machine, parts={**machine.parts, result.part: result})


def busy(machine: Machine, part: Part) -> Machine:
    """Extend the self-test for a part that reports progress: a slow processor has not failed."""
    deadline_ns = machine.deadline_ns
    if machine.state is not State.SELF_TEST or part in machine.parts or deadline_ns is None:
        return machine
    # A report of progress must not shorten the wait.
    return replace(machine, deadline_ns=max(deadline_ns, machine.now_ns + seconds_ns(machine.settings.busy_s)))


def finished(machine: Machine) -> bool:
    """Return True if every device and part has a result."""
    # A lost device is a result, too.
    devices_tried = all(device in machine.up or device in machine.lost for device in Device)
    return devices_tried and all(part in machine.parts for part in Part)


def stops(machine: Machine) -> bool:
    """Return True if a scan is impossible because of a fault, which the diver must see."""
    storage = machine.parts.get(Part.STORAGE)
    return refusal(machine) is not None or (storage is not None and not storage.passed)


def passed(machine: Machine) -> bool:
    """Return True if all devices and parts work."""
    return finished(machine) and not machine.lost and all(test.passed for test in machine.parts.values())


def waits_for_ok(machine: Machine) -> bool:
    """Return True if the diver is asked to go on despite the faults."""
    return machine.state is State.SELF_TEST and finished(machine) and stops(machine)


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a key: SCAN (OK) goes on despite the faults, and so does BACK."""
    if waits_for_ok(machine) and key in (Key.SCAN, Key.BACK):
        return enter(machine, State.AIM), ()
    return machine, ()


def leave_if_shown(machine: Machine) -> Machine:
    """Go to AIM, once all results are there and were shown long enough."""
    if machine.state is not State.SELF_TEST or not finished(machine):
        return machine
    settings = machine.settings
    if stops(machine):
        # Without keys OK cannot be pressed, and an instrument that waits for it would never show live images.
        if Device.KEYS in machine.up:
            return replace(machine, deadline_ns=None)
        shown_s = settings.keyless_s
    else:
        shown_s = settings.passed_s if passed(machine) else settings.limited_s
    return enter(machine, State.AIM) if machine.now_ns - machine.since_ns >= seconds_ns(shown_s) else machine


def late(machine: Machine) -> Result:
    """Count all devices and parts without a result as failed."""
    if machine.state is State.BOOT:
        return enter(machine, State.SELF_TEST, machine.settings.self_test_s), ()
    # A result that comes later is recorded all the same: `device_up` and `tested` do not depend on the state.
    for device in Device:
        if device not in machine.up and device not in machine.lost:
            machine = device_down(machine, device, Text.NO_ANSWER.english, None)
    silent = {part: PartResult(part, False, Text.NO_ANSWER) for part in Part if part not in machine.parts}
    # The results are shown from now on, for the usual time.
    return enter(replace(machine, parts={**machine.parts, **silent}), State.SELF_TEST), ()
