"""Owns that the kernels of a host are compiled once, before any of its workers takes a scan.

Workers of one host wait for each other (``kernel_build`` holds a lock in the folder of the kernels), so that the first one compiles on all
cores and the others find them ready. With a cold cache in every worker nothing was finished after seven minutes.
"""

from __future__ import annotations

import os
import pickle
import socket
import subprocess
import sys
import time
from functools import cache
from typing import Any

from appliance import kernel_cache
from appliance.kernel_build import CompileError, compile_pieces, missing
from appliance.kernel_cache import Origin
from appliance.surface.libraries import needed

WORKER = "worker"
"""Key of a row: the address of the worker that answered; it is published nowhere."""
MOST_S = 1800.0
"""The longest that a host may take; a slow one with one core takes some minutes."""


def warm_host() -> float:
    """Compile what this host's cache lacks, or wait until another process has; return the seconds that took.

    Afterwards this process uses that cache. Raises CompileError, OSError.
    """
    begun_s = time.monotonic()
    cache = kernel_cache.use()  # before any kernel is imported
    from appliance.worker.warm import PIECES

    # Whoever set NUMBA_CACHE_DIR keeps that folder up to date (ADR 0019).
    if cache.origin is Origin.GIVEN or not missing(cache.path, PIECES):
        return time.monotonic() - begun_s
    # In a process of its own: workers of dask's are daemons, which may not start the processes that compile side by side.
    program = [sys.executable, "-m", __name__]
    done = subprocess.run(program, env=os.environ.copy(), capture_output=True, text=True, timeout=MOST_S, check=False)
    if done.returncode:
        raise CompileError(f"kernels could not be compiled: {done.stderr.strip()[-500:]}")
    return time.monotonic() - begun_s


@cache
def _warmed() -> float:
    return warm_host()


def greeting(job: bytes) -> str | None:
    """Return why the worker that this runs on can do no job like the pickled one, after its host's kernels are there; ``None``: it can."""
    try:
        _warmed()
        from appliance.offline.anew.task import unfit

        return unfit(pickle.loads(job))
    except (CompileError, OSError, ImportError, subprocess.SubprocessError) as error:
        return f"{socket.gethostname()}: {type(error).__name__}: {error}"


def warmed_attempts(jobs: bytes) -> list[dict[str, Any]]:
    """Do pickled jobs one after another (``task.attempt``) on a worker of Dask's, after this host's kernels are there; return their rows.

    Only a process's first one waits. Pickled, because the module of jobs brings kernels, which must be told where their cache is before
    they are imported.
    """
    _warmed()
    from appliance.offline.anew.task import attempt

    worker = needed("distributed", "distributed", "a worker").get_worker()
    return [{**attempt(job), WORKER: worker.address} for job in pickle.loads(jobs)]


def _compile() -> None:
    from appliance.worker.warm import PIECES

    compile_pieces(kernel_cache.use().path, PIECES)


if __name__ == "__main__":
    _compile()
