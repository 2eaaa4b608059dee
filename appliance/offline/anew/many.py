"""Owns the work of many computers through a scheduler of Dask's: who warms their kernels, and what happens when one of them fails.

Workers are started by ``dask worker ADDRESS --nthreads 1``, on computers with the same program and the same paths. A worker that dies
is missed by the scheduler, which gives its scans to others. One that hangs is noticed here: a scan that takes too long is given to
another worker besides, and whoever publishes first is right. When the scheduler itself is lost, everything in work comes back, and goes
out again as soon as there is one at the same address. Each worker is asked once whether it can do such scans at all, before it gets any.
"""

from __future__ import annotations

import itertools
import pickle
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from appliance.offline.anew.coordinator import Ended
from appliance.offline.anew.hosts import MOST_S, WORKER, greeting, warmed_attempts
from appliance.offline.anew.results import Row
from appliance.offline.anew.task import Job
from appliance.surface.libraries import needed

CONNECT_S = 30.0
SCHEDULER_BACK_S = 600.0
"""Time that a scheduler may stay away before the work is given up."""
RETRY_S = 1.0
LOOK_S = 5.0
"""Pause between two questions to the scheduler about its workers; until then a new one waits. Each costs both of them milliseconds."""
UNASKED_S = 60.0
"""Pause between two reports about all workers that the client fetches of its own accord; nobody reads them here."""
PER_THREAD = 2
"""Tasks in work for each thread of the workers: one that is done, and one that waits beside it."""
TASK_S = 4.0
"""Scans that are quicker share a task until it takes about so long: scheduler, worker and caller need some 10 ms a task."""
MOST_AT_ONCE = 8
TASKS_LEFT = 4
"""Tasks of each thread that shall be left when so many share one, so that all threads end at about the same time."""
MOST_IN_WORK = 10_000
COPIES = 3
ASK_S, END_S = 30.0, 10.0


class SchedulerError(Exception):
    """The scheduler cannot be reached, or stayed away; the text says which and what to do."""


@dataclass(slots=True)
class _InWork:
    jobs: tuple[Job, ...]
    begun_s: float
    futures: list[Any] = field(default_factory=list)
    only: frozenset[str] | None = None
    """Workers that alone may do it; ``None``: any."""


@dataclass(slots=True)
class _Member:
    """One worker, as its scheduler knows it now."""

    threads: int
    asked: Any
    """Future of its answer whether it can do such scans."""
    asked_s: float
    able: bool = False
    reason: str | None = None
    """Why it gets no scans."""


