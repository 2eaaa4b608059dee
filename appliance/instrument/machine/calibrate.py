"""Owns the decisions of CALIBRATE: which step comes next, what its keys mean, and what becomes of a recording."""

from __future__ import annotations

from dataclasses import replace

from appliance.calibrate import HELD, STEPS, RecordingCheck, Session, Step
from appliance.instrument.machine import effects as do
from appliance.instrument.machine.conditions import cleared, raised
from appliance.instrument.machine.moves import Result, enter
from appliance.instrument.machine.states import Calibrating, Failure, FailureKind, Machine, State, Task
from appliance.measure import Fault, FaultCode
from drivers.api import Key


def begin(machine: Machine) -> Result:
    """Go from AIM to the first step that is not done."""
    machine = enter(machine, State.CALIBRATE)
    return replace(machine, calibrating=Calibrating(machine.session.next_step)), ()


def records(machine: Machine) -> bool:
    """Tell whether the step has live views, and SCAN records."""
    return machine.calibrating is not None and machine.calibrating.step in HELD


def neighbour(machine: Machine, key: Key) -> Step | None:
    """Return the nearest step before or after that can be done, to which UP or DOWN leads."""
    at = machine.calibrating
    if at is None or at.task is not None or key not in (Key.UP, Key.DOWN):
        return None
    here = STEPS.index(at.step)
    there = STEPS[:here][::-1] if key is Key.UP else STEPS[here + 1 :]
    return next((step for step in there if machine.session.open(step)), None)


def decision(machine: Machine) -> do.Wish | None:
    """Return the effect that SCAN has at a step that records nothing."""
    at = machine.calibrating
    if at is None or at.task is not None:
        return None
    if at.step is Step.SOLVE:
        return do.Wish.SOLVE_CALIBRATION
    if at.step is Step.RESULT and machine.session.solved is not None:
        if not machine.session.in_use:
            return do.Wish.USE_SOLVED
        if machine.session.kept is not None:
            return do.Wish.RESTORE_KEPT
    return None


def may_begin_session(machine: Machine) -> bool:
    """Tell whether DOWN held puts the session away: at its end."""
    at = machine.calibrating
    return machine.state is State.CALIBRATE and at is not None and at.task is None and at.step is Step.RESULT


def pressed(machine: Machine, key: Key) -> Result:
    """Do what a key means at a step; SCAN at one that records is not among them, since that is a scan like any
    other."""
    at = machine.calibrating
    if at is None:  # cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    if key is Key.BACK:
        effects = cancelled(machine, "left by the diver")
        return enter(machine, State.AIM), effects
    if at.task is not None:
        return machine, ()
    # What became of the last recording stays on the screen until a key is pressed: by then it was read.
    at = replace(at, latest=None, failed=None)
    machine = replace(machine, calibrating=at)
    step = neighbour(machine, key)
    if step is not None:
        return replace(machine, calibrating=replace(at, step=step)), ()
    wanted = decision(machine) if key is Key.SCAN else None
    if wanted is None:
        return machine, ()
    if wanted is do.Wish.SOLVE_CALIBRATION:
        return _wait(machine, Task.SOLVE, machine.settings.solve_s), (wanted,)
    return _wait(machine, Task.SWITCH, machine.settings.saving_s), (wanted,)


def begin_session(machine: Machine) -> Result:
    """Put the session away for a new one, as DOWN was held at the result."""
    return _wait(machine, Task.SWITCH, machine.settings.saving_s), (do.Wish.BEGIN_SESSION,)


def captured(machine: Machine, number: int) -> Result:
    """Have a recording for the step stored, now that it is in memory."""
    machine = _wait(machine, Task.STORE, machine.settings.saving_s, number)
    # The worker decoded the frames while they came, and its cloud is not wanted: the artefact is looked for in
    # the stored frames, as it will be when the calibration is solved from them.
    return machine, (do.Wish.CANCEL_RECONSTRUCTION, do.StoreRaw(number))


def stored(machine: Machine, number: int) -> Result:
    """Go on once the recording's frames are on the disk."""
    at = machine.calibrating
    # Answers carry the number of the recording: one that comes after BACK, or for the recording before, finds
    # nobody waiting.
    if not _waits(machine, Task.STORE, number) or at is None:
        return machine, ()
    return _wait(machine, Task.EXAMINE, machine.settings.examine_s, number), (do.CheckRecording(number, at.step),)


