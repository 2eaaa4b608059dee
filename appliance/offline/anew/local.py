"""Owns the processes of this computer that work scans through: each does one at a time, and may die, hang or grow.

A process that dies takes only its own scan with it, and it is known which that was; one that takes too long is ended, and one that
has grown is replaced between two scans.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from appliance.offline.anew.coordinator import Ended
from appliance.offline.anew.task import Job

MOST_MB = 3000
"""Memory of a process that is replaced before its next scan; one that works scans through one by one stays below 1500."""
END_S = 10.0
HERE = "this computer"
"""Name of the only place."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    pipe: Connection
    job: Job | None = None
    until_s: float = 0.0


class LocalEngine:
    """``processes`` processes; a job that takes longer than ``limit_s`` comes back. A context manager."""

    def __init__(self, processes: int, limit_s: float) -> None:
        self._limit_s = limit_s
        self._left_out: str | None = None
        # Not fork: it copies locks that other threads hold, and none of the threads that would release them.
        self._context = multiprocessing.get_context("spawn")
        self._workers = [self._begun() for _ in range(processes)]

    def __enter__(self) -> LocalEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def process_ids(self) -> list[int]:
        """Numbers of the processes, in order."""
        return [worker.process.pid or 0 for worker in self._workers]

    @property
    def others_may_come(self) -> bool:
        """False: it is this computer alone."""
        return False

    def places(self) -> Mapping[str, str | None]:
        """Do what ``Engine`` promises: all processes are one place, for they share everything that refuses."""
        return {HERE: self._left_out}

    def leave_out(self, place: str, reason: str) -> None:
        """Do what ``Engine`` promises."""
        del place
        self._left_out = reason

    def room(self) -> int:
        """Do what ``Engine`` promises."""
        if self._left_out is not None:
            return 0
        return sum(worker.job is None for worker in self._workers)

    def at_once(self, waiting: int) -> int:
        """Do what ``Engine`` promises: a job through a pipe costs nothing that would be saved."""
        del waiting
        return 1

    def start(self, jobs: Sequence[Job]) -> None:
        """Do what ``Engine`` promises."""
        (job,) = jobs
        worker = next(worker for worker in self._workers if worker.job is None)
        worker.job, worker.until_s = job, time.monotonic() + self._limit_s
        with suppress(OSError):  # it died in between: its pipe says so where answers are waited for
            worker.pipe.send(job)

    def ended(self, timeout_s: float) -> list[Ended]:
        """Do what ``Engine`` promises."""
        busy = {worker.pipe: worker for worker in self._workers if worker.job is not None}
        found = []
        for pipe in wait(list(busy), timeout_s):
            assert isinstance(pipe, Connection)
            found.append(self._heard(busy[pipe]))
        for worker in self._workers:
            if worker.job is not None and time.monotonic() > worker.until_s:
                found.append(Ended(worker.job, None, f"not done after {self._limit_s:.0f} s"))
                self._replace(worker)
        return found

    def close(self) -> None:
        """Do what ``Engine`` promises."""
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join(END_S)
            worker.pipe.close()
        self._workers = []

    def _heard(self, worker: _Worker) -> Ended:
        assert worker.job is not None
        job = worker.job
        try:
            row = worker.pipe.recv()
        except (EOFError, OSError):
            worker.process.join(END_S)
            code = worker.process.exitcode
            self._replace(worker)
            return Ended(job, None, f"the process that worked on it ended with code {code}")
        worker.job = None
        if row.get("peak_mb", 0) > MOST_MB:
            self._replace(worker)
        return Ended(job, row, place=HERE)

    def _replace(self, worker: _Worker) -> None:
        worker.process.kill()
        worker.process.join(END_S)
        worker.pipe.close()
        new = self._begun()
        worker.process, worker.pipe, worker.job = new.process, new.pipe, None

    def _begun(self) -> _Worker:
        mine, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
        # This side's copy of their end: left open, the pipe would not end with the process, and its death not be noticed.
        theirs.close()
        return _Worker(process, mine)


def _serve(pipe: Connection) -> None:
    """Serve as a worker: a job in, its row out, until the pipe closes."""
    from appliance.offline.anew.task import attempt

    try:
        while True:
            pipe.send(attempt(pipe.recv()))
    except (EOFError, OSError, KeyboardInterrupt):
        pass  # nothing is left to be done
