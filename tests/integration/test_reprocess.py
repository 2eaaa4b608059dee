"""An archive worked through anew as somebody types it: packed scans, damaged ones, another water, and a second call."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.calibration import file as calibration_file
from appliance.offline.anew.results import read_table
from appliance.storage.calibrations import CURRENT
from hw_sim.scene import Scene
from tests.support.commands import Shell, kingfisher
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store
from tests.support.truth import true_calibration

WIDTH_PX, HEIGHT_PX = 200, 150


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A packed archive of three scans, of which the second was damaged after it was packed."""
    base = tmp_path_factory.mktemp("archive")
    scan = render_scan(Scene("frustum", texture="checker"), "nominal", 3, WIDTH_PX, 16)
    origin = origin_of(scan.renderer.truth, WIDTH_PX, HEIGHT_PX)
    for name in ("000001", "000002", "000003"):
        (base / "root" / "scans").mkdir(parents=True, exist_ok=True)
        store(scan, base / "root" / "scans" / name, origin=origin)
    assert kingfisher("archive", "pack", base / "root", "--out", base / "packed").code == 0
    damaged = base / "packed" / "scans" / "000002" / "frames_left.npy.jls"
    data = bytearray(damaged.read_bytes())
    data[-100] ^= 1
    damaged.write_bytes(data)
    return base


