"""One scan reprocessed, and where its result lies: one of each whatever dies or is full meanwhile, and a reason where there is none."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import threading
from pathlib import Path

import cv2
import numba
import numpy as np
import pytest

from appliance.calibration import file as calibration_file
from appliance.offline.anew import results as module
from appliance.offline.anew import task
from appliance.offline.anew.results import (
    COLUMNS,
    Results,
    ResultsError,
    Row,
    name_of,
    program_digits,
    read_table,
)
from appliance.offline.anew.task import attempt
from appliance.offline.anew.work import AGAIN, DONE, FAILED, Again, Job
from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.scan import ScanError, write_raw
from hw_sim.truth import draw_truth
from tests.appliance.storage.scenes import ORIGIN, frames, record
from tests.support.truth import true_calibration

MADE_WITH = {"calibration": None, "foreign": False, "water": None, "clouds": False, "program": program_digits()}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results.of(tmp_path / "out", MADE_WITH)


def job(number: int, folder: Path, results: Results, calibration: Path | None = None) -> Job:
    return Job(
        str(folder / f"{number:06d}"), str(results.folder), None if calibration is None else str(calibration), None
    )


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


def test_what_a_killed_process_left_is_swept(results: Results) -> None:
    (results.folder / "drafts" / "tmp1" / "000001-a").mkdir(parents=True)
    (results.folder / "drafts" / "tmp1" / "000001-a" / "row.json").write_text("{")
    assert results.sweep() == 1
    assert list((results.folder / "drafts").iterdir()) == []
    assert results.sweep() == 0


def test_other_settings_have_another_key(results: Results, tmp_path: Path) -> None:
    assert Results.of(tmp_path / "out", MADE_WITH).folder == results.folder
    assert len(results.folder.name) == 16
    assert Results.of(tmp_path / "out", {**MADE_WITH, "water": (4.0, 35.0)}).folder != results.folder


def test_a_scans_name_follows_its_manifest_and_not_how_its_frames_are_kept(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name / "000001").mkdir(parents=True)
        (tmp_path / name / "000001" / "manifest.json").write_text("{}")
    assert name_of(tmp_path / "a" / "000001") == name_of(tmp_path / "b" / "000001")
    assert re.fullmatch("000001-[0-9a-f]{12}", name_of(tmp_path / "a" / "000001"))
    (tmp_path / "b" / "000001" / "manifest.json").write_text("{ }")
    assert name_of(tmp_path / "a" / "000001") != name_of(tmp_path / "b" / "000001")
    (tmp_path / "c" / "000009").mkdir(parents=True)
    assert name_of(tmp_path / "c" / "000009") == "000009-unreadable"


def test_the_table_has_every_row_in_order_and_is_read_back(results: Results, tmp_path: Path) -> None:
    path = results.write_table(
        [row(2, result="b", points=5, faults='MOTION: "quick", 3 mm'), row(1, state=AGAIN, reason="full\ndisk")]
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


def test_a_call_keeps_the_rows_of_scans_that_it_does_not_know(results: Results) -> None:
    for number in (1, 2):
        results.publish(f"{number:06d}-a", row(number, result=f"{number:06d}-a"), None)
    results.publish_failure("000003-a", row(3, state=FAILED, reason="damaged", result="000003-a"))
    path = results.write_table([row(1, result="000001-a"), row(4, state=AGAIN, reason="full")])
    assert [(one["scan"], one["state"]) for one in read_table(path)] == [
        ("000001", DONE), ("000002", DONE), ("000003", FAILED), ("000004", AGAIN),
    ]  # fmt: skip


def test_a_scan_that_became_another_one_is_in_the_table_once(results: Results) -> None:
    results.publish("000001-a", row(1, result="000001-a", points=5), None)
    results.publish("000001-b", row(1, result="000001-b", points=7), None)
    results.publish_failure("000002-a", row(2, state=FAILED, result="000002-a"))
    results.publish("000002-b", row(2, result="000002-b", points=8), None)
    table = results.write_table([row(1, result="000001-b", points=7)])
    assert [(one["scan"], one["points"]) for one in read_table(table)] == [("000001", "7"), ("000002", "8")]


def test_a_scan_that_has_a_result_of_before_is_not_called_left(results: Results) -> None:
    results.publish("000001-a", row(1, result="000001-a"), None)
    table = results.write_table([row(1, state=AGAIN, reason="full")])
    assert [one["state"] for one in read_table(table)] == [DONE]


def test_a_row_that_cannot_be_read_is_named(results: Results) -> None:
    (results.folder / "results" / "000001-a").mkdir()
    (results.folder / "results" / "000001-a" / "row.json").write_text("{")
    with pytest.raises(StorageError, match=r"cannot read .*000001-a/row.json"):
        results.row("000001-a")


# ------------------------------------------------------------------------------------------- the task


def broken(tmp_path: Path) -> Path:
    """A shelf with a scan whose manifest is none."""
    (tmp_path / "scans" / "000001").mkdir(parents=True)
    (tmp_path / "scans" / "000001" / "manifest.json").write_text("{")
    return tmp_path / "scans"


def complete(tmp_path: Path) -> Path:
    """A shelf with a scan as an instrument writes it."""
    (tmp_path / "scans").mkdir()
    write_raw(LocalFileSystem(), tmp_path / "scans" / "000001", "000001", frames(1), record(), ORIGIN)
    return tmp_path / "scans"


def failures(results: Results) -> list[Path]:
    return list((results.folder / "failed").iterdir())


def test_what_is_wrong_with_a_scan_is_a_result_with_its_reason(results: Results, tmp_path: Path) -> None:
    found = attempt(job(1, broken(tmp_path), results))
    assert found["state"] == FAILED
    assert "not readable as JSON" in found["reason"]
    assert len(failures(results)) == 1


def test_a_computer_that_can_do_no_such_job_writes_nothing_down_and_says_what_to_do(
    results: Results, tmp_path: Path
) -> None:
    shelf = broken(tmp_path)
    other = Results.of(tmp_path / "out", {**MADE_WITH, "program": "0.0.9-abc"})
    with pytest.raises(Again, match="install the same version everywhere"):
        attempt(job(1, shelf, other))
    with pytest.raises(Again, match=f"does not see {shelf}/000002; mount SOURCE there"):
        attempt(job(2, shelf, results))
    with pytest.raises(StorageError, match="under the same path"):
        attempt(job(1, shelf, Results(tmp_path / "nowhere" / "key")))
    encoded = calibration_file.encode(true_calibration(draw_truth("nominal", 1, 64, 48, 1.34)))
    (tmp_path / "other.json").write_bytes(encoded)
    with pytest.raises(Again, match="sees another calibration"):
        attempt(job(1, shelf, results, tmp_path / "other.json"))
    assert failures(results) == failures(other) == []


def test_a_scan_that_goes_while_it_is_worked_through_is_no_failure(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shelf = complete(tmp_path)

    def unmounted(folder: Path) -> None:
        shutil.rmtree(shelf)
        raise ScanError(f"{folder / 'frames_left.npy'}: missing")

    monkeypatch.setattr(task, "refuse_damaged_frames", unmounted)
    with pytest.raises(Again, match="000001 changed while it was worked through"):
        attempt(job(1, shelf, results))
    assert failures(results) == []


def test_a_mistake_of_the_program_is_a_row_with_its_type_and_text(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(_: Path) -> None:
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr(task, "refuse_damaged_frames", wrong)
    found = attempt(job(1, complete(tmp_path), results))
    assert (found["state"], found["reason"]) == (FAILED, "unexpected ValueError: operands could not be broadcast")
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
        attempt(job(1, complete(tmp_path), results))
    assert list((results.folder / "failed").iterdir()) == []


@pytest.mark.parametrize("error", [MemoryError(), OSError(errno.ENOSPC, "full")])
def test_what_the_machine_lacks_is_no_scans_failure(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def lacks(_: Path) -> None:
        raise error

    monkeypatch.setattr(task, "refuse_damaged_frames", lacks)
    with pytest.raises(type(error)):
        attempt(job(1, complete(tmp_path), results))
    assert failures(results) == []


# ------------------------------------------------------------------------------------------- the program


def test_another_rig_file_is_another_program(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "a.py").write_text("1")
    seen = []
    for text in ("width_px = 1600", "width_px = 1600", "width_px = 1601"):
        (tmp_path / "rigs" / "kingfisher.toml").write_text(text)
        seen.append(program_digits.__wrapped__(tmp_path))
    assert seen[0] == seen[1]
    assert seen[1] != seen[2]


def test_the_program_names_the_libraries_that_compute() -> None:
    assert re.match(r"kingfisher \S+-[0-9a-f]{12} numpy ", program_digits())
    for name, library in (("numpy", np), ("numba", numba), ("opencv-python-headless", cv2)):
        assert re.search(rf"\b{name} {re.escape(library.__version__)}", program_digits()), name
