"""Owns how the machine goes from one state to another: its clock, its deadline, and what a state takes along."""

from __future__ import annotations

from dataclasses import replace

from appliance.machine import effects as do
from appliance.machine.states import Machine, State, seconds_ns

Result = tuple[Machine, tuple[do.Effect, ...]]


def enter(machine: Machine, state: State, timeout_s: float | None = None) -> Machine:
    """The machine in ``state``, which ends after ``timeout_s`` at the latest."""
    deadline_ns = None if timeout_s is None else machine.now_ns + seconds_ns(timeout_s)
    scan = machine.scan if state in (State.RECONSTRUCT, State.REVIEW, State.SAVING) else None
    at = machine.calibrating if state in (State.CALIBRATE, State.CAPTURE) else None
    return replace(machine, state=state, since_ns=machine.now_ns, deadline_ns=deadline_ns, scan=scan, calibrating=at)


def home(machine: Machine) -> Machine:
    """Where a capture came from: AIM, or the step of the calibration it was for."""
    return enter(machine, State.AIM if machine.calibrating is None else State.CALIBRATE)
