"""Owns one process for long computations, so that neither keys nor screen wait for them. It does one job at a time.

A job is a function of a module, its arguments, and a way to say how far it is; all of them travel between processes. The
process stays warm for the next job. One that dies, or is no longer wanted, is killed; the next job starts another.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from appliance.instrument.worker.child import ChildGone, ChildProcess

NICENESS = 10
"""Priority of the process, behind the heartbeat, the cameras and the reconstruction."""

Report = Callable[[float], None]
Job = Callable[..., Any]
"""Called with its arguments and a ``Report``, which takes 0..1."""


@dataclass(frozen=True, slots=True)
class Progressed:
    """The job is so far."""

    progress: float


@dataclass(frozen=True, slots=True)
class Done:
    """The job's answer."""

    answer: Any


@dataclass(frozen=True, slots=True)
class Failed:
    """The job raised, or its process is gone; why, in words."""

    reason: str
    error: str | None = None
    """Name of the exception's class, where the job raised one."""
    about: str = ""
    """The subject of the exception in a word, where it has an ``about``."""


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

    def poll(self) -> Progressed | Done | Failed | None:
        """Return the next thing it says about the job that was asked for last."""
        if not self._child.runs:
            if self.busy:
                self.busy = False
                return Failed("no process could be started; restart the instrument")
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
            return Failed(str(gone)) if was_busy else None
        return None

    def _of_this_job(self, message: object) -> Progressed | Done | Failed | None:
        match message:
            case (int(ticket), outcome) if ticket != self._ticket or not self.busy:
                return None
            case (int(), Progressed() | Done() | Failed() as outcome):
                self.busy = isinstance(outcome, Progressed)
                return outcome
            case _:
                self.busy = False
                return Failed(f"it sent a {type(message).__name__}, which is no answer")

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

            def report(progress: float, ticket: int = ticket) -> None:
                pipe.send((ticket, Progressed(progress)))

            try:
                outcome: Done | Failed = Done(job(*arguments, report))
            except (EOFError, BrokenPipeError):
                raise
            except Exception as error:  # the one place where it can still be named
                about = str(getattr(error, "about", ""))
                outcome = Failed(str(error) or type(error).__name__, type(error).__name__, about)
            pipe.send((ticket, outcome))
    except (EOFError, OSError):
        return  # the parent closed the pipe: the normal end
