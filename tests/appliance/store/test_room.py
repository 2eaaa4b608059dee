"""Space for the next scan is taken before the shot: who fills the disk meanwhile does not cost the scan that was recorded."""

from __future__ import annotations

import errno
import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.store.atomic import LocalFileSystem, StorageError, draft_of
from appliance.store.library import Library
from appliance.store.room import FOLDER, Room
from appliance.store.scan import cloud_bytes
from tests.appliance.store.scenes import FRAMES, ORIGIN, PREVIEW, BadDisk, cloud, record

FS = LocalFileSystem()
HEIGHT, WIDTH = 600, 800
LENGTHS = {**Room.plan(FRAMES, WIDTH, HEIGHT), "cloud": cloud_bytes(200, 100), "preview": 200_000}
FEW = {"frames-left": 10_000, "number": 1}


def frames(seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    chance = np.random.default_rng(seed)
    return {side: chance.integers(0, 256, (FRAMES, HEIGHT, WIDTH), np.uint8) for side in ("left", "right")}


def in_room(root: Path) -> list[str]:
    return sorted(path.name for path in (root / FOLDER).iterdir())


def library_with_room(root: Path) -> tuple[Library, Room]:
    room = Room(root, FS)
    library = Library(root, room)
    library.prepare()
    room.hold(LENGTHS)
    return library, room


def refusal(work: object) -> StorageError:
    assert callable(work)
    with pytest.raises(StorageError) as refused:
        work()
    return refused.value


def test_one_scan_needs_both_cameras_frames_the_points_and_something_for_each_small_file() -> None:
    lengths = Room.plan(24, 1600, 1200)
    assert (lengths["frames-left"], lengths["frames-right"], lengths["cloud"]) == (46_080_128, 46_080_128, 48_004_096)
    small = {name: length for name, length in lengths.items() if length < 10_000_000}
    assert set(small) == {"preview", "calibration", "rig", "manifest-1", "manifest-2", "number", "slack"}
    assert all(4096 <= length <= 1_500_000 for length in small.values())


def test_what_is_held_is_not_taken_again_and_what_is_too_short_hollow_or_anothers_is(tmp_path: Path) -> None:
    disk, piece = BadDisk(), tmp_path / FOLDER / "frames-left"
    room = Room(tmp_path, disk)
    room.hold(FEW)
    assert disk.calls == ["make_folder room", "make_folder folder", "allocate frames-left", "allocate number"]
    for enough in (FEW, {"frames-left": 9_999}):
        room.hold(enough)
        assert len(disk.calls) == 4
    room.hold({"frames-left": 10_001})
    assert disk.calls[4:] == ["remove frames-left", "allocate frames-left"]
    assert room.held_bytes == 4 * 4096, "in blocks, and without the folder"
    assert room.free_bytes(tmp_path) == pytest.approx(disk.free_bytes(tmp_path) + room.held_bytes, rel=0.2)
    assert Room(tmp_path / "nowhere", disk).held_bytes == 0
    piece.write_bytes(b"")
    os.truncate(piece, 10_001)  # as long as it should be, and not a block of it
    room.hold(FEW)
    assert piece.stat().st_blocks * 512 >= 10_000
    os.link(piece, tmp_path / "also-somewhere-else")
    room.hold(FEW)
    assert piece.stat().st_nlink == 1, "nobody else's file is written over"


ALLOCATING = {errno.EOPNOTSUPP: True, errno.ENOSYS: True, errno.EINVAL: True, errno.ENOSPC: False, errno.EIO: False, errno.EROFS: False}  # fmt: skip


@pytest.mark.parametrize(("error", "counted"), ALLOCATING.items())
def test_space_that_cannot_be_allocated_is_counted_and_refusals_told(tmp_path: Path, error: int, counted: bool) -> None:
    room = Room(tmp_path, BadDisk(2, 99, error))
    with nullcontext() if counted else pytest.raises(StorageError):
        room.hold(FEW)
    assert room.allocates is not counted
    assert in_room(tmp_path) == ["folder"]


@pytest.mark.parametrize(("error", "given_up"), [(errno.ENOSPC, True), (errno.EIO, False), (errno.EDQUOT, False)])
def test_the_slack_is_given_up_once_for_a_folder_that_has_to_grow(tmp_path: Path, error: int, given_up: bool) -> None:
    Room(tmp_path, FS).hold({"slack": 4096})
    (tmp_path / "one").write_bytes(b"content")
    with nullcontext() if given_up else pytest.raises(OSError, match="injected"):
        Room(tmp_path, BadDisk(0, 1, error)).rename(tmp_path / "one", tmp_path / "two")
    assert (tmp_path / "two").exists() is given_up
    assert (tmp_path / FOLDER / "slack").exists() is not given_up
    if given_up:
        with pytest.raises(OSError, match="injected"):
            Room(tmp_path, BadDisk(0, 1, errno.ENOSPC)).make_folder(tmp_path / "three")


def test_files_and_folders_are_made_of_their_places_and_of_none_where_those_are_used(tmp_path: Path) -> None:
    room = Room(tmp_path, FS)
    room.hold({"manifest-1": 4096, "manifest-2": 4096, "cloud": 50_000})
    for left in (["cloud", "folder", "manifest-2"], ["cloud", "folder"], ["cloud", "folder"]):
        room.replace_file(tmp_path / "manifest.json", b"content")
        assert not draft_of(tmp_path / "manifest.json").exists()
        assert (tmp_path / "manifest.json").read_bytes() == b"content"
        assert in_room(tmp_path) == left
    file = room.create(tmp_path / "cloud.ply")
    file.write(b"few points")
    file.sync()
    file.close()
    assert (tmp_path / "cloud.ply").read_bytes() == b"few points", "as long as what was written"
    with pytest.raises(FileExistsError):
        room.create(tmp_path / "cloud.ply")
    (tmp_path / FOLDER / "folder" / "something").write_bytes(b"x")
    room.make_folder(tmp_path / "000001")
    assert list((tmp_path / "000001").iterdir()) == [], "a spare folder with something in it is not a scan's"
    (tmp_path / FOLDER / "folder" / "something").unlink()
    room.make_folder(tmp_path / "000002")
    assert in_room(tmp_path) == [], "it became the scan's"
    with pytest.raises(FileExistsError):
        room.make_folder(tmp_path / "000002")


@pytest.mark.parametrize("piece", ["manifest-1", "frames-left", "cloud"])
def test_a_piece_that_a_stored_scan_has_under_another_name_is_not_written_to(tmp_path: Path, piece: str) -> None:
    """A loss of power between the two halves of a rename leaves a file under its old name and the new one."""
    library, room = library_with_room(tmp_path)
    kept = library.begin(frames(), record(), ORIGIN)
    kept.publish(record(), cloud(), PREVIEW)
    stored = {"manifest-1": "manifest.json", "frames-left": "frames_left.npy", "cloud": "cloud.ply"}[piece]
    (tmp_path / FOLDER / piece).hardlink_to(library.entry(kept.scan_id).folder / stored)
    for seed in (1, 2):
        library.begin(frames(seed), record(), ORIGIN).publish(record(), cloud(seed=seed), PREVIEW)
        room.hold(LENGTHS)
    assert [library.verify(entry.scan_id).problems for entry in library.entries()] == [(), (), ()]


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of its own; skipped where this user may not mount one."""
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=12m", "none", str(folder)], capture_output=True, timeout=20
    )
    if mounted.returncode != 0:
        pytest.skip(f"no file system can be mounted: {mounted.stderr.decode().strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True, timeout=20)


@contextmanager
def somebody_fills(folder: Path) -> Iterator[None]:
    """Every block that is free, and every one that gets free, is gone at once."""
    enough, full = threading.Event(), threading.Event()

    def fill() -> None:
        with (folder / "somebody-elses").open("wb", buffering=0) as file:
            while not enough.is_set():
                try:
                    file.write(bytes(4096))
                except OSError:
                    full.set()

    thief = threading.Thread(target=fill)
    thief.start()
    try:
        assert full.wait(30.0)
        yield
    finally:
        enough.set()
        thief.join(30.0)


@pytest.mark.parametrize("kept", [True, False])
def test_a_scan_is_saved_while_somebody_takes_every_block_that_gets_free(tmp_path: Path, kept: bool) -> None:
    with small_disk(tmp_path / "disk") as root:
        Library(root).prepare()
        before = FS.free_bytes(root)
        library, room = library_with_room(root)
        assert FS.free_bytes(root) == before - room.held_bytes <= before - sum(LENGTHS.values())
        assert library.scans_left(1_000_000, 0) == before // 1_000_000, "free for scans, and for nobody else"
        library = Library(root, Room(root, FS))  # as after a restart: the room is still there
        with somebody_fills(root):
            assert FS.free_bytes(root) < 100_000, "nothing is left for a scan of 4 MB"
            scan = library.begin(frames(), record(), ORIGIN)
            if kept:
                scan.publish(record(), cloud(10_000), PREVIEW * 1000)
            else:
                scan.reject("moved")
            assert library.verify(scan.scan_id).problems == ()
            assert refusal(lambda: room.hold(LENGTHS)).is_full, "the next one is refused before it is recorded"
            assert refusal(lambda: Library(root).begin(frames(), record(), ORIGIN)).is_full
            assert list((root / "scans").glob(".*")) == [], "nothing of the scan that found no room stays"
        assert (library.load(scan.scan_id).frames["left"] == frames()["left"]).all()


def test_a_disk_mounted_for_reading_only_is_told_from_a_full_one(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as root:
        library, room = library_with_room(root)
        scan = library.begin(frames(), record(), ORIGIN)
        subprocess.run(["mount", "-o", "remount,ro", str(root)], check=True, timeout=20)
        for work in (lambda: room.hold(LENGTHS), lambda: library.begin(frames(), record(), ORIGIN),
                     lambda: scan.publish(record(), cloud(), PREVIEW), lambda: scan.reject("moved")):  # fmt: skip
            error = refusal(work)
            assert (error.is_read_only, error.is_full) == (True, False)
        subprocess.run(["mount", "-o", "remount,rw", str(root)], check=True, timeout=20)
        with suppress(StorageError):
            room.hold(LENGTHS)
        scan.publish(record(), cloud(), PREVIEW)
        assert library.verify(scan.scan_id).ok
