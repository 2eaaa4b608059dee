"""Packed scans: the same bytes come back, a damaged one is found, and no source goes that was not compared."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from appliance.store import archive, packed
from appliance.store import label as labels
from appliance.store import scan as stored
from appliance.store.archive import CopyOutcome, pack_scan, problems_of, remove_source, unpack_scan
from appliance.store.atomic import FileSystem, LocalFileSystem, StorageError
from appliance.store.damage import damaged_frames, frames_as_they_are
from appliance.store.library import Library, LibraryFolder, ScanEntry
from appliance.store.manifest import Decision
from appliance.store.scan import ScanError, StoredScan
from tests.appliance.store.scenes import FRAMES, ORIGIN, PREVIEW, BadDisk, cloud, frames, record, second_sequence

FS = LocalFileSystem()
SCANS = (LibraryFolder.SCANS,)
JLS = "frames_left.npy.jls"


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scan of one exposure, and no more files than it needs."""
    folder = tmp_path / "from" / "scans" / "000001"
    folder.parent.mkdir(parents=True)
    stored.write_raw(FS, folder, "000001", frames(), record(), ORIGIN)
    return folder


@pytest.fixture
def source(small: Path) -> Path:
    """A complete scan with both exposures."""
    told = record(second=second_sequence())
    both = stored.add_second(FS, small, StoredScan.manifest_of(small), frames(1), told)
    stored.finish_scan(FS, small, both, Decision.KEPT, told, cloud(), PREVIEW)
    labels.Label("bollard 3").write(FS, small)
    return small


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """A folder in which the packed scan is to lie."""
    archive.make_scan_folders(FS, tmp_path / "archive", SCANS)
    return tmp_path / "archive" / "scans" / "000001"


@pytest.fixture
def there(source: Path, target: Path) -> Path:
    """The packed scan."""
    pack_scan(FS, source, target)
    return target


def moved(fs: FileSystem, source: Path, target: Path) -> None:
    pack_scan(fs, source, target)
    remove_source(fs, source, target)


def flip(path: Path, at: int) -> None:
    data = bytearray(path.read_bytes())
    data[at] ^= 0x10
    path.write_bytes(data)


def test_a_packed_scan_is_opened_as_it_was_and_comes_back(source: Path, target: Path, tmp_path: Path) -> None:
    before, plain = content(source), StoredScan.load(source)
    assert pack_scan(FS, source, target) is CopyOutcome.WRITTEN
    assert content(source) == before, "the source is only read"
    opened = StoredScan.load(target)
    assert opened.manifest == plain.manifest == Library(target.parent.parent).load("1").manifest
    assert opened.second is not None
    for side in ("left", "right"):
        assert np.array_equal(opened.frames[side], frames()[side])
        assert np.array_equal(opened.second[side], frames(1)[side])
        # Kernels are compiled for arrays that can be written, and for no others.
        assert opened.frames[side].flags.writeable
        assert opened.frames[side].flags.c_contiguous
    assert ScanEntry.of(target, checksums=True).ok
    assert not list(target.glob("*.npy")), "reading leaves nothing"
    archive.make_scan_folders(FS, tmp_path / "back", SCANS)
    back = tmp_path / "back" / "scans" / "000001"
    assert unpack_scan(FS, target, back) is CopyOutcome.WRITTEN
    assert content(back) == before


