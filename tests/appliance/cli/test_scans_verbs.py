"""Stored scans from the command line: what is there, what is damaged, named and put away; nothing is deleted, and the root is found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from appliance.desk.scripting import open_dive
from appliance.instrument.machine.ashore import ASHORE
from appliance.measure.calibration.file import encode_calibration
from appliance.measure.fault import FaultCode
from appliance.measure.verdict import Verdict
from appliance.store import label as labels
from appliance.store.atomic import StorageError
from appliance.store.config import load_rig
from appliance.store.instrument import Instrument
from appliance.store.label import Label
from appliance.store.library import Library, LibraryFolder
from appliance.store.lock import hold_lock
from appliance.store.names import CALIBRATION_FILE
from tests.appliance.store.scenes import ORIGIN, PREVIEW, BadDisk, cloud, frames, record
from tests.support.commands import Shell

DEFAULT_ROOT = load_rig().storage.root


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three saved scans, one with a trusted clock, a rejected one, and a calibration of another instrument than the packaged rig file's."""
    root = tmp_path / "dive"
    library = Library(root)
    library.prepare()
    for seed in (1, 2, 3):
        kept = record(cloud={"points": 20}, clock_trusted=seed == 2)
        library.begin(frames(seed), kept, ORIGIN).publish(kept, cloud(), PREVIEW)
    library.begin(frames(4), record(), ORIGIN).reject("moved 3 px")
    made = replace(Instrument(load_rig()).design(), rig_serial="KF-0042", method="bundle")
    (root / CALIBRATION_FILE).parent.mkdir()
    (root / CALIBRATION_FILE).write_bytes(encode_calibration(made))
    return root


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


def scans(shell: Shell, root: Path, *words: str, code: int = 0) -> Any:
    said = shell("scans", *words, "--root", root)
    assert said.code == code
    return said


def test_the_list_shows_each_scan_with_its_state_time_and_points(root: Path, tmp_path: Path, shell: Shell) -> None:
    head, first, second, *_, last = scans(shell, root, "list", "--all").out.splitlines()
    assert head.split() == ["SCAN", "STATE", "GRADE", "TIME", "POINTS", "OBJECT", "MB", "NAME", "REMARK", "NOTE"]
    assert (first.split()[:2], "20" in first) == (["000001", "saved"], True)
    assert ["+00:00 ?" in line for line in (first, second)] == [True, False], "whose clock nobody set"
    assert (last.startswith("000004  rejected"), last.endswith("moved 3 px")) == (True, True)
    assert len(scans(shell, root, "list", "--json").document) == 3
    (tmp_path / "empty").mkdir()
    assert scans(shell, tmp_path / "empty", "list").out == f"no scans under {tmp_path / 'empty'}\n"
    assert "--root" in scans(shell, tmp_path / "none", "list", code=2).error


def test_the_list_says_what_the_screen_said_and_notes_are_the_users(root: Path, shell: Shell) -> None:
    numbers = {"points": 20, "coverage_percent": 82.0, "noise_mm": 0.02}
    moved = Verdict("motion", False, {}, "7 px"), Verdict("compensation", True)
    told = Verdict("causes", False, {"compensated_percent": 0.0, "too_bright_percent": 7.0})
    for word, causes in (("good", ()), ("usable", (told,))):
        kept = record(cloud=numbers, verdicts=(*moved, *causes, Verdict("grade", True, {}, word)))
        Library(root).begin(frames(), kept, ORIGIN).publish(kept, cloud())
    scans(shell, root, "label", "000005", "--note", "the bow")
    *_, good, usable = scans(shell, root, "list").out.splitlines()
    assert (good.split()[2], usable.split()[2]) == ("GOOD", "USABLE")
    assert ("MOTION CORRECTED" in good, good.endswith("the bow")) == (True, True)
    assert usable.rstrip().endswith("MOTION CORRECTED, TOO BRIGHT")
    last = scans(shell, root, "list", "--json").document[-1]
    assert (last["grade"], last["corrected"], last["note"]) == ("usable", True, None)


