"""The number of the next scan, its name, and who holds the root."""

from __future__ import annotations

import os
import threading
import zlib
from contextlib import ExitStack
from pathlib import Path

import pytest

from appliance.checksummed_file import with_checksum
from appliance.storage import counter, label
from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.label import Label, LabelError
from appliance.storage.lock import hold_lock, holder
from tests.appliance.storage.scenes import padded

FS = LocalFileSystem()


def sealed_number(number: int) -> bytes:
    return b"%d %08x\n" % (number, zlib.crc32(b"%d" % number))


def test_numbers_begin_with_one_never_repeat_and_end(tmp_path: Path) -> None:
    assert [counter.take(FS, tmp_path, ()) for _ in range(3)] == [1, 2, 3]
    assert counter.take(FS, tmp_path, (1, 9, 4)) == 10, "a folder's number counts as well"
    assert counter.take(FS, tmp_path, (3,)) == 11, "and the higher of the two wins"
    assert (tmp_path / counter.FILE_NAME).read_bytes() == sealed_number(12)
    for damage in (b"", b"700\n", b"700 00000000\n", sealed_number(700) + b"x", b"7x0 01234567\n"):
        (tmp_path / counter.FILE_NAME).write_bytes(damage)
        assert counter.take(FS, tmp_path, (41, 5)) == 42, "left to the folders"
    (tmp_path / counter.FILE_NAME).write_bytes(sealed_number(counter.LARGEST))
    assert counter.take(FS, tmp_path, ()) == counter.LARGEST == 999_999_999_999
    for taken in ((), (counter.LARGEST,)):
        with pytest.raises(StorageError, match="last number"):
            counter.take(FS, tmp_path, taken)
    assert [counter.spell_id(number) for number in (1, 123456, 1234567)] == ["000001", "123456", "1234567"]


@pytest.mark.parametrize(("what", "longest"), [("name", 60), ("note", 1000)])
def test_a_label_has_so_many_characters_that_can_be_read(what: str, longest: int) -> None:
    limit = {"name": label.LONGEST_NAME, "note": label.LONGEST_NOTE}[what]
    assert label.checked(what, f"  {'x' * longest} ", limit) == "x" * longest
    with pytest.raises(LabelError, match=f"{what}: {longest + 1} characters"):
        label.checked(what, "x" * (longest + 1), limit)
    for character in "\n\t\u202e\u2028\u2029\ue000\u0378\x7f\udcff":
        with pytest.raises(LabelError, match=rf"{what}: character 3 is U\+{ord(character):04X}"):
            label.checked(what, f"ab{character}c", limit)
    assert label.checked(what, "Bo\u0308je", limit) == "B\u00f6je", "two spellings of one letter are one"
    assert label.checked(what, " \t ", limit) is None


def test_a_label_is_read_as_it_was_written_and_another_hands_with_the_same_care(tmp_path: Path) -> None:
    assert label.read(tmp_path) == Label(None, None)
    for written in (Label("bollard 3", "north side"), Label(None, "x" * 1000), Label("\u6d77" * 60, None)):
        label.write(FS, tmp_path, written)
        assert label.read(tmp_path) == written
    path, named = tmp_path / label.FILE_NAME, {"schema": 1, "name": "a", "note": None}
    path.write_bytes(padded(named, 16_384))
    assert label.read(tmp_path).name == "a"
    for data, said in (
        (with_checksum({"schema": 2, "name": "a"}), "schema 2"), (with_checksum({"schema": 1, "name": 7}), "name is 7"),
        (with_checksum({"schema": 1, "note": "x" * 1001}), "1001"), (with_checksum({"schema": 1, "name": "a\x07"}), "name"), (padded(named, 16_385), "16384"),
    ):  # fmt: skip
        path.write_bytes(data)
        with pytest.raises(LabelError, match=rf"^label\.json: .*{said}"):
            label.read(tmp_path)
    path.unlink()
    path.mkdir()
    with pytest.raises(LabelError, match=r"label\.json"):
        label.read(tmp_path)


def test_one_process_holds_a_root_and_others_are_told_which(tmp_path: Path) -> None:
    assert holder(tmp_path) is None, "nobody ever did"
    with hold_lock(tmp_path):
        assert holder(tmp_path) == str(os.getpid())
        with pytest.raises(StorageError, match=f"process {os.getpid()}"), hold_lock(tmp_path):
            pass
    assert holder(tmp_path) is None, "and nobody does now"
    with ExitStack() as held:
        held.enter_context(hold_lock(tmp_path))
        threading.Timer(0.1, held.close).start()
        with hold_lock(tmp_path, wait_s=20.0):
            assert holder(tmp_path) == str(os.getpid()), "who waits gets it"
    (tmp_path / "run" / "lock").write_text("1234567890\n")  # of an earlier process, with more digits
    with hold_lock(tmp_path):
        assert holder(tmp_path) == str(os.getpid())
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"), hold_lock(tmp_path / "file"):
        pass
