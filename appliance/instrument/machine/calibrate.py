"""Decisions of CALIBRATE: the next step, the effect of its keys, and the fate of a recording."""

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
    """Return True if the step has live views, and SCAN records."""
    return machine.calibrating is not None and machine.calibrating.step in HELD


def neighbour(machine: Machine, key: Key) -> Step | None:
    """Return the nearest available step to which UP or DOWN leads."""
    position = machine.calibrating
    if position is None or position.task is not None or key not in (Key.UP, Key.DOWN):
        return None
    index = STEPS.index(position.step)
    steps = STEPS[:index][::-1] if key is Key.UP else STEPS[index + 1 :]
    return next((step for step in steps if machine.session.open(step)), None)


def decision(machine: Machine) -> do.Wish | None:
    """Return the effect of SCAN at a step without a recording."""
    position = machine.calibrating
    if position is None or position.task is not None:
        return None
    if position.step is Step.SOLVE:
        return do.Wish.SOLVE_CALIBRATION
    if position.step is Step.RESULT and machine.session.solved is not None:
        if not machine.session.in_use:
            return do.Wish.USE_SOLVED
        if machine.session.kept is not None:
            return do.Wish.RESTORE_KEPT
    return None


def may_begin_session(machine: Machine) -> bool:
    """Return True if holding DOWN puts the session away: at its end."""
    position = machine.calibrating
    return (
        machine.state is State.CALIBRATE
        and position is not None
        and position.task is None
        and position.step is Step.RESULT
    )


def pressed(machine: Machine, key: Key) -> Result:
    """Handle a key at a step, except SCAN at one that records, which is a scan like any other."""
    position = machine.calibrating
    if position is None:  # cannot be reached; if it were, the way out is AIM
        return enter(machine, State.AIM), ()
    if key is Key.BACK:
        effects = cancelled(machine, "ended by the diver")
        return enter(machine, State.AIM), effects
    if position.task is not None:
        return machine, ()
    # The result of the last recording stays on the screen until a key is pressed: by then it was read.
    position = replace(position, latest=None, failed=None)
    machine = replace(machine, calibrating=position)
    step = neighbour(machine, key)
    if step is not None:
        return replace(machine, calibrating=replace(position, step=step)), ()
    effect = decision(machine) if key is Key.SCAN else None
    if effect is None:
        return machine, ()
    if effect is do.Wish.SOLVE_CALIBRATION:
        return _wait(machine, Task.SOLVE, machine.settings.solve_s), (effect,)
    return _wait(machine, Task.SWITCH, machine.settings.saving_s), (effect,)


def begin_session(machine: Machine) -> Result:
    """Put the session away for a new one, as DOWN was held at the result."""
    return _wait(machine, Task.SWITCH, machine.settings.saving_s), (do.Wish.BEGIN_SESSION,)


def captured(machine: Machine, number: int) -> Result:
    """Store the recording for the step, now that it is in memory."""
    machine = _wait(machine, Task.STORE, machine.settings.saving_s, number)
    # The worker's cloud of these frames is not needed: the artefact is searched for in the stored frames, as it is
    # when the calibration is solved.
    return machine, (do.Wish.CANCEL_RECONSTRUCTION, do.StoreRaw(number))


def stored(machine: Machine, number: int) -> Result:
    """Have the recording examined, once its frames are on the disk."""
    position = machine.calibrating
    # Answers carry the number of the recording: one that comes after BACK, or for an earlier recording, is ignored.
    if not _waits(machine, Task.STORE, number) or position is None:
        return machine, ()
    return _wait(machine, Task.EXAMINE, machine.settings.examine_s, number), (do.CheckRecording(number, position.step),)


def examined(machine: Machine, number: int, check: RecordingCheck) -> Result:
    """Accept an examined recording into the session, or reject it with the reason on the screen."""
    position = machine.calibrating
    if not _waits(machine, Task.EXAMINE, number) or position is None or check.step is not position.step:
        return machine, ()
    if check.refusal is None:
        machine = _wait(machine, Task.ACCEPT, machine.settings.saving_s, number)
        machine = replace(machine, calibrating=replace(position, task=Task.ACCEPT, number=number, latest=check))
        # The step changes only with the session, which is sent after the fsync (ADR 0020): progress is shown when
        # it is durable.
        return machine, (do.AcceptRecording(number, check),)
    reason = f"calibration {check.step.value}: {check.refusal.value}: {check.detail}"
    return _end_task(machine, replace(position, latest=check)), (do.Reject(number, reason),)