def test_a_damaged_scan_is_marked_and_the_others_are_fine(root: Path, shell: Shell) -> None:
    path = root / "scans" / "000001" / "frames_left.npy"
    path.write_bytes(path.read_bytes()[:-3] + b"\0\0\0")
    out = scans(shell, root, "verify", code=4).out
    for words in ("000001  DAMAGED: frames_left.npy", "000002  ok", "3 checked, 1 damaged"):
        assert words in out
    scans(shell, root, "verify", "2")
    path.with_name("manifest.json").unlink()
    assert "DAMAGED" in scans(shell, root, "list").out


def test_show_prints_the_manifest_and_what_to_look_at_ashore(root: Path, shell: Shell) -> None:
    lines = scans(shell, root, "show", "1").lines
    assert (lines["manifest.record.water.index"], lines["manifest.record.temperatures_c.case"]) == ("1.3347", "-")
    dark = (
        Verdict("identity", False, {}, "PROJECTOR_DARK: all is dark"),
        Verdict("causes", False, {"too_bright_percent": 7.0}),
    )
    Library(root).begin(frames(4), record(), ORIGIN).reject("dark", record(verdicts=dark))
    shown = shell("scans", "show", root / "rejected" / "000005").lines
    ashore = {key: text for key, text in shown.items() if "ashore" in key}
    assert ashore == {"ashore.PROJECTOR_DARK": ASHORE[FaultCode.PROJECTOR_DARK]}
    assert shown["manifest.record.verdicts.causes.numbers.too_bright_percent"] == "7.00"


def test_a_name_and_a_note_are_listed_and_shown_and_a_damaged_label_is_told(root: Path, shell: Shell) -> None:
    folder = root / "scans" / "000002"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    scans(shell, root, "label", "2", "--name", "bollard 3", "--note", "north side, before cleaning")
    after = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert {name: after[name] for name in before} == before, "the manifest's bytes are those of the dive"
    line = scans(shell, root, "list").out.splitlines()[2]
    assert ("bollard 3" in line, line.endswith("north side, before cleaning")) == (True, True)
    (folder / "label.json").write_bytes(after["label.json"].replace(b"bollard", b"ballard"))
    assert "label.json" in scans(shell, root, "verify", "2", code=4).out
    scans(shell, root, "label", "2", "--name", "bollard 3")
    scans(shell, root, "verify", "2")
    scans(shell, root, "label", "2", "--note", "south")
    assert scans(shell, root, "label", "2", "--name", "").out == "000002  name: -; note: south\n"
    assert labels.Label.read(folder) == Label(None, "south")


