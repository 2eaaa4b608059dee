"""Names, notes and a trash for scans at the desk: nothing is deleted, no number comes twice, the scan's own files stay."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from appliance.checksummed_file import with_checksum
from appliance.cli import main
from appliance.storage import label as labels
from appliance.storage.atomic import StorageError
from appliance.storage.label import Label, LabelError, checked
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.lock import hold_lock
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, BadDisk, cloud, frames, record


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three saved scans and a rejected one."""
    root = tmp_path / "root"
    library = Library(root)
    library.prepare()
    for seed in (1, 2, 3):
        library.begin(frames(seed), record(), ORIGIN).publish(record(cloud={"points": 20}), cloud(), PREVIEW)
    library.begin(frames(4), record(), ORIGIN).reject("moved 3 px")
    return root


def kingfisher(root: Path, *words: str, code: int = 0) -> None:
    assert main(["scans", *words, "--root", str(root)]) == code


def content(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}


def test_a_name_and_a_note_are_listed_and_shown_and_change_nothing_else(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = content(root / "scans" / "000002")
    kingfisher(root, "name", "2", "bollard 3")
    kingfisher(root, "note", "2", "north side, before cleaning")
    after = content(root / "scans" / "000002")
    assert set(after) - set(before) == {"label.json"}
    assert {name: after[name] for name in before} == before, "the manifest's bytes are those of the dive"
    capsys.readouterr()
    kingfisher(root, "list")
    line = capsys.readouterr().out.splitlines()[2]
    assert line.startswith("000002")
    assert "bollard 3" in line
    assert line.endswith("north side, before cleaning")
    kingfisher(root, "show", "2", "--json")
    shown = json.loads(capsys.readouterr().out)
    assert (shown["name"], shown["note"]) == ("bollard 3", "north side, before cleaning")
    kingfisher(root, "verify")
    kingfisher(root, "name", "2", "")
    assert labels.read(root / "scans" / "000002") == Label(None, "north side, before cleaning")


def test_a_trashed_scan_is_gone_from_list_and_gallery_and_comes_back_whole(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    library, before = Library(root), content(root / "scans" / "000002")
    kingfisher(root, "name", "2", "bollard 3")
    kingfisher(root, "trash", "2")
    assert library.ids() == ["000001", "000003"], "what the diver's gallery lists"
    assert (library.count(), library.last_id()) == (2, "000003")
    capsys.readouterr()
    kingfisher(root, "list")
    assert "000002" not in capsys.readouterr().out
    kingfisher(root, "list", "--trash")
    assert "000002  trash" in capsys.readouterr().out
    kingfisher(root, "list", "--all")
    assert "000002  trash" in capsys.readouterr().out
    assert content(root / "trash" / "000002").items() >= before.items()
    kingfisher(root, "restore", "2")
    assert library.ids() == ["000001", "000002", "000003"]
    assert content(root / "scans" / "000002").items() >= before.items()
    assert library.entry("2").label.name == "bollard 3"
    assert library.verify("2").ok


def test_the_number_of_a_trashed_scan_is_never_given_again(root: Path) -> None:
    kingfisher(root, "trash", "1", "2", "3")
    (root / "next-id").unlink()
    (root / "rejected" / "000004" / "manifest.json").unlink()
    for path in (root / "rejected" / "000004").iterdir():
        path.unlink()
    (root / "rejected" / "000004").rmdir()
    assert Library(root).begin(frames(9), record(), ORIGIN).scan_id == "000004"


def test_a_rejected_scan_comes_back_among_the_rejected(root: Path) -> None:
    kingfisher(root, "trash", "4")
    assert Library(root).entry("4").shelf is LibraryFolder.TRASH
    kingfisher(root, "restore", "4")
    assert Library(root).entry("4").shelf is LibraryFolder.REJECTED


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("trash", "1", "77"), 1, "no scan '77'"),
        (("restore", "1"), 1, "no scan '1' in the trash"),
        (("name", "77", "x"), 1, "no scan '77'"),
        (("name", "1", "x" * 61), 2, "NAME: 61 characters; allowed are 60"),
        (("note", "1", "x" * 1001), 2, "NOTE: 1001 characters; allowed are 1000"),
        (("name", "1", "a\x1b[31mb"), 2, "NAME: character 2 is U+001B, a control character"),
        (("note", "1", "two\nlines"), 2, "NOTE: character 4 is U+000A"),
        (("name", "1", "a\u202eb"), 2, "NAME: character 2 is U+202E"),
        (("note", "1", "a\u2028b"), 2, "NOTE: character 2 is U+2028"),
        (("name", "1", "a\udcffb"), 2, "NAME: character 2 is U+DCFF"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(
    words: tuple[str, ...], code: int, said: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kingfisher(root, *words, code=code)
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert Library(root).ids() == ["000001", "000002", "000003"]
    assert not list(root.glob("scans/*/label.json"))


def test_twice_into_the_trash_and_over_another_are_refused(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kingfisher(root, "trash", "1")
    kingfisher(root, "trash", "1", code=1)
    assert "is in the trash already" in capsys.readouterr().err
    (root / "scans" / "000001").mkdir()  # somebody copied it back by hand
    kingfisher(root, "restore", "1", code=1)
    assert "is there already; move one of them elsewhere" in capsys.readouterr().err
    assert (root / "trash" / "000001" / "manifest.json").is_file()


def test_beside_a_running_instrument_nothing_is_moved_or_named(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with hold_lock(root):
        for words in (("trash", "1"), ("restore", "1"), ("name", "1", "x"), ("note", "1", "x")):
            kingfisher(root, *words, code=1)
            assert "another instance" in capsys.readouterr().err
    assert Library(root).ids() == ["000001", "000002", "000003"]


def test_a_damaged_label_is_no_damaged_scan_but_verify_names_it(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kingfisher(root, "name", "1", "bollard")
    path = root / "scans" / "000001" / "label.json"
    path.write_bytes(path.read_bytes().replace(b"bollard", b"ballard"))
    assert Library(root).entry("1").ok
    assert Library(root).entry("1").label == Label()
    kingfisher(root, "verify", "1", code=4)
    assert "label.json: checksum" in capsys.readouterr().out
    kingfisher(root, "name", "1", "bollard")
    kingfisher(root, "verify", "1")


@pytest.mark.parametrize("call", range(7))
def test_a_disk_that_refuses_leaves_the_old_label_and_the_scan_in_its_place(root: Path, call: int) -> None:
    Library(root).set_label("1", Label("before", None))
    bad = BadDisk(first_bad=call)
    try:
        Library(root, bad).set_label("1", Label("after", "x"))
        assert len(bad.calls) <= call, "nothing failed"
    except StorageError:
        assert labels.read(root / "scans" / "000001") in (Label("before", None), Label("after", "x"))
    bad = BadDisk(first_bad=call)
    try:
        Library(root, bad).trash("2")
        assert len(bad.calls) <= call, "nothing failed"
    except StorageError:
        places = [root / shelf / "000002" for shelf in ("scans", "trash")]
        assert sum((place / "manifest.json").is_file() for place in places) == 1


def test_text_is_composed_and_blanks_around_it_go() -> None:
    assert checked("name", "  bollard 3 ", 60) == "bollard 3"
    assert checked("name", "Mu\u0308hle", 60) == "M\u00fchle"
    assert checked("name", " \t ", 60) is None


@pytest.mark.parametrize(
    ("content_", "words"),
    [
        ({"schema": 2}, "schema 2; this version reads 1"),
        ({"schema": 1, "name": 3}, "name is 3; allowed is a text"),
        ({"schema": 1, "note": "a\x07"}, r"note: character 2 is U\+0007"),
        ({"schema": 1, "name": "x" * 61}, "61 characters; allowed are 60"),
    ],
)
def test_a_label_of_another_hand_is_read_with_the_same_care(
    content_: dict[str, object], words: str, tmp_path: Path
) -> None:
    (tmp_path / labels.FILE_NAME).write_bytes(with_checksum(content_))
    with pytest.raises(LabelError, match=words):
        labels.read(tmp_path)
