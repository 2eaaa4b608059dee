"""A whole archive worked through anew: one result of each scan whatever dies, hangs or is full meanwhile, and a reason where there is none."""

from __future__ import annotations

import errno
import json
import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.offline.anew import results as module
from appliance.offline.anew.coordinator import TRIES, TROUBLES_IN_A_ROW, Ended, work_through_all
from appliance.offline.anew.local import LocalEngine
from appliance.offline.anew.results import COLUMNS, Results, ResultsError, Row, name_of, read_table
from appliance.offline.anew.task import AGAIN, DONE, FAILED, Job, attempt, program_digits
from appliance.storage.atomic import StorageError

SETTINGS = {"calibration": None, "program": "1"}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results.of(tmp_path / "out", SETTINGS)


def job(number: int, folder: Path = Path("/nowhere")) -> Job:
    return Job(str(folder / f"{number:06d}"), "", None, False, None, False, program_digits())


def row(number: int, **more: object) -> Row:
    return {"scan": f"{number:06d}", "folder": f"/x/{number:06d}", "state": DONE, **more}


# ------------------------------------------------------------------------------------------ results


def test_one_result_is_published_whoever_was_first(results: Results) -> None:
    first = results.publish("000001-a", row(1, host="one"), (b"points", b"!"))
    second = results.publish("000001-a", row(1, host="two"), (b"other",))
    assert first == second
    assert second["host"] == "one"
    folder = results.folder / "results" / "000001-a"
    assert (folder / "cloud.ply").read_bytes() == b"points!"
    assert json.loads((folder / "row.json").read_text()) == first
    assert list((results.folder / "drafts").iterdir()) == []


def test_twenty_at_once_publish_one(results: Results) -> None:
    begin = threading.Barrier(20)
    seen: list[Row] = []

    def publish(number: int) -> None:
        begin.wait(timeout=30)
        seen.append(results.publish("000001-a", row(1, host=str(number)), (bytes([number]) * 1000,)))

    threads = [threading.Thread(target=publish, args=(number,)) for number in range(20)]
    for one in threads:
        one.start()
    for one in threads:
        one.join(timeout=60)
    assert len(seen) == 20
    assert all(one == seen[0] for one in seen)
    assert [path.name for path in (results.folder / "results").iterdir()] == ["000001-a"]
    cloud = (results.folder / "results" / "000001-a" / "cloud.ply").read_bytes()
    assert cloud == bytes([int(seen[0]["host"])]) * 1000, "row and cloud are of the same one"


def test_a_full_disk_publishes_nothing_and_leaves_no_draft(results: Results, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise StorageError("cannot write", Path("x"), os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(module, "write_new", full)
        with pytest.raises(StorageError):
            results.publish("000001-a", row(1), None)
    assert results.row("000001-a") is None
    assert list((results.folder / "drafts").iterdir()) == []


def test_a_result_takes_the_place_of_a_failure(results: Results) -> None:
    results.publish_failure("000001-a", row(1, state=FAILED))
    assert (results.folder / "failed" / "000001-a.json").exists()
    results.publish("000001-a", row(1), None)
    assert not (results.folder / "failed" / "000001-a.json").exists()


def test_drafts_of_the_dead_are_swept_and_those_of_the_living_stay(results: Results) -> None:
    drafts = results.folder / "drafts"
    host = os.uname().nodename
    gone = 2**22 - 1  # above pid_max of this machine, or nobody's
    for name in (
        f"000001-a.{host}.{os.getpid()}.1",
        f"000002-a.{host}.{gone}.2",
        "000003-a.elsewhere.7.3",
        "000004-a.elsewhere.7.4",
    ):
        (drafts / name).mkdir()
        (drafts / name / "row.json").write_text("{")
    old_s = time.time() - 7 * 3600
    os.utime(drafts / "000004-a.elsewhere.7.4", (old_s, old_s))
    assert results.sweep() == 2
    assert {path.name[:6] for path in drafts.iterdir()} == {"000001", "000003"}


def test_other_settings_have_another_key(results: Results, tmp_path: Path) -> None:
    assert Results.of(tmp_path / "out", SETTINGS).key == results.key
    assert Results.of(tmp_path / "out", {**SETTINGS, "water": (4.0, 35.0)}).key != results.key


def test_a_scans_name_follows_its_manifest_and_not_how_its_frames_are_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "000001").mkdir(parents=True)
        (tmp_path / name / "000001" / "manifest.json").write_text("{}")
    assert name_of(tmp_path / "a" / "000001") == name_of(tmp_path / "b" / "000001")
    (tmp_path / "b" / "000001" / "manifest.json").write_text("{ }")
    assert name_of(tmp_path / "a" / "000001") != name_of(tmp_path / "b" / "000001")
    assert name_of(tmp_path / "c" / "000009") == "000009-unreadable"


def test_the_table_has_every_row_in_order_and_is_read_back(results: Results, tmp_path: Path) -> None:
    path = results.write_table(
        [row(2, points=5, faults='MOTION: "quick", 3 mm'), row(1, state=FAILED, reason="damaged\nframes")]
    )
    first, second = read_table(path)
    assert (first["scan"], first["state"], first["reason"]) == ("000001", FAILED, "damaged\nframes")
    assert (second["points"], second["faults"]) == ("5", 'MOTION: "quick", 3 mm')
    assert set(first) == set(COLUMNS)
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match="is no table"):
        read_table(tmp_path / "x.csv")


