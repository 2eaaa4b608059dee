"""Space for the next scan is taken before the shot: who fills the disk meanwhile does not cost the scan that was recorded."""

from __future__ import annotations

import errno
import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import LocalFileSystem, WritableFile
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.room import FOLDER, Room, is_full, is_read_only, plan
from appliance.storage.scan import cloud_bytes, frames_bytes
from tests.appliance.storage.scenes import FRAMES, ORIGIN, PREVIEW, cloud, record

HEIGHT, WIDTH = 600, 800
LENGTHS = {**plan(frames_bytes(FRAMES, WIDTH, HEIGHT), cloud_bytes(200, 100)), "preview": 200_000}


@pytest.mark.parametrize("piece", ["manifest-1", "frames-left", "cloud"])
def test_a_piece_that_a_stored_scan_has_under_another_name_is_not_written_to(tmp_path: Path, piece: str) -> None:
    """A loss of power between the two halves of a rename leaves a file under its old name and the new one."""
    room = Room(tmp_path, LocalFileSystem())
    library = Library(tmp_path, room)
    library.prepare()
    room.hold(LENGTHS)
    kept = library.begin(frames(), record(), ORIGIN)
    kept.publish(record(), cloud(), PREVIEW)
    stored = {"manifest-1": "manifest.json", "frames-left": "frames_left.npy", "cloud": "cloud.ply"}[piece]
    (tmp_path / FOLDER / piece).hardlink_to(library.entry(kept.scan_id).folder / stored)
    library.begin(frames(1), record(), ORIGIN).publish(record(), cloud(seed=1), PREVIEW)
    assert library.verify(kept.scan_id).ok
    room.hold(LENGTHS)
    library.begin(frames(2), record(), ORIGIN).publish(record(), cloud(seed=2), PREVIEW)
    assert [library.verify(entry.scan_id).problems for entry in library.entries()] == [(), (), ()]


def frames(seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    chance = np.random.default_rng(seed)
    return {side: chance.integers(0, 256, (FRAMES, HEIGHT, WIDTH), np.uint8) for side in ("left", "right")}


@contextmanager
def small_disk(folder: Path, size_mb: int = 12) -> Iterator[Path]:
    """A file system of its own; skipped where this user may not mount one."""
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "none", str(folder)], capture_output=True, timeout=20
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


