"""What a person types to keep scans in a third of the room, and what is said where that does not work."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.storage import scan as stored
from appliance.storage.library import Library
from appliance.storage.lock import hold_lock
from tests.appliance.storage.scenes import ORIGIN, frames, record
from tests.support.commands import Shell


@pytest.fixture
def desk(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A storage root with three scans and a calibration of before."""
    root = tmp_path / "root"
    library = Library(root)
    library.prepare()
    for number in range(3):
        library.begin(frames(number), record(), ORIGIN).publish(record())
    (root / "calibration" / "kept").mkdir(parents=True)
    (root / "calibration" / "kept" / "0001-2031-05-06.json").write_text("{}")
    return root


def everything(root: Path) -> dict[str, bytes]:
    wanted = [path for name in ("scans", "calibration") for path in (root / name).rglob("*")]
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in wanted if path.is_file()}


def test_there_and_back_and_a_second_time_nothing_is_done(root: Path, tmp_path: Path, desk: Shell) -> None:
    before = everything(root)
    packed, back = tmp_path / "archive", tmp_path / "back"
    said = desk("archive", "pack", root, "--out", packed)
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith("3 written, 0 already there, 0 failed; ")
    assert desk("archive", "pack", root, "--out", packed, "--json").document["already_there"] == 3
    assert desk("archive", "verify", packed).out.splitlines()[-1] == "3 decoded, 0 damaged"
    assert desk("scans", "verify", "--root", packed).code == 0, "an archive is a storage root"
    assert desk("archive", "unpack", packed, "--out", back).code == 0
    assert everything(back) == before == everything(root)
    one = desk("archive", "unpack", packed, "2", "--out", tmp_path / "one")
    assert one.out.startswith("1 written")
    assert [path.name for path in (tmp_path / "one" / "scans").iterdir()] == ["000002"]


def test_a_source_is_removed_only_when_that_was_asked_for_and_its_copy_was_compared(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    before, packed = everything(root), tmp_path / "archive"
    damaged = root / "scans" / "000002" / "frames_left.npy"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"\0")
    said = desk("archive", "pack", root, "--out", packed, "--remove")
    assert said.code == 1
    assert "000002  failed: " in said.out
    assert "2 written, 0 already there, 1 failed" in said.out
    assert [path.name for path in (root / "scans").iterdir()] == ["000002"]
    assert desk("archive", "unpack", packed, "--out", tmp_path / "back").code == 0
    back = everything(tmp_path / "back")
    assert back == {name: data for name, data in before.items() if "000002" not in name}


def test_sources_stay_while_an_instrument_uses_them(root: Path, tmp_path: Path, desk: Shell) -> None:
    with hold_lock(root):
        said = desk("archive", "pack", root, "--out", tmp_path / "archive", "--remove")
        assert said.code == 1
        assert "another instance" in said.error
        assert desk("archive", "pack", root, "--out", tmp_path / "archive").code == 0, "reading disturbs nobody"


def test_a_damaged_archive_is_told_with_the_frame(root: Path, tmp_path: Path, desk: Shell) -> None:
    desk("archive", "pack", root, "--out", tmp_path / "archive")
    path = tmp_path / "archive" / "scans" / "000003" / "frames_right.npy.jls"
    data = bytearray(path.read_bytes())
    data[-40] ^= 1
    path.write_bytes(data)
    said = desk("archive", "verify", tmp_path / "archive")
    assert said.code == 4
    assert "000003  DAMAGED: frames_right.npy" in said.out
    assert "gray-x-0" in desk("scans", "verify", "--root", tmp_path / "archive").out
    again = desk("archive", "unpack", tmp_path / "archive", "--out", tmp_path / "back")
    assert again.code == 1
    assert "2 written, 0 already there, 1 failed" in again.out


def test_one_frame_as_a_picture(root: Path, tmp_path: Path, desk: Shell) -> None:
    desk("archive", "pack", root, "--out", tmp_path / "archive")
    scan = tmp_path / "archive" / "scans" / "000001"
    assert desk("archive", "frame", scan, "left", "dark", "--out", tmp_path / "dark.png").code == 0
    picture = cv2.imread(str(tmp_path / "dark.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert np.array_equal(picture, frames(0)["left"][1])
    assert "bright, dark, gray-x-0" in desk("archive", "frame", scan, "left", "sine").error


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("pack", "{root}"), "--out is missing"),
        (("pack", "{root}", "--out", "{root}"), "give another folder"),
        (("pack", "{root}/scans", "--out", "{root}/x"), "give the folder that holds scans/"),
        (("verify", "/nowhere"), "no storage root"),
        (("frame", "/nowhere", "left", "bright"), "no such folder"),
        (("frame", "{root}/scans/000001", "middle", "bright"), "allowed are left and right"),
        (("frame", "{root}/scans/000001", "left", "bright", "--out", "x.jpg"), "give x.png"),
    ],
)
def test_wrong_words_end_in_one_line(root: Path, desk: Shell, words: tuple[str, ...], said: str) -> None:
    done = desk("archive", *(word.format(root=root) for word in words))
    assert done.code == 2
    assert said in done.error


