"""Owns that every scan of an archive is reprocessed once: given out by Dask to processes of this computer, or to workers of many.

A worker that dies is missed by Dask, which gives its scans to others; a scan that is not done after its limit ends its worker.
Nothing here brings kernels: a worker must be told where they are before it imports any.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import socket
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from appliance.base import KernelOrigin, missing_kernels, needed, use_kernel_cache
from appliance.desk.anew.results import Row
from appliance.store import ListedScan

DONE, FAILED, AGAIN = "done", "failed", "again"
"""States of a row; one that is to be tried again is never published."""
RETRIES = 2
"""Times that a scan is given out once more because the machine refused, before it is left for the next call."""
TROUBLES_IN_A_ROW = 8
"""Scans left with no result between them that are no accident of one: the disk is full, or a worker sees no scans. The call ends."""
IN_WORK = 1000
"""Scans that Dask knows of at a time, so that neither its memory nor ours grows with the archive."""
CONNECT_S = 30.0
WORKER_MEMORY = "3GB"
"""Memory at which Dask starts a process of this computer again; one that reprocesses stays below half of it."""

_UNINTERRUPTED = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Ctrl-C reaches every process of a terminal: Dask's of this computer are ended by ours."""


class Again(Exception):
    """A scan cannot be done now, or not on this computer, and is not to blame for it; the text says why."""


class SchedulerError(Exception):
    """The scheduler cannot be reached, or has no worker; the text says which and what to do."""


@dataclass(frozen=True, slots=True)
class Job:
    """Everything that one scan's task must know; small, and the same bytes on every computer."""

    folder: str
    """The scan's; every computer must see it there."""
    results: str
    """Folder of the results of this key, whose settings say how it is done."""
    calibration: str | None
    """Calibration file; ``None``: each scan's own."""
    listed: ListedScan | None
    """The artefact that the scan shows; ``None``: none that is known."""


def work_through_all(
    jobs: Sequence[Job], scheduler: str | None, processes: int | None, limit_s: float
) -> Generator[Row, None, None]:
    """Yield a row of every job, as they are done by workers of ``scheduler``, or by ``processes`` of this computer (default: its cores).

    Ends early where one scan after another is left. Raises SchedulerError, MissingLibraryError.
    """
    dask = needed("distributed", "distributed", "reprocess")
    troubles, waiting = 0, iter(jobs)
    with _client(dask, scheduler, processes) as client:
        name = f"reprocess-{uuid4().hex}"

        def begun(most: int) -> list[Any]:
            # Under one name, so that Dask keeps what waits at its scheduler: a worker that dies is then suspected for one or two scans alone.
            return [
                client.submit(do, job, limit_s, key=(name, job.folder), retries=RETRIES, pure=False)
                for job in islice(waiting, most)
            ]

        ended = dask.as_completed(begun(IN_WORK))
        for future in ended:
            try:
                row, troubles = future.result(timeout=limit_s), 0
            except Exception as error:  # also what Dask raises where every worker of a scan died, or its scheduler did
                row = {"scan": Path(future.key[1]).name, "folder": future.key[1], "state": AGAIN, "reason": str(error)}
                troubles += 1
            yield row
            if troubles == TROUBLES_IN_A_ROW:
                return
            ended.update(begun(1))


def do(job: Job, limit_s: float) -> Row:
    """Do one job in a worker of Dask's (``task.attempt``). Raises Again, which names this computer; ends the process after ``limit_s``."""
    try:
        _find_kernels()
        from appliance.desk.anew.task import attempt

        # Written in C: it also ends kernels that let no other thread run. Dask starts the worker again, and gives the scan out again.
        faulthandler.dump_traceback_later(limit_s, exit=True)
        return attempt(job)
    except Exception as error:
        told = str(error) if isinstance(error, Again) else f"{type(error).__name__}: {error}"
        # Its cause stays here: not every error survives being pickled.
        raise Again(f"{socket.gethostname()}: {told}") from None
    finally:
        faulthandler.cancel_dump_traceback_later()


@cache
def _find_kernels() -> None:
    kernels = use_kernel_cache()  # before any kernel is imported
    from appliance.measure import PIECES

    # Each worker would compile all of them by itself, at the same time, for longer than a scan's limit.
    if kernels.origin is not KernelOrigin.GIVEN and missing_kernels(kernels.path, PIECES):
        raise Again("its kernels are not compiled; call `kingfisher setup compile` there, once")


def _client(dask: Any, scheduler: str | None, processes: int | None) -> Any:
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # what it says of lost workers is told by rows
    if scheduler is None:
        return dask.Client(
            n_workers=processes or len(os.sched_getaffinity(0)), threads_per_worker=1, memory_limit=WORKER_MEMORY,
            dashboard_address=":0", security=True, silence_logs=logging.CRITICAL, preload=_UNINTERRUPTED,
        )  # fmt: skip
    try:
        client = dask.Client(scheduler, timeout=CONNECT_S, name="kingfisher-reprocess")
        client.wait_for_workers(1, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        # The last two: files for TLS are missing, or the address is without it where Dask's settings require it.
        raise SchedulerError(
            f"--workers {scheduler}: cannot be reached, or has no worker ({error}); start `dask scheduler` and `dask worker`, "
            "with the same settings of TLS (docs/archive.md)"
        ) from error
    return client