def test_a_scan_is_saved_while_somebody_takes_every_block_that_gets_free(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as root:
        room = Room(root, LocalFileSystem())
        library = Library(root, room)
        library.prepare()
        room.hold(LENGTHS)
        with somebody_fills(root):
            assert LocalFileSystem().free_bytes(root) < 100_000, "nothing is left for a scan of 4 MB"
            scan = library.begin(frames(), record(), ORIGIN)
            scan.publish(record(), cloud(10_000), PREVIEW * 1000)
            assert library.verify(scan.scan_id).problems == ()
            with pytest.raises(StorageError) as refused:
                room.hold(LENGTHS)
        assert is_full(refused.value), "and the next one is refused before it is recorded"
        assert (library.load(scan.scan_id).frames["left"] == frames()["left"]).all()


def test_without_allocated_space_the_same_scan_would_be_refused(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as root:
        library = Library(root)
        library.prepare()
        with somebody_fills(root), pytest.raises(StorageError) as refused:
            library.begin(frames(), record(), ORIGIN)
        assert is_full(refused.value)


class FullDisk(LocalFileSystem):
    """No block can be had any more; what was allocated before can be written."""

    def make_folder(self, path: Path) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    def create(self, path: Path) -> WritableFile:
        raise OSError(errno.ENOSPC, "no space left")

    def allocate(self, path: Path, length_bytes: int) -> None:
        raise OSError(errno.ENOSPC, "no space left")

    def reopen(self, path: Path) -> WritableFile:
        return _Bounded(super().reopen(path), path.stat().st_size)


class _Bounded:
    def __init__(self, file: WritableFile, room: int) -> None:
        self._file, self._room = file, room

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._room -= len(data)
        if self._room < 0:
            raise OSError(errno.ENOSPC, "no space left")
        self._file.write(data)

    def sync(self) -> None:
        self._file.sync()

    def close(self) -> None:
        self._file.close()


@pytest.mark.parametrize("kept", [True, False])
def test_a_disk_that_gives_no_block_any_more_still_takes_the_scan_that_was_recorded(tmp_path: Path, kept: bool) -> None:
    Library(tmp_path).prepare()
    Room(tmp_path, LocalFileSystem()).hold(LENGTHS)
    library = Library(tmp_path, Room(tmp_path, FullDisk()))  # as after a restart: the room is still there
    scan = library.begin(frames(), record(), ORIGIN)
    if kept:
        scan.publish(record(), cloud(10_000), PREVIEW * 1000)
    else:
        scan.reject("moved")
    (entry,) = library.entries(LibraryFolder.SCANS if kept else LibraryFolder.REJECTED)
    assert library.verify(entry.scan_id).problems == ()
    with pytest.raises(StorageError) as refused:
        library.begin(frames(1), record(), ORIGIN)
    assert is_full(refused.value)
    assert list((tmp_path / "scans").glob(".*")) == [], "nothing of the scan that found no room stays"


def test_the_room_is_free_space_for_scans_and_taken_for_everybody_else(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as root:
        room = Room(root, LocalFileSystem())
        library = Library(root, room)
        library.prepare()
        before = LocalFileSystem().free_bytes(root)
        room.hold(LENGTHS)
        assert room.held_bytes >= sum(LENGTHS.values())
        assert LocalFileSystem().free_bytes(root) == before - room.held_bytes
        assert library.scans_left(1_000_000, 0) == before // 1_000_000


def test_what_a_loss_of_power_or_a_shorter_sequence_left_is_allocated_anew(tmp_path: Path) -> None:
    room = Room(tmp_path, LocalFileSystem())
    room.hold({"frames-left": 100_000, "cloud": 50_000})
    with (tmp_path / FOLDER / "cloud").open("wb") as hole:
        hole.truncate(50_000)  # as long as it should be, and not a block of it
    room.hold({"frames-left": 200_000, "cloud": 50_000})
    for name, length in (("frames-left", 200_000), ("cloud", 50_000)):
        found = (tmp_path / FOLDER / name).stat()
        assert found.st_size >= length
        assert found.st_blocks * 512 >= length
    os.link(tmp_path / FOLDER / "cloud", tmp_path / "also-somewhere-else")
    room.hold({"cloud": 50_000})
    assert (tmp_path / FOLDER / "cloud").stat().st_nlink == 1, "nobody else's file is written over"


def test_a_file_made_of_the_room_is_as_long_as_what_was_written(tmp_path: Path) -> None:
    room = Room(tmp_path, LocalFileSystem())
    room.hold({"cloud": 50_000})
    file = room.create(tmp_path / "cloud.ply")
    file.write(b"few points")
    file.sync()
    file.close()
    assert (tmp_path / "cloud.ply").read_bytes() == b"few points"
    assert not (tmp_path / FOLDER / "cloud").exists()
    with pytest.raises(FileExistsError):
        room.create(tmp_path / "cloud.ply")


def test_where_nothing_can_be_allocated_scans_are_saved_all_the_same_and_it_is_known(tmp_path: Path) -> None:
    class OldDisk(LocalFileSystem):
        def allocate(self, path: Path, length_bytes: int) -> None:
            path.write_bytes(b"")
            raise OSError(errno.EOPNOTSUPP, "operation not supported")

    room = Room(tmp_path, OldDisk())
    library = Library(tmp_path, room)
    library.prepare()
    room.hold(LENGTHS)
    assert not room.allocates
    assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["folder"]
    scan = library.begin(frames(), record(), ORIGIN)
    scan.publish(record(), cloud(), PREVIEW)
    assert library.verify(scan.scan_id).ok


def test_a_disk_mounted_for_reading_only_is_told_from_a_full_one(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as root:
        room = Room(root, LocalFileSystem())
        library = Library(root, room)
        library.prepare()
        room.hold(LENGTHS)
        scan = library.begin(frames(), record(), ORIGIN)
        subprocess.run(["mount", "-o", "remount,ro", str(root)], check=True, timeout=20)
        for refused in (lambda: room.hold(LENGTHS), lambda: library.begin(frames(), record(), ORIGIN),
                        lambda: scan.publish(record(), cloud(), PREVIEW), lambda: scan.reject("moved")):  # fmt: skip
            with pytest.raises(StorageError) as error:
                refused()
            assert is_read_only(error.value)
            assert not is_full(error.value)
        subprocess.run(["mount", "-o", "remount,rw", str(root)], check=True, timeout=20)
        with suppress(StorageError):
            room.hold(LENGTHS)
        scan.publish(record(), cloud(), PREVIEW)
        assert library.verify(scan.scan_id).ok
