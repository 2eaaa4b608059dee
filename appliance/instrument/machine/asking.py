"""Owns two answers of the diver: to the question before every switching off, and to a lasting warning.

    ask, pressed, unanswered               the question whether to switch off; STAY ON is selected first
    pending_fault, with_acknowledged, …    BACK takes the warning that is shown in full for known, and does nothing else

Leak, heat and supply do not ask, nor does the operating system (``appliance.instrument.machine.safety``).

Of a warning that is known a small mark is left on every screen. It is shown in full again when it comes anew, for
another reason, or noticeably worse. What is critical stays as it is for as long as it lasts.
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


def with_acknowledged(machine: Machine, fault: Fault) -> Machine:
    """Return the machine with ``fault`` known as it is now. Held on, the same press means nothing more."""
    others = tuple(was for was in machine.seen if (was.code, was.device) != (fault.code, fault.device))
    return replace(machine, seen=(*others, fault), back_spent=True)


def without_acknowledged(machine: Machine) -> Machine:
    """Return the machine without what was acknowledged and has ended: when it comes again, it is news."""
    if not machine.seen:
        return machine
    # By code and device alone: numbers that change are still the same fault. Whether it has become worse is asked
    # by `alerts.seen`.
    there = {(fault.code, fault.device) for fault in lasting(machine)}
    seen = tuple(was for was in machine.seen if (was.code, was.device) in there)
    return machine if len(seen) == len(machine.seen) else replace(machine, seen=seen)


def ask(machine: Machine) -> Machine:
    """Return the machine with the question on its screen, in whatever state it is; STAY ON is selected."""
    until_ns = machine.now_ns + seconds_ns(machine.settings.ask_off_s)
    return replace(machine, off_question=OffQuestion(Answer.STAY_ON, until_ns))


def unanswered(machine: Machine) -> Machine:
    """Return the machine without the question, if nobody answered it in time: it stays on."""
    question = machine.off_question
    if question is None or machine.now_ns < question.until_ns:
        return machine
    return replace(machine, off_question=None)


def pressed(machine: Machine, key: Key) -> Result:
    """UP and DOWN select, SCAN (OK) takes what is selected, BACK stays on."""
    question = machine.off_question
    if question is None:
        return machine, ()
    if key is Key.BACK:
        # Held on, this press must not ask again.
        return replace(machine, off_question=None, back_spent=True), ()
    if key is Key.SCAN:
        machine = replace(machine, off_question=None)
        # The question goes first: where a save is under way `stop` stays in the state it is in, and it would stay
        # on its screen.
        return safety.stop(machine, Ending.POWER_OFF) if question.answer is Answer.SWITCH_OFF else (machine, ())
    other = other_answer(machine, key)
    return (machine, ()) if other is None else (replace(machine, off_question=replace(question, answer=other)), ())


def other_answer(machine: Machine, key: Key) -> Answer | None:
    """Return the answer that UP or DOWN would select; ``None``: nothing else. Where DOWN stands in for a stuck BACK, UP
    leads to both answers."""
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
