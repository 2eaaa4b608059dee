"""A whole archive worked through anew: one result of each scan whatever dies, hangs or is full meanwhile, and a reason where there is none."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import re
import shutil
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import cv2
import numba
import numpy as np
import pytest

from appliance.calibration import file as calibration_file
from appliance.offline.anew import results as module
from appliance.offline.anew import task
from appliance.offline.anew.coordinator import (
    LEFT_OUT_S,
    PLACELESS_S,
    TRIES,
    TROUBLES_IN_A_ROW,
    Ended,
    work_through_all,
)
from appliance.offline.anew.local import LocalEngine, _Worker
from appliance.offline.anew.program import _version, program_digits, program_text
from appliance.offline.anew.results import COLUMNS, Results, ResultsError, Row, host_digits, name_of, read_table
from appliance.offline.anew.task import AGAIN, BLAME, DONE, FAILED, OF_HOST, OF_MACHINE, OF_SCAN, Job, attempt
from appliance.storage.atomic import StorageError
from appliance.storage.lock import hold_lock
from appliance.storage.scan import ScanError
from hw_sim.truth import draw_truth
from tests.support.truth import true_calibration

SETTINGS = {"calibration": None, "program": "1"}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results.of(tmp_path / "out", SETTINGS)


def job(number: int, folder: Path = Path("/nowhere")) -> Job:
    return Job(str(folder / f"{number:06d}"), "", None, None, False, None, False, program_digits())


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
    host = host_digits()
    gone = 2**22 - 1  # above pid_max of this machine, or nobody's
    for name in (
        f"000001-a.{host}.{os.getpid()}.1",
        f"000002-a.{host}.{gone}.2",
        f"000003-a.{'0' * 12}.{gone}.3",  # its process lives there, whoever has the number here
        "000004-a.elsewhere.7.4",
        "000005",  # of no form: another program's, perhaps
        f"000006-a.{host}.²{gone}.6",
        f"000007-a.{host}.{gone}0000000000.7",
    ):
        (drafts / name).mkdir()
        (drafts / name / "row.json").write_text("{")
    now_s = time.time()
    for name, age_s in (("000004-a.elsewhere.7.4", 6.1 * 3600), ("000005", 5.9 * 3600)):
        os.utime(drafts / name, (now_s - age_s, now_s - age_s))
    assert results.sweep() == 2
    assert {path.name[:6] for path in drafts.iterdir()} == {"000001", "000003", "000005", "000006", "000007"}


@pytest.mark.parametrize("host", ["../../elsewhere", "a/b", "x" * 250, "\udcff"])
def test_a_result_is_published_whatever_the_computer_is_called(
    host: str, results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: host)
    assert results.publish("000001-a", row(1), None) == row(1)
    assert list((results.folder / "drafts").iterdir()) == []


def test_other_settings_have_another_key(results: Results, tmp_path: Path) -> None:
    assert Results.of(tmp_path / "out", SETTINGS).key == results.key
    assert len(results.key) == 16
    assert Results.of(tmp_path / "out", {**SETTINGS, "water": (4.0, 35.0)}).key != results.key


def test_a_scans_name_follows_its_manifest_and_not_how_its_frames_are_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "000001").mkdir(parents=True)
        (tmp_path / name / "000001" / "manifest.json").write_text("{}")
    assert name_of(tmp_path / "a" / "000001") == name_of(tmp_path / "b" / "000001")
    assert re.fullmatch("000001-[0-9a-f]{12}", name_of(tmp_path / "a" / "000001"))
    assert name_of(tmp_path / "a" / "000001", ["beside"]) != name_of(tmp_path / "a" / "000001")
    (tmp_path / "b" / "000001" / "manifest.json").write_text("{ }")
    assert name_of(tmp_path / "a" / "000001") != name_of(tmp_path / "b" / "000001")
    (tmp_path / "c" / "000009").mkdir(parents=True)
    assert name_of(tmp_path / "c" / "000009") == "000009-unreadable"
    with pytest.raises(FileNotFoundError):
        name_of(tmp_path / "d" / "000009")


def test_the_table_has_every_row_in_order_and_is_read_back(results: Results, tmp_path: Path) -> None:
    path = results.write_table(
        [row(2, points=5, faults='MOTION: "quick", 3 mm'), row(1, state=AGAIN, reason="full\ndisk")]
    )
    first, second = read_table(path)
    assert (first["scan"], first["state"], first["reason"]) == ("000001", AGAIN, "full\ndisk")
    assert (second["points"], second["faults"]) == ("5", 'MOTION: "quick", 3 mm')
    assert set(first) == set(COLUMNS)
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match="is no table"):
        read_table(tmp_path / "x.csv")


def test_the_table_is_in_the_order_of_the_scans_numbers_beyond_six_digits(results: Results, tmp_path: Path) -> None:
    numbers = [999_998, 1_000_000, 1_000_001, 999_999]
    path = results.write_table([row(number) for number in numbers])
    assert [int(one["scan"]) for one in read_table(path)] == sorted(numbers)
    assert [int(line.split(",")[0]) for line in path.read_text().splitlines()[1:]] == sorted(numbers)
    head, *lines = path.read_text().splitlines()
    (tmp_path / "old.csv").write_text("\n".join([head, *reversed(lines)]))  # earlier versions sorted text
    assert [int(one["scan"]) for one in read_table(tmp_path / "old.csv")] == sorted(numbers)


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1.1e12"])
def test_a_number_that_no_scan_has_is_refused_with_its_line_and_column(results: Results, value: str) -> None:
    path = results.write_table([row(1, noise_mm=0.02), row(2, noise_mm=value)])
    with pytest.raises(ResultsError, match=rf"line 3: noise_mm {value}: allowed are -1e\+12 to 1e\+12"):
        read_table(path)
    assert len(read_table(results.write_table([row(1, noise_mm=1e12), row(2, noise_mm="nan")]))) == 2


def test_a_call_for_one_part_keeps_the_rows_of_the_others(results: Results) -> None:
    for number in (1, 2):
        results.publish(f"{number:06d}-a", row(number, result=f"{number:06d}-a"), None)
    results.publish_failure("000003-a", row(3, state=FAILED, reason="damaged", result="000003-a"))
    path = results.write_table([row(1, result="000001-a"), row(4, state=AGAIN, reason="full")])
    assert [(one["scan"], one["state"]) for one in read_table(path)] == [
        ("000001", DONE), ("000002", DONE), ("000003", FAILED), ("000004", AGAIN),
    ]  # fmt: skip


def test_a_scan_that_became_another_one_is_in_the_table_once_and_its_old_failure_is_gone(results: Results) -> None:
    results.publish("000001-a", row(1, result="000001-a", points=5), None)
    results.publish("000001-b", row(1, result="000001-b", points=7), None)
    results.publish_failure("000002-a", row(2, state=FAILED, result="000002-a"))
    results.publish("000002-b", row(2, result="000002-b", points=8), None)
    table = results.write_table([row(1, result="000001-b"), row(2, result="000002-b")])
    assert [(one["scan"], one["points"]) for one in read_table(table)] == [("000001", "7"), ("000002", "8")]
    assert list((results.folder / "failed").iterdir()) == []


def test_a_scan_that_has_a_result_of_before_is_not_called_refused_by_the_disk(results: Results) -> None:
    results.publish("000001-a", row(1, result="000001-a"), None)
    table = results.write_table([row(1, state=AGAIN, reason="full")])
    assert [one["state"] for one in read_table(table)] == [DONE]


def test_two_calls_may_share_the_work_and_not_the_same_part_of_it(results: Results) -> None:
    with results.call("/a (1, 2)"):
        with results.call("/a (2, 2)"):
            pass
        with pytest.raises(StorageError, match="another instance"), results.call("/a (1, 2)"):
            pass


def test_who_is_done_second_waits_until_the_first_one_has_written_the_table(
    results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    results.publish("000001-a", row(1, result="000001-a"), None)
    written: list[Path] = []
    writer = threading.Thread(target=lambda: written.append(results.write_table([])))
    with hold_lock(results.folder):
        writer.start()
        writer.join(timeout=0.5)
        assert written == []
        results.publish("000002-a", row(2, result="000002-a"), None)
    writer.join(timeout=30)
    assert [one["scan"] for one in read_table(written[0])] == ["000001", "000002"]
    monkeypatch.setattr(module, "TABLE_WAIT_S", 0.1)
    with hold_lock(results.folder), pytest.raises(StorageError, match="another instance"):
        results.write_table([])


# -------------------------------------------------------------------------------------- coordinator


class Scripted:
    """An engine of two places in each of ``names`` that ends each job as the script says; it counts what it was given.

    ``slow``: places that answer only every so many times; ``several``: jobs that it takes at once.
    """

    others_may_come = False

    def __init__(
        self,
        end: Callable[[Job, int], Ended],
        names: tuple[str, ...] = ("",),
        slow: Mapping[str, int] = MappingProxyType({}),
        several: int = 1,
    ) -> None:
        self._several = several
        self.together: list[list[str]] = []
        self._end, self._slow, self._turn = end, slow, 0
        self._held: dict[str, list[Job]] = {name: [] for name in names}
        self._out: dict[str, str] = {}
        self.given: dict[str, int] = {}
        self.most = 0

    def places(self) -> Mapping[str, str | None]:
        return {name: self._out.get(name) for name in self._held}

    def leave_out(self, place: str, reason: str) -> None:
        self._out[place] = reason

    def room(self) -> int:
        return sum(2 - len(held) for name, held in self._held.items() if name not in self._out)

    def at_once(self, waiting: int) -> int:
        return min(self._several, waiting)

    def start(self, jobs: Sequence[Job]) -> None:
        name = next(name for name, held in self._held.items() if len(held) < 2 and name not in self._out)
        self._held[name] += jobs
        self.together.append([job.name for job in jobs])
        for job in jobs:
            self.given[job.name] = self.given.get(job.name, 0) + 1
        self.most = max(self.most, len(self._held[name]))

    def ended(self, timeout_s: float) -> list[Ended]:
        del timeout_s
        self._turn += 1
        found = []
        for name, held in self._held.items():
            if self._turn % self._slow.get(name, 1) == 0:
                found += [replace(self._end(job, self.given[job.name]), place=name) for job in held]
                held.clear()
        return found

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
    assert engine.given["000007"] == TRIES == 3


def test_a_scan_that_kills_its_worker_takes_none_with_it_that_shared_its_task() -> None:
    killer = "000007"

    class Killed(Scripted):
        """Everything that is in work when the killer is ends with it."""

        def ended(self, timeout_s: float) -> list[Ended]:
            found = super().ended(timeout_s)
            by_name = {one.job.name: one for one in found}
            lost = [names for names in self.together[-2:] if killer in names and killer in by_name]
            for names in lost:
                for name in names:
                    by_name[name] = Ended(by_name[name].job, None, "code -9", together=len(names) > 1)
            return list(by_name.values())

    engine = Killed(lambda one, _: done(one), several=5)
    worked = work_through_all(JOBS, engine, silent)
    assert sorted(one["scan"] for one in worked.rows) == [one.name for one in JOBS if one.name != killer]
    assert [one["scan"] for one in worked.left] == [killer]
    assert engine.given[killer] == TRIES + 1
    assert max(count for name, count in engine.given.items() if name != killer) == 2
    assert max(len(names) for names in engine.together) == 5
    assert [names for names in engine.together if killer in names][1:] == [[killer]] * TRIES


def test_a_lost_scheduler_counts_against_no_scan() -> None:
    engine = Scripted(lambda one, n: done(one) if n > 2 * TRIES else Ended(one, None, "lost", counts=False))
    assert len(work_through_all(JOBS, engine, silent).rows) == 30


def test_a_full_disk_ends_the_work_early_and_says_so() -> None:
    engine = Scripted(lambda one, _: Ended(one, {"scan": one.name, "state": AGAIN, "reason": "the disk is full"}))
    worked = work_through_all(JOBS, engine, silent)
    assert worked.stopped is not None
    assert "the disk is full" in worked.stopped
    assert sum(engine.given.values()) == TROUBLES_IN_A_ROW == 8
    assert worked.not_begun + len(worked.left) == len(JOBS)


def test_a_disk_that_is_full_for_four_places_ends_the_work_after_a_few_of_each() -> None:
    engine = Scripted(
        lambda one, _: Ended(one, {"scan": one.name, "state": AGAIN, "reason": "full"}), ("a", "b", "c", "d")
    )
    assert work_through_all(JOBS, engine, silent).stopped == "full"
    assert sum(engine.given.values()) <= 2 * TROUBLES_IN_A_ROW


class SomeBad(Scripted):
    """Every place but ``good`` refuses with ``blame``, forty times while the good one answers once; they are given jobs first."""

    def __init__(self, blame: str, bad: Sequence[str]) -> None:
        super().__init__(lambda one, _: done(one), (*bad, "good"), {"good": 40})
        self._blame = blame

    def ended(self, timeout_s: float) -> list[Ended]:
        refusal = {"state": AGAIN, "reason": "no memory", "host": "old", BLAME: self._blame}
        return [
            one if one.place == "good" else replace(one, row={"scan": one.job.name, **refusal})
            for one in super().ended(timeout_s)
        ]


@pytest.mark.parametrize("blame", [OF_HOST, OF_MACHINE])
def test_bad_places_that_refuse_in_an_instant_end_nothing_and_are_named(blame: str) -> None:
    worked = work_through_all(JOBS, SomeBad(blame, ("bad", "worse")), silent)
    assert worked.stopped is None
    assert dict(worked.left_out) == {"bad": "old: no memory", "worse": "old: no memory"}
    assert len(worked.rows) + len(worked.left) == len(JOBS)
    assert len(worked.left) <= (0 if blame == OF_HOST else 2 * TROUBLES_IN_A_ROW / TRIES)


def test_what_a_host_cannot_do_counts_against_no_scan_however_many_hosts_there_are() -> None:
    worked = work_through_all(JOBS[:1], SomeBad(OF_HOST, [f"bad{k}" for k in range(2 * TRIES)]), silent)
    assert [one["state"] for one in worked.rows] == [DONE]
    assert len(worked.left_out) == 2 * TRIES


def test_scans_that_are_gone_one_after_another_leave_nobody_out() -> None:
    gone = {one.name for one in JOBS[:12]}

    def end(one: Job, n: int) -> Ended:
        del n
        row = {"scan": one.name, "state": AGAIN, "reason": "gone", BLAME: OF_SCAN}
        return Ended(one, row) if one.name in gone else done(one)

    worked = work_through_all(JOBS, Scripted(end), silent)
    assert (len(worked.rows), {one["scan"] for one in worked.left}, worked.left_out) == (18, gone, {})


def test_where_all_are_left_out_others_are_waited_for_and_not_for_ever() -> None:
    class Open(Scripted):
        others_may_come = True

    bad = {"state": AGAIN, "reason": "no SOURCE", BLAME: OF_HOST}
    clock = iter(range(10_000))
    engine = Open(lambda one, _: Ended(one, {"scan": one.name, **bad}), ("a", "b"))
    worked = work_through_all(JOBS, engine, silent, lambda: float(next(clock)))
    assert worked.stopped is not None
    assert "nobody is left who can do it" in worked.stopped
    assert "no SOURCE" in worked.stopped
    assert worked.not_begun == len(JOBS)
    assert LEFT_OUT_S == 60.0 < next(clock) < LEFT_OUT_S + 10.0


def test_single_refusals_between_results_stop_nothing() -> None:
    def end(one: Job, n: int) -> Ended:
        odd = int(one.name) % 2 == 1
        return Ended(one, {"scan": one.name, "state": AGAIN, "reason": "busy"}) if odd and n == 1 else done(one)

    worked = work_through_all(JOBS, Scripted(end), silent)
    assert (len(worked.rows), worked.stopped) == (30, None)


def test_workers_that_go_for_good_end_the_work_also_while_they_hold_scans() -> None:
    class Gone(Scripted):
        """Both places vanish with what they were given, after four results."""

        others_may_come = True

        def places(self) -> Mapping[str, str | None]:
            return {} if sum(self.given.values()) > 4 else super().places()

        def ended(self, timeout_s: float) -> list[Ended]:
            return super().ended(timeout_s) if self.places() else []

    clock = iter(range(10_000))
    worked = work_through_all(JOBS, Gone(lambda one, _: done(one), ("a", "b")), silent, lambda: float(next(clock)))
    assert worked.stopped is not None
    assert "there was no worker for 600 s" in worked.stopped
    assert (len(worked.rows), worked.not_begun) == (4, len(JOBS) - 4)
    assert PLACELESS_S < next(clock) < PLACELESS_S + 10.0


# ------------------------------------------------------------------------------------------- the task


def broken(tmp_path: Path) -> Path:
    """A shelf with a scan whose manifest is none."""
    (tmp_path / "scans" / "000001").mkdir(parents=True)
    (tmp_path / "scans" / "000001" / "manifest.json").write_text("{")
    return tmp_path / "scans"


def test_what_is_wrong_with_a_scan_is_a_result_with_its_reason(results: Results, tmp_path: Path) -> None:
    found = attempt(replace(job(1, broken(tmp_path)), results=str(results.folder)))
    assert found["state"] == FAILED
    assert "not readable as JSON" in found["reason"]
    assert len(list((results.folder / "failed").iterdir())) == 1


def test_another_program_does_not_write_under_this_ones_key(results: Results, tmp_path: Path) -> None:
    found = attempt(replace(job(1, broken(tmp_path)), results=str(results.folder), program="0.0.9-abc"))
    assert (found["state"], found[BLAME]) == (AGAIN, OF_HOST)
    assert "another version" in found["reason"]


def test_a_host_that_does_not_see_the_scans_publishes_no_failure_and_is_named(results: Results, tmp_path: Path) -> None:
    """Neither where nothing is mounted, nor where the folder waits for its disk."""
    host = os.uname().nodename
    for _ in ("not there", "empty"):
        found = attempt(replace(job(1, tmp_path / "scans"), results=str(results.folder)))
        assert (found["state"], found[BLAME]) == (AGAIN, OF_HOST)
        assert f"{host} sees no scans in {tmp_path / 'scans'}; mount SOURCE there" in found["reason"]
        (tmp_path / "scans").mkdir(exist_ok=True)
    gone = attempt(replace(job(2, broken(tmp_path)), results=str(results.folder)))
    assert (gone["state"], gone[BLAME]) == (AGAIN, OF_SCAN)
    assert f"{host}: {tmp_path / 'scans' / '000002'} is not there any more" in gone["reason"]
    assert list((results.folder / "failed").iterdir()) == []


def test_a_host_that_does_not_see_the_results_or_the_calibration_is_named_before_it_works(
    results: Results, tmp_path: Path
) -> None:
    one = replace(job(1, broken(tmp_path)), results=str(results.folder))
    found = attempt(replace(one, results=str(tmp_path / "nowhere" / "key")))
    assert found[BLAME] == OF_HOST
    assert f"does not see --out {tmp_path / 'nowhere'}" in found["reason"]
    found = attempt(replace(one, calibration=str(tmp_path / "none.json"), calibration_hash="ab"))
    assert found[BLAME] == OF_HOST
    assert "cannot use --calibration" in found["reason"]
    encoded = calibration_file.encode(true_calibration(draw_truth("nominal", 1, 64, 48, 1.34)))
    (tmp_path / "other.json").write_bytes(encoded)
    found = attempt(replace(one, calibration=str(tmp_path / "other.json"), calibration_hash="ab"))
    assert found[BLAME] == OF_HOST
    assert "sees another calibration" in found["reason"]
    assert list((results.folder / "failed").iterdir()) == []


def test_a_scan_that_goes_while_it_is_worked_through_is_no_failure(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf = broken(tmp_path)

    def unmounted(folder: Path) -> None:
        shutil.rmtree(shelf)
        raise ScanError(f"{folder / 'frames_left.npy'}: missing")

    monkeypatch.setattr(task, "refuse_damaged_frames", unmounted)
    found = attempt(replace(job(1, shelf), results=str(results.folder)))
    assert (found["state"], found[BLAME]) == (AGAIN, OF_SCAN)
    assert list((results.folder / "failed").iterdir()) == []


def test_a_mistake_of_the_program_is_a_row_with_its_type_and_text_and_the_log_has_the_rest(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def wrong(_: Path) -> None:
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr(task, "refuse_damaged_frames", wrong)
    found = attempt(replace(job(1, broken(tmp_path)), results=str(results.folder)))
    assert (found["state"], found["reason"]) == (FAILED, "unexpected ValueError: operands could not be broadcast")
    assert "in wrong" in caplog.text
    (path,) = (results.folder / "failed").iterdir()
    assert "in wrong" in json.loads(path.read_text())["traceback"]


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(1)])
def test_what_ends_a_process_ends_it(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def ends(_: Path) -> None:
        raise error

    monkeypatch.setattr(task, "refuse_damaged_frames", ends)
    with pytest.raises(type(error)):
        attempt(replace(job(1, broken(tmp_path)), results=str(results.folder)))
    assert list((results.folder / "failed").iterdir()) == []


def test_too_little_memory_is_the_machines_fault(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wants(_: Path) -> None:
        raise MemoryError

    monkeypatch.setattr(task, "refuse_damaged_frames", wants)
    found = attempt(replace(job(1, broken(tmp_path)), results=str(results.folder)))
    assert (found["state"], found[BLAME]) == (AGAIN, OF_MACHINE)
    assert list((results.folder / "failed").iterdir()) == []


# ------------------------------------------------------------------------------------------- the program


def test_another_library_or_rig_file_is_another_program(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "a.py").write_text("1")
    (tmp_path / "rigs" / "kingfisher.toml").write_text("width_px = 1600")
    before = program_text(tmp_path, {"numpy": "2.2.0", "numba": "0.61.0"})
    assert program_text(tmp_path, {"numpy": "2.2.0", "numba": "0.61.0"}) == before
    assert program_text(tmp_path, {"numpy": "2.2.1", "numba": "0.61.0"}) != before
    (tmp_path / "rigs" / "kingfisher.toml").write_text("width_px = 1601")
    assert program_text(tmp_path, {"numpy": "2.2.0", "numba": "0.61.0"}) != before


def test_the_program_names_the_libraries_that_compute() -> None:
    assert re.match(r"kingfisher \S+-[0-9a-f]{12} numpy ", program_digits())
    assert _version("no such library") == "?"
    for name, library in (("numpy", np), ("numba", numba), ("opencv-python-headless", cv2)):
        assert re.search(rf"\b{name} {re.escape(library.__version__)}", program_digits()), name


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
        warm.start([replace(job(1, folder), results=str(results.folder))])
        assert [one.row is not None for one in warm.ended(60.0)] == [True]
        (process,) = warm.process_ids
        os.kill(process, signal.SIGSTOP)
        warm._limit_s = 0.5
        warm.start([replace(job(2, folder), results=str(results.folder))])
        ended: list[Ended] = []
        until_s = time.monotonic() + 30.0
        while not ended and time.monotonic() < until_s:
            ended = warm.ended(0.1)
        assert [(one.row, one.trouble) for one in ended] == [(None, "not done after 0 s")]
        assert warm.process_ids != [process]


def test_a_process_that_has_grown_is_replaced_between_two_scans() -> None:
    mine, theirs = multiprocessing.Pipe()
    idle = multiprocessing.get_context("fork").Process(target=time.sleep, args=(60.0,), daemon=True)
    idle.start()
    with LocalEngine(0, limit_s=30.0) as engine:
        worker = _Worker(idle, mine)
        engine._workers.append(worker)
        theirs.send({"peak_mb": 3000})
        assert engine.ended(0.05) == [], "nothing is in work"
        for peak_mb, kept in ((3000, True), (3001, False)):
            worker.job, worker.until_s = JOBS[0], time.monotonic() + 30.0
            assert engine.room() == 0
            (one,) = engine.ended(10.0)
            assert (one.job, one.row, one.place) == (JOBS[0], {"peak_mb": peak_mb}, "this computer")
            assert (engine.process_ids == [idle.pid]) is kept
            assert engine.room() == 1
            if kept:
                theirs.send({"peak_mb": 3001})
        assert dict(engine.places()) == {"this computer": None}
        assert not engine.others_may_come
        assert engine.at_once(9) == 1
        engine.leave_out("this computer", "full")
        assert (engine.room(), dict(engine.places())) == (0, {"this computer": "full"})
        worker.job = JOBS[0]  # its process is ended at once
    assert not idle.is_alive()
    assert worker.process.exitcode == -signal.SIGKILL