def test_without_the_codec_one_line_says_what_to_install(
    root: Path, tmp_path: Path, desk: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk("archive", "pack", root, "--out", tmp_path / "archive")
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    said = desk("archive", "verify", tmp_path / "archive")
    assert said.code == 1
    assert "needs imagecodecs: pip install 'kingfisher-3d[desk]'" in said.error
    assert desk("scans", "verify", "--root", tmp_path / "archive").code == 0, "that decodes nothing"


def test_a_scan_with_a_file_nobody_knows_is_archived_with_it(root: Path, tmp_path: Path, desk: Shell) -> None:
    (root / "scans" / "000001" / "diary.txt").write_text("north side")
    (root / "scans" / "000001" / "frames_left.npy.partial").write_bytes(b"1234")
    assert desk("archive", "pack", root, "--out", tmp_path / "archive", "--remove").code == 0
    there = tmp_path / "archive" / "scans" / "000001"
    assert (there / "diary.txt").read_text() == "north side"
    assert (there / "frames_left.npy.partial").read_bytes() == b"1234"
    assert stored.manifest_of(there).scan_id == "000001"


# -------------------------------------------------------------------------- nothing that is there is replaced


def test_what_was_worked_out_in_an_archive_is_still_there_after_the_next_pack(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    packed, path = tmp_path / "archive", Path("objects") / "hull" / "object.json"
    (root / path).parent.mkdir(parents=True)
    (root / path).write_text("two scans")
    assert desk("archive", "pack", root, "--out", packed).code == 0
    (packed / path).write_text("solved, three scans")
    for call in ("the next one", "and one more"):
        said = desk("archive", "pack", root, "--out", packed)
        assert said.code == 0, call
        assert (packed / path).read_text() == "solved, three scans", call
        (copy,) = (packed / path).parent.glob("object.*.json")
        assert copy.read_text() == "two scans"
        assert f"{path}  DIFFERS: " in said.out
        assert copy.name in said.out
    assert desk("archive", "pack", root, "--out", packed, "--json").document["different"] == [
        {"path": str(path), "copy": str(copy)}
    ]
    copy.write_text("something else")
    said = desk("archive", "pack", root, "--out", packed)
    assert (said.code, copy.read_text()) == (1, "something else")
    assert "move away the one with a checksum in its name" in said.out


def test_the_calibration_in_use_stays_in_use_where_an_old_scan_is_unpacked(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    packed, back = tmp_path / "archive", tmp_path / "back"
    (root / "calibration" / "current.json").write_text("of last year")
    desk("archive", "pack", root, "--out", packed)
    (back / "calibration").mkdir(parents=True)
    (back / "calibration" / "current.json").write_text("of today")
    said = desk("archive", "unpack", packed, "1", "--out", back)
    assert said.code == 0
    assert "calibration/current.json  DIFFERS" in said.out
    assert (back / "calibration" / "current.json").read_text() == "of today"
    (copy,) = (back / "calibration").glob("current.*.json")
    assert copy.read_text() == "of last year", "scans find their calibration by its hash, under whatever name"


def test_a_leftover_with_a_folder_in_it_is_told_and_keeps_no_other_scan_from_being_packed(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    """As an earlier version left it: half removed under a hidden name, for a folder was in it."""
    left = root / "scans" / ".000007.archived"
    (left / "notes").mkdir(parents=True)
    (left / "notes" / "log.txt").write_text("north side")
    (left / "preview.png").write_bytes(b"x")
    said = desk("archive", "pack", root, "--out", tmp_path / "archive", "--remove")
    assert said.code == 1
    assert f".000007.archived  failed: {left}: notes: no file, and only files are packed; move it out" in said.out
    assert "3 written, 0 already there, 1 failed" in said.out
    assert {path.name for path in left.iterdir()} == {"notes", "preview.png"}, "nobody removes what was not compared"
    assert [path.name for path in (root / "scans").iterdir()] == [left.name]
    (left / "notes").rename(tmp_path / "notes")
    assert desk("archive", "pack", root, "--out", tmp_path / "archive", "--remove").code == 0
    assert list((root / "scans").iterdir()) == []


@pytest.mark.parametrize("verb", ["pack", "unpack"])
def test_a_second_call_takes_nothing_away_from_one_that_is_still_writing(
    root: Path, tmp_path: Path, desk: Shell, verb: str
) -> None:
    out = tmp_path / "out"
    half = out / "scans" / ".000002.packing" / "manifest.json"
    half.parent.mkdir(parents=True)
    half.write_text("{")
    with hold_lock(out):
        assert desk("archive", verb, root, "--out", out).code == 1
        assert half.exists()
    assert desk("archive", verb, root, "--out", out).code == 0
    assert not half.parent.exists()


def test_a_frame_for_a_folder_that_is_not_there_is_refused_by_the_name_that_was_typed(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    out = tmp_path / "pictures" / "dark.png"
    said = desk("archive", "frame", root / "scans" / "000001", "left", "dark", "--out", out)
    assert said.code == 2
    assert f"--out {out}: there is no folder {out.parent}" in said.error
    assert ".draft" not in said.error