def examined(machine: Machine, number: int, check: RecordingCheck) -> Result:
    """Take a recording that was judged into the session, or to the rejected ones with the reason on the screen."""
    at = machine.calibrating
    if not _waits(machine, Task.EXAMINE, number) or at is None or check.step is not at.step:
        return machine, ()
    if check.refusal is None:
        machine = _wait(machine, Task.ACCEPT, machine.settings.saving_s, number)
        machine = replace(machine, calibrating=replace(at, task=Task.ACCEPT, number=number, latest=check))
        # The step changes with the session only, which is sent after the fsync (ADR 0020): progress is what
        # the disk says.
        return machine, (do.AcceptRecording(number, check),)
    said = f"calibration {check.step.value}: {check.refusal.value}: {check.detail}"
    return _rest(machine, replace(at, latest=check)), (do.Reject(number, said),)


def not_saved(machine: Machine, number: int, reason: str) -> Result:
    """Go back to the step, as the disk refused the frames, or the scan."""
    at = machine.calibrating
    if at is None or at.number != number or machine.state is not State.CALIBRATE:
        return machine, ()
    return _rest(machine, replace(at, latest=None, failed=Failure(FailureKind.DISK, reason))), ()


def session_changed(machine: Machine, session: Session) -> Result:
    """Go on to what is next in the session that the disk holds now."""
    machine = _judge_lengths(replace(machine, session=session))
    at = machine.calibrating
    if machine.state is not State.CALIBRATE or at is None:
        return machine, ()
    # VERIFY may be recorded again and again; `next_step` would lead to what is still to be done instead of to its
    # result.
    if at.task is Task.ACCEPT and at.step is Step.VERIFY and session.open(Step.RESULT):
        return _rest(machine, replace(at, step=Step.RESULT)), ()
    if at.task in (Task.ACCEPT, Task.SOLVE, Task.SWITCH):
        return _rest(machine, replace(at, step=session.next_step)), ()
    if not session.open(at.step):
        # Nobody's answer, as when a scan that the session names was moved away: the step may not be possible any
        # more.
        return _rest(machine, replace(at, step=session.next_step)), cancelled(machine, "the session changed")
    return machine, ()


def _judge_lengths(machine: Machine) -> Machine:
    """Tell of a bar that was measured wrongly until one is measured right, or another calibration is in use."""
    error = machine.session.length_error
    if not machine.session.wrong or error is None:
        return cleared(machine, FaultCode.LENGTH_ERROR)
    percent = 100.0 * abs(error)
    said = f"the ball bar of VERIFY came out wrong by {100.0 * error:+.3f} %"
    return raised(machine, Fault(FaultCode.LENGTH_ERROR, said, {"error_percent": percent}))


def progressed(machine: Machine, progress: float) -> Machine:
    """Take over how far the adjustment is."""
    at = machine.calibrating
    if at is None or at.task is not Task.SOLVE:
        return machine
    return replace(machine, calibrating=replace(at, progress=progress))


def failed(machine: Machine, failure: Failure) -> Result:
    """End the latest task, which came to nothing."""
    at = machine.calibrating
    if machine.state is not State.CALIBRATE or at is None or at.task is None:
        return machine, ()
    return _rest(machine, replace(at, latest=None, failed=failure)), _dropped(at, failure.detail)


def late(machine: Machine) -> Result:
    """Give the task up, as nobody answered in time."""
    at = machine.calibrating
    if at is None or at.task is None:
        return replace(machine, deadline_ns=None), ()
    said = f"no answer in time ({at.task.value})"
    return _rest(machine, replace(at, latest=None, failed=Failure(FailureKind.NO_ANSWER, said))), cancelled(
        machine, said
    )


def cancelled(machine: Machine, reason: str) -> tuple[do.Effect, ...]:
    """Return the effects that end the step's task; what is being written to the disk is finished all the same."""
    at = machine.calibrating
    # ACCEPT and SWITCH are short and change the session on the disk: they run to their end, whoever left the
    # screen.
    if at is None or at.task not in (Task.STORE, Task.EXAMINE, Task.SOLVE):
        return ()
    return do.Wish.CANCEL_CALIBRATION, *_dropped(at, reason)


def _dropped(at: Calibrating, reason: str) -> tuple[do.Effect, ...]:
    if at.task in (Task.STORE, Task.EXAMINE) and at.number is not None:
        return (do.Reject(at.number, f"calibration {at.step.value}: {reason}"),)
    return ()


def _waits(machine: Machine, task: Task, number: int) -> bool:
    at = machine.calibrating
    return machine.state is State.CALIBRATE and at is not None and (at.task, at.number) == (task, number)


def _wait(machine: Machine, task: Task, timeout_s: float, number: int | None = None) -> Machine:
    at = machine.calibrating
    machine = enter(machine, State.CALIBRATE, timeout_s)
    if at is None:
        return machine
    return replace(machine, calibrating=replace(at, task=task, number=number, progress=None, latest=None, failed=None))


def _rest(machine: Machine, at: Calibrating) -> Machine:
    machine = enter(machine, State.CALIBRATE)
    return replace(machine, calibrating=replace(at, task=None, number=None, progress=None))
