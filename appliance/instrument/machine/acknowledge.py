"""Owns what the diver acknowledges: BACK takes the lasting warning that is shown in full for known, and does nothing else.

From then on a small mark is left of it on every screen. It is shown in full again when it comes anew, for another reason, or
noticeably worse (``appliance.instrument.machine.alerts``). What is critical stays as it is for as long as it lasts.
"""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine.alerts import Severity, lasting
from appliance.instrument.machine.leading import in_full, on_screen
from appliance.instrument.machine.moves import RECORDING
from appliance.instrument.machine.states import Machine, State
from appliance.measure import Fault


def pending(machine: Machine) -> Fault | None:
    """Return the warning that a press of BACK acknowledges now; ``None``: BACK means what it always means.

    While something is recorded BACK ends that and nothing else, and while a question is on the screen it answers it.
    """
    # A second exposure goes through RECONSTRUCT as well, which is not in RECORDING: there, too, BACK gives it up
    # and must not mean anything else.
    adding = machine.scan is not None and machine.scan.adding is not None
    if machine.state in (*RECORDING, State.SHUTDOWN) or adding or machine.off_question is not None:
        return None
    shown = in_full(on_screen(machine))
    if shown is None or not shown.lasts or shown.severity is Severity.CRITICAL:
        return None
    return next((fault for fault in lasting(machine) if (fault.code, fault.device) == (shown.code, shown.device)), None)


def acknowledged(machine: Machine, fault: Fault) -> Machine:
    """Return the machine with ``fault`` known as it is now. Held on, the same press means nothing more."""
    others = tuple(was for was in machine.seen if (was.code, was.device) != (fault.code, fault.device))
    return replace(machine, seen=(*others, fault), back_spent=True)


def forgotten(machine: Machine) -> Machine:
    """Return the machine without what was acknowledged and has ended: when it comes again, it is news."""
    if not machine.seen:
        return machine
    # By code and device alone: numbers that change are still the same fault. Whether it has become worse is asked
    # by `alerts.seen`.
    there = {(fault.code, fault.device) for fault in lasting(machine)}
    seen = tuple(was for was in machine.seen if (was.code, was.device) in there)
    return machine if len(seen) == len(machine.seen) else replace(machine, seen=seen)
