"""Owns what lasts: how telemetry and devices turn into conditions, with debouncing and hysteresis."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine.permissions import LOST_CODES
from appliance.instrument.machine.states import Device, Machine, seconds_ns
from appliance.measure import Fault, FaultCode
from drivers.api import Telemetry

LEAK_HEARTBEATS = 2
"""Consecutive heartbeats with a leak before it is believed; from then on it is latched."""
LASER_SETTLE_S = 1.0
"""Two heartbeats: older ones may show the lasers as they were before they were switched off."""
HYSTERESIS_V = 0.3


def raised(machine: Machine, fault: Fault) -> Machine:
    """Return the machine with that condition, which replaces an older one of the same code and device."""
    others = tuple(c for c in machine.conditions if (c.code, c.device) != (fault.code, fault.device))
    return replace(machine, conditions=(*others, fault))


def cleared(machine: Machine, code: FaultCode, device: str | None = None) -> Machine:
    """Return the machine without that condition. A leak stays: water does not leave by itself."""
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
    """Judge the conditions after one heartbeat, but for those of warmth (``thermal``). A value that is missing
    changes nothing: missing is not zero."""
    machine = _leak(machine, telemetry.leak)
    machine = _supply(machine, telemetry.supply_v)
    return _lasers(machine, telemetry)


def _leak(machine: Machine, leak: bool | None) -> Machine:
    # A sensor that does not answer (None) is no vote; that a board fell silent is a fault of its own.
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
        # Raised anew with each heartbeat, so that the number on the screen is the latest; it replaces the one
        # before.
        return raised(
            machine, Fault(FaultCode.SUPPLY_LOW, f"{supply_v:g} V, limit {low_v:g} V", {"supply_v": supply_v})
        )
    return cleared(machine, FaultCode.SUPPLY_LOW)


def _lasers(machine: Machine, telemetry: Telemetry) -> Machine:
    since_ns = machine.lasers_off_since_ns
    if since_ns is None or machine.now_ns - since_ns < seconds_ns(LASER_SETTLE_S):
        return machine
    # The board reports the current that flows through the lasers, not what it was told: an order is no proof.
    lasers = telemetry.lasers
    if lasers.left_on or lasers.right_on:
        sides = " and ".join(n for n, on in (("left", lasers.left_on), ("right", lasers.right_on)) if on)
        return raised(machine, Fault(FaultCode.LASER_ON, f"{sides} laser conducts although switched off"))
    return cleared(machine, FaultCode.LASER_ON)


def has(machine: Machine, code: FaultCode, device: str | None = None) -> bool:
    """Tell whether that condition lasts."""
    return any((fault.code, fault.device) == (code, device) for fault in machine.conditions)