def test_a_trashed_scan_is_gone_from_the_lists_and_comes_back_whole(root: Path, shell: Shell) -> None:
    library = Library(root)
    scans(shell, root, "trash", "2", "4")
    assert library.ids() == ["000001", "000003"], "what the diver's gallery lists"
    assert "000002" not in scans(shell, root, "list").out
    for option in ("trash", "--all"):
        assert "000002  trash" in scans(shell, root, "list", option).out
    scans(shell, root, "restore", "2", "4")
    assert (library.ids(), library.entry("4").folder_kind) == (["000001", "000002", "000003"], LibraryFolder.REJECTED)
    assert library.verify("2").ok


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("show", "99"), 1, "'99'"), (("trash", "1", "77"), 1, "'77'"), (("restore", "1"), 1, "'1'"), (("label", "77", "--name", "x"), 1, "'77'"),
        (("label", "1", "--name", "x" * 61), 2, "--name: 61"), (("label", "1", "--note", "x" * 1001), 2, "--note: 1001"),
        (("label", "1", "--name", "a\x1b[31mb"), 2, "U+001B"), (("label", "1", "--note", "two\nlines"), 2, "U+000A"),
        (("label", "1", "--name", "a\udcffb"), 2, "U+DCFF"), (("label", "1"), 2, "--name TEXT or --note TEXT"), (("list", "rejcted"), 2, "rejected, set-aside"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_one_line_and_changes_nothing(
    words: tuple[str, ...], code: int, said: str, root: Path, shell: Shell
) -> None:
    error = scans(shell, root, *words, code=code).err
    assert (said in error, error.count("\n")) == (True, 1)
    assert said in json.loads(scans(shell, root, *words, "--json", code=code).err)["error"]
    with hold_lock(root):  # beside a running instrument nothing is moved or named
        for changes in (("trash", "1"), ("restore", "1"), ("label", "1", "--name", "x")):
            assert "another instance" in scans(shell, root, *changes, code=1).error
    assert Library(root).ids() == ["000001", "000002", "000003"]
    assert not list(root.glob("scans/*/label.json"))


@pytest.mark.parametrize("call", range(7))
def test_a_disk_that_refuses_leaves_the_old_label_and_the_scan_in_its_place(root: Path, call: int) -> None:
    Library(root).set_label("1", Label("before", None))
    for change in ("name", "trash"):
        bad = BadDisk(first_bad=call)
        try:
            if change == "name":
                Library(root, bad).set_label("1", Label("after", "x"))
            else:
                Library(root, bad).trash("2")
            assert len(bad.calls) <= call, "nothing failed"
        except StorageError:
            assert labels.Label.read(root / "scans" / "000001") in (Label("before", None), Label("after", "x"))
            places = [root / shelf / "000002" / "manifest.json" for shelf in ("scans", "trash")]
            assert sum(place.is_file() for place in places) == 1


def test_the_root_is_the_one_that_somebody_stands_in_or_else_that_of_the_environment(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    scan, elsewhere = root / "scans" / "000001", tmp_path / "elsewhere"
    (elsewhere / "scans").mkdir(parents=True)  # anybody's folder of that name is no root
    gone = str(tmp_path / "gone")
    for folder, named in ((root, gone), (root / "scans", gone), (scan, gone), (elsewhere, str(root))):
        monkeypatch.chdir(folder)
        monkeypatch.setenv("KINGFISHER_ROOT", named)
        assert shell("scans", "list", "--json").document[0]["folder"] == str(scan)
        assert open_dive().root == root
    assert f"--root {root}" in shell("cloud", "7").error
    monkeypatch.setenv("KINGFISHER_ROOT", gone)
    said = shell("scans", "list")
    assert (said.code, f"KINGFISHER_ROOT={gone}" in said.error) == (2, True)


@pytest.mark.skipif(DEFAULT_ROOT.exists(), reason="this computer has the default root, as an instrument does")
@pytest.mark.parametrize("verb", [["scans", "list"], ["cloud", "1"], ["object", "show", "thing"]])
def test_where_there_is_no_root_it_is_said_where_was_looked(
    verb: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KINGFISHER_ROOT", raising=False)
    said = shell(*verb)
    assert said.code == 2
    for where in ("the current folder", "KINGFISHER_ROOT is not set", str(DEFAULT_ROOT), "--root PATH"):
        assert where in said.error
    with pytest.raises(NotADirectoryError, match="KINGFISHER_ROOT"):
        open_dive()


def test_the_calibration_of_a_root_is_shown_without_its_rig_file(root: Path, shell: Shell) -> None:
    # The packaged rig file draws KF-0001: that drawing was shown instead.
    shown = shell("calibration", "show", "--root", root, "--json").document
    assert (shown["rig_serial"], shown["method"]) == ("KF-0042", "bundle")
    (root / CALIBRATION_FILE).unlink()
    said = shell("calibration", "show", "--root", root)
    assert (said.code, str(root / CALIBRATION_FILE) in said.error) == (1, True)
