"""Owns what Dask costs a scan in processor time, told apart from the scan: by task and by second, of each who takes part.

The scans have results already, so that nothing but giving them out and taking their rows back is left; their rows say how long each
took, which decides how many share a task. Processor time, not wall time: other programs on the machine change it little.
"""

from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

from appliance.offline.anew.coordinator import work_through_all
from appliance.offline.anew.many import ManyEngine
from appliance.offline.anew.program import program_digits
from appliance.offline.anew.results import Results, name_of
from appliance.offline.anew.task import DONE, Job
from bench.archive.scaling import own_cpu_s, running
from bench.result import Measured

COUNT, WORKERS = 1000, 2
FIRST = 40
"""Scans that are left out: connecting, loading the program, learning how long a scan takes."""
WATCHED_S = 20.0
RAW_S, PACKED_S = 0.64, 2.4
"""How long a full-size scan takes one core, without and with unpacking it."""
MS = 1000.0
MOST_PERCENT = 2.0


def measure(scratch: Path, say: Callable[[str], None]) -> Iterator[Measured]:
    """Give ``COUNT`` scans out below ``scratch``, once as quick as raw ones and once as slow as packed ones."""
    for name, scan_s in (("raw", RAW_S), ("packed", PACKED_S)):
        say(f"{COUNT} scans as long as {name} ones")
        yield from _measured(scratch / name, name, scan_s)


def _measured(folder: Path, name: str, scan_s: float) -> Iterator[Measured]:
    jobs = _jobs_with_results(folder, scan_s)
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    words = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder / "dask"))
    with ExitStack() as stack:
        started = [
            stack.enter_context(running(folder, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"))
        ]  # fmt: skip
        started += [
            stack.enter_context(running(folder, "distributed.cli.dask_worker", address, *words)) for _ in range(WORKERS)
        ]
        engine = stack.enter_context(ManyEngine(address, 600.0, jobs[0]))
        work_through_all(jobs[:FIRST], engine, lambda *_: None)
        before = _cpu_s(started)
        worked = work_through_all(jobs[FIRST:], engine, lambda *_: None)
        after = _cpu_s(started)
        if len(worked.rows) != COUNT - FIRST:
            raise RuntimeError(f"{len(worked.rows)} of {COUNT - FIRST} scans; see {folder / 'dask.log'}")
        each = [MS * (b - a) / len(worked.rows) for a, b in zip(before, after, strict=True)]
        begun_s, before = time.monotonic(), after
        while time.monotonic() - begun_s < WATCHED_S:
            engine.room()
            engine.ended(0.5)
        a_second = [MS * (b - a) / WATCHED_S for a, b in zip(before, _cpu_s(started), strict=True)]
    caller, scheduler, workers = each[0], each[1], sum(each[2:])
    yield Measured(f"{name}: caller", caller, "ms a scan")
    yield Measured(f"{name}: scheduler", scheduler, "ms a scan")
    yield Measured(f"{name}: workers, finding the result included", workers, "ms a scan")
    yield Measured(f"{name}: caller and scheduler, whatever is done", sum(a_second[:2]), "ms a second")
    yield Measured(f"{name}: a worker, whatever is done", sum(a_second[2:]) / WORKERS, "ms a second")
    # With one worker that is busy all the time; with more of them, the seconds of caller and scheduler are shared.
    total_ms = sum(each) + scan_s * (sum(a_second[:2]) + sum(a_second[2:]) / WORKERS)
    share = 100.0 * total_ms / (MS * scan_s)
    yield Measured(f"{name}: all of it, of {scan_s:g} s a scan on one core", share, "%", at_most=MOST_PERCENT)


def _cpu_s(started: list[subprocess.Popen[bytes]]) -> list[float]:
    return [time.process_time(), *(own_cpu_s(one.pid) for one in started)]


def _jobs_with_results(folder: Path, scan_s: float) -> list[Job]:
    results = Results.of(folder / "out", {"cost": os.getpid()})
    jobs = []
    for number in range(COUNT):
        scan = folder / "scans" / f"{number:06d}"
        scan.mkdir(parents=True)
        (scan / "manifest.json").write_text(f"{{{number}", encoding="utf-8")
        row = {"scan": scan.name, "folder": str(scan), "state": DONE, "wall_s": scan_s}
        results.publish(name_of(scan), row, None)
        jobs.append(Job(str(scan), str(results.folder), None, None, False, None, False, program_digits()))
    return jobs
