"""The number of the next scan, its name, who holds the root, and what a refusing disk is said to need."""

from __future__ import annotations

import errno
import os
import threading
import zlib
from contextlib import ExitStack
from pathlib import Path

import pytest

from appliance.checksummed_file import with_checksum
from appliance.storage import counter, label
from appliance.storage.atomic import StorageError, checked_stamp, refused, remedy_for, write_new
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.label import Label, LabelError
from appliance.storage.lock import hold_lock, holder

FS = LocalFileSystem()


def number_file(root: Path, content: bytes) -> None:
    (root / counter.FILE_NAME).write_bytes(content)


def sealed_number(number: int) -> bytes:
    return b"%d %08x\n" % (number, zlib.crc32(b"%d" % number))


def test_numbers_begin_with_one_and_never_repeat(tmp_path: Path) -> None:
    assert [counter.take(FS, tmp_path, ()) for _ in range(3)] == [1, 2, 3]
    assert counter.take(FS, tmp_path, (1, 9, 4)) == 10, "a folder's number counts as well"
    assert counter.take(FS, tmp_path, (3,)) == 11, "and the higher of the two wins"
    assert (tmp_path / counter.FILE_NAME).read_bytes() == sealed_number(12)


@pytest.mark.parametrize("damage", [b"", b"700\n", b"700 00000000\n", sealed_number(700) + b"x", b"7x0 01234567\n"])
def test_a_damaged_number_leaves_it_to_the_folders(tmp_path: Path, damage: bytes) -> None:
    number_file(tmp_path, damage)
    assert counter.take(FS, tmp_path, (41, 5)) == 42


def test_the_last_number_is_given_and_none_after_it(tmp_path: Path) -> None:
    number_file(tmp_path, sealed_number(counter.LARGEST))
    assert counter.take(FS, tmp_path, ()) == counter.LARGEST == 999_999_999_999
    with pytest.raises(StorageError, match="999999999999 is the last number; start a new storage folder"):
        counter.take(FS, tmp_path, ())
    with pytest.raises(StorageError, match="is the last number"):
        counter.take(FS, tmp_path, (counter.LARGEST,))


@pytest.mark.parametrize(("number", "spelled"), [(1, "000001"), (123456, "123456"), (1234567, "1234567")])
def test_a_number_has_six_digits_and_more_when_they_are_needed(number: int, spelled: str) -> None:
    assert counter.spell_id(number) == spelled


@pytest.mark.parametrize("what", ["name", "note"])
def test_a_label_of_the_longest_length_is_taken_and_one_longer_is_not(tmp_path: Path, what: str) -> None:
    longest = {"name": 60, "note": 1000}[what]
    limit = {"name": label.LONGEST_NAME, "note": label.LONGEST_NOTE}[what]
    assert label.checked(what, f"  {'x' * longest} ", limit) == "x" * longest
    with pytest.raises(LabelError, match=f"{what}: {longest + 1} characters; allowed are {longest}"):
        label.checked(what, "x" * (longest + 1), limit)


@pytest.mark.parametrize("character", ["\n", "\t", "\u202e", "\u2028", "\u2029", "\ue000", "\u0378", "\x7f"])
def test_the_place_of_a_character_that_cannot_be_read_is_told(character: str) -> None:
    with pytest.raises(LabelError, match=rf"name: character 3 is U\+{ord(character):04X}, a control character"):
        label.checked("name", f"ab{character}c", 60)


def test_two_spellings_of_one_letter_are_one_and_blanks_alone_are_none() -> None:
    assert label.checked("name", "Bo\u0308je", 60) == "B\u00f6je"
    assert label.checked("name", "  ", 60) is None


def test_a_label_is_read_as_it_was_written(tmp_path: Path) -> None:
    assert label.read(tmp_path) == Label(None, None)
    for written in (Label("bollard 3", "north side"), Label(None, "x" * 1000), Label("\u6d77" * 60, None)):
        label.write(FS, tmp_path, written)
        assert label.read(tmp_path) == written


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"schema": 2, "name": "a"}, "schema 2; this version reads 1"),
        ({"schema": 1, "name": 7}, "name is 7; allowed is a text"),
        ({"schema": 1, "note": "x" * 1001}, "note: 1001 characters"),
        ({"schema": 1, "name": "x" * 61}, "name: 61 characters"),
    ],
)
def test_a_label_that_cannot_be_used_says_why(tmp_path: Path, content: dict[str, object], said: str) -> None:
    (tmp_path / label.FILE_NAME).write_bytes(with_checksum(content))
    with pytest.raises(LabelError, match=f"^label.json: {said}"):
        label.read(tmp_path)


def test_one_process_holds_a_root_and_others_are_told_which(tmp_path: Path) -> None:
    assert holder(tmp_path) is None, "nobody ever did"
    with hold_lock(tmp_path):
        assert holder(tmp_path) == str(os.getpid())
        said = rf"another instance \(process {os.getpid()}\) is using it; stop that"
        with pytest.raises(StorageError, match=said), hold_lock(tmp_path):
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


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "the disk is full"),
        (errno.EDQUOT, "share of the disk is used up"),
        (errno.EROFS, "mounted for reading only"),
        (errno.EACCES, "this user may not"),
        (errno.EPERM, "this user may not"),
        (errno.ENOENT, "does not exist"),
        (errno.ENOTDIR, "is a file"),
        (errno.EISDIR, "it is a folder"),
        (errno.ENAMETOOLONG, "too long"),
        (errno.EIO, "the disk fails"),
        (errno.EMFILE, "too many files"),
        (errno.EXDEV, "free space or replace the disk"),
    ],
)
def test_every_refusal_names_the_path_the_reason_and_its_own_remedy(number: int, remedy: str) -> None:
    with pytest.raises(StorageError) as error, refused("cannot write", Path("/somewhere/x")):
        raise OSError(number, os.strerror(number))
    assert str(error.value).startswith(f"cannot write /somewhere/x: {os.strerror(number)}; ")
    assert remedy in error.value.remedy
    assert (error.value.path, error.value.reason) == (Path("/somewhere/x"), os.strerror(number))


def test_a_refusal_without_a_number_has_a_remedy_all_the_same() -> None:
    assert remedy_for(OSError("said in words")) == "free space or replace the disk"


def test_a_file_in_several_parts_has_the_length_and_checksum_that_are_found_on_the_disk(tmp_path: Path) -> None:
    parts = (b"head", bytes(range(256)) * 40_000, memoryview(b"tail"))  # more than two blocks of 4 MiB
    stamp = write_new(FS, tmp_path / "file", parts)
    assert stamp.length == 4 + 256 * 40_000 + 4
    assert stamp == checked_stamp(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"".join(parts)
    with pytest.raises(StorageError, match="cannot write"):
        write_new(FS, tmp_path / "file", (b"another",))
    assert (tmp_path / "file").stat().st_size == stamp.length, "what was there is not written over"
