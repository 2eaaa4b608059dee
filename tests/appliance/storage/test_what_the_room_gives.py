"""What is allocated beforehand, when it is taken, what a refusal means, and limits of the files beside it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from appliance.checksummed_file import checked_content, with_checksum
from appliance.ranging.beams import Pointers
from appliance.storage.atomic import StorageError, discard, draft_of, move_folder, refused, replace_file
from appliance.storage.beams import MAX_BYTES, BeamsFile
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.room import Room, is_full, is_read_only, plan
from tests.appliance.storage.scenes import BadDisk

LENGTHS = {"frames-left": 10_000, "number": 1}


def test_one_scan_needs_both_cameras_frames_the_points_and_something_for_each_small_file() -> None:
    lengths = plan(46_000_000, 48_000_000)
    assert (lengths["frames-left"], lengths["frames-right"], lengths["cloud"]) == (46_000_000, 46_000_000, 48_000_000)
    small = {name: length for name, length in lengths.items() if length < 10_000_000}
    assert set(small) == {"preview", "calibration", "rig", "manifest-1", "manifest-2", "number", "slack"}
    assert all(4096 <= length <= 1_500_000 for length in small.values())


def test_what_is_allocated_is_not_allocated_again_and_what_is_too_short_is(tmp_path: Path) -> None:
    disk = BadDisk()
    room = Room(tmp_path, disk)
    room.hold(LENGTHS)
    assert disk.calls == ["make_folder room", "make_folder folder", "allocate frames-left", "allocate number"]
    assert (tmp_path / "room" / "frames-left").stat().st_size == 10_000
    room.hold(LENGTHS)
    assert len(disk.calls) == 4, "nothing is missing"
    room.hold({"frames-left": 9_999})
    assert len(disk.calls) == 4, "more than enough"
    room.hold({"frames-left": 10_001})
    assert disk.calls[4:] == ["remove frames-left", "allocate frames-left"]
    assert room.held_bytes == 4 * 4096, "in blocks, and without the folder"
    assert room.free_bytes(tmp_path) == pytest.approx(disk.free_bytes(tmp_path) + room.held_bytes, rel=0.2)
    assert Room(tmp_path / "nowhere", disk).held_bytes == 0


def test_a_file_with_holes_is_not_allocated(tmp_path: Path) -> None:
    """As long as it should be, and without a block."""
    room = Room(tmp_path, LocalFileSystem())
    room.hold(LENGTHS)
    path = tmp_path / "room" / "frames-left"
    path.unlink()
    path.touch()
    os.truncate(path, 10_000)
    assert path.stat().st_blocks == 0
    room.hold(LENGTHS)
    assert path.stat().st_blocks * 512 >= 10_000


@pytest.mark.parametrize(
    ("error", "counted"),
    [
        (errno.EOPNOTSUPP, True),
        (errno.ENOSYS, True),
        (errno.EINVAL, True),
        (errno.ENOSPC, False),
        (errno.EIO, False),
        (errno.EROFS, False),
    ],
)
def test_where_nothing_can_be_allocated_space_is_counted_and_where_it_is_refused_that_is_told(
    tmp_path: Path, error: int, counted: bool
) -> None:
    room = Room(tmp_path, BadDisk(2, 99, error))
    if counted:
        room.hold(LENGTHS)
    else:
        with pytest.raises(StorageError, match="cannot allocate space in"):
            room.hold(LENGTHS)
    assert room.allocates is not counted
    assert sorted(path.name for path in (tmp_path / "room").iterdir()) == ["folder"]


@pytest.mark.parametrize(("error", "given_up"), [(errno.ENOSPC, True), (errno.EIO, False), (errno.EDQUOT, False)])
def test_the_slack_is_given_up_once_for_a_folder_that_has_to_grow(tmp_path: Path, error: int, given_up: bool) -> None:
    Room(tmp_path, LocalFileSystem()).hold({"slack": 4096})
    (tmp_path / "one").write_bytes(b"content")
    room = Room(tmp_path, BadDisk(0, 1, error))
    if given_up:
        room.rename(tmp_path / "one", tmp_path / "two")
        assert (tmp_path / "two").read_bytes() == b"content"
    else:
        with pytest.raises(OSError, match="injected"):
            room.rename(tmp_path / "one", tmp_path / "two")
    assert (tmp_path / "room" / "slack").exists() is not given_up
    again = Room(tmp_path, BadDisk(0, 1, errno.ENOSPC))
    if given_up:
        with pytest.raises(OSError, match="injected"):
            again.make_folder(tmp_path / "three")


def test_each_manifest_is_made_of_its_own_place_and_a_third_one_of_none(tmp_path: Path) -> None:
    room = Room(tmp_path, LocalFileSystem())
    room.hold({"manifest-1": 4096, "manifest-2": 4096})
    draft = draft_of(tmp_path / "manifest.json")
    for left in (["folder", "manifest-2"], ["folder"], ["folder"]):
        replace_file(room, tmp_path / "manifest.json", b"content")
        assert not draft.exists()
        assert (tmp_path / "manifest.json").read_bytes() == b"content"
        assert sorted(path.name for path in (tmp_path / "room").iterdir()) == left


def test_a_spare_folder_with_something_in_it_is_not_a_scans(tmp_path: Path) -> None:
    room = Room(tmp_path, LocalFileSystem())
    room.hold({})
    (tmp_path / "room" / "folder" / "something").write_bytes(b"x")
    room.make_folder(tmp_path / "000001")
    assert list((tmp_path / "000001").iterdir()) == []
    (tmp_path / "room" / "folder" / "something").unlink()
    room.make_folder(tmp_path / "000002")
    assert not (tmp_path / "room" / "folder").exists(), "it became the scan's"
    with pytest.raises(FileExistsError):
        room.make_folder(tmp_path / "000002")


@pytest.mark.parametrize(
    ("error", "full", "read_only"),
    [
        (errno.ENOSPC, True, False),
        (errno.EDQUOT, True, False),
        (errno.EROFS, False, True),
        (errno.EIO, False, False),
    ],
)
def test_a_full_disk_is_told_from_one_that_takes_no_changes(error: int, full: bool, read_only: bool) -> None:
    with pytest.raises(StorageError) as caught, refused("cannot write", Path("x")):
        raise OSError(error, os.strerror(error))
    assert (is_full(caught.value), is_read_only(caught.value)) == (full, read_only)
    plain = StorageError("cannot count on in", Path("x"), "it is the last number")
    assert (is_full(plain), is_read_only(plain)) == (False, False)


# -------------------------------------------------------------------------------------------- replacing and moving


def test_what_an_earlier_attempt_left_is_no_obstacle(tmp_path: Path) -> None:
    path = tmp_path / "choices.json"
    draft_of(path).write_bytes(b"half of something that is much longer than this")
    replace_file(LocalFileSystem(), path, b"new")
    assert [one.name for one in tmp_path.iterdir()] == ["choices.json"]
    assert path.read_bytes() == b"new"
    discard(LocalFileSystem(), tmp_path / "none")
    with pytest.raises(StorageError, match="cannot remove the unfinished"):
        discard(BadDisk(0), path)


def test_a_folder_that_stays_in_its_parent_needs_that_parent_synced_once(tmp_path: Path) -> None:
    (tmp_path / ".000001").mkdir()
    disk = BadDisk()
    move_folder(disk, tmp_path / ".000001", tmp_path / "000001")
    assert disk.calls == ["sync_folder .000001", "rename .000001 000001", f"sync_folder {tmp_path.name}"]


def test_beams_are_read_up_to_20_kb(tmp_path: Path) -> None:
    pointers = Pointers((40.0, -60.0, 30.0), (25.0, 0.0, 522.5), 0.3)
    file = BeamsFile(tmp_path, pointers)
    left, right = pointers.beams()
    taught = left, right.taught(right.at(np.array(right.z0_mm + 450.0)))
    file.write("abc", taught)
    whole = with_checksum(checked_content(file.path.read_bytes(), MAX_BYTES))
    for length, read in ((20_000, True), (20_001, False)):
        file.path.write_bytes(whole[:-2] + b" " * (length - len(whole)) + whole[-2:])
        assert (file.read("abc") == taught) == read
