"""Owns the calibration under way: its session on the disk, and its long computations in the background.

    CalibrationController    session, recordings and answers; neither a device nor a decision
    Background               one process for long computations, so that neither keys nor screen wait for them

A job is a function of a module, its arguments, and a progress; all of them travel between processes. One job is done at
a time, and the process stays warm for the next one. One that dies, or is no longer wanted, is killed; the next job
starts another.
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
    NotConverged,
    RecordingCheck,
    RecordingError,
    Session,
    SessionError,
    Solution,
    Step,
    Verified,
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
"""Priority of the process, behind the heartbeat, the cameras and the reconstruction."""

Job = Callable[..., Any]
"""Called with its arguments and a ``Progress``."""


class Background:
    """The parent's end. ``poll`` and all else are called by one thread, and none of it waits for the job."""

    def __init__(self) -> None:
        self._child = ChildProcess("kf-calibrate", _serve)
        self._ticket = 0
        self.busy = False
        """A job's answer is awaited."""

    def start(self) -> None:
        """Start the process where there is none, so that the first job finds it warm. Raises OSError."""
        if not self._child.runs:
            self._child.start()

    def ask(self, job: Job, *arguments: Any) -> None:
        """Begin a job; its answer comes through ``poll``. A job that was still running is given up."""
        if self.busy:
            self.stop()
        try:
            self.start()
        except OSError:
            self.busy = True  # poll says why
            return
        # An answer may be on its way already when the next job is asked for; its ticket tells that it is not this
        # one's.
        self._ticket += 1
        self.busy = True
        self._child.send((self._ticket, job, arguments))

    def poll(self) -> object | None:
        """Return the next thing that is known of the job that was asked for last: CalibrationProgressed, the Failure
        that it came to where it raised or its process is gone, or its answer."""
        if not self._child.runs:
            if self.busy:
                self.busy = False
                return Failure(FailureKind.BROKEN_OFF, "no process could be started; restart the instrument")
            return None
        try:
            # Past what earlier jobs still say, up to the first word on this one: one for each heartbeat is enough.
            while (message := self._child.receive()) is not None:
                outcome = self._of_this_job(message)
                if outcome is not None:
                    return outcome
        except ChildGone as gone:
            was_busy = self.busy
            self.stop()
            return Failure(FailureKind.BROKEN_OFF, str(gone)) if was_busy else None
        return None

    def _of_this_job(self, message: object) -> object | None:
        match message:
            case (int(ticket), _) if ticket != self._ticket or not self.busy:
                return None
            case (int(), outcome) if outcome is not None:
                self.busy = isinstance(outcome, on.CalibrationProgressed)
                return outcome
            case _:
                self.busy = False
                return Failure(FailureKind.BROKEN_OFF, f"it sent a {type(message).__name__}, which is no answer")

    def stop(self) -> None:
        """Give up the job, if there is one, and end the process."""
        self.busy = False
        self._child.stop()