class ManyEngine:
    """Workers of the scheduler at ``address``; a job that takes longer than ``limit_s`` is begun once more elsewhere. A context manager.

    ``like``: a job as all of them are. Raises MissingLibraryError, SchedulerError.
    """

    def __init__(self, address: str, limit_s: float, like: Job) -> None:
        self._dask = needed("distributed", "distributed", "--scheduler")
        self._settings = needed("dask.config", "distributed", "--scheduler")
        self._address = address
        self._limit_s = limit_s
        self._like = pickle.dumps(like)
        self._numbers = itertools.count(1)
        self._in_work: dict[str, _InWork] = {}
        self._back: list[Ended] = []
        self._something = threading.Event()
        self._workers: dict[str, _Member] = {}
        self._looked_s = 0.0
        self._scan_s: float | None = None
        self._client = self._connected(CONNECT_S)

    def __enter__(self) -> ManyEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def others_may_come(self) -> bool:
        """True: a worker may join at any time."""
        return True

    def places(self) -> Mapping[str, str | None]:
        """Do what ``Engine`` promises, by the workers' addresses; one that has not answered yet may be able to."""
        return {address: worker.reason for address, worker in self._workers.items()}

    def leave_out(self, place: str, reason: str) -> None:
        """Do what ``Engine`` promises."""
        if place in self._workers:
            self._workers[place].able, self._workers[place].reason = False, reason

    def room(self) -> int:
        """Do what ``Engine`` promises."""
        now_s = time.monotonic()
        if now_s > self._looked_s + (LOOK_S if self._able() else RETRY_S):
            self._looked_s = now_s
            self._look(now_s)
        self._hear_greetings(now_s)
        threads = sum(self._workers[address].threads for address in self._able())
        return min(MOST_IN_WORK, PER_THREAD * threads) - len(self._in_work)

    def _able(self) -> list[str]:
        return [address for address, worker in self._workers.items() if worker.able]

    def _look(self, now_s: float) -> None:
        """Ask the scheduler who is there, greet the new ones, and take back what only those could do that are gone."""
        try:
            threads: dict[str, int] = self._client.nthreads()
        except (OSError, TypeError, KeyError, RuntimeError):
            return
        for address in self._workers.keys() - threads.keys():
            del self._workers[address]
        for address in threads.keys() - self._workers.keys():
            try:
                asked = self._submitted(greeting, self._like, "greeting", [address])
            except Exception:  # the client closes in this moment: asked again after it has connected
                return
            self._workers[address] = _Member(threads[address], asked, now_s)
        for folder, work in list(self._in_work.items()):
            if work.only is not None and not work.only & threads.keys():
                self._cancel(work.futures)
                self._back += [
                    Ended(job, None, "the workers that could do it are gone", counts=False) for job in work.jobs
                ]
                del self._in_work[folder]

    def _hear_greetings(self, now_s: float) -> None:
        for worker in self._workers.values():
            if worker.able or worker.reason is not None:
                continue
            match worker.asked.status:
                case "finished":
                    try:
                        worker.reason = worker.asked.result(timeout=ASK_S)
                    except Exception as error:  # it went while its answer was fetched: the next look says so
                        worker.reason = f"{type(error).__name__}: {error}"
                    worker.able = worker.reason is None
                case "pending" if now_s < worker.asked_s + MOST_S:
                    pass
                case "pending":
                    worker.reason = f"no answer after {MOST_S:.0f} s"
                case "error":
                    # Not even the question could be understood there: the program is missing, or of another form.
                    trouble = worker.asked.exception(timeout=ASK_S)
                    worker.reason = f"{type(trouble).__name__}: {trouble}; install the same Kingfisher with its desk libraries there"
                case _:
                    pass  # with its scheduler

    def at_once(self, waiting: int) -> int:
        """Do what ``Engine`` promises: by how long the last ones took."""
        threads = sum(self._workers[address].threads for address in self._able())
        fits = 1 if self._scan_s is None else int(TASK_S / max(self._scan_s, TASK_S / MOST_AT_ONCE))
        return max(1, min(fits, waiting // (TASKS_LEFT * max(1, threads))))

    def start(self, jobs: Sequence[Job]) -> None:
        """Do what ``Engine`` promises."""
        work = _InWork(tuple(jobs), time.monotonic())
        self._in_work[jobs[0].folder] = work
        self._submit(work)

    def ended(self, timeout_s: float) -> list[Ended]:
        """Do what ``Engine`` promises. Raises SchedulerError where there is no scheduler for ``SCHEDULER_BACK_S``."""
        if not self._back:
            self._something.wait(timeout_s)
        self._something.clear()
        if self._client.status not in ("running", "connecting"):
            self._connect_again()
        found, self._back = self._back, []
        for folder, work in list(self._in_work.items()):
            ended = self._ended(work)
            if ended:
                del self._in_work[folder]
                found += ended
        self._copy_overdue()
        return found

    def close(self) -> None:
        """Do what ``Engine`` promises."""
        for work in self._in_work.values():
            self._cancel(work.futures)
        self._in_work = {}
        self._client.close(timeout=END_S)

    def _ended(self, work: _InWork) -> list[Ended]:
        """Return what became of each job of a task; nothing while it is in work."""
        alive = []
        for future in work.futures:
            match future.status:
                case "finished":
                    try:
                        rows = future.result(timeout=ASK_S)
                    except (
                        Exception
                    ) as error:  # the worker that held the rows may be gone by now: they are read from the disk then
                        trouble = f"{type(error).__name__}: {error}"
                        return [Ended(job, None, trouble, counts=False) for job in work.jobs]
                    self._cancel([one for one in work.futures if one is not future])
                    self._learn(rows)
                    pairs = zip(work.jobs, rows, strict=True)
                    return [Ended(job, row, place=str(row.pop(WORKER, ""))) for job, row in pairs]
                case "error":
                    raised = future.exception(timeout=ASK_S)
                    self._cancel([one for one in work.futures if one is not future])
                    trouble = f"{type(raised).__name__}: {raised}"
                    return [Ended(job, None, trouble, together=len(work.jobs) > 1) for job in work.jobs]
                case "pending":
                    alive.append(future)
                case _:
                    pass  # cancelled or lost, with its scheduler
        if not alive:
            return [Ended(job, None, "the scheduler forgot it", counts=False) for job in work.jobs]
        return []

    def _learn(self, rows: Sequence[Row]) -> None:
        """Remember how long scans take, the last ones most."""
        for row in rows:
            taken_s = row.get("wall_s")
            if taken_s is not None:
                self._scan_s = taken_s if self._scan_s is None else 0.8 * self._scan_s + 0.2 * taken_s

    def _submit(self, work: _InWork, workers: list[str] | None = None) -> None:
        if workers is None:
            able = self._able()
            # Named only where there is somebody to be avoided: the scheduler takes longer over names.
            workers = None if len(able) == len(self._workers) else able
        try:
            # Not a plugin of the workers: to register one waits for all of them, also for one that hangs.
            future = self._submitted(warmed_attempts, pickle.dumps(work.jobs), work.jobs[0].name, workers)
        except Exception:  # the client closes in this moment: the job comes back where it is looked for
            return
        work.futures.append(future)
        # Only the first one counts: where it is in vain to wait for that one, there may be no copy.
        work.only = frozenset(workers) if workers is not None and len(work.futures) == 1 else None

    def _submitted(self, what: Any, argument: bytes, name: str, workers: list[str] | None) -> Any:
        # The argument has no name: dask takes some by name for itself, `key` among them.
        key = f"{name}-{next(self._numbers)}-{time.monotonic_ns()}"
        only = {} if workers is None else {"workers": workers, "allow_other_workers": False}
        future = self._client.submit(what, argument, key=key, pure=False, **only)
        future.add_done_callback(lambda _: self._something.set())
        return future

    def _copy_overdue(self) -> None:
        """Begin once more elsewhere what has been in work for too long; the first one to publish is right."""
        now_s = time.monotonic()
        # A task of several is over after a few seconds: one scan's limit is enough for it, too.
        late = [work for work in self._in_work.values() if now_s > work.begun_s + self._limit_s * len(work.futures)]
        late = [work for work in late if len(work.futures) < COPIES]
        if not late:
            return
        try:
            held = self._client.processing()
        except Exception:  # no answer: asked again in a moment
            return
        for work in late:
            keys = {future.key for future in work.futures}
            others = [one for one in self._able() if not keys & set(held.get(one, ()))]
            if others:
                self._submit(work, others)

    def _connected(self, timeout_s: float) -> Any:
        try:
            with self._settings.set({"distributed.client.scheduler-info-interval": f"{UNASKED_S:.0f}s"}):
                client: Any = self._dask.Client(self._address, timeout=timeout_s, name="kingfisher-reprocess")
        except (OSError, TimeoutError, ValueError) as error:
            raise SchedulerError(
                f"--scheduler {self._address}: cannot be reached ({error}); start one with `dask scheduler`"
            ) from error
        except (TypeError, RuntimeError) as error:
            # So Dask says that files for TLS are missing, and that an address is without it where its settings require it.
            raise SchedulerError(
                f"--scheduler {self._address}: its settings of TLS do not fit ({error}); docs/archive.md says which are needed"
            ) from error
        return client

    def _connect_again(self) -> None:
        """Wait for a scheduler at the same address. What was in work comes back."""
        until_s, never = time.monotonic() + SCHEDULER_BACK_S, threading.Event()
        self._back += [
            Ended(job, None, "the scheduler was lost", counts=False)
            for work in self._in_work.values()
            for job in work.jobs
        ]
        self._in_work, self._workers, self._looked_s = {}, {}, 0.0
        self._client.close(timeout=END_S)
        while True:
            try:
                self._client = self._connected(RETRY_S * 5)
                return
            except (SchedulerError, OSError) as error:
                if time.monotonic() > until_s:
                    raise SchedulerError(
                        f"--scheduler {self._address}: lost, and not back after {SCHEDULER_BACK_S:.0f} s"
                    ) from error
                never.wait(RETRY_S)

    def _cancel(self, futures: list[Any]) -> None:
        for future in futures:
            try:
                future.cancel()
            except Exception:  # with the scheduler gone there is nothing to cancel
                continue
