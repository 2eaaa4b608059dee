"""The calibration in water: its session on the disk, and its long computations in the background.

    CalibrationController    session, recordings and answers
    Background               one process for long computations, so that neither keys nor screen wait for them

A job is a function of a module, its arguments, and a progress callback; all are sent between processes. One job runs at
a time, and the process stays warm for the next one. A process that died, or whose job is no longer needed, is replaced.
"""

from __future__ import annotations

import logging
import os
import signal
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

from appliance.calibrate import (
    Calibrations,
    CamerasDiffer,
    CertificateMissing,
    Examination,
    LengthCheck,
    NotConverged,
    RecordingCheck,
    RecordingError,
    Session,
    SessionError,
    Solution,
    Step,
    examine_recording,
    solve_calibration,
)
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Failure, FailureKind
from appliance.instrument.service.scans import ScanController
from appliance.instrument.service.watches import write_trend
from appliance.instrument.worker.child import ChildGone, ChildProcess
from appliance.measure import Calibration, CalibrationError, Fault, FaultCode, Verdict
from appliance.store import Instrument, Rig, ScanError, StorageError

NICENESS = 10
"""Priority of the process, below the service, the cameras and the worker."""

Job = Callable[..., Any]
"""Called with its arguments and a ``Progress``."""


class Background:
    """The parent's end. Called by one thread; never waits for the job."""

    def __init__(self) -> None:
        self._child = ChildProcess("kf-calibrate", _serve)
        self._ticket = 0
        self.busy = False
        """True while the result of a job is awaited."""

    def start(self) -> None:
        """Start the process if there is none, to warm it for the first job. Raises OSError."""
        if not self._child.runs:
            self._child.start()

    def ask(self, job: Job, *arguments: Any) -> None:
        """Begin a job; its result comes through ``poll``. A job that was still running is given up."""
        if self.busy:
            self.stop()
        try:
            self.start()
        except OSError:
            self.busy = True  # poll returns the failure
            return
        # The ticket distinguishes this job's result from one of an earlier job that is still on its way.
        self._ticket += 1
        self.busy = True
        self._child.send((self._ticket, job, arguments))

    def poll(self) -> object | None:
        """Return the next message about the latest job, or ``None``.

        It is CalibrationProgressed, the job's result, or a Failure if the job raised or its process ended.
        """
        if not self._child.runs:
            if self.busy:
                self.busy = False
                return Failure(FailureKind.BROKEN_OFF, "no process could be started; restart the instrument")
            return None
        try:
            # Messages of earlier jobs are skipped; one message of this job for each cycle is enough.
            while (message := self._child.receive()) is not None:
                outcome = self._result_of(message)
                if outcome is not None:
                    return outcome
        except ChildGone as gone:
            was_busy = self.busy
            self.stop()
            return Failure(FailureKind.BROKEN_OFF, str(gone)) if was_busy else None
        return None

    def _result_of(self, message: object) -> object | None:
        match message:
            case (int(ticket), _) if ticket != self._ticket or not self.busy:
                return None
            case (int(), outcome) if outcome is not None:
                self.busy = isinstance(outcome, on.CalibrationProgressed)
                return outcome
            case _:
                self.busy = False
                return Failure(FailureKind.BROKEN_OFF, f"it sent a {type(message).__name__}, no valid answer")

    def stop(self) -> None:
        """Give up the job, if there is one, and end the process."""
        self.busy = False
        self._child.stop()


