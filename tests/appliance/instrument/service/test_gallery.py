"""The gallery shows what lies on the disk, marks what is damaged, and never keeps the screen waiting."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.instrument.machine import events as on
from appliance.instrument.service.gallery import GalleryController, read
from appliance.measure.verdict import GRADE_NAME, LENGTHS_DOUBTFUL, Grade, Verdict
from appliance.store.library import Library
from tests.appliance.store.scenes import ORIGIN, cloud, frames, record

PICTURE = np.arange(40 * 60 * 3, dtype=np.uint8).reshape(40, 60, 3)
NUMBERS = {"points": 20, "coverage_percent": 81.5, "noise_mm": 0.03, "distance_mm": 512.0}


def saved(library: Library, clock_trusted: bool = True, preview: bool = True, doubtful: bool = False) -> str:
    _, png = cv2.imencode(".png", cv2.cvtColor(PICTURE, cv2.COLOR_RGB2BGR))
    verdict = Verdict(GRADE_NAME, True, {LENGTHS_DOUBTFUL: 1.0} if doubtful else {}, "usable")
    said = replace(record(cloud=NUMBERS), clock_trusted=clock_trusted, verdicts=(verdict,))
    pending = library.begin(frames(), said, ORIGIN)
    pending.publish(said, cloud(), png.tobytes() if preview else None)
    return pending.scan_id


@pytest.fixture
def library(tmp_path: Path) -> Library:
    library = Library(tmp_path / "storage")
    library.prepare()
    return library


def test_a_scan_is_shown_as_it_was_judged_when_it_was_taken(library: Library) -> None:
    assert read(library, saved(library, clock_trusted=False)).captured_at is None, "a date that cannot be believed"
    shown = read(library, saved(library))
    assert shown.captured_at is not None
    assert (shown.grade, shown.damaged) == (Grade.USABLE, False)
    assert (shown.points, shown.coverage_percent, shown.distance_mm) == (20, 81.5, 512.0)
    np.testing.assert_array_equal(shown.preview, PICTURE)


def test_lengths_are_doubtful_where_the_diver_was_told_so(library: Library) -> None:
    for doubtful in (True, False):
        shown = read(library, saved(library, preview=False, doubtful=doubtful))
        assert (shown.lengths_doubtful, shown.preview, shown.damaged) == (doubtful, None, False)
        assert (shown.noise_mm, shown.corrected) == (0.03, False)


@pytest.mark.parametrize("name", ["preview.png", "manifest.json", "cloud.ply"])
def test_whatever_is_cut_short_is_marked_and_the_others_are_fine(library: Library, name: str) -> None:
    damaged, fine = saved(library), saved(library)
    path = library.entry(damaged).folder / name
    path.write_bytes(path.read_bytes()[:-7])
    assert read(library, damaged).damaged
    assert not read(library, fine).damaged
    assert read(library, "000099").damaged, "one that has gone"


def test_the_newest_comes_first_and_the_latest_wish_counts_however_slow_the_disk_is(library: Library) -> None:
    ids, asked = [saved(library) for _ in range(3)], list[Callable[[], None]]()

    def later(work: Callable[[], None]) -> Future[None]:
        asked.append(work)
        return Future()

    gallery = GalleryController(library, later)
    gallery.list_scans()
    for scan_id in ids:
        gallery.show(scan_id)
    assert (gallery.poll(), gallery.shown) == ([], None), "nothing is waited for"
    for work in asked:
        assert gallery.shown is None, "the diver has gone on meanwhile"
        work()
    assert gallery.poll() == [on.ScansListed(tuple(reversed(ids)))]
    assert gallery.shown is not None
    assert gallery.poll() == [], "listed once"
    told = {"scan": ids[-1], "damaged": False, "grade": "usable", "taken": gallery.shown.captured_at}
    assert gallery.status_of(ids[-1]) == told
    assert gallery.status_of(ids[0]) is None, "it is not what the diver looks at"
