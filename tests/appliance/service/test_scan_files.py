"""What the disk refuses once is written at the next attempt: no scan that is shown as saved lacks an exposure."""

from __future__ import annotations

import errno
from pathlib import Path

import numpy as np
import pytest

from appliance.capture.store import FrameStore
from appliance.machine import events as on
from appliance.scan.exposure import Exposure
from appliance.service.room import ScanRoom
from appliance.service.scan_files import ScanFiles
from appliance.service.scan_in_memory import ScanInMemory, SecondInMemory
from appliance.storage.library import Library
from tests.appliance.storage.scenes import FRAMES, ORIGIN, BadDisk, frames, record, second_sequence
from tests.drivers.clock import SteppedClock


@pytest.mark.parametrize("refused", ["create frames_left_second.npy", "sync frames_right_second.npy"])
def test_a_second_exposure_that_the_disk_refused_once_is_written_when_the_scan_is_saved(
    tmp_path: Path, refused: str
) -> None:
    counting = BadDisk()
    _save(tmp_path / "counted", counting)
    disk = BadDisk(counting.calls.index(refused), error=errno.EIO)
    first, saved = _save(tmp_path / "refused", disk)
    assert [type(event) for event in first[:1]] == [on.SaveFailed]
    assert [type(event) for event in saved[:1]] == [on.Saved]
    library = Library(tmp_path / "refused")
    (entry,) = library.entries()
    assert library.verify(entry.scan_id).ok
    second = library.load(entry.scan_id).second
    assert second is not None
    assert all(np.array_equal(second[side], frames(1)[side]) for side in ("left", "right"))


def _save(root: Path, disk: BadDisk) -> tuple[list[on.Event], list[on.Event]]:
    """Answers of a second exposure's own writing, and of publishing afterwards."""
    library, clock = Library(root, disk), SteppedClock()
    library.prepare()
    with FrameStore(FRAMES, 8, 10, sequences=2) as store:
        for side in ("left", "right"):
            store.frames(side)[:] = frames(0)[side]
            store.frames(side, second=True)[:] = frames(1)[side]
        files = ScanFiles(library, ScanRoom(library, None, 0, clock), store, clock)
        scan = ScanInMemory(1, clock.now_ns(), Exposure(2000), ORIGIN, record=record())
        scan.pending = library.begin(frames(0), record(), ORIGIN)
        scan.second = SecondInMemory(2, clock.now_ns(), Exposure(14_000), second_sequence(), merged=True)
        return files.store_second(scan), files.publish(scan, None)
