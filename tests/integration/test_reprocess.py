"""An archive worked through anew as somebody types it: packed scans, a damaged one, and a second call."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from appliance.desk.anew.results import read_table
from appliance.store.lock import hold_lock
from hw_sim.scene import Scene
from tests.support.commands import Shell
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

LISTED = 'artefact = "frustum"\ntop_mm = 81.0\nbase_mm = 120.0\n'


@pytest.fixture
def desk(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A storage root with two scans of a frustum, the second of small cameras."""
    root = tmp_path_factory.mktemp("archive") / "root"
    for name, width_px in (("000001", 400), ("000002", 200)):
        made = render_scan(Scene("frustum"), "nominal", 3, width_px, 16)
        origin = origin_of(made.renderer.truth, width_px, width_px * 3 // 4)
        (root / "scans").mkdir(parents=True, exist_ok=True)
        store(made, root / "scans" / name, origin=origin)
    return root


def test_every_scan_has_one_result_or_a_reason_and_a_second_call_does_nothing_but_what_failed(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    packed, words = tmp_path / "packed", ("--out", tmp_path / "out", "--workers", "1", "--json")
    assert desk("archive", "pack", root, "--out", packed).code == 0
    damaged = packed / "scans" / "000002" / "frames_left.npy.jls"
    data = bytearray(damaged.read_bytes())
    data[-100] ^= 1
    damaged.write_bytes(data)
    said = desk("archive", "reprocess", packed, *words).document
    assert (said["done"], said["failed"], said["left"]) == (1, 1, 0)
    table = {row["scan"]: row for row in read_table(Path(said["table"]))}
    assert sorted(table) == ["000001", "000002"]
    assert "frames_left.npy: damaged" in table["000002"]["reason"]
    results = Path(said["table"]).parent / "results"
    # The points of the frames that were packed are those of the frames as they were recorded, byte for byte.
    assert desk("cloud", root / "scans" / "000001", "--out", tmp_path / "x.ply").code == 0
    (cloud,) = results.glob("*/cloud.ply")
    assert cloud.read_bytes() == (tmp_path / "x.ply").read_bytes()

    # Somebody brings the damaged one back; nothing else is done again.
    before = {path: path.stat().st_mtime_ns for path in results.glob("*/*")}
    shutil.rmtree(packed / "scans" / "000002")
    shutil.copytree(root / "scans" / "000002", packed / "scans" / "000002")
    with hold_lock(results.parent):
        refused = desk("archive", "reprocess", packed, *words)
    assert (refused.code, "another instance" in refused.err) == (1, True)
    again = desk("archive", "reprocess", packed, *words)
    assert (again.code, again.document["key"], len(list(results.iterdir()))) == (0, said["key"], 2)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert list((results.parent / "failed").iterdir()) == []


def test_lengths_are_those_that_evaluate_says(root: Path, tmp_path: Path, desk: Shell) -> None:
    shutil.copytree(root / "scans" / "000001", tmp_path / "one" / "scans" / "000001")
    listed = tmp_path / "list.toml"
    listed.write_text(f'[[scan]]\nscan = "{root / "scans" / "000001"}"\n{LISTED}', encoding="utf-8")
    words = ("--out", tmp_path / "out", "--workers", "1", "--table-only", "--json")
    (row,) = desk("archive", "reprocess", tmp_path / "one", listed, *words).document["rows"]
    assert desk("evaluate", listed, "--out", tmp_path / "x.html").code == 0
    (said,) = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["scans"]
    assert row["e_l_percent"] == max(abs(length["e_l_percent"]) for length in said["lengths"])
    assert row["e_l_percent"] > 0.5, "its top is narrower than the list says"