def test_smooth_pictures_take_less_room_and_scans_come_by_their_numbers(tmp_path: Path) -> None:
    v, u = np.mgrid[0:60, 0:80]
    smooth = np.stack([(u + k * v) // 2 % 200 for k in range(FRAMES)]).astype(np.uint8)
    folder = tmp_path / "000001"
    stored.write_raw(FS, folder, "000001", {"left": smooth, "right": smooth}, record(), ORIGIN)
    pack_scan(FS, folder, tmp_path / "000002")
    assert (tmp_path / "000002" / JLS).stat().st_size < (folder / "frames_left.npy").stat().st_size / 3
    names = ["000002", "000010", "000010-2", "999999", "1000000", "10000000"]
    for name in reversed(names):
        (tmp_path / "scans" / name).mkdir(parents=True)
    assert [one.name for one in Library(tmp_path).folders(every=False)] == names


def test_one_frame_is_read_although_all_others_are_destroyed(source: Path, there: Path) -> None:
    index = packed.read_index(there / JLS)
    data = bytearray((there / JLS).read_bytes())
    for other in (0, 2):
        start, end = index.offsets[other : other + 2]
        data[start:end] = bytes(end - start)
    (there / JLS).write_bytes(data)
    assert np.array_equal(StoredScan.read_frame(there, "left", 1), frames()["left"][1])
    assert np.array_equal(StoredScan.read_frame(source, "left", 1), frames()["left"][1])
    assert np.array_equal(StoredScan.read_frame(there, "right", 1, second=True), frames(1)["right"][1])
    for k in (0, 2, FRAMES):
        with pytest.raises(ScanError, match=str(k)):
            StoredScan.read_frame(there, "left", k)
    flip(source / "frames_left.npy", 128 + 5)
    with pytest.raises(ScanError, match="frame bright"):
        StoredScan.read_frame(source, "left", 0)


def test_every_flipped_byte_and_every_cut_of_a_packed_file_is_found(there: Path) -> None:
    good = (there / JLS).read_bytes()
    manifest = StoredScan.manifest_of(there)
    assert stored.wrong_files(there, manifest, checksums=True) == problems_of(there) == {}
    for at in (*range(0, len(good), 3), len(good) - 1):
        flip(there / JLS, at)
        assert list(stored.wrong_files(there, manifest, checksums=True)) == ["frames_left.npy"], at
        (there / JLS).write_bytes(good)
    for length in (0, 5, 11, 40, -1):
        (there / JLS).write_bytes(good[:length])
        assert "frames_left.npy" in stored.wrong_files(there, manifest, checksums=False)
        with pytest.raises(ScanError, match=r"frames_left\.npy"):
            StoredScan.load(there)


def test_verifying_believes_neither_file_nor_checksum(source: Path, there: Path, tmp_path: Path) -> None:
    """As a codec would that is not lossless: everything about the file fits but what it decodes to."""
    stored.write_raw(FS, tmp_path / "000007", "000007", frames(9), record(), ORIGIN)
    pack_scan(FS, tmp_path / "000007", tmp_path / "000008")
    index = packed.read_index(there / JLS)
    (there / JLS).write_bytes((tmp_path / "000008" / JLS).read_bytes())
    assert set(problems_of(there)) == {"frames_left.npy"}
    wrong = np.array(frames()["left"])
    wrong[1, 0, 0] ^= 1
    (there / JLS).write_bytes(b"".join(packed.pack(index.header, wrong, index.stamp, JLS)))
    assert stored.wrong_files(there, StoredScan.manifest_of(there), checksums=True) == {}
    assert set(problems_of(there)) == {"frames_left.npy"}
    with pytest.raises(ScanError, match="nothing is removed"):
        remove_source(FS, source, there)
    assert source.is_dir()


def test_a_damaged_frame_is_named_and_the_others_are_left(there: Path) -> None:
    index = packed.read_index(there / JLS)
    flip(there / JLS, (index.offsets[1] + index.offsets[2]) // 2)
    manifest = StoredScan.manifest_of(there)
    (found,) = damaged_frames(there, manifest)
    assert (found.file, found.frames) == ("frames_left.npy", (1,))
    left = frames_as_they_are(there, manifest, "frames_left.npy")
    assert [np.array_equal(left[k], frames()["left"][k]) for k in range(FRAMES)] == [True, False, True]
    flip(there / JLS, 0)  # the index is gone
    assert damaged_frames(there, manifest)[0].frames == tuple(range(FRAMES))


def test_an_index_that_says_nonsense_is_refused(there: Path) -> None:
    data = (there / JLS).read_bytes()
    length = int.from_bytes(data[8:12], "little")
    changes: tuple[dict[str, object], ...] = (
        {"height_px": 0}, {"height_px": 70_000}, {"width_px": "10"}, {"streams": []}, {"streams": [1, 2]}, {"crc32": [1, 2, 3]}, {"stream_crc32": []},
        {"length": 10**15}, {"header_bytes": 10**9}, {"sha256": None}, {"streams": [10**12, 1, 1]},
    )  # fmt: skip
    for change in changes:
        text = json.dumps({**json.loads(data[12 : 12 + length]), **change}).encode()
        (there / JLS).write_bytes(data[:8] + len(text).to_bytes(4, "little") + text + data[12 + length :])
        with pytest.raises(packed.PackedError, match="index"):
            packed.read_index(there / JLS)


def taller_stream(data: bytes, index: packed.PackedFile) -> bytes:
    """The codec believes the size in a stream's own head, and takes gigabytes and minutes for a damaged one."""
    head = data.index(b"\xff\xf7\x00\x0b\x08", index.offsets[1])  # start of frame, 8 bits; then the height
    assert data[head + 5 : head + 7] == b"\x00\x08"
    return data[: head + 6] + b"\x09" + data[head + 7 :]


def other_pixels(data: bytes, index: packed.PackedFile) -> bytes:
    return data.replace(index.crc32[1].encode(), f"{int(index.crc32[1], 16) ^ 1:08x}".encode())


@pytest.mark.parametrize(("spoil", "said"), [(taller_stream, "damaged"), (other_pixels, "different pixels")])
def test_a_damaged_stream_has_no_pixels(
    there: Path, spoil: Callable[[bytes, packed.PackedFile], bytes], said: str
) -> None:
    (there / JLS).write_bytes(spoil((there / JLS).read_bytes(), packed.read_index(there / JLS)))
    with pytest.raises(ScanError, match=f"frame 1 .*{said}"):
        StoredScan.read_frame(there, "left", 1)


def test_a_damaged_source_and_a_scan_of_a_taken_number_stay(source: Path, target: Path, tmp_path: Path) -> None:
    good = (source / "frames_right.npy").read_bytes()
    flip(source / "frames_right.npy", 200)
    with pytest.raises(ScanError, match=r"frames_right\.npy"):
        pack_scan(FS, source, target)
    assert not target.exists()
    (source / "frames_right.npy").write_bytes(good)
    pack_scan(FS, source, target)
    stored.write_raw(FS, tmp_path / "000001", "000001", frames(9), record(), ORIGIN)
    with pytest.raises(ScanError, match="another scan"):
        pack_scan(FS, tmp_path / "000001", target)
    (target / JLS).write_bytes((target / JLS).read_bytes()[:-1])
    with pytest.raises(ScanError, match="move it away"):
        pack_scan(FS, source, target)


def test_packing_again_adds_a_label_and_replaces_none(source: Path, target: Path) -> None:
    label = (source / labels.LABEL_FILE).read_bytes()
    (source / labels.LABEL_FILE).unlink()
    pack_scan(FS, source, target)
    (source / labels.LABEL_FILE).write_bytes(label)
    assert pack_scan(FS, source, target) is CopyOutcome.ALREADY
    assert labels.Label.read(target).name == "bollard 3"
    before = content(target)
    assert pack_scan(FS, source, target) is CopyOutcome.ALREADY
    labels.Label("bollard 4").write(FS, source)
    with pytest.raises(ScanError, match=r"label\.json"):
        pack_scan(FS, source, target)
    assert content(target) == before, "people name scans in an archive, too"


def test_packing_that_is_refused_at_any_call_leaves_no_half_scan(small: Path, target: Path, tmp_path: Path) -> None:
    """The disk refuses at each call in turn, packing and removing; afterwards everything is there once, and the next try ends well."""
    before, counting = content(small), BadDisk()
    moved(counting, small, tmp_path / "counted")
    calls = len(counting.calls)
    assert calls > 25
    for bad in range(calls):
        small.mkdir()
        for name, data in before.items():
            (small / name).write_bytes(data)
        with pytest.raises(StorageError):
            moved(BadDisk(bad, error=errno.ENOSPC), small, target)
        assert small.exists() or target.exists(), f"removed without a copy at call {bad}"
        if small.exists():
            assert content(small) == before, f"half a source after call {bad}"
        if target.exists():
            assert problems_of(target) == {}, f"half a scan after call {bad}"
        archive.make_scan_folders(FS, target.parent.parent, SCANS)
        archive.finish_removals(FS, small.parent.parent, SCANS)
        assert {path.name for path in target.parent.iterdir()} <= {"000001"}
        if small.exists():
            moved(FS, small, target)
        assert list(small.parent.iterdir()) == []
        assert problems_of(target) == {}
        FS.remove_folder(target)


def test_no_source_is_removed_whose_copy_lacks_a_byte(source: Path, there: Path) -> None:
    for name in ("cloud.ply", "label.json", "manifest.json", "calibration.json"):
        data = (there / name).read_bytes()
        (there / name).write_bytes(data[:-1])
        with pytest.raises(ScanError, match="nothing is removed"):
            remove_source(FS, source, there)
        (there / name).unlink()
        with pytest.raises(ScanError, match="nothing is removed"):
            remove_source(FS, source, there)
        (there / name).write_bytes(data)
    assert source.is_dir()


def a_folder(path: Path) -> None:
    path.mkdir()
    (path / "log.txt").write_text("north side")


@pytest.mark.parametrize("make", [a_folder, Path.mkdir, lambda path: path.symlink_to("/tmp"), os.mkfifo])
def test_a_source_with_what_is_no_file_in_it_stays(source: Path, there: Path, make: Callable[[Path], None]) -> None:
    make(source / "notes")
    before = sorted(source.iterdir())
    for work in (pack_scan, remove_source):
        with pytest.raises(ScanError, match="notes"):
            work(FS, source, there)
    assert sorted(source.iterdir()) == before
    assert list(source.parent.iterdir()) == [source]


def test_a_file_that_came_while_a_source_was_compared_is_not_removed_with_it(source: Path, there: Path) -> None:
    class Late(LocalFileSystem):
        """Somebody writes a note in the moment in which the compared source gets its hidden name."""

        def rename(self, source: Path, target: Path) -> None:
            if target.name.startswith("."):
                (source / "note.txt").write_text("wait")
            super().rename(source, target)

    with pytest.raises(ScanError, match="nothing is removed"):
        remove_source(Late(), source, there)
    assert (source / "note.txt").read_text() == "wait"
    assert stored.wrong_files(source, StoredScan.manifest_of(source), checksums=True) == {}
