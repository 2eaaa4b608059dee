"""Owns how an event is said in the log: whole words, the device's name, the fault's code and what is known of it."""

from __future__ import annotations

import logging

from appliance.machine import events as on
from appliance.scan.fault import Fault


def spoken(event: on.Event) -> tuple[int, str] | None:
    """Level and text of a log line; ``None`` for what needs none: it is seen in the states, or comes all the time."""
    match event:
        case on.DeviceUp(device):
            return logging.INFO, f"{device.value} works"
        case on.DeviceDown(device, reason, code):
            return logging.WARNING, f"{device.value} lost{'' if code is None else f' ({code.value})'}: {reason}"
        case on.CaptureFailed(number, fault):
            return logging.WARNING, f"scan {number} of this start failed: {fault_text(fault)}"
        case on.SaveFailed(number, fault):
            return logging.WARNING, f"scan {number} of this start is not saved: {fault_text(fault)}"
        case on.ReconstructionFailed(number, fault):
            return logging.WARNING, f"scan {number} of this start was not reconstructed: {fault_text(fault)}"
        case _:
            return None


def fault_text(fault: Fault) -> str:
    """Code, device, the detector's words and its numbers, in one line."""
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in fault.numbers.items())
    of = "" if fault.device is None else f" of {fault.device}"
    said = "; ".join(filter(None, (fault.detail, numbers)))
    return f"{fault.code.value}{of}" + (f": {said}" if said else "")
