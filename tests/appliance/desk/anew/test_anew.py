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

from appliance.desk.anew.results import COLUMNS, Results, ResultsError, Row, name_of, program_digits, read_table
from appliance.desk.anew.work import AGAIN, DONE, FAILED, Job, RetryError, attempt
from appliance.measure.calibration import file as calibration_file
from appliance.store.atomic import LocalFileSystem, StorageError
from appliance.store.scan import ScanError, StoredScan, write_raw
from hw_sim.truth import draw_truth
from tests.appliance.store.scenes import ORIGIN, frames, record
from tests.support.truth import true_calibration

MADE_WITH = {"calibration": None, "foreign": False, "water": None, "clouds": False, "program": program_digits()}


@pytest.fixture
def results(tmp_path: Path) -> Results:
    return Results.of(tmp_path / "out", MADE_WITH)


def row(number: int, **more: object) -> Row:
    return {"scan": f"{number:06d}", "folder": f"/x/{number:06d}", "state": DONE, **more}


def below(results: Results, folder: str) -> list[str]:
    return sorted(path.name for path in (results.folder / folder).iterdir())


def test_twenty_at_once_publish_one_result_which_stands(results: Results) -> None:
    results.publish_failure("000001-a", row(1, state=FAILED))
    assert below(results, "failed") == ["000001-a.json"]
    begin, seen = threading.Barrier(20), list[Row]()

    def publish(number: int) -> None:
        begin.wait(timeout=30)
        seen.append(results.publish("000001-a", row(1, host=str(number)), (bytes([number]) * 500,) * 2))

    threads = [threading.Thread(target=publish, args=(number,)) for number in range(20)]
    for one in threads:
        one.start()
    for one in threads:
        one.join(timeout=60)
    assert seen == [seen[0]] * 20
    assert results.publish("000001-a", row(1, host="later"), (b"other",)) == seen[0]
    folder = results.folder / "results" / "000001-a"
    cloud = bytes([int(seen[0]["host"])]) * 1000
    assert (folder / "cloud.ply").read_bytes() == cloud, "row and cloud are of the same one"
    assert json.loads((folder / "row.json").read_text()) == results.row("000001-a") == seen[0]
    assert [below(results, name) for name in ("results", "drafts", "failed")] == [["000001-a"], [], []]
    (folder / "row.json").write_text("{")
    with pytest.raises(StorageError, match=r"000001-a/row.json"):
        results.row("000001-a")