def _serve(pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when to end
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # It may compute for minutes, on the processor that plays the patterns.
    os.nice(NICENESS)
    logging.disable()  # a job answers or raises; it has nobody to tell on the way
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
            except Exception as error:  # the one place where it can still be named
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
class _Changed:
    """The session on the disk; with the calibration in use and what is wrong with it, where that may have changed."""

    session: Session
    in_use: tuple[Calibration, tuple[Fault, ...]] | None = None


class CalibrationController:
    """Everything about the calibration that is neither a device nor a decision. A context manager."""

    def __init__(self, rig: Rig, scans: ScanController) -> None:
        """Disk work goes through the thread of ``scans``."""
        self._rig = rig
        self._scans = scans
        self._store = Calibrations(rig.storage.root, rig.rig.serial)
        self._background = Background()
        self._number = 0
        """Number of the recording that is examined."""
        self._verified: Verified | None = None
        """Length check of the latest recording of VERIFY."""
        self._passed: deque[str] = deque(maxlen=1)
        """Length checks that are on the disk and found lengths right, from the disk's thread: what they say."""
        self._answers: list[Future[_Changed]] = []
        self._events: list[on.Event] = []

    def __enter__(self) -> Self:
        self._ask(lambda: _Changed(self._store.session()))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._background.stop()

    # ------------------------------------------------------------------------------------- what is wanted

    def warm(self) -> None:
        """Somebody calibrates: let the first recording find the process ready."""
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
            # In the disk's thread, behind the publication: the session never names a scan that is not there (ADR 0020).
            session = self._store.session().with_check(replace(check, scan_id=scan_id))
            if check.step is Step.VERIFY:
                session = replace(session, verified=verified)
            session = self._store.write(session)
            if check.step is Step.VERIFY and session.right and session.length_error is not None:
                # Left for the heartbeat: the watch over the ray gaps is changed by one thread only.
                self._passed.append(f"VERIFY, scan {scan_id}: ball bar {100.0 * session.length_error:+.3f} %")
            return [session]

        self._scans.accept(number, verdict, entered)

    def solve(self) -> None:
        """Answer CalibrationProgressed, then the Session or a Failure."""
        self._background.ask(
            solve_calibration, self._rig, self._scans.calendar.today().utc.isoformat(timespec="seconds")
        )

    def use_solved(self) -> None:
        """Answer the Session or a Failure; the calibration in use is another from then on."""
        date = self._scans.calendar.today().utc.date().isoformat()
        # Read back from the disk behind the change: what is measured with from now on is what the next start would
        # find.
        self._ask(lambda: _Changed(self._store.use_solved(date), Instrument(self._rig).calibration()))

    def restore(self) -> None:
        """Go back to the file of before; answer as ``use_solved``."""
        self._ask(lambda: _Changed(self._store.restore(), Instrument(self._rig).calibration()))

    def begin(self) -> None:
        """Begin a new session; answer the Session or a Failure."""
        self._ask(lambda: _Changed(self._store.begin()))

    def cancel(self) -> None:
        """Give up what is computed: it is no longer wanted."""
        self._background.stop()

    # ------------------------------------------------------------------------------------- answers

    def poll(self) -> list[on.Event]:
        """Return what the disk and the background answered since the last call."""
        events, self._events = self._events, []
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        for answer in done:
            events += self._changed(answer)
        while self._passed:
            events += self._lengths_right(self._passed.popleft())
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
            # A job answers what it likes: one that fits nothing must not leave the diver waiting.
            case other:
                events.append(Failure(FailureKind.BROKEN_OFF, f"it answered with a {type(other).__name__}"))
        return events

    @property
    def busy(self) -> bool:
        """Something is on its way to the disk."""
        return bool(self._answers)

    def _lengths_right(self, evidence: str) -> list[on.Event]:
        """Answer an alarm of the ray gaps, as a bar was measured right: what they show now is normal."""
        write = self._scans.watch.answer(evidence)
        if write is None:
            return []
        log.info("ray gaps accepted: %s", evidence)
        self._scans.submit(lambda: write_trend(write))
        return [on.ConditionCleared(FaultCode.VERIFY_CALIBRATION)]

    def _solved(self, solution: Solution) -> None:
        for warning in solution.solved.warnings:
            log.warning("calibration: %s", warning)

        def write() -> _Changed:
            session = replace(self._store.session(), solved=solution.solved, verified=solution.verified)
            return _Changed(self._store.write_solved(solution.calibration, session, solution.report))

        self._ask(write)

    def _changed(self, answer: Future[_Changed]) -> list[on.Event]:
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
            # Cleared first, then raised where they hold for the new one: both conditions are about the calibration of
            # before.
            events += [on.ConditionCleared(code) for code in (FaultCode.UNCALIBRATED, FaultCode.VERIFY_CALIBRATION)]
            held = self._scans.watch.fault
            events += [on.ConditionRaised(fault) for fault in (*faults, held) if fault is not None]
        return events

    def _ask(self, work: Callable[[], _Changed]) -> None:
        self._answers.append(self._scans.submit(work))


def _failure(error: Exception) -> Failure:
    """Return what an exception means to the diver; one may have an ``about``, its subject in a word."""
    kind = _FAILURES.get(type(error), FailureKind.BROKEN_OFF)
    return Failure(kind, str(error) or type(error).__name__, str(getattr(error, "about", "")))


def _outcome(check: RecordingCheck) -> str:
    return "will do" if check.refusal is None else check.refusal.value