# -------------------------------------------------------------------------------------- coordinator


class Scripted:
    """An engine of two places that ends each job as the script says; it counts what it was given."""

    def __init__(self, end: Callable[[Job, int], Ended]) -> None:
        self._end, self._held = end, list[Job]()
        self.given: dict[str, int] = {}
        self.most = 0

    def room(self) -> int:
        return 2 - len(self._held)

    def start(self, job: Job) -> None:
        self._held.append(job)
        self.given[job.name] = self.given.get(job.name, 0) + 1
        self.most = max(self.most, len(self._held))

    def ended(self, timeout_s: float) -> list[Ended]:
        del timeout_s
        held, self._held = self._held, []
        return [self._end(job, self.given[job.name]) for job in held]

    def close(self) -> None: ...


def silent(done: int, of: int, left_s: float | None) -> None:
    del done, of, left_s


JOBS = [job(number) for number in range(30)]


def done(one: Job) -> Ended:
    return Ended(one, {"scan": one.name, "state": DONE})


def test_no_more_is_in_work_than_there_is_room_for_and_each_is_done_once() -> None:
    engine = Scripted(lambda one, _: done(one))
    heard: list[tuple[int, float | None]] = []
    clock = iter(range(1000))
    worked = work_through_all(JOBS, engine, lambda n, _, left: heard.append((n, left)), lambda: float(next(clock)))
    assert sorted(one["scan"] for one in worked.rows) == [one.name for one in JOBS]
    assert engine.most == 2
    assert heard[0] == (2, 1 / 2 * 28)
    assert heard[-1] == (30, 0.0)


def test_what_a_dead_worker_held_is_given_out_again() -> None:
    engine = Scripted(lambda one, n: done(one) if n > 1 else Ended(one, None, "gone"))
    worked = work_through_all(JOBS, engine, silent)
    assert len({one["scan"] for one in worked.rows}) == len(worked.rows) == 30
    assert worked.lost == 30
    assert worked.left == ()


def test_a_scan_that_kills_every_worker_is_left_with_a_reason_and_the_others_are_done() -> None:
    engine = Scripted(lambda one, _: Ended(one, None, "code -9") if one.name == "000007" else done(one))
    worked = work_through_all(JOBS, engine, silent)
    assert len(worked.rows) == 29
    assert [(one["scan"], one["state"], one["reason"]) for one in worked.left] == [("000007", AGAIN, "code -9")]
    assert engine.given["000007"] == TRIES


