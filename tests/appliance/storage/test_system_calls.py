"""The disk of this machine is really asked to keep what was written, at the right moments; what it refuses is told with a remedy."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from appliance.storage.atomic import (
    StorageError,
    checked_stamp,
    discard,
    draft_of,
    move_folder,
    refused,
    remedy_for,
    replace_by,
    replace_file,
    write_new,
)
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library
from appliance.storage.room import Room, is_full, is_read_only
from appliance.storage.scan import ORIGIN_FILES, RAW_FILES
from tests.appliance.storage.scenes import ORIGIN, PLAN, PREVIEW, BadDisk, cloud, frames, record
from tests.support.system_calls import Call, seen_by_python, seen_by_the_kernel

FS = LocalFileSystem()
Witness = Callable[[Callable[[], object]], list[Call]]


@pytest.fixture(params=[seen_by_the_kernel, seen_by_python])
def witness(request: pytest.FixtureRequest) -> Witness:
    chosen: Witness = request.param
    return chosen


def test_each_way_to_write_syncs_the_file_and_the_folder_that_names_it(tmp_path: Path, witness: Witness) -> None:
    new, cloud_file, draft, place = (tmp_path / name for name in ("new", "cloud", ".cloud.draft", "place"))
    assert witness(lambda: write_new(FS, new, [b"content"])) == [Call("fsync", new)]
    cloud_file.write_bytes(b"of before")
    calls = witness(lambda: replace_file(FS, cloud_file, b"old"))
    assert calls == [Call("fsync", draft), Call("rename", draft, cloud_file), Call("fsync", tmp_path)]

    def library(path: Path) -> None:
        path.write_bytes(b"new")
        assert cloud_file.read_bytes() == b"old"

    calls = witness(lambda: replace_by(FS, cloud_file, library))
    assert [call for call in calls if call.name == "fsync"] == [Call("fsync", draft), Call("fsync", tmp_path)]
    assert (cloud_file.read_bytes(), draft.exists()) == (b"new", False)
    FS.allocate(place, 4096)

    def reopened() -> None:
        file = FS.reopen(place)
        file.write(b"short")
        file.sync()
        file.close()

    assert witness(reopened) == [Call("fsync", place)]
    assert place.read_bytes() == b"short", "at its new length"


def test_a_folder_is_moved_with_its_names_on_the_disk_and_both_parents_follow(tmp_path: Path, witness: Witness) -> None:
    source, target = tmp_path / "scans" / ".1", tmp_path / "rejected" / "1"
    source.mkdir(parents=True)
    target.parent.mkdir()
    calls = witness(lambda: move_folder(FS, source, target))
    assert calls[:2] == [Call("fsync", source), Call("rename", source, target)]
    assert set(calls[2:]) == {Call("fsync", target.parent), Call("fsync", source.parent)}
    disk, beside = BadDisk(), target.with_name("2")
    move_folder(disk, target, beside)
    assert disk.calls == ["sync_folder 1", "rename 1 2", "sync_folder rejected"], "one parent is synced once"
    target.mkdir()
    with pytest.raises(FileExistsError):  # POSIX would replace an empty folder in silence
        FS.rename(beside, target)
    assert beside.exists()


@pytest.mark.parametrize("allocated", [False, True])
def test_nothing_of_a_saved_scan_is_left_to_the_page_cache(tmp_path: Path, witness: Witness, allocated: bool) -> None:
    """When a name appears in a list of scans, every byte and every name below it has been synced before; then that name is."""
    fs = Room(tmp_path, FS) if allocated else FS
    library = Library(tmp_path, fs)
    library.prepare()
    if isinstance(fs, Room):
        fs.hold(PLAN)
    hidden, shown = tmp_path / "scans" / ".000001", tmp_path / "scans" / "000001"
    raw = {"manifest.json", *RAW_FILES, *ORIGIN_FILES}
    begun = []
    before = witness(lambda: begun.append(library.begin(frames(), record(), ORIGIN)))
    synced = [call.path for call in before if call.name == "fsync"]
    assert {path.name for path in hidden.iterdir()} == raw
    assert {hidden, *(hidden / name for name in raw - {"manifest.json"})} <= set(synced), "before the decision"
    assert synced[-1] == tmp_path / "scans"
    calls = witness(lambda: begun[0].publish(record(), cloud(), PREVIEW))
    assert {path.name for path in shown.iterdir()} == raw | {"cloud.ply", "preview.png"}
    published = calls.index(Call("rename", hidden, shown))
    synced = [call.path for call in calls[:published] if call.name == "fsync"]
    assert {hidden / name for name in ("cloud.ply", "preview.png", ".manifest.json.draft")} <= set(synced)
    manifest = [k for k, call in enumerate(calls) if call.name == "rename" and call.target == hidden / "manifest.json"]
    assert hidden in [call.path for call in calls[manifest[-1] : published]], "the name of the last manifest"
    assert calls[published + 1 :] == [Call("fsync", tmp_path / "scans")]


# --------------------------------------------------------------------------------- what is made, and what is refused


@pytest.fixture
def open_umask() -> Iterator[None]:
    before = os.umask(0)
    yield
    os.umask(before)


@pytest.mark.usefixtures("open_umask")
def test_what_is_made_may_be_read_by_all_takes_its_place_and_is_made_once(tmp_path: Path) -> None:
    folder, file, place = (tmp_path / name for name in ("folder", "file", "place"))
    FS.make_folder(folder)
    FS.create(file).close()
    FS.allocate(place, 100_000)
    assert [path.stat().st_mode & 0o777 for path in (folder, file, place)] == [0o755, 0o644, 0o644]
    assert (place.stat().st_size, place.stat().st_blocks * 512 >= 100_000) == (100_000, True)
    for make in (FS.create, lambda path: FS.allocate(path, 9), FS.make_folder):
        with pytest.raises(FileExistsError):
            make(file)
    with pytest.raises(OSError, match="not empty"):
        FS.remove(tmp_path)
    for path in (folder, file, place):
        FS.remove(path)
    assert list(tmp_path.iterdir()) == []


def test_space_that_the_system_keeps_for_root_is_not_space_for_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1000 blocks are free, of which 950 are for root alone; a fragment has another size than the preferred block."""
    answer = os.statvfs_result((65536, 4096, 20_000, 1000, 50, 1000, 900, 900, 0, 255))
    with monkeypatch.context() as patched:
        patched.setattr(os, "statvfs", lambda path: answer)
        assert FS.free_bytes(tmp_path) == 50 * 4096
    assert FS.free_bytes(tmp_path) == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.05)


