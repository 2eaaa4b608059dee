"""A disk that refuses any one call, or all calls from one on: one clear error, nothing half visible, nothing lost."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library, LibraryFolder, PendingScan
from appliance.storage.room import Room
from tests.appliance.storage.scenes import ORIGIN, PLAN, PREVIEW, BadDisk, cloud, frames, record


def prepared(root: Path) -> Path:
    Library(root).prepare()
    Room(root, LocalFileSystem()).hold(PLAN)
    return root


def on_a(disk: BadDisk, root: Path) -> Library:
    """Its scans are written into allocated space, as on the instrument."""
    return Library(root, Room(root, disk))


def decide(scan: PendingScan, kept: bool) -> None:
    if kept:
        scan.publish(record(), cloud(), PREVIEW)
    else:
        scan.reject("moved")


def save(library: Library, kept: bool = True) -> str:
    scan = library.begin(frames(), record(), ORIGIN)
    decide(scan, kept)
    return scan.scan_id


def calls_of(root: Path, kept: bool = True) -> list[str]:
    disk = BadDisk()
    save(on_a(disk, prepared(root)), kept)
    return disk.calls


def nothing_half_is_visible(root: Path) -> None:
    for shelf in (LibraryFolder.SCANS, LibraryFolder.REJECTED):
        for entry in Library(root).entries(shelf):
            assert Library(root).verify(entry.scan_id).problems == ()


@pytest.mark.parametrize(("error", "kept"), [(errno.EIO, True), (errno.ENOSPC, True), (errno.EIO, False)])
def test_each_call_of_a_save_or_rejection_fails_once_and_trying_again_succeeds(
    tmp_path: Path, error: int, kept: bool
) -> None:
    calls = calls_of(tmp_path / "count", kept)
    assert sum(name.startswith("sync") for name in calls) >= 8
    shelf = LibraryFolder.SCANS if kept else LibraryFolder.REJECTED
    for bad in range(len(calls)):
        root = prepared(tmp_path / f"{bad}")
        library = on_a(BadDisk(bad, error=error), root)
        scan: PendingScan | None = None
        failures = 0
        for _ in range(2):
            try:
                scan = scan or library.begin(frames(), record(), ORIGIN)
                decide(scan, kept)
                break
            except StorageError:
                failures += 1
                nothing_half_is_visible(root)
        # A folder that cannot grow is given the room's slack.
        helped = error == errno.ENOSPC and calls[bad].split()[0] in ("rename", "create", "make_folder")
        assert failures == (0 if helped else 1), calls[bad]
        assert scan is not None
        fresh = Library(root)
        assert fresh.recover().failed == ()
        assert fresh.verify(scan.scan_id).ok
        stored = fresh.load(scan.scan_id)
        assert (stored.frames["left"] == frames()["left"]).all()
        assert (stored.cloud() is not None) is kept
        found = [entry.scan_id for one in (LibraryFolder.SCANS, LibraryFolder.REJECTED) for entry in fresh.entries(one)]
        assert found == [entry.scan_id for entry in fresh.entries(shelf)] == [scan.scan_id]


def test_a_disk_that_dies_for_good_at_each_call_keeps_what_was_there_and_shows_nothing_half(tmp_path: Path) -> None:
    calls = calls_of(tmp_path / "count")
    for bad in range(len(calls)):
        root = prepared(tmp_path / f"dead-{bad}")
        first = save(Library(root))
        with pytest.raises(StorageError):
            save(on_a(BadDisk(bad, bad_for=10**6), root))
        nothing_half_is_visible(root)
        fresh = Library(root)
        assert fresh.recover().failed == ()
        nothing_half_is_visible(root)
        assert fresh.verify(first).ok
        assert int(save(fresh)) > int(first)


def test_each_call_of_a_recovery_fails_once_and_the_next_start_completes_it(tmp_path: Path) -> None:
    def unfinished(root: Path) -> Path:
        library = Library(prepared(root))
        library.begin(frames(1), record(), ORIGIN)
        (library.begin(frames(2), record(), ORIGIN).folder / "frames_left.npy").write_bytes(b"half")
        return root

    disk = BadDisk()
    Library(unfinished(tmp_path / "count"), disk).recover()
    for bad in range(len(disk.calls)):
        root = unfinished(tmp_path / f"recover-{bad}")
        first = Library(root, BadDisk(bad)).recover()
        assert len(first.failed) == 1, disk.calls[bad]
        second = Library(root).recover()
        assert second.failed == ()
        assert [entry.scan_id for entry in Library(root).entries()] == ["000001"]
        assert [entry.scan_id for entry in Library(root).entries(LibraryFolder.SET_ASIDE)] == ["000002"]
        assert Library(root).verify("000001").ok
