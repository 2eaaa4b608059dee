"""The gallery shows what lies on the disk, marks what is damaged, and never keeps the screen waiting."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.machine import events as on
from appliance.scan.grade import LENGTHS_DOUBTFUL, NAME, Grade
from appliance.scan.verdict import Verdict
from appliance.service.gallery import GalleryController, read
from appliance.storage.library import Library
from tests.appliance.storage.scenes import ORIGIN, cloud, frames, record

PICTURE = np.arange(40 * 60 * 3, dtype=np.uint8).reshape(40, 60, 3)
NUMBERS = {"points": 20, "coverage_percent": 81.5, "noise_mm": 0.03, "distance_mm": 512.0}


def saved(library: Library, grade: str = "usable", clock_trusted: bool = True) -> str:
    """A kept scan with a preview."""
    _, png = cv2.imencode(".png", cv2.cvtColor(PICTURE, cv2.COLOR_RGB2BGR))
    said = replace(record(cloud=NUMBERS), clock_trusted=clock_trusted, verdicts=(Verdict(NAME, True, {}, grade),))
    pending = library.begin(frames(), said, ORIGIN)
    pending.publish(said, cloud(), png.tobytes())
    return pending.scan_id


@pytest.fixture
def library(tmp_path: Path) -> Library:
    library = Library(tmp_path / "storage")
    library.prepare()
    return library


def test_a_scan_is_shown_as_it_was_judged_when_it_was_taken(library: Library) -> None:
    assert read(library, saved(library, clock_trusted=False)).taken is None, "a date that cannot be believed"
    shown = read(library, saved(library))
    assert shown.taken is not None
    assert (shown.grade, shown.damaged) == (Grade.USABLE, False)
    assert (shown.points, shown.coverage_percent, shown.distance_mm) == (20, 81.5, 512.0)
    np.testing.assert_array_equal(shown.preview, PICTURE)


@pytest.mark.parametrize("doubtful", [1.0, None])
def test_lengths_are_doubtful_where_the_diver_was_told_so(library: Library, doubtful: float | None) -> None:
    numbers = {} if doubtful is None else {LENGTHS_DOUBTFUL: doubtful}
    said = replace(record(cloud=NUMBERS), verdicts=(Verdict(NAME, True, numbers, "good"),))
    pending = library.begin(frames(), said, ORIGIN)
    pending.publish(said, cloud(), None)
    shown = read(library, pending.scan_id)
    assert shown.lengths_doubtful is (doubtful == 1.0)
    assert (shown.preview, shown.damaged, shown.noise_mm, shown.corrected) == (None, False, 0.03, False)


@pytest.mark.parametrize("name", ["preview.png", "manifest.json", "cloud.ply"])
def test_whatever_is_cut_short_is_marked_and_the_others_are_fine(library: Library, name: str) -> None:
    damaged, fine = saved(library), saved(library)
    path = library.entry(damaged).folder / name
    path.write_bytes(path.read_bytes()[:-7])
    assert read(library, damaged).damaged
    assert not read(library, fine).damaged
    assert read(library, "000099").damaged, "one that has gone"


class _Disk:
    """A disk's thread that a test can hold up."""

    def __init__(self) -> None:
        self.pool = ThreadPoolExecutor(1)
        self.free = threading.Event()

    def submit(self, work: Callable[[], None]) -> Future[None]:
        return self.pool.submit(self._do, work)

    def _do(self, work: Callable[[], None]) -> None:
        self.free.wait(10.0)
        work()


def test_the_newest_comes_first_and_the_latest_wish_counts_however_slow_the_disk_is(library: Library) -> None:
    ids = [saved(library) for _ in range(3)]
    disk = _Disk()
    gallery = GalleryController(library, disk.submit)
    gallery.list_scans()
    for scan_id in ids:
        gallery.show(scan_id)
    assert gallery.poll() == [], "nothing is waited for"
    disk.free.set()
    disk.pool.shutdown(wait=True)
    assert gallery.poll() == [on.ScansListed(tuple(reversed(ids)))]
    assert gallery.shown is not None
    assert gallery.shown.scan_id == ids[-1]
    assert gallery.poll() == [], "listed once"
    told = {"scan": ids[-1], "damaged": False, "grade": "usable", "taken": gallery.shown.taken}
    assert gallery.status_of(ids[-1]) == told
    assert gallery.status_of(ids[0]) is None, "it is not what the diver looks at"