def test_a_lost_scheduler_counts_against_no_scan() -> None:
    engine = Scripted(lambda one, n: done(one) if n > 2 * TRIES else Ended(one, None, "lost", counts=False))
    assert len(work_through_all(JOBS, engine, silent).rows) == 30


def test_a_full_disk_ends_the_work_early_and_says_so() -> None:
    engine = Scripted(lambda one, _: Ended(one, {"scan": one.name, "state": AGAIN, "reason": "the disk is full"}))
    worked = work_through_all(JOBS, engine, silent)
    assert worked.stopped == "the disk is full"
    assert sum(engine.given.values()) <= TROUBLES_IN_A_ROW + 2


def test_single_refusals_between_results_stop_nothing() -> None:
    def end(one: Job, n: int) -> Ended:
        odd = int(one.name) % 2 == 1
        return Ended(one, {"scan": one.name, "state": AGAIN, "reason": "busy"}) if odd and n == 1 else done(one)

    worked = work_through_all(JOBS, Scripted(end), silent)
    assert (len(worked.rows), worked.stopped) == (30, None)


# ------------------------------------------------------------------------------------------- the task


def test_what_is_wrong_with_a_scan_is_a_result_with_its_reason(results: Results, tmp_path: Path) -> None:
    (tmp_path / "000001").mkdir()
    (tmp_path / "000001" / "manifest.json").write_text("{")
    found = attempt(replace(job(1, tmp_path), results=str(results.folder)))
    assert found["state"] == FAILED
    assert "not readable as JSON" in found["reason"]
    assert len(list((results.folder / "failed").iterdir())) == 1


def test_another_program_does_not_write_under_this_ones_key(results: Results, tmp_path: Path) -> None:
    found = attempt(replace(job(1, tmp_path), results=str(results.folder), program="0.0.9-abc"))
    assert found["state"] == AGAIN
    assert "another version" in found["reason"]


# ---------------------------------------------------------------------------------- local processes


@pytest.fixture
def folder(tmp_path: Path, results: Results) -> Path:
    """Thirty folders that are no scans: each is a failure with a reason, and quick."""
    del results
    for number in range(30):
        (tmp_path / "scans" / f"{number:06d}").mkdir(parents=True)
        (tmp_path / "scans" / f"{number:06d}" / "manifest.json").write_text("{" + str(number))
    return tmp_path / "scans"


def test_processes_that_are_killed_or_stopped_lose_nothing(folder: Path, results: Results) -> None:
    jobs = [replace(job(number, folder), results=str(results.folder)) for number in range(30)]
    hit: list[int] = []
    with LocalEngine(2, limit_s=20.0) as engine:
        first, second = engine.process_ids

        def hurt(ended: int, of: int, left_s: float | None) -> None:
            del of, left_s
            if ended >= 5 and not hit:
                os.kill(first, signal.SIGKILL)
                hit.append(first)
            if ended >= 10 and len(hit) == 1:
                os.kill(second, signal.SIGKILL)
                hit.append(second)

        worked = work_through_all(jobs, engine, hurt)
        assert not {first, second} & set(engine.process_ids)
    assert sorted(one["scan"] for one in worked.rows) == [one.name for one in jobs]
    assert len(list((results.folder / "failed").iterdir())) == 30
    assert 1 <= worked.lost <= 4


def test_a_process_that_hangs_is_ended_and_its_scan_comes_back(folder: Path, results: Results) -> None:
    with LocalEngine(1, limit_s=30.0) as warm:  # its process has loaded everything by then
        warm.start(replace(job(1, folder), results=str(results.folder)))
        assert [one.row is not None for one in warm.ended(60.0)] == [True]
        (process,) = warm.process_ids
        os.kill(process, signal.SIGSTOP)
        warm._limit_s = 0.5
        warm.start(replace(job(2, folder), results=str(results.folder)))
        ended: list[Ended] = []
        until_s = time.monotonic() + 30.0
        while not ended and time.monotonic() < until_s:
            ended = warm.ended(0.1)
        assert [(one.row, one.trouble) for one in ended] == [(None, "not done after 0 s")]
        assert warm.process_ids != [process]
