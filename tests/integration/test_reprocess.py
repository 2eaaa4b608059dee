"""An archive worked through anew as somebody types it: packed scans, damaged ones, another water, and a second call."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from appliance.offline.anew.results import read_table
from appliance.storage.lock import hold_lock
from hw_sim.scene import Scene
from tests.support.commands import Shell, kingfisher
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

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
    assert 'and why</h2><p class="note">None.' in (tmp_path / "season.html").read_text(encoding="utf-8")


def test_a_second_archive_under_the_same_key_has_its_rows_in_the_same_table_and_nothing_is_done_twice(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    desk = Shell(capsys)
    words = ("--out", tmp_path / "out", "--workers", "1", "--table-only", "--json")
    table = desk("reprocess", root / "packed", *words).document["table"]
    shutil.copytree(root / "root" / "scans" / "000003", tmp_path / "b" / "scans" / "000007")
    assert desk("reprocess", tmp_path / "b", *words).document["table"] == table
    rows = [(row["scan"], row["state"]) for row in read_table(Path(table))]
    assert rows == [("000001", "done"), ("000002", "failed"), ("000003", "done"), ("000007", "done")]
    with hold_lock(Path(table).parent):
        refused = desk("reprocess", tmp_path / "b", *words)
    assert (refused.code, "another instance" in refused.err) == (1, True)


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
