"""Incomplete recordings: whole or not there, counted nowhere, never in the way of a scan, and refused by whoever wants a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.storage import incomplete
from appliance.storage import scan as stored
from appliance.storage.atomic import StorageError
from appliance.storage.filesystem import FileSystem, LocalFileSystem
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.record import ScanRecord, SequenceInfo
from tests.appliance.storage.scenes import ORIGIN, BadDisk, record

PATTERNS = ("bright", "dark", "gray-x-0", "sine-x-0", "gray-y-0")
REASON = "CAMERA_LOST: camera.left went away"


def frames(count: int = 4, seed: int = 0) -> dict[str, NDArray[np.uint8]]:
    chance = np.random.default_rng(seed)
    return {side: chance.integers(0, 256, (count, 8, 10), np.uint8) for side in ("left", "right")}


def of(patterns: tuple[str, ...] = PATTERNS) -> ScanRecord:
    return record(sequence=SequenceInfo(16, 1024, 768, patterns))


def kept(root: Path, count: int = 4, fs: FileSystem | None = None, reserve_bytes: int = 0) -> Path:
    return incomplete.keep(fs or LocalFileSystem(), root, frames(count), of(), ORIGIN, REASON, reserve_bytes)


def test_what_is_kept_is_read_back_with_what_is_missing_and_why(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    assert folder == tmp_path / "incomplete" / "000001"
    found = incomplete.load(folder)
    assert found.missing == ("gray-y-0",)
    assert found.scan.manifest.reason == REASON
    assert found.scan.manifest.record == of()
    for side, given in frames().items():
        np.testing.assert_array_equal(found.scan.frames[side], given)
    assert (folder / stored.CALIBRATION).read_bytes() == ORIGIN.calibration
    assert (folder / stored.RIG).read_bytes() == ORIGIN.rig
    assert kept(tmp_path).name == "000002"
    assert incomplete.find(tmp_path, "2").name == "000002"


def test_it_is_no_scan_for_anybody(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    folder = kept(tmp_path)
    assert (library.count(), library.ids(), library.newest_first()) == (0, [], [])
    assert all(library.entries(shelf) == [] for shelf in LibraryFolder)
    assert library.recover().set_aside == ()
    pending = library.begin(frames(5), of(), ORIGIN)
    assert pending.scan_id == "000001", "its number is none of the scans'"
    # This is what evaluate, calibrate and reconstruct ask first.
    with pytest.raises(stored.ScanError, match=r"incomplete recording is no scan, .* evaluated .* `kingfisher rescue`"):
        stored.manifest_of(folder)


@pytest.mark.parametrize("for_calls", [1, 99])
def test_a_disk_that_fails_at_any_call_leaves_all_or_nothing(tmp_path: Path, for_calls: int) -> None:
    counting = BadDisk()
    kept(tmp_path / "whole", fs=counting)
    assert len(counting.calls) > 15
    for call in range(len(counting.calls)):
        root = tmp_path / f"{call}"
        with pytest.raises(StorageError):
            kept(root, fs=BadDisk(call, for_calls))
        for folder in (root / "incomplete").glob("[0-9]*"):
            assert incomplete.load(folder).missing == ("gray-y-0",)
        # Whatever was left is out of the way of the next one.
        after = kept(root)
        assert incomplete.load(after).missing == ("gray-y-0",)
        assert list((root / "incomplete").glob(".*")) == []


@pytest.fixture(autouse=True)
def roots(tmp_path: Path) -> None:
    """Storage roots are there before anything is kept in them."""
    for name in ("whole", *map(str, range(60))):
        (tmp_path / name).mkdir()


class SoFull(LocalFileSystem):
    def __init__(self, free: int) -> None:
        self.free = free

    def free_bytes(self, path: Path) -> int:
        return self.free


def test_a_scan_that_may_come_goes_first(tmp_path: Path) -> None:
    needed = stored.size_bytes(5, 10, 8) + 2 * 4 * 80 + 1_000_000
    with pytest.raises(StorageError, match="no room for the next scan"):
        kept(tmp_path, fs=SoFull(needed + 999), reserve_bytes=1000)
    assert list((tmp_path / "incomplete").iterdir()) == []
    kept(tmp_path, fs=SoFull(needed + 1000), reserve_bytes=1000)


def test_no_more_than_so_many(tmp_path: Path) -> None:
    for number in range(1, incomplete.MOST + 1):
        (tmp_path / "incomplete" / f"{number:06d}").mkdir(parents=True)
    with pytest.raises(ValueError, match="has 50 recordings already"):
        kept(tmp_path)


@pytest.mark.parametrize("count", [0, 5])
def test_a_whole_sequence_and_none_at_all_are_not_incomplete(tmp_path: Path, count: int) -> None:
    with pytest.raises(ValueError, match="are no incomplete recording"):
        kept(tmp_path, count)


def test_frames_of_different_patterns_are_refused(tmp_path: Path) -> None:
    given = frames(4) | {"right": frames(3)["right"]}
    with pytest.raises(ValueError, match="left and right frames differ"):
        incomplete.keep(LocalFileSystem(), tmp_path, given, of(), ORIGIN, REASON, 0)


@pytest.mark.parametrize("name", ["frames_left.npy", "frames_right.npy", "incomplete.json"])
def test_a_flipped_byte_is_noticed(tmp_path: Path, name: str) -> None:
    folder = kept(tmp_path)
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 4
    (folder / name).write_bytes(content)
    with pytest.raises(stored.ScanError, match=name):
        incomplete.load(folder)


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(stored.ScanError, match="no incomplete recording '7'"):
        incomplete.find(tmp_path, "7")
    with pytest.raises(stored.ScanError, match="not an incomplete recording"):
        incomplete.load(tmp_path)
    folder = kept(tmp_path)
    (folder / "frames_left.npy").unlink()
    with pytest.raises(stored.ScanError, match=r"frames_left\.npy: No such file"):
        incomplete.load(folder)
