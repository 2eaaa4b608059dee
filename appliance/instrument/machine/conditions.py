"""Conditions, and the actions that they allow.

    raised, cleared, device_up, …    telemetry and devices become conditions, with debouncing and hysteresis
    may_shine, may_lase, refusal, …  whether the instrument may shine, scan, or go on with a capture now

The functions of the second group change nothing.
"""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.states import NEEDED_FOR_A_SCAN, Device, Machine, State, seconds_ns
from appliance.measure import SPOILS_POINTS, Exposure, Fault, FaultCode
from drivers.api import Telemetry

LOST_CODES = {
    Device.CAMERA_LEFT: FaultCode.CAMERA_LOST,
    Device.CAMERA_RIGHT: FaultCode.CAMERA_LOST,
    Device.BOARD: FaultCode.BOARD_LOST,
    Device.KEYS: FaultCode.KEYS_LOST,
    Device.PROJECTOR: FaultCode.PROJECTOR_LOST,
    Device.DISPLAY: FaultCode.DISPLAY_LOST,
}


def may_light(machine: Machine) -> bool:
    """Return True if any light may be on: not with a leak, not when too hot."""
    return not any(RULES[fault.code].forbids_light for fault in machine.conditions)


def too_hot_to_shine(machine: Machine) -> bool:
    """Return True if the instrument must cool down before it may shine."""
    return any(fault.code in (FaultCode.HOT, FaultCode.TOO_HOT) for fault in machine.conditions)


def may_shine(machine: Machine) -> bool:
    """Return True if the projector may shine."""
    return may_light(machine) and Device.PROJECTOR in machine.up


def may_lase(machine: Machine) -> bool:
    """Return True if the lasers may be on. A laser that ignored its switch keeps both off for good."""
    misbehaved = any(fault.code is FaultCode.LASER_ON for fault in machine.conditions)
    return may_light(machine) and Device.BOARD in machine.up and not misbehaved


def refusal(machine: Machine) -> Fault | None:
    """Return the most severe reason to refuse SCAN now; ``None``: it is allowed."""
    reasons = [fault for fault in machine.conditions if RULES[fault.code].blocks_scan]
    reasons.sort(key=lambda fault: -RULES[fault.code].severity)
    # Conditions come before lost devices, of which they may be the cause, such as a leak.
    return next(iter(reasons), None) or missing_device(machine) or _spent_ration(machine)


def rationed(machine: Machine) -> Fault | None:
    """Return the reason why light is rationed: an unknown temperature."""
    return next((fault for fault in machine.conditions if fault.code is FaultCode.TEMPERATURE_UNKNOWN), None)


def _spent_ration(machine: Machine) -> Fault | None:
    """Return the reason why a scan must wait for its ration of light."""
    # Checked for the complete sequence, so that the ration never interrupts one.
    left = machine.thermal.ration_s >= machine.settings.light_s(machine.choices.period_px)
    return None if left else rationed(machine)


def interruption(machine: Machine) -> Fault | None:
    """Return the reason why a running capture must end now."""
    for fault in machine.conditions:
        if RULES[fault.code].stops_capture or RULES[fault.code].forbids_light:
            return fault
    return missing_device(machine)


def missing_device(machine: Machine) -> Fault | None:
    """Return the fault of the first missing device that a scan needs."""
    for device in NEEDED_FOR_A_SCAN:
        if device not in machine.up:
            # Neither up nor lost: it was not tried yet, so no reason is known.
            unheard = Fault(LOST_CODES[device], "not found yet", device=device.value)
            return machine.lost.get(device, unheard)
    return None


def second_exposure(machine: Machine) -> Exposure | None:
    """Return the exposure of a second sequence that a key may add in REVIEW.

    ``None``: there is no gain, or the first sequence has wrong points.
    """
    scan = machine.scan
    if machine.state is not State.REVIEW or scan is None or scan.full is None or scan.added is not None:
        return None
    # A second sequence is merged with the points of the first, which are wrong after motion or flicker.
    return None if any(fault.code in SPOILS_POINTS for fault in scan.warnings) else scan.second


