"""The diver's answers to the question before switching off, and to a lasting warning.

    ask, pressed, unanswered               the question whether to switch off; STAY ON is selected first
    pending_fault, with_acknowledged, …    BACK acknowledges the warning that is shown in full, and has no other effect

A leak, heat, a low supply and the operating system switch off without a question
(``appliance.instrument.machine.safety``).

An acknowledged warning leaves a small mark on every screen. It is shown in full again when it returns, for another
reason, or noticeably worse. Critical alerts stay in full for as long as they last.
"""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import safety
from appliance.instrument.machine.alerts import Severity, lasting
from appliance.instrument.machine.leading import in_full, on_screen
from appliance.instrument.machine.moves import RECORDING, Result
from appliance.instrument.machine.states import Answer, Ending, Machine, OffQuestion, State, seconds_ns
from appliance.measure import Fault
from drivers.api import Key


def pending_fault(machine: Machine) -> Fault | None:
    """Return the warning that a press of BACK acknowledges now; ``None``: BACK has its usual meaning.

    During a recording BACK only ends that, and while a question is on the screen it only answers it.
    """
    # A second exposure also passes RECONSTRUCT, which is not in RECORDING: there, too, BACK only gives it up.
    adding = machine.scan is not None and machine.scan.adding is not None
    if machine.state in (*RECORDING, State.SHUTDOWN) or adding or machine.off_question is not None:
        return None
    shown = in_full(on_screen(machine))
    if shown is None or not shown.lasts or shown.severity is Severity.CRITICAL:
        return None
    return next((fault for fault in lasting(machine) if (fault.code, fault.device) == (shown.code, shown.device)), None)


def with_acknowledged(machine: Machine, fault: Fault) -> Machine:
    """Return the machine with ``fault`` acknowledged. Holding the key on has no further effect."""
    remaining = tuple(
        earlier for earlier in machine.acknowledged if (earlier.code, earlier.device) != (fault.code, fault.device)
    )
    return replace(machine, acknowledged=(*remaining, fault), back_spent=True)


def without_acknowledged(machine: Machine) -> Machine:
    """Return the machine without acknowledgements of faults that have ended."""
    if not machine.acknowledged:
        return machine
    # Compared by code and device: numbers change while it is the same fault. `alerts.is_acknowledged` checks whether
    # it has become worse.
    present = {(fault.code, fault.device) for fault in lasting(machine)}
    remaining = tuple(earlier for earlier in machine.acknowledged if (earlier.code, earlier.device) in present)
    return machine if len(remaining) == len(machine.acknowledged) else replace(machine, acknowledged=remaining)


def ask(machine: Machine) -> Machine:
    """Return the machine with the question on its screen, in any state; STAY ON is selected."""
    until_ns = machine.now_ns + seconds_ns(machine.settings.ask_off_s)
    return replace(machine, off_question=OffQuestion(Answer.STAY_ON, until_ns))


def unanswered(machine: Machine) -> Machine:
    """Return the machine without the question, if its time is over: the instrument stays on."""
    question = machine.off_question
    if question is None or machine.now_ns < question.until_ns:
        return machine
    return replace(machine, off_question=None)


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a key: UP and DOWN select, SCAN (OK) confirms the selected answer, BACK stays on."""
    question = machine.off_question
    if question is None:
        return machine, ()
    if key is Key.BACK:
        # Holding this press on must not ask again.
        return replace(machine, off_question=None, back_spent=True), ()
    if key is Key.SCAN:
        machine = replace(machine, off_question=None)
        # The question is removed first: during a save `stop` stays in its state, and the question would stay, too.
        return safety.stop(machine, Ending.POWER_OFF) if question.answer is Answer.SWITCH_OFF else (machine, ())
    selected = other_answer(machine, key)
    return (
        (machine, ()) if selected is None else (replace(machine, off_question=replace(question, answer=selected)), ())
    )


def other_answer(machine: Machine, key: Key) -> Answer | None:
    """Return the answer that UP or DOWN would select; ``None``: no change.

    If DOWN replaces a stuck BACK, UP selects both answers in turn.
    """
    if machine.off_question is None:
        return None
    match key:
        case Key.DOWN if machine.off_question.answer is Answer.STAY_ON:
            return Answer.SWITCH_OFF
        case Key.UP if machine.off_question.answer is Answer.SWITCH_OFF:
            return Answer.STAY_ON
        case Key.UP if Key.BACK in machine.stuck:
            return Answer.SWITCH_OFF
        case _:
            return None
