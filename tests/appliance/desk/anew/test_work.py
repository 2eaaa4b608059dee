"""Scans given out by Dask: to threads of this process, and to processes of this computer, of which some die."""

from __future__ import annotations

import multiprocessing
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from appliance.base import kernel_cache
from appliance.desk.anew import work
from appliance.desk.anew.results import Results, program_digits
from appliance.desk.anew.work import AGAIN, FAILED, TROUBLES_IN_A_ROW, Job, RetryError, SchedulerError, work_through_all

distributed = pytest.importorskip("distributed")
MADE_WITH = {"calibration": None, "foreign": False, "water": None, "clouds": True, "program": program_digits()}
LIMIT_S = 60.0
COUNT = 20


def jobs_of(shelf: Path, results: Results) -> list[Job]:
    return [Job(str(folder), str(results.folder), None, None) for folder in sorted(shelf.iterdir())]


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results.of(tmp_path / "out", MADE_WITH)


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    """A shelf of scans whose manifests are none: each is a failure with a reason, and quick."""
    for number in range(COUNT):
        (tmp_path / "scans" / f"{number:06d}").mkdir(parents=True)
        (tmp_path / "scans" / f"{number:06d}" / "manifest.json").write_text("{" + str(number))
    return tmp_path / "scans"


def all_failed(rows: list[Any], shelf: Path) -> None:
    assert sorted(row["folder"] for row in rows) == sorted(map(str, shelf.iterdir()))
    assert {row["state"] for row in rows} == {FAILED}


@pytest.fixture(scope="module")
def here() -> Iterator[Any]:
    """A scheduler with two workers, all threads of this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        yield cluster


def test_every_scan_is_done_once_and_no_more_are_given_out_than_a_bound(
    here: Any, broken: Path, results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "IN_WORK", 3)
    most, seen = 0, []
    for row in work_through_all(jobs_of(broken, results), here.scheduler_address, None, LIMIT_S):
        seen.append(row)
        most = max(most, len(here.scheduler.tasks))
    all_failed(seen, broken)
    assert len(list((results.folder / "failed").iterdir())) == COUNT
    assert most <= 4, "one that ended may not be forgotten yet"


def test_workers_that_can_do_nothing_end_the_call_early_and_are_named(here: Any, broken: Path, tmp_path: Path) -> None:
    other = Results.of(tmp_path / "out", {**MADE_WITH, "program": "0.0.9-abc"})
    rows = list(work_through_all(jobs_of(broken, other), here.scheduler_address, None, LIMIT_S))
    assert len(rows) == TROUBLES_IN_A_ROW == 8
    assert {row["state"] for row in rows} == {AGAIN}
    assert all(row["reason"].startswith(f"{socket.gethostname()}: has kingfisher ") for row in rows)
    assert list((other.folder / "failed").iterdir()) == []


def test_a_worker_without_kernels_refuses_and_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config: Any = sys.modules["numba"].config
    monkeypatch.setattr(config, "CACHE_DIR", config.CACHE_DIR)
    monkeypatch.setenv(kernel_cache.VARIABLE, str(tmp_path / "given"))
    work._find_kernels.__wrapped__()  # whoever gave the folder keeps it
    monkeypatch.setenv(kernel_cache.VARIABLE, str(tmp_path / kernel_cache.fingerprint()))
    with pytest.raises(RetryError, match="call `kingfisher setup compile` there"):
        work._find_kernels.__wrapped__()


@pytest.mark.parametrize(
    ("address", "said"), [("tcp://127.0.0.1:9", ""), ("tls://127.0.0.1:9", ""), (None, "no worker")]
)
def test_a_scheduler_that_is_not_there_or_has_no_certificate_or_worker_is_one_clear_line(
    address: str | None, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "CONNECT_S", 0.5)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster:
        asked = address or cluster.scheduler_address
        with pytest.raises(SchedulerError, match=rf"--workers {asked}.*{said}"):
            next(work_through_all([], asked, None, LIMIT_S))


@pytest.mark.dive
def test_a_process_of_this_computer_that_is_killed_loses_nothing(broken: Path, results: Results) -> None:
    seen = []
    for row in work_through_all(jobs_of(broken, results), None, 2, LIMIT_S):
        seen.append(row)
        if len(seen) == 3:
            killed = multiprocessing.active_children()[0]
            killed.kill()
    all_failed(seen, broken)
    assert killed.exitcode == -9


@pytest.mark.long
def test_a_scan_that_never_ends_ends_its_workers_and_is_left_while_the_others_are_done(
    broken: Path, results: Results
) -> None:
    (broken / "000007" / "manifest.json").unlink()
    os.mkfifo(broken / "000007" / "manifest.json")  # whoever reads it waits for ever
    rows = list(work_through_all(jobs_of(broken, results), None, 2, 10.0))
    (left,) = (row for row in rows if row["state"] == AGAIN)
    assert left["scan"] == "000007"
    assert "died" in left["reason"]
    assert len(rows) == COUNT
