"""Owns the work of many computers through a scheduler of Dask's: who warms their kernels, and what happens when one of them fails.

Workers are started by ``dask worker ADDRESS --nthreads 1``, on computers with the same program and the same paths. A worker that dies
is missed by the scheduler, which gives its scans to others. One that hangs is noticed here: a scan that takes too long is given to
another worker besides, and whoever publishes first is right. When the scheduler itself is lost, everything in work comes back, and goes
out again as soon as there is one at the same address.
"""

from __future__ import annotations

import itertools
import pickle
import threading
import time
from dataclasses import dataclass, field
from typing import Any

from appliance.offline.anew.coordinator import Ended
from appliance.offline.anew.hosts import warmed_attempt
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
"""Scans in work for each thread of the workers: one that is done, and one that waits beside it."""
MOST_IN_WORK = 10_000
COPIES = 3
ASK_S, END_S = 30.0, 10.0


class SchedulerError(Exception):
    """The scheduler cannot be reached, or stayed away; the text says which and what to do."""


@dataclass(slots=True)
class _InWork:
    job: Job
    begun_s: float
    futures: list[Any] = field(default_factory=list)


class ManyEngine:
    """Workers of the scheduler at ``address``; a job that takes longer than ``limit_s`` is begun once more elsewhere. A context manager.

    Raises MissingLibraryError, SchedulerError.
    """

    def __init__(self, address: str, limit_s: float) -> None:
        self._dask = needed("distributed", "distributed", "--scheduler")
        self._settings = needed("dask.config", "distributed", "--scheduler")
        self._address = address
        self._limit_s = limit_s
        self._numbers = itertools.count(1)
        self._in_work: dict[str, _InWork] = {}
        self._back: list[Ended] = []
        self._something = threading.Event()
        self._threads, self._asked_s = 0, 0.0
        self._client = self._connected(CONNECT_S)

    def __enter__(self) -> ManyEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def room(self) -> int:
        """Do what ``Engine`` promises."""
        now_s = time.monotonic()
        if now_s > self._asked_s + (LOOK_S if self._threads else RETRY_S):
            self._asked_s = now_s
            try:
                workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
                self._threads = sum(int(worker["nthreads"]) for worker in workers)
            except (OSError, TypeError, KeyError, RuntimeError):
                self._threads = 0
        return min(MOST_IN_WORK, PER_THREAD * self._threads) - len(self._in_work)

    def start(self, job: Job) -> None:
        """Do what ``Engine`` promises."""
        work = _InWork(job, time.monotonic())
        self._in_work[job.folder] = work
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
            if ended is not None:
                del self._in_work[folder]
                found.append(ended)
        self._copy_overdue()
        return found

    def close(self) -> None:
        """Do what ``Engine`` promises."""
        for work in self._in_work.values():
            self._cancel(work.futures)
        self._in_work = {}
        self._client.close(timeout=END_S)

    def _ended(self, work: _InWork) -> Ended | None:
        alive = []
        for future in work.futures:
            match future.status:
                case "finished":
                    try:
                        row = future.result(timeout=ASK_S)
                    except (
                        Exception
                    ) as error:  # the worker that held the row may be gone by now: it is read from the disk then
                        return Ended(work.job, None, f"{type(error).__name__}: {error}", counts=False)
                    self._cancel([one for one in work.futures if one is not future])
                    return Ended(work.job, row)
                case "error":
                    trouble = future.exception(timeout=ASK_S)
                    self._cancel([one for one in work.futures if one is not future])
                    return Ended(work.job, None, f"{type(trouble).__name__}: {trouble}")
                case "pending":
                    alive.append(future)
                case _:
                    pass  # cancelled or lost, with its scheduler
        if not alive:
            return Ended(work.job, None, "the scheduler forgot it", counts=False)
        return None

    def _submit(self, work: _InWork, workers: list[str] | None = None) -> None:
        # The job is an argument by its place: dask takes some by name for itself, `key` among them.
        name = f"{work.job.name}-{next(self._numbers)}-{time.monotonic_ns()}"
        only = {} if workers is None else {"workers": workers, "allow_other_workers": False}
        try:
            # Not a plugin of the workers: to register one waits for all of them, also for one that hangs.
            future = self._client.submit(warmed_attempt, pickle.dumps(work.job), key=name, pure=False, **only)
        except Exception:  # the client closes in this moment: the job comes back where it is looked for
            return
        future.add_done_callback(lambda _: self._something.set())
        work.futures.append(future)

    def _copy_overdue(self) -> None:
        """Begin once more elsewhere what has been in work for too long; the first one to publish is right."""
        now_s = time.monotonic()
        late = [work for work in self._in_work.values() if now_s > work.begun_s + self._limit_s * len(work.futures)]
        late = [work for work in late if len(work.futures) < COPIES]
        if not late:
            return
        try:
            held = self._client.processing()
            everybody = list(self._client.scheduler_info(n_workers=-1)["workers"])
        except Exception:  # no answer: asked again in a moment
            return
        for work in late:
            keys = {future.key for future in work.futures}
            others = [one for one in everybody if not keys & set(held.get(one, ()))]
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
        return client

    def _connect_again(self) -> None:
        """Wait for a scheduler at the same address. What was in work comes back."""
        until_s, never = time.monotonic() + SCHEDULER_BACK_S, threading.Event()
        self._back += [Ended(work.job, None, "the scheduler was lost", counts=False) for work in self._in_work.values()]
        self._in_work, self._threads, self._asked_s = {}, 0, 0.0
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