def test_every_scan_has_one_result_or_a_reason_and_a_second_call_does_nothing_but_what_failed(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = Shell(capsys)
    said = desk("reprocess", root / "packed", "--out", tmp_path / "out", "--workers", "1", "--json").document
    assert (said["done"], said["failed"], said["left"]) == (2, 1, 0)
    table = {row["scan"]: row for row in read_table(Path(said["table"]))}
    assert sorted(table) == ["000001", "000002", "000003"]
    assert "frames_left.npy: damaged" in table["000002"]["reason"]
    assert int(table["000001"]["points"]) > 1000
    assert all(0.0 < float(table["000001"][name]) < 600.0 for name in ("cpu_s", "wall_s"))
    results = Path(said["table"]).parent / "results"
    assert len(list(results.iterdir())) == 2

    # The points of the frames that were packed are those of the frames as they were recorded, byte for byte.
    assert desk("reconstruct", root / "root" / "scans" / "000001", "--out", tmp_path / "x.ply").code == 0
    (cloud,) = results.glob("000001-*/cloud.ply")
    assert cloud.read_bytes() == (tmp_path / "x.ply").read_bytes()

    # Somebody brings the damaged one back; nothing else is done again.
    before = {path: path.stat().st_mtime_ns for path in results.glob("*/*")}
    shutil.copytree(root / "packed", tmp_path / "packed")
    shutil.rmtree(tmp_path / "packed" / "scans" / "000002")
    shutil.copytree(root / "root" / "scans" / "000002", tmp_path / "packed" / "scans" / "000002")
    again = desk("reprocess", tmp_path / "packed", "--out", tmp_path / "out", "--workers", "1", "--json")
    assert again.code == 0
    assert again.document["key"] == said["key"]
    assert len(list(results.iterdir())) == 3
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert list((results.parent / "failed").iterdir()) == []
    assert desk("season", said["table"], "--out", tmp_path / "season.html").code == 0
    assert "<h2>Refused scans</h2><p>None." in (tmp_path / "season.html").read_text(encoding="utf-8")


def test_two_calls_at_once_share_an_archive_and_one_table_has_all_of_it(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = Shell(capsys)
    words = ("--out", tmp_path / "out", "--workers", "1", "--table-only", "--json")
    with ThreadPoolExecutor() as pool:
        calls = [pool.submit(kingfisher, "reprocess", root / "packed", *words, "--part", f"{k}/2") for k in (1, 2)]
        said = [call.result(timeout=240) for call in calls]
    assert sorted(one["scan"] for each in said for one in each.document["rows"]) == ["000001", "000002", "000003"]
    assert [each.code for each in said] == [0, 1], "the second part has the damaged scan"
    (table,) = {each.document["table"] for each in said}
    assert [row["state"] for row in read_table(Path(table))] == ["done", "failed", "done"]

    # Another archive under the same key: its scans stand beside the others, with nothing done twice.
    shutil.copytree(root / "root" / "scans" / "000003", tmp_path / "b" / "scans" / "000007")
    assert desk("reprocess", tmp_path / "b", *words).document["table"] == table
    assert [row["scan"] for row in read_table(Path(table))] == ["000001", "000002", "000003", "000007"]

    refused = desk("reprocess", tmp_path / "b", *words, "--part", "2/2")
    assert (refused.code, "there are fewer scans than parts" in refused.error) == (2, True)
    for part in ("0/2", "3/2", "1", "a/b"):
        refused = desk("reprocess", tmp_path / "b", *words, "--part", part)
        assert (refused.code, "allowed are K/N" in refused.err) == (2, True)


def test_scans_that_take_the_calibration_in_use_are_done_anew_when_it_is_another(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are of before a manifest named its calibration."""
    desk = Shell(capsys)
    scan = render_scan(Scene("frustum", texture="checker"), "nominal", 3, WIDTH_PX, 16)
    (tmp_path / "root" / "scans").mkdir(parents=True)
    store(scan, tmp_path / "root" / "scans" / "000001")
    (tmp_path / "root" / "calibration").mkdir()
    seen = []
    for made_at in ("2031-05-01", "2031-05-02", "2031-05-02"):
        calibration = replace(
            true_calibration(scan.renderer.truth), rig_serial="KF-0001", camera_serials=None, made_at=made_at
        )
        (tmp_path / "root" / "calibration" / CURRENT).write_bytes(calibration_file.encode(calibration))
        said = desk(
            "reprocess", tmp_path / "root", "--out", tmp_path / "out", "--workers", "1", "--table-only", "--json"
        )
        (row,) = said.document["rows"]
        assert row["state"] == "done", row
        (in_table,) = read_table(Path(said.document["table"]))
        assert in_table["calibration"] == row["calibration"]
        seen.append(row)
    assert seen[0]["calibration"] != seen[1]["calibration"]
    assert seen[1] == seen[2], "nothing is done again where nothing changed"


def test_a_scan_whose_rig_file_was_damaged_is_done_anew_when_it_is_whole(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = Shell(capsys)
    shutil.copytree(root / "root" / "scans" / "000001", tmp_path / "root" / "scans" / "000001")
    rig = tmp_path / "root" / "scans" / "000001" / "rig.toml"
    whole = rig.read_bytes()
    names = []
    for content in (whole, whole[:-1], whole):
        rig.write_bytes(content)
        said = desk(
            "reprocess", tmp_path / "root", "--out", tmp_path / "out", "--workers", "1", "--table-only", "--json"
        )
        names.append(said.document["rows"][0]["result"])
        assert len(read_table(Path(said.document["table"]))) == 1
    assert names[0] == names[2]
    assert names[1] != names[0]


def test_another_water_is_another_key_and_gives_other_points(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = Shell(capsys)
    water = ("--temperature-c", "4", "--salinity-psu", "35")
    said = desk(
        "reprocess", root / "root", "--out", tmp_path / "out", "--workers", "1", "--table-only", "--json", *water
    ).document
    assert {row["salinity_psu"] for row in said["rows"]} == {35.0}
    assert all(row["water_index"] > 1.339 for row in said["rows"])
    assert not list(Path(said["table"]).parent.glob("results/*/cloud.ply"))
    settings = json.loads((Path(said["table"]).parent / "settings.json").read_text(encoding="utf-8"))
    assert settings["water"] == [4.0, 35.0]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("{root}/root",), "--out is missing"),
        (("{root}/root/scans", "--out", "x"), "give the folder that holds scans/"),
        (("{root}/root", "--out", "x", "--salinity-psu", "35"), "give both or neither"),
    ],
)
def test_wrong_words_end_in_one_line(
    root: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str
) -> None:
    done = Shell(capsys)("reprocess", *(word.format(root=root) for word in words))
    assert done.code == 2
    assert said in done.error


LISTED = 'artefact = "frustum"\ntop_mm = 81.0\nbase_mm = 120.0\n'


def one_scan(folder: Path, root: Path) -> tuple[object, ...]:
    """Return the words that work ``folder`` through, a scan's, in a storage root of its own below ``root``."""
    (root / "one" / "scans").mkdir(parents=True)
    shutil.copytree(folder, root / "one" / "scans" / "000003")
    (root / "list.toml").write_text(f'[[scan]]\nscan = "{folder}"\n{LISTED}', encoding="utf-8")
    return (
        "reprocess",
        root / "one",
        "--out",
        root / "out",
        "--workers",
        "1",
        "--table-only",
        "--json",
        "--list",
        root / "list.toml",
    )


def test_an_artefact_that_is_not_found_has_its_reason_in_the_table(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Images of 200 x 150 pixels are too small for it."""
    desk = Shell(capsys)
    words = one_scan(root / "root" / "scans" / "000003", tmp_path)
    (row,) = desk(*words).document["rows"]
    assert desk("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html").code == 1
    (said,) = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["scans"]
    assert row["reason"] == f"not evaluated: {said['reason']}"
    assert row["state"] == "done"

    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "7"\n{LISTED}', encoding="utf-8")
    refused = desk(*words)
    assert (refused.code, "scan 7 is not below" in refused.error) == (2, True)


@pytest.mark.dive
def test_lengths_are_those_that_evaluate_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    desk = Shell(capsys)
    scan = render_scan(Scene("frustum"), "nominal", 3, 400, 16)
    folder = tmp_path / "scans" / "000003"
    folder.parent.mkdir()
    store(scan, folder, origin=origin_of(scan.renderer.truth, 400, 300))
    (row,) = desk(*one_scan(folder, tmp_path)).document["rows"]
    assert desk("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html").code == 0
    (said,) = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["scans"]
    assert row["e_l_percent"] == max(abs(length["e_l_percent"]) for length in said["lengths"])
    assert row["e_l_percent"] > 0.5  # its top is narrower than the list says


def test_a_root_without_scans_is_no_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scans").mkdir()
    refused = Shell(capsys)("reprocess", tmp_path, "--out", tmp_path / "out")
    assert (refused.code, "there is no scan in it" in refused.error) == (2, True)
    assert not (tmp_path / "out").exists()
