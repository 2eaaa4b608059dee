"""What a person types to keep scans in a third of the room loses nothing: what is removed has a copy, and nothing that is there is replaced."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from appliance.store.library import Library
from appliance.store.lock import hold_lock
from tests.appliance.store.scenes import ORIGIN, frames, record
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


def test_there_and_back_beside_a_running_instrument_and_a_second_time_nothing_is_done(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    before, packed, back = everything(root), tmp_path / "archive", tmp_path / "back"
    with hold_lock(root):
        said = desk("archive", "pack", root, "--out", packed, "--remove")
        assert (said.code, "another instance" in said.error) == (1, True)
        said = desk("archive", "pack", root, "--out", packed)  # reading disturbs nobody
    assert (said.code, said.err, said.out[:38]) == (0, "", "3 written, 0 already there, 0 failed; ")
    assert desk("archive", "pack", root, "--out", packed, "--json").document["already_there"] == 3
    assert desk("scans", "verify", "--root", packed).code == 0, "an archive is a storage root"
    assert desk("archive", "unpack", packed, "--out", back).code == 0
    assert everything(back) == before == everything(root)


def test_a_source_is_removed_only_when_that_was_asked_for_and_its_copy_was_compared(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    (root / "scans" / "000001" / "diary.txt").write_text("north side")
    before, packed = everything(root), tmp_path / "archive"
    damaged = root / "scans" / "000002" / "frames_left.npy"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"\0")
    said = desk("archive", "pack", root, "--out", packed, "--remove")
    assert (said.code, "000002  failed: " in said.out) == (1, True)
    assert "2 written, 0 already there, 1 failed" in said.out
    assert [path.name for path in (root / "scans").iterdir()] == ["000002"]
    assert desk("archive", "unpack", packed, "--out", tmp_path / "back").code == 0
    assert everything(tmp_path / "back") == {name: data for name, data in before.items() if "000002" not in name}


def test_a_damaged_archive_is_told_with_the_frame_and_without_the_codec_what_to_install(
    root: Path, tmp_path: Path, desk: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = tmp_path / "archive"
    desk("archive", "pack", root, "--out", packed)
    path = packed / "scans" / "000003" / "frames_right.npy.jls"
    data = bytearray(path.read_bytes())
    data[-40] ^= 1
    path.write_bytes(data)
    said = desk("scans", "verify", "--all", "--root", packed)
    assert (said.code, "000003  DAMAGED: frames_right.npy" in said.out, "gray-x-0" in said.out) == (4, True, True)
    assert desk("archive", "pack", root, "--out", packed, "--remove").code == 1
    assert [path.name for path in (root / "scans").iterdir()] == ["000003"], "only what has a good copy is removed"
    again = desk("archive", "unpack", packed, "--out", tmp_path / "back")
    assert (again.code, "2 written, 0 already there, 1 failed" in again.out) == (1, True)
    scan, missing = packed / "scans" / "000001", tmp_path / "pictures" / "dark.png"
    assert "bright, dark, gray-x-0" in desk("scans", "show", scan, "left", "sine").error
    said = desk("scans", "show", scan, "left", "dark", "--out", missing)
    assert (said.code, f"--out {missing}" in said.error, ".draft" in said.error) == (2, True, False)
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    said = desk("scans", "verify", "--all", "--root", packed)
    assert (said.code, "kingfisher-3d[desk]" in said.error) == (1, True)


def test_what_was_worked_out_in_an_archive_and_the_calibration_in_use_stay(
    root: Path, tmp_path: Path, desk: Shell
) -> None:
    packed, path = tmp_path / "archive", Path("objects") / "hull" / "object.json"
    (root / path).parent.mkdir(parents=True)
    (root / path).write_text("two scans")
    (root / "calibration" / "current.json").write_text("of last year")
    assert desk("archive", "pack", root, "--out", packed).code == 0
    (packed / path).write_text("solved, three scans")
    for call in ("the next one", "and one more"):
        said = desk("archive", "pack", root, "--out", packed)
        assert (said.code, (packed / path).read_text()) == (0, "solved, three scans"), call
        (copy,) = (packed / path).parent.glob("object.*.json")
        assert (copy.read_text(), f"{path}  DIFFERS: " in said.out) == ("two scans", True)
    copy.write_text("something else")
    said = desk("archive", "pack", root, "--out", packed)
    assert (said.code, copy.read_text()) == (1, "something else")

    back = tmp_path / "back" / "calibration"
    back.mkdir(parents=True)
    (back / "current.json").write_text("of today")
    assert "current.json  DIFFERS" in desk("archive", "unpack", packed, "1", "--out", back.parent).out
    (copy,) = back.glob("current.*.json")
    assert ((back / "current.json").read_text(), copy.read_text()) == ("of today", "of last year")


@pytest.mark.parametrize("verb", ["pack", "unpack"])
def test_a_second_call_takes_nothing_away_from_one_that_is_still_writing(
    root: Path, tmp_path: Path, desk: Shell, verb: str
) -> None:
    out = tmp_path / "out"
    half = out / "scans" / ".000002.packing" / "manifest.json"
    half.parent.mkdir(parents=True)
    half.write_text("{")
    with hold_lock(out):
        assert (desk("archive", verb, root, "--out", out).code, half.exists()) == (1, True)
    assert (desk("archive", verb, root, "--out", out).code, half.parent.exists()) == (0, False)