def test_a_file_that_could_not_be_written_leaves_no_draft_and_the_old_content(tmp_path: Path) -> None:
    path = tmp_path / "choices.json"
    path.write_bytes(b"old")
    for bad in range(6):
        with pytest.raises(StorageError, match=r"choices\.json|cannot make durable"):
            replace_file(BadDisk(bad), path, b"new content")
        assert path.read_bytes() in (b"old", b"new content")
        assert bad > 3 or [one.name for one in tmp_path.iterdir()] == ["choices.json"]
    draft_of(path).write_bytes(b"half of something that is much longer than this")
    replace_file(FS, path, b"old")  # an earlier attempt is no obstacle
    for error in (OSError(errno.ENOSPC, "full"), ValueError("no points")):

        def library(draft: Path, error: Exception = error) -> None:
            draft.write_bytes(b"ne")
            raise error

        with pytest.raises(StorageError if isinstance(error, OSError) else ValueError):
            replace_by(FS, path, library)
    replace_file(FS, path, b"o", b"ld")
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"choices.json": b"old"}
    discard(FS, tmp_path / "none")
    with pytest.raises(StorageError):
        discard(BadDisk(0), path)


def test_a_file_in_several_parts_has_the_length_and_checksum_that_are_found_on_the_disk(tmp_path: Path) -> None:
    parts = (b"head", bytes(range(256)) * 40_000, memoryview(b"tail"))  # more than two blocks of 4 MiB
    stamp = write_new(FS, tmp_path / "file", parts)
    assert stamp == checked_stamp(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"".join(parts)
    with pytest.raises(StorageError):
        write_new(FS, tmp_path / "file", (b"another",))
    assert (tmp_path / "file").stat().st_size == stamp.length, "what was there is not written over"


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "full"), (errno.EDQUOT, "share"), (errno.EROFS, "reading only"), (errno.EACCES, "this user may not"), (errno.EPERM, "this user may not"),
        (errno.ENOENT, "does not exist"), (errno.ENOTDIR, "is a file"), (errno.EISDIR, "is a folder"), (errno.ENAMETOOLONG, "too long"),
        (errno.EIO, "the disk fails"), (errno.EMFILE, "too many files"), (errno.EXDEV, "replace the disk"), (None, "replace the disk"),
    ],
)  # fmt: skip
def test_every_refusal_names_the_path_the_reason_and_its_own_remedy(number: int | None, remedy: str) -> None:
    raised = OSError("said in words") if number is None else OSError(number, os.strerror(number))
    assert remedy in remedy_for(raised)
    with pytest.raises(StorageError) as error, refused("cannot write", Path("/somewhere/x")):
        raise raised
    assert (error.value.path, error.value.reason) == (Path("/somewhere/x"), raised.strerror or "said in words")
    assert str(error.value) == f"cannot write /somewhere/x: {error.value.reason}; {error.value.remedy}"
    assert is_full(error.value) is (number in (errno.ENOSPC, errno.EDQUOT))
    assert is_read_only(error.value) is (number == errno.EROFS)
