"""Workers of a scheduler of Dask's, in processes of their own: killed, stopped, and the scheduler started again in between."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from appliance.offline.anew.coordinator import work_through_all
from appliance.offline.anew.many import ManyEngine, SchedulerError
from appliance.offline.anew.results import Results
from appliance.offline.anew.task import FAILED, Job, program_digits
from tests.support.commands import ROOT

COUNT = 60


@dataclass
class Cluster:
    """A scheduler and workers on this computer."""

    folder: Path
    port: int
    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def scheduler(self) -> subprocess.Popen[bytes]:
        return self._run(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"
        )

    def worker(self) -> subprocess.Popen[bytes]:
        words = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder))
        return self._run("distributed.cli.dask_worker", self.address, *words)

    def _run(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        # A folder of kernels that somebody else keeps up to date: nothing here needs any, and nothing is compiled.
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(self.folder)}
        with (self.folder / "log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, *words], cwd=ROOT, env=environment, stdout=log, stderr=log
            )
        self.started.append(process)
        return process


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        cluster = Cluster(tmp_path, one.getsockname()[1])
    yield cluster
    for process in cluster.started:
        with suppress(ProcessLookupError):
            process.kill()
        process.wait(timeout=30)


def made(folder: Path, results: Results, count: int) -> list[Job]:
    """Jobs of folders that are no scans, so that each is a failure with its reason, and quick: what is tested is who does it."""
    jobs = []
    for number in range(count):
        scan = folder / "scans" / f"{number:06d}"
        scan.mkdir(parents=True)
        (scan / "manifest.json").write_text("{" + str(number))
        jobs.append(Job(str(scan), str(results.folder), None, False, None, False, program_digits()))
    return jobs


@pytest.mark.long
def test_a_worker_that_hangs_before_the_work_begins_keeps_nobody_from_it(cluster: Cluster, tmp_path: Path) -> None:
    results = Results.of(tmp_path / "out", {"a": 1})
    cluster.scheduler()
    hanging, _ = cluster.worker(), cluster.worker()
    with ManyEngine(cluster.address, limit_s=5.0) as engine:
        until_s = time.monotonic() + 60.0
        while engine.room() < 4 and time.monotonic() < until_s:
            engine.ended(0.2)
        assert engine.room() == 4, "both are there"
        os.kill(hanging.pid, signal.SIGSTOP)
    with ManyEngine(cluster.address, limit_s=5.0) as engine:
        worked = work_through_all(made(tmp_path, results, 10), engine, lambda *_: None)
    assert len(worked.rows) == 10


@pytest.mark.long
def test_nothing_is_lost_whoever_dies_and_whoever_hangs(cluster: Cluster, tmp_path: Path) -> None:
    results = Results.of(tmp_path / "out", {"a": 1})
    jobs = made(tmp_path, results, COUNT)
    scheduler = cluster.scheduler()
    workers = [cluster.worker() for _ in range(3)]
    blows: list[str] = []

    def hurt(done: int, of: int, left_s: float | None) -> None:
        nonlocal scheduler
        del of, left_s
        if done >= 5 and not blows:
            blows.append("killed")
            workers[0].kill()
        if done >= 15 and len(blows) == 1:
            blows.append("stopped")
            os.kill(workers[1].pid, signal.SIGSTOP)
        if done >= 30 and len(blows) == 2:
            blows.append("scheduler")
            scheduler.kill()
            scheduler.wait(timeout=30)
            scheduler = cluster.scheduler()
            workers.append(cluster.worker())

    with ManyEngine(cluster.address, limit_s=5.0) as engine:
        worked = work_through_all(jobs, engine, hurt)
    assert blows == ["killed", "stopped", "scheduler"]
    assert sorted(row["scan"] for row in worked.rows) == [job.name for job in jobs]
    assert {row["state"] for row in worked.rows} == {FAILED}
    assert worked.left == ()
    assert len(list((results.folder / "failed").iterdir())) == COUNT


def test_a_scheduler_that_is_not_there_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("appliance.offline.anew.many.CONNECT_S", 0.5)
    with pytest.raises(SchedulerError, match=r"cannot be reached .* start one with `dask scheduler`"):
        ManyEngine("tcp://127.0.0.1:9", limit_s=5.0)
