"""Workers of a scheduler of Dask's, in processes of their own: killed, stopped, and the scheduler started again in between."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from appliance.offline.anew.coordinator import work_through_all
from appliance.offline.anew.many import ManyEngine, SchedulerError
from appliance.offline.anew.program import program_digits
from appliance.offline.anew.results import Results, Row
from appliance.offline.anew.task import DONE, Job
from hw_sim.scene import Scene
from tests.support.commands import ROOT
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

COUNT = 60
WIDTH_PX = 200


@dataclass
class Cluster:
    """A scheduler and workers on this computer."""

    folder: Path
    port: int
    protocol: str = "tcp"
    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"{self.protocol}://127.0.0.1:{self.port}"

    def scheduler(self) -> subprocess.Popen[bytes]:
        return self._run(
            "distributed.cli.dask_scheduler", "--protocol", self.protocol, "--host", "127.0.0.1", "--port", str(self.port),
            "--no-dashboard",
        )  # fmt: skip

    def worker(self, tree: Path = ROOT, without: Path | None = None) -> subprocess.Popen[bytes]:
        """Start a worker with the program of ``tree``; ``without``: it sees an empty folder there (as root)."""
        words = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder))
        blind = ("unshare", "--mount", "sh", "-c", f'mount -t tmpfs none "{without}" && exec "$@"', "sh")
        before = () if without is None else blind
        return self._run("distributed.cli.dask_worker", self.address, *words, tree=tree, before=before)

    def _run(
        self, module: str, *words: str, tree: Path = ROOT, before: tuple[str, ...] = ()
    ) -> subprocess.Popen[bytes]:
        with (self.folder / "log").open("ab") as log:
            process = subprocess.Popen(
                [*before, sys.executable, "-m", module, *words], cwd=tree, stdout=log, stderr=log
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


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A shelf of small scans that are the same but for their numbers: each gives the same points."""
    scan = render_scan(Scene("frustum", texture="checker"), "nominal", 3, WIDTH_PX, 16)
    shelf = tmp_path_factory.mktemp("archive") / "scans"
    shelf.mkdir()
    origin = origin_of(scan.renderer.truth, WIDTH_PX, WIDTH_PX * 3 // 4)
    for number in range(COUNT):
        store(scan, shelf / f"{number + 1:06d}", origin=origin)
    return shelf


def made(scans: Path, results: Results, count: int) -> list[Job]:
    """A job of each of the first ``count`` scans, with its cloud."""
    digits = program_digits()
    return [
        Job(str(folder), str(results.folder), None, None, False, None, True, digits)
        for folder in sorted(scans.iterdir())[:count]
    ]


def assert_each_once_and_whole(results: Results, jobs: list[Job], rows: Sequence[Row]) -> None:
    assert sorted(row["scan"] for row in rows) == [job.name for job in jobs]
    assert {row["state"] for row in rows} == {DONE}
    folders = sorted((results.folder / "results").iterdir())
    assert [folder.name.partition("-")[0] for folder in folders] == [job.name for job in jobs]
    clouds = {hashlib.sha256((folder / "cloud.ply").read_bytes()).hexdigest() for folder in folders}
    assert len(clouds) == 1, "the same frames give the same points, whoever worked them through"
    assert min(int(row["points"]) for row in rows) > 1000
    assert {row["cloud_sha256"] for row in rows} == clouds
    assert list((results.folder / "failed").iterdir()) == []


@pytest.mark.long
def test_a_worker_that_hangs_before_the_work_begins_keeps_nobody_from_it(
    cluster: Cluster, scans: Path, tmp_path: Path
) -> None:
    results = Results.of(tmp_path / "out", {"a": 1})
    cluster.scheduler()
    hanging, _ = cluster.worker(), cluster.worker()
    jobs = made(scans, results, 10)
    with ManyEngine(cluster.address, 5.0, jobs[0]) as engine:
        until_s = time.monotonic() + 240.0
        while engine.room() < 4 and time.monotonic() < until_s:
            engine.ended(0.2)
        assert engine.room() == 4, "both are there"
        os.kill(hanging.pid, signal.SIGSTOP)
    with ManyEngine(cluster.address, 20.0, jobs[0]) as engine:
        worked = work_through_all(jobs, engine, lambda *_: None)
    assert_each_once_and_whole(results, jobs, worked.rows)


@pytest.mark.long
def test_nothing_is_lost_whoever_dies_and_whoever_hangs(cluster: Cluster, scans: Path, tmp_path: Path) -> None:
    results = Results.of(tmp_path / "out", {"a": 1})
    jobs = made(scans, results, COUNT)
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

    with ManyEngine(cluster.address, 20.0, jobs[0]) as engine:
        worked = work_through_all(jobs, engine, hurt)
    assert blows == ["killed", "stopped", "scheduler"]
    assert_each_once_and_whole(results, jobs, worked.rows)
    assert worked.left == ()


@pytest.mark.long
@pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to hide a folder from one process")
def test_three_hosts_that_can_do_nothing_are_named_and_keep_nobody_from_it(
    cluster: Cluster, scans: Path, tmp_path: Path
) -> None:
    """One has another version, one has none at all, one does not see the scans; they refuse in an instant."""
    results = Results.of(tmp_path / "out", {"a": 1})
    jobs = made(scans, results, 20)
    other, none = tmp_path / "other", tmp_path / "none"
    for package in ("appliance", "drivers"):
        shutil.copytree(ROOT / package, other / package, ignore=shutil.ignore_patterns("__pycache__"))
    changed = other / "appliance" / "optics" / "water.py"
    changed.write_text(changed.read_text(encoding="utf-8") + "\n# Another version.\n", encoding="utf-8")
    (none / "appliance").mkdir(parents=True)
    (none / "appliance" / "__init__.py").touch()
    cluster.scheduler()
    for _ in range(2):
        cluster.worker(tree=other)
        cluster.worker(tree=none)
        cluster.worker(without=scans)
    cluster.worker()
    with ManyEngine(cluster.address, 60.0, jobs[0]) as engine:
        worked = work_through_all(jobs, engine, lambda *_: None)
        until_s = time.monotonic() + 240.0
        while sum(reason is not None for reason in engine.places().values()) < 6 and time.monotonic() < until_s:
            engine.room()
            time.sleep(0.5)
        reasons = sorted(reason for reason in engine.places().values() if reason is not None)
    assert_each_once_and_whole(results, jobs, worked.rows)
    assert (worked.stopped, worked.left, worked.not_begun) == (None, (), 0)
    for words in ("has another version", "ImportError", f"sees no scans in {scans}"):
        assert sum(words in reason for reason in reasons) == 2, reasons


def test_a_scheduler_that_is_not_there_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("appliance.offline.anew.many.CONNECT_S", 0.5)
    with pytest.raises(SchedulerError, match=r"cannot be reached .* start one with `dask scheduler`"):
        ManyEngine("tcp://127.0.0.1:9", 5.0, Job("", "", None, None, False, None, False, ""))


# --------------------------------------------------------------------------------------------------- TLS


def settings_of_tls(folder: Path) -> dict[str, str]:
    """Dask's settings, by their names in the environment, for a certificate of an authority that is made in ``folder``."""
    folder.mkdir()
    key = ("openssl", "req", "-newkey", "rsa:2048", "-nodes", "-subj")
    for command in (
        (*key, "/CN=authority", "-x509", "-days", "2", "-keyout", "ca.key", "-out", "ca.pem"),
        (*key, "/CN=desk", "-keyout", "desk.key", "-out", "desk.csr"),
        ("openssl", "x509", "-req", "-in", "desk.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2", "-out", "desk.pem"),
    ):  # fmt: skip
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=60)
    files = {f"TLS__{role}__{kind}": str(folder / f"desk.{ending}")
             for role in ("SCHEDULER", "WORKER", "CLIENT") for kind, ending in (("CERT", "pem"), ("KEY", "key"))}  # fmt: skip
    settings = {"REQUIRE_ENCRYPTION": "True", "TLS__CA_FILE": str(folder / "ca.pem"), **files}
    return {f"DASK_DISTRIBUTED__COMM__{name}": value for name, value in settings.items()}


