"""Owns the question that stands before every switching off that the diver wants: two answers, the harmless one selected.

Leak, heat and supply do not ask, nor does the operating system (``appliance.instrument.machine.safety``).
"""

from __future__ import annotations

from dataclasses import replace

from appliance.instrument.machine import safety
from appliance.instrument.machine.moves import Result
from appliance.instrument.machine.states import Answer, Ending, Machine, OffQuestion, seconds_ns
from drivers.api import Key


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
