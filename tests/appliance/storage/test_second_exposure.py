"""The frames of a second exposure come to those of the first; whatever fails, the first one is whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from appliance.storage.atomic import StorageError
from appliance.storage.library import Library
from tests.appliance.storage.scenes import ORIGIN, PREVIEW, BadDisk, cloud, frames, record, second_sequence

SECOND = second_sequence()
BOTH = replace(record(), second=SECOND)


def test_both_exposures_are_read_back_with_their_ledgers_and_verdicts(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    scan = library.begin(frames(1), record(), ORIGIN)
    scan.add_second(frames(2), BOTH)
    scan.publish(BOTH, cloud(), PREVIEW)
    assert library.verify(scan.scan_id).ok
    stored = library.load(scan.scan_id)
    assert stored.second is not None
    assert (stored.frames["right"] == frames(1)["right"]).all()
    assert (stored.second["right"] == frames(2)["right"]).all()
    assert stored.manifest.record.second == SECOND
    assert (stored.folder / "rig.toml").read_bytes() == ORIGIN.rig
    files = ["frames_left.npy", "frames_left_second.npy", "frames_right.npy", "frames_right_second.npy"]
    assert sorted(stored.manifest.frame_crc32) == files


def test_a_scan_of_one_exposure_has_no_second_one(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    scan = library.begin(frames(), record(), ORIGIN)
    scan.publish(record())
    assert library.load(scan.scan_id).second is None


def test_whichever_call_fails_the_first_exposure_is_whole_and_the_second_can_be_added_again(tmp_path: Path) -> None:
    disk = BadDisk()
    library = Library(tmp_path / "count", disk)
    Library(tmp_path / "count").prepare()
    scan = library.begin(frames(1), record(), ORIGIN)
    before = len(disk.calls)
    scan.add_second(frames(2), BOTH)
    calls = disk.calls[before:]
    assert len(calls) >= 6
    for k in range(len(calls)):
        root = tmp_path / str(k)
        Library(root).prepare()
        scan = Library(root, BadDisk(before + k)).begin(frames(1), record(), ORIGIN)
        with pytest.raises(StorageError):
            scan.add_second(frames(2), BOTH)
        if k % 2:  # the power fails as well
            fresh = Library(root)
            assert fresh.recover().recovered == (scan.scan_id,)
        else:
            scan.add_second(frames(2), BOTH)
            scan.publish(BOTH, cloud())
            fresh = Library(root)
            assert fresh.load(scan.scan_id).second is not None
        assert fresh.verify(scan.scan_id).ok, calls[k]
        assert (fresh.load(scan.scan_id).frames["left"] == frames(1)["left"]).all()


def test_after_a_loss_of_power_a_damaged_second_exposure_costs_only_itself(tmp_path: Path) -> None:
    library = Library(tmp_path)
    library.prepare()
    scan = library.begin(frames(1), record(), ORIGIN)
    scan.add_second(frames(2), BOTH)
    damaged = scan.folder / "frames_left_second.npy"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"\0")
    assert library.recover().recovered == (scan.scan_id,)
    stored = library.load(scan.scan_id)
    assert stored.second is None
    assert stored.manifest.record.second is None
    assert (stored.frames["left"] == frames(1)["left"]).all()
    assert sorted(path.name for path in stored.folder.glob("*second*")) == [
        "frames_left_second.npy.partial",
        "frames_right_second.npy.partial",
    ]
