"""The disk of this machine is really asked to keep what was written, at the right moments: seen at the system calls themselves."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from appliance.storage.atomic import StorageError, move_folder, replace_by, replace_file, write_new
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library
from appliance.storage.room import Room
from appliance.storage.scan import ORIGIN_FILES, RAW_FILES
from tests.appliance.storage.scenes import ORIGIN, PLAN, PREVIEW, cloud, frames, record
from tests.support.system_calls import Call, seen_by_python, seen_by_the_kernel

Witness = Callable[[Callable[[], None]], list[Call]]


@pytest.fixture(params=[seen_by_the_kernel, seen_by_python])
def witness(request: pytest.FixtureRequest) -> Witness:
    chosen: Witness = request.param
    return chosen


def test_a_written_file_is_synced_and_so_is_the_folder_that_names_it(tmp_path: Path, witness: Witness) -> None:
    fs = LocalFileSystem()

    def work() -> None:
        write_new(fs, tmp_path / "new", [b"content"])
        fs.sync_folder(tmp_path)

    assert witness(work) == [Call("fsync", tmp_path / "new"), Call("fsync", tmp_path)]


def test_a_file_that_a_library_wrote_is_synced_before_it_has_its_name(tmp_path: Path, witness: Witness) -> None:
    (tmp_path / "cloud").write_bytes(b"of before")

    def library(path: Path) -> None:
        path.write_bytes(b"new")
        assert (tmp_path / "cloud").read_bytes() == b"of before"

    calls = witness(lambda: replace_by(LocalFileSystem(), tmp_path / "cloud", library))
    draft = tmp_path / ".cloud.draft"
    assert [call for call in calls if call.name == "fsync"] == [Call("fsync", draft), Call("fsync", tmp_path)]
    assert (tmp_path / "cloud").read_bytes() == b"new"
    assert not draft.exists()


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("no points")])
def test_a_library_that_fails_leaves_the_file_of_before_and_no_draft(error: Exception, tmp_path: Path) -> None:
    (tmp_path / "cloud").write_bytes(b"of before")

    def library(path: Path) -> None:
        path.write_bytes(b"ne")
        raise error

    with pytest.raises(StorageError if isinstance(error, OSError) else ValueError, match=r"disk is full|no points"):
        replace_by(LocalFileSystem(), tmp_path / "cloud", library)
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"cloud": b"of before"}


def test_a_file_written_over_what_was_allocated_is_synced_at_its_new_length(tmp_path: Path, witness: Witness) -> None:
    fs = LocalFileSystem()
    fs.allocate(tmp_path / "place", 4096)

    def work() -> None:
        file = fs.reopen(tmp_path / "place")
        file.write(b"short")
        file.sync()
        file.close()

    assert witness(work) == [Call("fsync", tmp_path / "place")]
    assert (tmp_path / "place").read_bytes() == b"short"


def test_a_file_is_replaced_by_one_that_is_on_the_disk_already_and_the_name_follows(
    tmp_path: Path, witness: Witness
) -> None:
    draft, path = tmp_path / ".status.draft", tmp_path / "status"
    path.write_bytes(b"old")

    def work() -> None:
        replace_file(LocalFileSystem(), path, b"new")

    calls = witness(work)
    assert calls == [Call("fsync", draft), Call("rename", draft, path), Call("fsync", tmp_path)]


def test_a_folder_is_moved_with_its_names_on_the_disk_and_both_parents_follow(tmp_path: Path, witness: Witness) -> None:
    source, target = tmp_path / "scans" / ".1", tmp_path / "rejected" / "1"
    source.mkdir(parents=True)
    target.parent.mkdir()
    calls = witness(lambda: move_folder(LocalFileSystem(), source, target))
    assert calls[:2] == [Call("fsync", source), Call("rename", source, target)]
    assert set(calls[2:]) == {Call("fsync", target.parent), Call("fsync", source.parent)}


@pytest.mark.parametrize("allocated", [False, True])
def test_nothing_of_a_saved_scan_is_left_to_the_page_cache(tmp_path: Path, witness: Witness, allocated: bool) -> None:
    """When a name appears in a list of scans, every byte and every name below it has been synced before; then that name is."""
    fs = Room(tmp_path, LocalFileSystem()) if allocated else LocalFileSystem()
    library = Library(tmp_path, fs)

    def work() -> None:
        library.prepare()
        if isinstance(fs, Room):
            fs.hold(PLAN)
        library.begin(frames(), record(), ORIGIN).publish(record(), cloud(), PREVIEW)

    calls = witness(work)
    hidden, shown = tmp_path / "scans" / ".000001", tmp_path / "scans" / "000001"
    published = calls.index(Call("rename", hidden, shown))
    written = {path.name for path in shown.iterdir()}
    assert written == {"manifest.json", *RAW_FILES, *ORIGIN_FILES, "cloud.ply", "preview.png"}
    synced = [call.path for call in calls[:published] if call.name == "fsync"]
    assert {path.name for path in synced if path.parent == hidden} == (written - {"manifest.json"}) | {
        ".manifest.json.draft"
    }
    manifest = [k for k, call in enumerate(calls) if call.name == "rename" and call.target == hidden / "manifest.json"]
    assert hidden in [call.path for call in calls[manifest[-1] : published]], "the name of the last manifest"
    assert calls[published + 1 :] == [Call("fsync", tmp_path / "scans")]


def test_frames_that_wait_for_their_decision_are_on_the_disk_and_so_is_the_name_of_their_folder(
    tmp_path: Path, witness: Witness
) -> None:
    library = Library(tmp_path, LocalFileSystem())
    library.prepare()
    calls = witness(lambda: [library.begin(frames(), record(), ORIGIN)].clear())
    hidden = tmp_path / "scans" / ".000001"
    assert {path.name for path in hidden.iterdir()} == {"manifest.json", *RAW_FILES, *ORIGIN_FILES}
    synced = [call.path for call in calls if call.name == "fsync"]
    assert {hidden, *(hidden / name for name in (*RAW_FILES, *ORIGIN_FILES))} <= set(synced)
    assert synced[-1] == tmp_path / "scans"


def test_space_that_the_system_keeps_for_root_is_not_space_for_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1000 blocks are free, of which 950 are for root alone; a fragment has another size than the preferred block."""
    answer = os.statvfs_result((65536, 4096, 20_000, 1000, 50, 1000, 900, 900, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda path: answer)
    assert LocalFileSystem().free_bytes(tmp_path) == 50 * 4096
    monkeypatch.undo()
    assert LocalFileSystem().free_bytes(tmp_path) == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)


def test_a_folder_never_takes_the_place_of_an_empty_one_in_silence(tmp_path: Path) -> None:
    source, target = tmp_path / "one", tmp_path / "two"
    source.mkdir()
    (source / "frames").write_bytes(b"frames")
    target.mkdir()
    with pytest.raises(FileExistsError, match="two exists"):
        LocalFileSystem().rename(source, target)
    assert (source / "frames").read_bytes() == b"frames"
    assert list(target.iterdir()) == []
