"""Owns what the instrument may do at a moment: shine, scan, go on with a capture. Pure questions to a ``Machine``."""

from __future__ import annotations

from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.states import NEEDED_FOR_A_SCAN, Device, Machine, State
from appliance.measure import SPOILS_POINTS, Exposure, Fault, FaultCode

LOST_CODES = {
    Device.CAMERA_LEFT: FaultCode.CAMERA_LOST,
    Device.CAMERA_RIGHT: FaultCode.CAMERA_LOST,
    Device.BOARD: FaultCode.BOARD_LOST,
    Device.KEYS: FaultCode.KEYS_LOST,
    Device.PROJECTOR: FaultCode.PROJECTOR_LOST,
    Device.DISPLAY: FaultCode.DISPLAY_LOST,
}


def may_light(machine: Machine) -> bool:
    """Tell whether anything may shine at all: not with a leak, not when too hot."""
    return not any(RULES[fault.code].forbids_light for fault in machine.conditions)


def too_hot_to_shine(machine: Machine) -> bool:
    """Tell whether it must cool down before anything may shine."""
    return any(fault.code in (FaultCode.HOT, FaultCode.TOO_HOT) for fault in machine.conditions)


def may_shine(machine: Machine) -> bool:
    """Tell whether the projector may shine."""
    return may_light(machine) and Device.PROJECTOR in machine.up


def may_lase(machine: Machine) -> bool:
    """Tell whether the lasers may be on. One that ignored its switch must stay off for good."""
    misbehaved = any(fault.code is FaultCode.LASER_ON for fault in machine.conditions)
    return may_light(machine) and Device.BOARD in machine.up and not misbehaved


def refusal(machine: Machine) -> Fault | None:
    """Return why SCAN is refused now, the most severe reason; ``None`` when it is allowed."""
    reasons = [fault for fault in machine.conditions if RULES[fault.code].blocks_scan]
    reasons.sort(key=lambda fault: -RULES[fault.code].severity)
    # Conditions before devices: a leak says more than the camera that it has drowned.
    return next(iter(reasons), None) or missing_device(machine) or _out_of_light(machine)


def rationed(machine: Machine) -> Fault | None:
    """Return why light is rationed: a temperature is not known."""
    return next((fault for fault in machine.conditions if fault.code is FaultCode.TEMPERATURE_UNKNOWN), None)


def _out_of_light(machine: Machine) -> Fault | None:
    """Return why a scan must wait where light is rationed: none is left."""
    # Asked for the whole sequence before it begins: the ration does not end one half-way.
    left = machine.thermal.ration_s >= machine.settings.light_s(machine.choices.period_px)
    return None if left else rationed(machine)


def interruption(machine: Machine) -> Fault | None:
    """Return why a running capture must end now."""
    for fault in machine.conditions:
        if RULES[fault.code].stops_capture or RULES[fault.code].forbids_light:
            return fault
    return missing_device(machine)


def missing_device(machine: Machine) -> Fault | None:
    """Return the first device that a scan needs and does not have."""
    for device in NEEDED_FOR_A_SCAN:
        if device not in machine.up:
            # Neither up nor lost: it was not tried yet, so that there is no reason to show.
            unheard = Fault(LOST_CODES[device], "not found yet", device=device.value)
            return machine.lost.get(device, unheard)
    return None


def second_exposure(machine: Machine) -> Exposure | None:
    """Return the exposure with which one key records a second sequence while a scan is reviewed; ``None``: nothing to
    be gained, or not by points that are wrong."""
    scan = machine.scan
    if machine.state is not State.REVIEW or scan is None or scan.full is None or scan.added is not None:
        return None
    # A second sequence is merged with the points of the first, which are wrong where something moved or
    # flickered.
    return None if any(fault.code in SPOILS_POINTS for fault in scan.warnings) else scan.second


def other_exposure(machine: Machine) -> Exposure | None:
    """Return the exposure to which one key changes while a scan is reviewed: what was proposed, and back. ``None``:
    nothing was proposed."""
    scan = machine.scan
    if machine.state is not State.REVIEW or scan is None or scan.proposal is None:
        return None
    return scan.exposure if machine.exposure == scan.proposal else scan.proposal