def other_exposure(machine: Machine) -> Exposure | None:
    """Return the exposure to which a key changes in REVIEW: the proposed one, and back.

    ``None``: there is no proposal.
    """
    scan = machine.scan
    if machine.state is not State.REVIEW or scan is None or scan.proposal is None:
        return None
    return scan.exposure if machine.exposure == scan.proposal else scan.proposal


LEAK_HEARTBEATS = 2
"""Consecutive heartbeats with a leak before it is believed; from then on it is latched."""
LASER_SETTLE_S = 1.0
"""Two heartbeats: earlier ones may show the lasers as they were before they were switched off."""
HYSTERESIS_V = 0.3


def raised(machine: Machine, fault: Fault) -> Machine:
    """Return the machine with the condition, which replaces one of the same code and device."""
    remaining = tuple(c for c in machine.conditions if (c.code, c.device) != (fault.code, fault.device))
    return replace(machine, conditions=(*remaining, fault))


def cleared(machine: Machine, code: FaultCode, device: str | None = None) -> Machine:
    """Return the machine without the condition. A leak stays: water does not leave by itself."""
    if code is FaultCode.LEAK:
        return machine
    return replace(machine, conditions=tuple(c for c in machine.conditions if (c.code, c.device) != (code, device)))


def device_up(machine: Machine, device: Device) -> Machine:
    return replace(
        machine,
        up=machine.up | {device},
        lost={d: fault for d, fault in machine.lost.items() if d is not device},
    )


def device_down(machine: Machine, device: Device, reason: str, code: FaultCode | None) -> Machine:
    fault = Fault(code or LOST_CODES[device], reason, device=device.value)
    return replace(machine, up=machine.up - {device}, lost={**machine.lost, device: fault})


def judge(machine: Machine, telemetry: Telemetry) -> Machine:
    """Update the conditions by one heartbeat, except temperatures (``thermal``).

    A missing value changes nothing: missing is not zero.
    """
    machine = _leak(machine, telemetry.leak)
    machine = _supply(machine, telemetry.supply_v)
    return _lasers(machine, telemetry)


def _leak(machine: Machine, leak: bool | None) -> Machine:
    # A sensor that does not answer (None) is no vote; a silent board is a separate fault.
    votes = min(machine.leak_votes + 1, LEAK_HEARTBEATS) if leak else 0
    machine = replace(machine, leak_votes=votes)
    if votes < LEAK_HEARTBEATS or has(machine, FaultCode.LEAK):
        return machine
    return raised(machine, Fault(FaultCode.LEAK, f"{votes} heartbeats in a row report water"))


def _supply(machine: Machine, supply_v: float | None) -> Machine:
    low_v = machine.settings.supply_low_v
    if supply_v is None or low_v is None:
        return machine
    if supply_v < low_v or (has(machine, FaultCode.SUPPLY_LOW) and supply_v < low_v + HYSTERESIS_V):
        # Raised again with each heartbeat, so that the screen shows the latest voltage.
        return raised(
            machine, Fault(FaultCode.SUPPLY_LOW, f"{supply_v:g} V, limit {low_v:g} V", {"supply_v": supply_v})
        )
    return cleared(machine, FaultCode.SUPPLY_LOW)


def _lasers(machine: Machine, telemetry: Telemetry) -> Machine:
    since_ns = machine.lasers_off_since_ns
    if since_ns is None or machine.now_ns - since_ns < seconds_ns(LASER_SETTLE_S):
        return machine
    # The board reports the current through the lasers, not the order that it was given.
    lasers = telemetry.lasers
    if lasers.left_on or lasers.right_on:
        sides = " and ".join(n for n, on in (("left", lasers.left_on), ("right", lasers.right_on)) if on)
        return raised(machine, Fault(FaultCode.LASER_ON, f"{sides} laser conducts although it is switched off"))
    return cleared(machine, FaultCode.LASER_ON)


def has(machine: Machine, code: FaultCode, device: str | None = None) -> bool:
    """Return True if the condition is present."""
    return any((fault.code, fault.device) == (code, device) for fault in machine.conditions)
