"""An archive worked through anew as somebody types it: packed scans, a damaged one, and a second call."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from appliance.offline.anew.results import read_table
from appliance.storage.lock import hold_lock
from hw_sim.scene import Scene
from tests.support.commands import Shell
from tests.support.rendered import render_scan
from tests.support.stored import origin_of, store

WIDTH_PX, HEIGHT_PX = 400, 300
LISTED = 'artefact = "frustum"\ntop_mm = 81.0\nbase_mm = 120.0\n'


@pytest.fixture
def desk(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stored scan of a frustum."""
    made = render_scan(Scene("frustum"), "nominal", 3, WIDTH_PX, 16)
    folder = tmp_path_factory.mktemp("archive") / "000001"
    store(made, folder, origin=origin_of(made.renderer.truth, WIDTH_PX, HEIGHT_PX))
    return folder


@pytest.fixture
def packed(scan: Path, tmp_path: Path, desk: Shell) -> Path:
    """A packed archive of two scans, of which the second was damaged after it was packed."""
    shutil.copytree(scan, tmp_path / "root" / "scans" / "000001")
    small = render_scan(Scene("frustum"), "nominal", 3, 200, 16)
    store(small, tmp_path / "root" / "scans" / "000002", origin=origin_of(small.renderer.truth, 200, 150))
    assert desk("archive", "pack", tmp_path / "root", "--out", tmp_path / "packed").code == 0
    damaged = tmp_path / "packed" / "scans" / "000002" / "frames_left.npy.jls"
    data = bytearray(damaged.read_bytes())
    data[-100] ^= 1
    damaged.write_bytes(data)
    return tmp_path / "packed"


def test_every_scan_has_one_result_or_a_reason_and_a_second_call_does_nothing_but_what_failed(
    packed: Path, tmp_path: Path, desk: Shell
) -> None:
    words = ("--out", tmp_path / "out", "--workers", "1", "--json")
    said = desk("reprocess", packed, *words).document
    assert (said["done"], said["failed"], said["left"]) == (1, 1, 0)
    table = {row["scan"]: row for row in read_table(Path(said["table"]))}
    assert sorted(table) == ["000001", "000002"]
    assert "frames_left.npy: damaged" in table["000002"]["reason"]
    assert int(table["000001"]["points"]) > 1000
    results = Path(said["table"]).parent / "results"
    # The points of the frames that were packed are those of the frames as they were recorded, byte for byte.
    assert desk("reconstruct", tmp_path / "root" / "scans" / "000001", "--out", tmp_path / "x.ply").code == 0
    (cloud,) = results.glob("*/cloud.ply")
    assert cloud.read_bytes() == (tmp_path / "x.ply").read_bytes()

    # Somebody brings the damaged one back; nothing else is done again.
    before = {path: path.stat().st_mtime_ns for path in results.glob("*/*")}
    shutil.rmtree(packed / "scans" / "000002")
    shutil.copytree(tmp_path / "root" / "scans" / "000002", packed / "scans" / "000002")
    again = desk("reprocess", packed, *words)
    assert (again.code, again.document["key"]) == (0, said["key"])
    assert len(list(results.iterdir())) == 2
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert list((results.parent / "failed").iterdir()) == []
    assert desk("season", said["table"], "--out", tmp_path / "season.html").code == 0
    assert 'and why</h2><p class="note">None.' in (tmp_path / "season.html").read_text(encoding="utf-8")
    with hold_lock(Path(said["table"]).parent):
        refused = desk("reprocess", packed, *words)
    assert (refused.code, "another instance" in refused.err) == (1, True)


def test_lengths_are_those_that_evaluate_says(scan: Path, tmp_path: Path, desk: Shell) -> None:
    shutil.copytree(scan, tmp_path / "one" / "scans" / "000001")
    (tmp_path / "list.toml").write_text(f'[[scan]]\nscan = "{scan}"\n{LISTED}', encoding="utf-8")
    words = ("reprocess", tmp_path / "one", "--out", tmp_path / "out", "--workers", "1", "--table-only", "--json")
    (row,) = desk(*words, "--list", tmp_path / "list.toml").document["rows"]
    assert desk("evaluate", tmp_path / "list.toml", "--out", tmp_path / "x.html").code == 0
    (said,) = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["scans"]
    assert row["e_l_percent"] == max(abs(length["e_l_percent"]) for length in said["lengths"])
    assert row["e_l_percent"] > 0.5  # its top is narrower than the list says