def not_saved(machine: Machine, number: int, reason: str) -> Result:
    """Go back to the step, as the disk refused the frames or the scan."""
    position = machine.calibrating
    if position is None or position.number != number or machine.state is not State.CALIBRATE:
        return machine, ()
    return _end_task(machine, replace(position, latest=None, failed=Failure(FailureKind.DISK, reason))), ()


def session_changed(machine: Machine, session: Session) -> Result:
    """Go on to the next step of the session that is on the disk now."""
    machine = _judge_lengths(replace(machine, session=session))
    position = machine.calibrating
    if machine.state is not State.CALIBRATE or position is None:
        return machine, ()
    # VERIFY may be recorded again and again; `next_step` would lead past its result to the next open step.
    if position.task is Task.ACCEPT and position.step is Step.VERIFY and session.open(Step.RESULT):
        return _end_task(machine, replace(position, step=Step.RESULT)), ()
    if position.task in (Task.ACCEPT, Task.SOLVE, Task.SWITCH):
        return _end_task(machine, replace(position, step=session.next_step)), ()
    if not session.open(position.step):
        # No answer to a task: a scan of the session was moved away, and the step may no longer be possible.
        return _end_task(machine, replace(position, step=session.next_step)), cancelled(machine, "the session changed")
    return machine, ()


def _judge_lengths(machine: Machine) -> Machine:
    """Raise LENGTH_ERROR until a bar is measured right, or another calibration is in use."""
    error = machine.session.length_error
    if not machine.session.wrong or error is None:
        return cleared(machine, FaultCode.LENGTH_ERROR)
    percent = 100.0 * abs(error)
    detail = f"the length error of the ball bar of VERIFY is {100.0 * error:+.3f} %"
    return raised(machine, Fault(FaultCode.LENGTH_ERROR, detail, {"error_percent": percent}))


def progressed(machine: Machine, progress: float) -> Machine:
    """Record the progress of the adjustment."""
    position = machine.calibrating
    if position is None or position.task is not Task.SOLVE:
        return machine
    return replace(machine, calibrating=replace(position, progress=progress))


def failed(machine: Machine, failure: Failure) -> Result:
    """End the latest task, which failed."""
    position = machine.calibrating
    if machine.state is not State.CALIBRATE or position is None or position.task is None:
        return machine, ()
    return _end_task(machine, replace(position, latest=None, failed=failure)), _dropped(position, failure.detail)


def late(machine: Machine) -> Result:
    """Give up the task, as no answer came in time."""
    position = machine.calibrating
    if position is None or position.task is None:
        return replace(machine, deadline_ns=None), ()
    reason = f"no answer in time ({position.task.value})"
    return _end_task(machine, replace(position, latest=None, failed=Failure(FailureKind.NO_ANSWER, reason))), cancelled(
        machine, reason
    )


def cancelled(machine: Machine, reason: str) -> tuple[do.Effect, ...]:
    """Return the effects that end the step's task; a write to the disk in progress is finished."""
    position = machine.calibrating
    # ACCEPT and SWITCH are short and change the session on the disk: they run to their end even if the diver leaves.
    if position is None or position.task not in (Task.STORE, Task.EXAMINE, Task.SOLVE):
        return ()
    return do.Wish.CANCEL_CALIBRATION, *_dropped(position, reason)


def _dropped(position: Calibrating, reason: str) -> tuple[do.Effect, ...]:
    if position.task in (Task.STORE, Task.EXAMINE) and position.number is not None:
        return (do.Reject(position.number, f"calibration {position.step.value}: {reason}"),)
    return ()


def _waits(machine: Machine, task: Task, number: int) -> bool:
    position = machine.calibrating
    return (
        machine.state is State.CALIBRATE and position is not None and (position.task, position.number) == (task, number)
    )


def _wait(machine: Machine, task: Task, timeout_s: float, number: int | None = None) -> Machine:
    position = machine.calibrating
    machine = enter(machine, State.CALIBRATE, timeout_s)
    if position is None:
        return machine
    return replace(
        machine, calibrating=replace(position, task=task, number=number, progress=None, latest=None, failed=None)
    )


def _end_task(machine: Machine, position: Calibrating) -> Machine:
    machine = enter(machine, State.CALIBRATE)
    return replace(machine, calibrating=replace(position, task=None, number=None, progress=None))
