"""Incomplete recordings: whole or not there, counted nowhere, never in the way of a scan, and refused by whoever wants a scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.store import incomplete
from appliance.store import scan as stored
from appliance.store.atomic import FileSystem, LocalFileSystem, StorageError
from appliance.store.incomplete import IncompleteRecording
from appliance.store.library import Library, LibraryFolder
from appliance.store.manifest import SequenceInfo
from appliance.store.scan import StoredScan
from tests.appliance.store.scenes import ORIGIN, BadDisk, SoFull, record

RECORD = record(sequence=SequenceInfo(16, 1024, 768, ("bright", "dark", "gray-x-0", "sine-x-0", "gray-y-0")))
REASON = "CAMERA_LOST: camera.left went away"
Frames = dict[str, NDArray[np.uint8]]


def frames(count: int = 4) -> Frames:
    chance = np.random.default_rng(0)
    return {side: chance.integers(0, 256, (count, 8, 10), np.uint8) for side in ("left", "right")}


def kept(root: Path, given: Frames | None = None, fs: FileSystem | None = None, reserve_bytes: int = 0) -> Path:
    root.mkdir(exist_ok=True)
    return IncompleteRecording.keep(
        fs or LocalFileSystem(), root, given or frames(), RECORD, ORIGIN, REASON, reserve_bytes
    )


def test_what_is_kept_is_read_back_with_what_is_missing_and_why_and_found_by_its_number(tmp_path: Path) -> None:
    folder = kept(tmp_path)
    assert folder == tmp_path / "incomplete" / "000001"
    found = IncompleteRecording.load(folder)
    assert found.missing == ("gray-y-0",)
    assert (found.scan.manifest.reason, found.scan.manifest.record) == (REASON, RECORD)
    for side, given in frames().items():
        np.testing.assert_array_equal(found.scan.frames[side], given)
    assert (folder / stored.CALIBRATION).read_bytes() == ORIGIN.calibration
    assert (folder / stored.RIG_FILE).read_bytes() == ORIGIN.rig
    assert kept(tmp_path).name == "000002"
    for other in ("incomplete/000000", "incomplete/.000001", "incomplete/00kept", "scans/000001"):
        (tmp_path / other).mkdir(parents=True)
    assert IncompleteRecording.find(tmp_path, "1") == folder
    for none in ("7", "../scans/000001", "000001/../000001", "kept", ".000001", ""):
        with pytest.raises(stored.ScanError, match="no incomplete recording"):
            IncompleteRecording.find(tmp_path, none)


def test_it_is_no_scan_for_anybody(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    folder = kept(tmp_path)
    assert (library.count(), library.ids()) == (0, [])
    assert all(library.entries(shelf) == [] for shelf in LibraryFolder)
    assert library.recover().set_aside == ()
    assert library.begin(frames(5), RECORD, ORIGIN).scan_id == "000001", "its number is none of the scans'"
    # This is what evaluate, calibrate and reconstruct ask first.
    with pytest.raises(stored.ScanError, match=r"incomplete scan cannot be used.*kingfisher cloud incomplete:N"):
        StoredScan.manifest_of(folder)


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
            assert IncompleteRecording.load(folder).missing == ("gray-y-0",)
        # Whatever was left is out of the way of the next one.
        assert IncompleteRecording.load(kept(root)).missing == ("gray-y-0",)
        assert list((root / "incomplete").glob(".*")) == []


def test_a_scan_that_may_come_goes_first_and_no_more_are_kept_than_so_many(tmp_path: Path) -> None:
    needed = stored.size_bytes(5, 10, 8) + 2 * 4 * 80 + 1_000_000
    with pytest.raises(StorageError, match="space"):
        kept(tmp_path, fs=SoFull(needed + 999), reserve_bytes=1000)
    assert list((tmp_path / "incomplete").iterdir()) == []
    kept(tmp_path, fs=SoFull(needed + 1000), reserve_bytes=1000)
    for number in range(2, incomplete.MOST + 1):
        (tmp_path / "incomplete" / f"{number:06d}").mkdir(parents=True)
    with pytest.raises(ValueError, match="50"):
        kept(tmp_path)


def test_a_whole_sequence_none_at_all_and_frames_of_different_patterns_are_not_kept(tmp_path: Path) -> None:
    for given in (frames(0), frames(5), frames(4) | {"right": frames(3)["right"]}):
        with pytest.raises(ValueError, match=r"incomplete recording|differ"):
            kept(tmp_path, given)


@pytest.mark.parametrize("name", ["frames_left.npy", "frames_right.npy", "incomplete.json"])
def test_a_flipped_byte_or_a_missing_file_is_noticed(tmp_path: Path, name: str) -> None:
    folder = kept(tmp_path)
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 4
    (folder / name).write_bytes(content)
    with pytest.raises(stored.ScanError, match=name):
        IncompleteRecording.load(folder)
    (folder / name).unlink()
    with pytest.raises(stored.ScanError, match="incomplete" if name.endswith("json") else name):
        IncompleteRecording.load(folder)
