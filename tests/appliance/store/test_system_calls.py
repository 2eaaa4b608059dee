"""What is made on the disk of this machine; what it refuses is told with a remedy, and leaves what was there."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from appliance.store import atomic
from appliance.store.atomic import LocalFileSystem, StorageError
from tests.appliance.store.scenes import BadDisk

FS = LocalFileSystem()


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
    (tmp_path / "other").mkdir()
    with pytest.raises(FileExistsError):  # POSIX would replace an empty folder in silence
        FS.rename(folder, tmp_path / "other")
    FS.remove(tmp_path / "other")
    for path in (folder, file, place):
        FS.remove(path)
    assert list(tmp_path.iterdir()) == []


def test_space_that_is_kept_for_root_is_not_space_for_scans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
            BadDisk(bad).replace_file(path, b"new content")
        assert path.read_bytes() in (b"old", b"new content")
        assert bad > 3 or [one.name for one in tmp_path.iterdir()] == ["choices.json"]
    atomic.draft_of(path).write_bytes(b"half of something that is much longer than this")
    FS.replace_file(path, b"old")  # an earlier attempt is no obstacle
    for error in (OSError(errno.ENOSPC, "full"), ValueError("no points")):

        def library(draft: Path, error: Exception = error) -> None:
            draft.write_bytes(b"ne")
            raise error

        with pytest.raises(StorageError if isinstance(error, OSError) else ValueError):
            FS.replace_by(path, library)
    FS.replace_file(path, b"o", b"ld")
    assert {one.name: one.read_bytes() for one in tmp_path.iterdir()} == {"choices.json": b"old"}
    FS.discard(tmp_path / "none")
    with pytest.raises(StorageError):
        BadDisk(0).discard(path)


def test_a_file_in_several_parts_has_the_length_and_checksum_that_are_found_on_the_disk(tmp_path: Path) -> None:
    parts = (b"head", bytes(range(256)) * 40_000, memoryview(b"tail"))  # more than two blocks of 4 MiB
    stamp = FS.write_new(tmp_path / "file", parts)
    assert stamp == atomic.checked_stamp(tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == b"".join(parts)
    with pytest.raises(StorageError):
        FS.write_new(tmp_path / "file", (b"another",))
    assert (tmp_path / "file").stat().st_size == stamp.length, "what was there is not written over"


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "full"), (errno.EDQUOT, "quota"), (errno.EROFS, "read-only"), (errno.EACCES, "this user has no permission"), (errno.EPERM, "this user has no permission"),
        (errno.ENOENT, "does not exist"), (errno.ENOTDIR, "is a file"), (errno.EISDIR, "is a folder"), (errno.ENAMETOOLONG, "too long"),
        (errno.EIO, "the disk fails"), (errno.EMFILE, "too many files"), (errno.EXDEV, "replace the disk"), (None, "replace the disk"),
    ],
)  # fmt: skip
def test_every_refusal_names_the_path_the_reason_and_its_own_remedy(number: int | None, remedy: str) -> None:
    raised = OSError("said in words") if number is None else OSError(number, os.strerror(number))
    assert remedy in StorageError.of("cannot write", Path("x"), raised).remedy
    with pytest.raises(StorageError) as error, StorageError.naming("cannot write", Path("/somewhere/x")):
        raise raised
    assert (error.value.path, error.value.reason) == (Path("/somewhere/x"), raised.strerror or "said in words")
    assert str(error.value) == f"cannot write /somewhere/x: {error.value.reason}; {error.value.remedy}"
    assert error.value.is_full is (number in (errno.ENOSPC, errno.EDQUOT))
    assert error.value.is_read_only is (number == errno.EROFS)