def here(settings: dict[str, str]) -> dict[str, object]:
    """The same for this process, whose environment was read long ago."""
    names = {name: name.removeprefix("DASK_").replace("__", ".").lower() for name in settings}
    return {names[name]: value == "True" or value for name, value in settings.items()}


def comes_in(address: str, settings: dict[str, str]) -> bool:
    """Whether a caller of its own process is connected."""
    call = "import sys; from distributed import Client; Client(sys.argv[1], timeout=5)"
    done = subprocess.run(
        [sys.executable, "-c", call, address], env={**os.environ, **settings}, capture_output=True, timeout=120, check=False
    )  # fmt: skip
    return done.returncode == 0


def test_an_address_of_tls_without_certificates_is_refused_in_one_line() -> None:
    like = Job("/nowhere/000001", "", None, None, False, None, False, program_digits())
    with pytest.raises(SchedulerError, match=r"^--scheduler tls://127\.0\.0\.1:1: its settings of TLS do not fit"):
        ManyEngine("tls://127.0.0.1:1", 5.0, like)


@pytest.mark.long
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")
def test_with_tls_only_those_who_have_a_certificate_of_the_authority_take_part(
    cluster: Cluster, scans: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dask.config

    cluster.protocol = "tls"
    ours, strange = settings_of_tls(tmp_path / "ours"), settings_of_tls(tmp_path / "strange")
    results = Results.of(tmp_path / "out", {"a": 1})
    jobs = made(scans, results, 6)
    with monkeypatch.context() as patch:
        for name, value in ours.items():
            patch.setenv(name, value)
        cluster.scheduler()
        cluster.worker()
    with dask.config.set(here(ours)):
        with ManyEngine(cluster.address, 60.0, jobs[0]) as engine:
            worked = work_through_all(jobs, engine, lambda *_: None)
        assert_each_once_and_whole(results, jobs, worked.rows)
    plain = cluster.address.replace("tls", "tcp")
    assert comes_in(cluster.address, ours)
    assert not any(
        comes_in(*one) for one in ((plain, ours), (cluster.address, {}), (plain, {}), (cluster.address, strange))
    )
