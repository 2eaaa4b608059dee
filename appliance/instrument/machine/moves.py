"""Transitions between states: clock, deadline, and the values that each state keeps."""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import effects as do
from appliance.instrument.machine.states import Machine, State, seconds_ns

Result = tuple[Machine, tuple[do.Effect, ...]]

WITH_A_SCAN = (State.CHECK, State.RECONSTRUCT, State.REVIEW, State.SAVING, State.SAFE)
"""States in which a recorded scan may be in hand."""
RECORDING = (State.ARMED, State.CAPTURE)
STARTING = (State.BOOT, State.SELF_TEST)
"""States on the way to AIM that end by themselves: a question stays on the screen over them."""


def enter(machine: Machine, state: State, timeout_s: float | None = None) -> Machine:
    """Return the machine in ``state``, which ends after ``timeout_s`` at the latest."""
    # One value serves all states. Values that do not belong to the new state are dropped: a scan left in AIM would be
    # shown, judged and saved from there.
    adds = machine.scan is not None and machine.scan.adding is not None
    deadline_ns = None if timeout_s is None else machine.now_ns + seconds_ns(timeout_s)
    still_asked = machine.state in STARTING and state in (State.SELF_TEST, State.AIM)
    return replace(
        machine,
        state=state,
        since_ns=machine.now_ns,
        deadline_ns=deadline_ns,
        scan=machine.scan if state in WITH_A_SCAN or (adds and state in RECORDING) else None,
        calibrating=machine.calibrating if state in (State.CALIBRATE, *RECORDING) else None,
        menu=machine.menu if state in (State.MENU, State.GALLERY) else None,
        gallery=machine.gallery if state is State.GALLERY else None,
        insists_until_ns=None,
        off_question=machine.off_question if still_asked else None,
    )


def home(machine: Machine) -> Machine:
    """Return to the origin of a capture: AIM, the calibration's step, or the review of the scan in hand."""
    scan = machine.scan
    if scan is not None and scan.adding is not None:
        return replace(enter(machine, State.REVIEW), scan=replace(scan, adding=None))
    return enter(machine, State.AIM if machine.calibrating is None else State.CALIBRATE)