def test_a_full_disk_publishes_nothing_and_what_a_killed_process_left_is_swept(
    results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise StorageError("cannot write", Path("x"), os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(LocalFileSystem, "write_new", full)
        with pytest.raises(StorageError):
            results.publish("000001-a", row(1), None)
    assert (results.row("000001-a"), below(results, "drafts")) == (None, [])
    (results.folder / "drafts" / "tmp1" / "000001-a").mkdir(parents=True)
    (results.folder / "drafts" / "tmp1" / "000001-a" / "row.json").write_text("{")
    assert (results.sweep(), below(results, "drafts"), results.sweep()) == (1, [], 0)


def test_a_key_follows_the_settings_and_a_scans_name_its_manifest(results: Results, tmp_path: Path) -> None:
    assert Results.of(tmp_path / "out", MADE_WITH).folder == results.folder
    assert len(results.folder.name) == 16
    assert Results.of(tmp_path / "out", {**MADE_WITH, "water": (4.0, 35.0)}).folder != results.folder
    a, b = (tmp_path / name / "000001" for name in "ab")
    for folder in (a, b):
        folder.mkdir(parents=True)
        assert name_of(folder) == "000001-unreadable"
        (folder / "manifest.json").write_text("{}")
    assert name_of(a) == name_of(b)
    assert re.fullmatch("000001-[0-9a-f]{12}", name_of(a))
    (b / "manifest.json").write_text("{ }")
    assert name_of(a) != name_of(b)


def test_the_table_has_every_scan_once_in_the_order_of_their_numbers(results: Results, tmp_path: Path) -> None:
    results.publish("000001-a", row(1, result="000001-a", points=5), None)
    results.publish("000001-b", row(1, result="000001-b", points=7), None)
    results.publish("000002-a", row(2, result="000002-a"), None)
    results.publish_failure("000003-a", row(3, state=FAILED, reason="damaged", result="000003-a"))
    results.publish_failure("000005-a", row(5, state=FAILED, result="000005-a"))
    results.publish("000005-b", row(5, result="000005-b", points=8), None)
    given = [
        row(1_000_000), row(1, result="000001-b", points=7), row(2, state=AGAIN, reason="full"),
        row(4, state=AGAIN, reason="full\ndisk", faults='MOTION: "quick", 3 mm'), row(999_999),
    ]  # fmt: skip
    path = results.write_table(given)
    table = read_table(path)
    assert [(one["scan"], one["state"], one["points"]) for one in table] == [
        ("000001", DONE, "7"), ("000002", DONE, ""), ("000003", FAILED, ""), ("000004", AGAIN, ""), ("000005", DONE, "8"),
        ("999999", DONE, ""), ("1000000", DONE, ""),
    ]  # fmt: skip
    assert (table[3]["reason"], table[3]["faults"]) == ("full\ndisk", 'MOTION: "quick", 3 mm')
    assert set(table[0]) == set(COLUMNS)
    plain = results.write_table([row(number) for number in (1_000_000, 999_999)])
    head, *lines = plain.read_text().splitlines()
    numbers = [int(line.partition(",")[0]) for line in lines]
    assert numbers == sorted(numbers), "in the file itself"
    (tmp_path / "old.csv").write_text("\n".join([head, *reversed(lines)]))
    assert read_table(tmp_path / "old.csv")[-1]["scan"] == "1000000"
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ResultsError, match="no table"):
        read_table(tmp_path / "x.csv")


@pytest.fixture
def shelf(tmp_path: Path) -> Path:
    """A shelf with a scan as an instrument writes it, and one whose manifest is none."""
    (tmp_path / "scans" / "000002").mkdir(parents=True)
    write_raw(LocalFileSystem(), tmp_path / "scans" / "000001", "000001", frames(1), record(), ORIGIN)
    (tmp_path / "scans" / "000002" / "manifest.json").write_text("{")
    return tmp_path / "scans"


def attempted(number: int, shelf: Path, results: Results, calibration: str | None = None) -> Row:
    return attempt(Job(str(shelf / f"{number:06d}"), str(results.folder), calibration, None))


def test_a_computer_that_can_do_no_such_job_writes_nothing_down_and_says_what_to_do(
    results: Results, shelf: Path, tmp_path: Path
) -> None:
    other = Results.of(tmp_path / "out", {**MADE_WITH, "program": "0.0.9-abc"})
    with pytest.raises(RetryError, match="same version"):
        attempted(2, shelf, other)
    with pytest.raises(RetryError, match=f"{shelf}/000003"):
        attempted(3, shelf, results)
    with pytest.raises(StorageError, match="same path"):
        attempted(2, shelf, Results(tmp_path / "nowhere" / "key"))
    encoded = calibration_file.encode_calibration(true_calibration(draw_truth("nominal", 1, 64, 48, 1.34)))
    (tmp_path / "other.json").write_bytes(encoded)
    with pytest.raises(RetryError, match="calibration"):
        attempted(2, shelf, results, str(tmp_path / "other.json"))
    assert below(results, "failed") == below(other, "failed") == []


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(1), MemoryError(), OSError(errno.ENOSPC, "full")])
def test_what_ends_a_process_or_what_the_machine_lacks_is_no_scans_failure(
    results: Results, shelf: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def ends(_: Path) -> None:
        raise error

    monkeypatch.setattr(StoredScan, "refuse_damage", ends)
    with pytest.raises(type(error)):
        attempted(1, shelf, results)
    assert below(results, "failed") == []


def test_a_scan_that_goes_meanwhile_is_no_failure_and_what_is_wrong_with_it_or_the_program_is_one_with_its_text(
    results: Results, shelf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = attempted(2, shelf, results)
    assert (found["state"], "JSON" in found["reason"], len(below(results, "failed"))) == (FAILED, True, 1)

    def wrong(_: Path) -> None:
        raise ValueError("operands could not be broadcast")

    def unmounted(folder: Path) -> None:
        shutil.rmtree(shelf)
        raise ScanError(f"{folder / 'frames_left.npy'}: missing")

    monkeypatch.setattr(StoredScan, "refuse_damage", wrong)
    found = attempted(1, shelf, results)
    assert (found["state"], found["reason"]) == (FAILED, "unexpected ValueError: operands could not be broadcast")
    (path,) = (results.folder / "failed").glob("000001*")
    assert "in wrong" in json.loads(path.read_text())["traceback"]
    path.unlink()
    monkeypatch.setattr(StoredScan, "refuse_damage", unmounted)
    with pytest.raises(RetryError, match="000001 changed"):
        attempted(1, shelf, results)
    assert not list((results.folder / "failed").glob("000001*"))


def test_another_rig_file_or_library_is_another_program(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "a.py").write_text("1")
    seen = []
    for text in ("width_px = 1600", "width_px = 1600", "width_px = 1601"):
        (tmp_path / "rigs" / "kingfisher.toml").write_text(text)
        seen.append(program_digits.__wrapped__(tmp_path))
    assert seen[0] == seen[1] != seen[2]
    assert re.match(r"kingfisher \S+-[0-9a-f]{12} numpy ", program_digits())
    for name, library in (("numpy", np), ("numba", numba), ("opencv-python-headless", cv2)):
        assert re.search(rf"\b{name} {re.escape(library.__version__)}", program_digits()), name
