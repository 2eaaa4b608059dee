"""Workers of a scheduler of Dask's, in processes of their own: killed, stopped, and the scheduler started again in between."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from appliance import kernel_cache
from appliance.kernel_build import CompileError
from appliance.offline.anew import hosts
from appliance.offline.anew.coordinator import Ended, work_through_all
from appliance.offline.anew.hosts import WORKER, greeting, warm_host
from appliance.offline.anew.many import ManyEngine, SchedulerError, _InWork, _Member
from appliance.offline.anew.program import program_digits
from appliance.offline.anew.results import Results, Row
from appliance.offline.anew.task import DONE, FAILED, Job
from hw_sim.scene import Scene
from tests.support.commands import ROOT
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

distributed = pytest.importorskip("distributed")
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


# ------------------------------------------------------------------------------ a scheduler in this process


TIMEOUT_S = 30.0


@dataclass
class Here:
    """A scheduler with two workers, all threads of this process, and jobs that are failures with a reason, and quick."""

    cluster: Any
    jobs: list[Job]

    def engine(self, limit_s: float = 20.0, like: Job | None = None) -> ManyEngine:
        return ManyEngine(self.cluster.scheduler_address, limit_s, like or self.jobs[0])

    def ready(self) -> ManyEngine:
        """An engine that knows both workers."""
        engine = self.engine()
        until(lambda: engine.room() == 4)
        return engine


def until(true: Callable[[], object]) -> None:
    until_s = time.monotonic() + TIMEOUT_S
    while not true():
        assert time.monotonic() < until_s
        time.sleep(0.01)


def all_ended(engine: ManyEngine, count: int = 1) -> list[Ended]:
    found: list[Ended] = []

    def heard() -> bool:
        found.extend(engine.ended(0.05))
        return len(found) >= count

    until(heard)
    return found


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Here]:
    top = tmp_path_factory.mktemp("here")
    results = Results.of(top / "out", {"a": 1})
    for number in range(20):
        (top / "scans" / f"{number:06d}").mkdir(parents=True)
        (top / "scans" / f"{number:06d}" / "manifest.json").write_text("{" + str(number))
    digits = program_digits()
    jobs = [
        Job(str(folder), str(results.folder), None, None, False, None, False, digits)
        for folder in sorted((top / "scans").iterdir())
    ]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield Here(cluster, jobs)


def test_two_workers_have_room_for_two_tasks_a_thread_and_do_every_job_once(here: Here) -> None:
    with here.ready() as engine:
        assert engine.others_may_come
        assert list(engine.places().values()) == [None, None]
        hosts._warmed.cache_clear()
        engine.start(here.jobs[:2])
        assert engine.room() == 3
        assert [one.job for one in all_ended(engine, 2)] == here.jobs[:2]
        assert hosts._warmed.cache_info().currsize == 1, "its kernels were there before"
        assert engine.room() == 4
        worked = work_through_all(here.jobs, engine, lambda *_: None)
        assert {row["state"] for row in worked.rows} == {FAILED}
        assert sorted(row["scan"] for row in worked.rows) == [job.name for job in here.jobs]
        assert all(WORKER not in row for row in worked.rows)
        engine.start(here.jobs[:1])
        (one,) = all_ended(engine)
        assert one.place in engine.places(), "it is told which worker did it"


def test_workers_that_can_do_no_such_job_get_none_and_say_why(here: Here) -> None:
    with here.engine(like=replace(here.jobs[0], program="0.0.9-abc")) as engine:
        until(lambda: engine.room() == 0 and all(engine.places().values()) and engine.places())
        assert all("has another version" in (reason or "") for reason in engine.places().values())
    job = pickle.dumps(replace(here.jobs[0], program="0.0.9-abc"))
    assert "has another version" in (greeting(job) or "")
    assert greeting(pickle.dumps(here.jobs[0])) is None


def test_a_place_that_is_left_out_gets_no_more(here: Here) -> None:
    with here.ready() as engine:
        one, other = engine.places()
        engine.leave_out("tcp://nobody", "is unknown")
        engine.leave_out(one, "its disk is full")
        assert engine.room() == 2
        assert dict(engine.places()) == {one: "its disk is full", other: None}
        engine.start(here.jobs[:1])
        assert engine._in_work[here.jobs[0].folder].only == frozenset([other]), "nobody else may take it"
        assert [ended.place for ended in all_ended(engine)] == [other]


def test_workers_are_asked_for_again_after_some_seconds_and_sooner_where_there_is_none(here: Here) -> None:
    with here.ready() as engine:

        def looks(since_s: float) -> bool:
            engine._looked_s = time.monotonic() - since_s
            before = engine._looked_s
            engine.room()
            return engine._looked_s != before

        assert (looks(4.8), looks(5.2)) == (False, True)
        for place in engine.places():
            engine.leave_out(place, "full")
        assert (looks(0.8), looks(1.2)) == (False, True)


def test_what_only_a_lost_worker_could_do_comes_back_and_counts_against_nothing(here: Here) -> None:
    with here.ready() as engine:
        engine._in_work["x"] = _InWork((here.jobs[0],), time.monotonic(), only=frozenset({"tcp://gone"}))
        engine._in_work["y"] = _InWork((here.jobs[1],), time.monotonic(), only=frozenset(engine.places()))
        engine._workers["tcp://gone"] = engine._workers[next(iter(engine.places()))]
        engine._look(time.monotonic())
        assert list(engine._in_work) == ["y"]
        assert [(one.job, one.row, one.counts) for one in engine._back] == [(here.jobs[0], None, False)]
        assert len(engine.places()) == 2


def test_a_worker_that_does_not_answer_for_half_an_hour_gets_nothing(here: Here) -> None:
    with here.ready() as engine:
        engine._workers = {"late": _Member(1, engine._client.submit(time.sleep, 0.3, pure=False), 0.0)}
        engine._hear_greetings(1799.0)
        assert engine.places() == {"late": None}
        engine._hear_greetings(1801.0)
        assert engine.places() == {"late": "no answer after 1800 s"}
        raised = engine._client.submit(int, "no number", pure=False)
        distributed.wait(raised, TIMEOUT_S)
        engine._workers = {"other": _Member(1, raised, 0.0)}
        engine._hear_greetings(0.0)
        assert "ValueError" in (engine.places()["other"] or "")


@pytest.mark.parametrize(
    ("scan_s", "threads", "waiting", "most"),
    [(None, 1, 1000, 1), (4.1, 1, 1000, 1), (2.0, 1, 1000, 2), (0.5, 1, 1000, 8), (0.1, 1, 1000, 8), (0.1, 2, 24, 3), (0.1, 1, 12, 3), (0.1, 0, 12, 3), (0.1, 2, 1, 1)],
)  # fmt: skip
def test_quick_scans_share_a_task_of_four_seconds_while_each_thread_has_four_left(
    scan_s: float | None, threads: int, waiting: int, most: int, here: Here
) -> None:
    with here.engine() as engine:
        engine._workers = {"a": _Member(threads, None, 0.0, able=True), "b": _Member(9, None, 0.0, reason="full")}
        engine._scan_s = scan_s
        assert engine.at_once(waiting) == most


def test_no_more_than_ten_thousand_tasks_are_given_out_at_once(here: Here) -> None:
    with here.ready() as engine:
        engine._looked_s = time.monotonic()
        engine._workers = {"a": _Member(4999, None, 0.0, able=True)}
        assert engine.room() == 9998
        engine._workers = {"a": _Member(6000, None, 0.0, able=True)}
        assert engine.room() == 10_000


def test_what_a_host_lacks_is_compiled_in_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config: Any = sys.modules["numba"].config
    monkeypatch.setattr(config, "CACHE_DIR", config.CACHE_DIR)
    begun: list[list[str]] = []
    codes = iter([0, 1])

    def run(program: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        begun.append(program)
        return subprocess.CompletedProcess(program, next(codes), "", "  no compiler\n")

    monkeypatch.setattr(subprocess, "run", run)
    monkeypatch.setenv(kernel_cache.VARIABLE, str(tmp_path / "given"))
    assert 0.0 <= warm_host() < TIMEOUT_S
    assert begun == [], "whoever gave the folder keeps it"
    monkeypatch.setenv(kernel_cache.VARIABLE, str(tmp_path / kernel_cache.fingerprint()))
    assert 0.0 <= warm_host() < TIMEOUT_S
    assert begun == [[sys.executable, "-m", "appliance.offline.anew.hosts"]]
    with pytest.raises(CompileError, match=r"kernels could not be compiled: no compiler$"):
        warm_host()


@pytest.mark.parametrize(
    ("rows", "scan_s"),
    [
        ([{"state": FAILED}], None),
        ([{"wall_s": 2.0}], 2.0),
        ([{"wall_s": 2.0}, {"wall_s": 4.0}, {"state": FAILED}], 0.8 * 2.0 + 0.2 * 4.0),
    ],
)
def test_the_last_scans_count_most_for_how_long_one_takes(rows: list[Row], scan_s: float | None, here: Here) -> None:
    with here.engine() as engine:
        engine._learn(rows)
        assert engine._scan_s == (scan_s if scan_s is None else pytest.approx(scan_s))


def test_what_takes_too_long_is_begun_elsewhere_besides_at_most_twice(here: Here) -> None:
    with here.ready() as engine:
        work = _InWork((here.jobs[0],), time.monotonic())
        work.futures.append(engine._client.submit(time.sleep, 1.0, pure=False))
        engine._in_work[here.jobs[0].folder] = work
        until(lambda: any(engine._client.processing().values()))
        work.begun_s = time.monotonic() - 19.0
        engine._copy_overdue()
        assert len(work.futures) == 1
        work.begun_s = time.monotonic() - 21.0
        engine._copy_overdue()
        assert len(work.futures) == 2
        assert work.only is None, "the first one may still do it"
        engine._copy_overdue()
        assert len(work.futures) == 2, "a copy has its own time"
        (one,) = all_ended(engine)
        assert (one.job, one.row is not None) == (here.jobs[0], True)
        work.futures *= 2
        work.begun_s = 0.0
        count = len(work.futures)
        engine._in_work["again"] = work
        engine._copy_overdue()
        assert len(work.futures) == count


def test_a_task_that_its_worker_did_not_survive_may_be_any_of_its_jobs_fault(here: Here) -> None:
    with here.ready() as engine:
        for jobs in (here.jobs[:1], here.jobs[1:3]):
            work = _InWork(tuple(jobs), time.monotonic(), [engine._client.submit(int, "no number", pure=False)])
            distributed.wait(work.futures, TIMEOUT_S)
            ended = engine._ended(work)
            assert [(one.job, one.row, one.counts) for one in ended] == [(job, None, True) for job in jobs]
            assert {one.together for one in ended} == {len(jobs) > 1}
        forgotten = engine._client.submit(int, "3", pure=False)
        forgotten.cancel()
        ended = engine._ended(_InWork(tuple(here.jobs[:2]), time.monotonic(), [forgotten]))
        assert [(one.trouble, one.counts, one.together) for one in ended] == [
            ("the scheduler forgot it", False, False)
        ] * 2


def test_a_scheduler_that_goes_for_good_ends_the_work_with_its_address(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("SCHEDULER_BACK_S", 0.0), ("RETRY_S", 0.01)):
        monkeypatch.setattr(f"appliance.offline.anew.many.{name}", value)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as cluster:
        engine = ManyEngine(cluster.scheduler_address, 5.0, here.jobs[0])
    engine._client.close()
    engine._in_work["x"] = _InWork(tuple(here.jobs[:2]), 0.0)
    engine._workers["gone"] = _Member(1, None, 0.0, able=True)
    with pytest.raises(SchedulerError, match=f"{engine._address}: lost, and not back after 0 s"):
        engine.ended(0.01)
    assert [(one.job, one.row, one.counts) for one in engine._back] == [(job, None, False) for job in here.jobs[:2]]
    assert (engine._in_work, engine.places(), engine._looked_s) == ({}, {}, 0.0)


def test_a_scheduler_that_comes_back_gets_the_work_again(here: Here) -> None:
    with here.ready() as engine:
        engine._client.close()
        engine._in_work["x"] = _InWork((here.jobs[0],), 0.0)
        (one,) = engine.ended(0.01)
        assert (one.job, one.counts) == (here.jobs[0], False)
        until(lambda: engine.room() == 4)


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


def of_this_process(settings: dict[str, str]) -> dict[str, object]:
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
    with dask.config.set(of_this_process(ours)):
        with ManyEngine(cluster.address, 60.0, jobs[0]) as engine:
            worked = work_through_all(jobs, engine, lambda *_: None)
        assert_each_once_and_whole(results, jobs, worked.rows)
    plain = cluster.address.replace("tls", "tcp")
    assert comes_in(cluster.address, ours)
    assert not any(
        comes_in(*one) for one in ((plain, ours), (cluster.address, {}), (plain, {}), (cluster.address, strange))
    )
