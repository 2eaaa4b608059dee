"""Which object a scan belongs to: said by its manifest, and never given twice."""

from __future__ import annotations

from pathlib import Path

import pytest

from appliance.storage.library import Library, LibraryFolder
from appliance.storage.object_numbers import LOOKED_AT, largest_number, numbers, scans_of
from tests.appliance.storage.scenes import ORIGIN, frames, record


def take(library: Library, number: int | None) -> str:
    pending = library.begin(frames(), record(object=number), ORIGIN)
    pending.publish(record(object=number))
    return pending.scan_id


@pytest.fixture
def library(tmp_path: Path) -> Library:
    found = Library(tmp_path)
    found.prepare()
    return found


def test_scans_are_found_by_the_number_of_their_object_in_the_order_they_were_taken(library: Library) -> None:
    ids = [take(library, number) for number in (1, None, 2, 1)]
    assert scans_of(library, 1) == [ids[0], ids[3]]
    assert scans_of(library, 7) == []
    assert numbers(library) == [1, 2]


def test_a_number_is_used_up_by_scans_that_were_rejected_or_put_away_too(library: Library) -> None:
    assert largest_number(library) == 0
    take(library, 1)
    pending = library.begin(frames(), record(object=2), ORIGIN)
    pending.reject("blurred")
    assert largest_number(library) == 2
    library.trash(take(library, 3))
    take(library, None)
    assert largest_number(library) == 3


def test_a_damaged_manifest_is_passed_over(library: Library) -> None:
    take(library, 4)
    newest = take(library, 5)
    (library.root / LibraryFolder.SCANS.value / newest / "manifest.json").write_bytes(b"{}")
    assert largest_number(library) == 4
    assert numbers(library) == [4]


def test_a_start_reads_a_bounded_number_of_manifests(library: Library, monkeypatch: pytest.MonkeyPatch) -> None:
    take(library, 9)
    for _ in range(2):
        take(library, None)
    assert largest_number(library) == 9
    monkeypatch.setattr("appliance.storage.object_numbers.LOOKED_AT", 2)
    assert largest_number(library) == 0
    assert LOOKED_AT >= 100
