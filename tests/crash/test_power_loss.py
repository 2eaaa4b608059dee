"""A scan shown as SAVED survives the loss of power one millisecond later; whatever else happens, nothing half is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from appliance.storage.library import Library, Shelf
from appliance.storage.room import Room
from tests.appliance.storage.scenes import ORIGIN, PLAN, PREVIEW, PowerCut, VolatileDisk, cloud, frames, record


def dive(root: Path, disk: VolatileDisk, saved: list[str], rejected: list[str], *, allocated: bool) -> None:
    """Two scans kept, one rejected between them; with or without space allocated beforehand."""
    room = Room(root, disk)
    library = Library(root, room)
    library.prepare()
    library.recover()
    for k, keep in enumerate((True, False, True)):
        if allocated:
            room.hold(PLAN)
        scan = library.begin(frames(k), record(), ORIGIN)
        if keep:
            scan.publish(record(), cloud(seed=k), PREVIEW)
            saved.append(scan.scan_id)
        else:
            scan.reject("moved")
            rejected.append(scan.scan_id)


def calls_of_a_dive(root: Path, *, allocated: bool) -> int:
    root.mkdir()
    disk = VolatileDisk(root)
    dive(root, disk, [], [], allocated=allocated)
    return disk.calls


@pytest.mark.parametrize("allocated", [False, True])
@pytest.mark.parametrize("names_survive", [False, True])
def test_power_cut_before_every_single_call_of_a_dive(tmp_path: Path, names_survive: bool, allocated: bool) -> None:
    total = calls_of_a_dive(tmp_path / "count", allocated=allocated)
    assert total > 60
    recovered = set_aside = 0
    for cut_at in range(total + 1):
        root = tmp_path / f"before-{cut_at}"
        root.mkdir()
        disk = VolatileDisk(root, cut_at)
        saved: list[str] = []
        rejected: list[str] = []
        try:
            dive(root, disk, saved, rejected, allocated=allocated)
        except PowerCut:
            pass
        else:
            assert cut_at == total

        left = disk.survivors(tmp_path / "after", names_survive=names_survive)
        library = Library(left)
        library.prepare()
        outcome = library.recover()
        assert outcome.failed == ()
        recovered += len(outcome.recovered)
        set_aside += len(outcome.set_aside)

        on_shelf = {entry.scan_id for entry in library.entries()}
        assert set(saved) <= on_shelf, f"power cut before call {cut_at} lost a saved scan"
        assert set(rejected) <= {entry.scan_id for entry in library.entries(Shelf.REJECTED)}
        for entry in library.entries():
            assert library.verify(entry.scan_id).problems == ()
            assert entry.manifest is not None
            assert not (entry.manifest.recovered and entry.scan_id in saved)
        assert not list((left / "scans").glob(".*"))

        # numbers go on where they were, and the dive goes on
        seen = {int(entry.scan_id.partition("-")[0]) for shelf in Shelf for entry in library.entries(shelf)}
        scan = library.begin(frames(9), record(), ORIGIN)
        assert int(scan.scan_id) not in seen
        scan.publish(record())
        assert library.verify(scan.scan_id).ok
    # the cuts really fell where something had to be recovered or set aside
    assert recovered > 5
    assert set_aside > (5 if names_survive else 0)


def test_a_second_power_cut_during_the_recovery_loses_nothing_either(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    total = None
    cut_at = 0
    while total is None:
        for child in sorted(root.rglob("*"), reverse=True):
            child.rmdir() if child.is_dir() else child.unlink()
        disk = VolatileDisk(root)
        library = Library(root, disk)
        library.prepare()
        library.begin(frames(1), record(), ORIGIN)  # the power goes before the decision
        disk._cut_at = disk.calls + cut_at
        try:
            assert library.recover().recovered == ("000001",)
            total = cut_at
        except PowerCut:
            pass
        for names_survive in (False, True):
            after = Library(disk.survivors(tmp_path / "after", names_survive=names_survive))
            after.recover()
            assert [entry.scan_id for entry in after.entries()] == ["000001"]
            assert after.verify("000001").ok
        cut_at += 1
    assert total > 5