def _serve(pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when to end
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # A job may compute for minutes, on the processor that plays the patterns.
    os.nice(NICENESS)
    logging.disable()  # a job returns or raises; it has no log
    try:
        while True:
            ticket, job, arguments = pipe.recv()

            def report(what: str, fraction: float | None = None, /, ticket: int = ticket) -> None:
                if fraction is not None:
                    pipe.send((ticket, on.CalibrationProgressed(fraction)))

            try:
                outcome = job(*arguments, report)
            except (EOFError, BrokenPipeError):
                raise
            except Exception as error:  # the last place where it can be reported
                outcome = _failure(error)
            pipe.send((ticket, outcome))
    except (EOFError, OSError):
        return  # the parent closed the pipe: the normal end


log = logging.getLogger("kingfisher")

_FAILURES = {
    RecordingError: FailureKind.RECORDING,
    CertificateMissing: FailureKind.CERTIFICATE,
    CamerasDiffer: FailureKind.CAMERAS,
    NotConverged: FailureKind.NO_SOLUTION,
    ScanError: FailureKind.RECORDING,
    CalibrationError: FailureKind.FILES,
    SessionError: FailureKind.FILES,
    StorageError: FailureKind.DISK,
}
"""Kinds of failure by an exception's class."""


@dataclass(frozen=True, slots=True)
class _SessionChange:
    """The session on the disk, and the calibration in use with its faults, if it may have changed."""

    session: Session
    in_use: tuple[Calibration, tuple[Fault, ...]] | None = None


class CalibrationController:
    """Control of the calibration in water. A context manager."""

    def __init__(self, rig: Rig, scans: ScanController) -> None:
        """Prepare; disk work runs in the thread of ``scans``."""
        self._rig = rig
        self._scans = scans
        self._store = Calibrations(rig.storage.root, rig.rig.serial)
        self._background = Background()
        self._number = 0
        """Number of the recording that is examined."""
        self._verified: LengthCheck | None = None
        """Length check of the latest recording of VERIFY."""
        self._right_lengths: deque[str] = deque(maxlen=1)
        """Descriptions of stored length checks with right lengths, from the disk's thread."""
        self._answers: list[Future[_SessionChange]] = []
        self._events: list[on.Event] = []

    def __enter__(self) -> Self:
        self._submit(lambda: _SessionChange(self._store.session()))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._background.stop()

    # ------------------------------------------------------------------------------------- what is wanted

    def warm(self) -> None:
        """Start the process for the first recording, as the diver begins to calibrate."""
        try:
            self._background.start()
        except OSError as error:
            log.warning("no process for calibrating yet: %s", error)

    def examine(self, number: int, step: Step) -> None:
        """Answer TrialExamined or a Failure."""
        folder = self._scans.folder(number)
        if folder is None:
            reason = "the recording is not on the disk; record it again"
            self._events.append(Failure(FailureKind.RECORDING, reason))
            return
        self._number = number
        self._background.ask(examine_recording, self._rig, step, folder)

    def accept(self, number: int, check: RecordingCheck) -> None:
        """Publish the scan and enter it into the session; answer the Session or SaveFailed."""
        numbers = {"points": float(check.points), "rms_mm": check.number}
        verdict = Verdict("calibration", True, numbers, f"{check.step.value}: {check.detail}")
        verified = self._verified

        def entered(scan_id: str) -> list[on.Event]:
            # In the disk's thread, after the publication: the session only names scans on the disk (ADR 0020).
            session = self._store.session().with_check(replace(check, scan_id=scan_id))
            if check.step is Step.VERIFY:
                session = replace(session, verified=verified)
            session = self._store.write(session)
            if check.step is Step.VERIFY and session.right and session.length_error is not None:
                # Left for the service's thread, which alone changes the trend of the ray gaps.
                self._right_lengths.append(f"VERIFY, scan {scan_id}: ball bar {100.0 * session.length_error:+.3f} %")
            return [session]

        self._scans.accept(number, verdict, entered)

    def solve(self) -> None:
        """Answer CalibrationProgressed, then the Session or a Failure."""
        self._background.ask(
            solve_calibration, self._rig, self._scans.calendar.today().utc.isoformat(timespec="seconds")
        )

    def use_solved(self) -> None:
        """Put the solved calibration in use; answer the Session or a Failure."""
        date = self._scans.calendar.today().utc.date().isoformat()
        # Read back from the disk after the change, so that the calibration in use is that of the next start.
        self._submit(lambda: _SessionChange(self._store.use_solved(date), Instrument(self._rig).calibration()))

    def restore(self) -> None:
        """Put the former file in use again; answer as ``use_solved``."""
        self._submit(lambda: _SessionChange(self._store.restore(), Instrument(self._rig).calibration()))

    def begin(self) -> None:
        """Begin a new session; answer the Session or a Failure."""
        self._submit(lambda: _SessionChange(self._store.begin()))

    def cancel(self) -> None:
        """Give up the computation, which is no longer needed."""
        self._background.stop()

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> list[on.Event]:
        """Return the answers of disk and background since the last call."""
        events, self._events = self._events, []
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        for answer in done:
            events += self._changed(answer)
        while self._right_lengths:
            events += self._lengths_right(self._right_lengths.popleft())
        match self._background.poll():
            case on.CalibrationProgressed() as progressed:
                events.append(progressed)
            case Examination(check, verified):
                log.info("calibration %s: %s (%s)", check.step.value, _outcome(check), check.detail)
                self._verified = verified
                events.append(on.TrialExamined(self._number, check))
            case Solution() as solution:
                self._solved(solution)
            case Failure() as failure:
                log.warning("calibration: %s", failure.detail)
                events.append(failure)
            case None:
                pass
            # An unexpected result must not leave the diver waiting.
            case result:
                events.append(Failure(FailureKind.BROKEN_OFF, f"its answer is a {type(result).__name__}"))
        return events

    @property
    def busy(self) -> bool:
        """True while disk work is pending."""
        return bool(self._answers)

    def _lengths_right(self, evidence: str) -> list[on.Event]:
        """End the alarm of the ray gaps, as a bar was measured right: they count as normal from now on."""
        write = self._scans.watch.answer(evidence)
        if write is None:
            return []
        log.info("ray gaps accepted: %s", evidence)
        self._scans.submit(lambda: write_trend(write))
        return [on.ConditionCleared(FaultCode.VERIFY_CALIBRATION)]

    def _solved(self, solution: Solution) -> None:
        for warning in solution.solved.warnings:
            log.warning("calibration: %s", warning)

        def write() -> _SessionChange:
            session = replace(self._store.session(), solved=solution.solved, verified=solution.verified)
            return _SessionChange(self._store.write_solved(solution.calibration, session, solution.report))

        self._submit(write)

    def _changed(self, answer: Future[_SessionChange]) -> list[on.Event]:
        try:
            changed = answer.result()
        except (StorageError, SessionError, CalibrationError) as error:
            log.warning("calibration: %s", error)
            return [_failure(error)]
        events: list[on.Event] = [changed.session]
        if changed.in_use is not None:
            calibration, faults = changed.in_use
            log.info("in use: %s of %s", calibration.method, calibration.made_at)
            self._scans.use(calibration)
            # Both conditions refer to the former calibration: they are cleared, and raised again if they hold for the
            # new one.
            events += [on.ConditionCleared(code) for code in (FaultCode.UNCALIBRATED, FaultCode.VERIFY_CALIBRATION)]
            alarm = self._scans.watch.fault
            events += [on.ConditionRaised(fault) for fault in (*faults, alarm) if fault is not None]
        return events

    def _submit(self, work: Callable[[], _SessionChange]) -> None:
        self._answers.append(self._scans.submit(work))


def _failure(error: Exception) -> Failure:
    """Return the failure of an exception; its attribute ``about``, if any, names the step."""
    kind = _FAILURES.get(type(error), FailureKind.BROKEN_OFF)
    return Failure(kind, str(error) or type(error).__name__, str(getattr(error, "about", "")))


def _outcome(check: RecordingCheck) -> str:
    return "will do" if check.refusal is None else check.refusal.value
