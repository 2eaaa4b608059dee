"""A scan shown as SAVED survives the loss of power one millisecond later; whatever else happens, nothing half is shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from appliance.storage import scan as content
from appliance.storage.filesystem import AllocatingFileSystem
from appliance.storage.library import Library, LibraryFolder
from appliance.storage.room import Room
from tests.appliance.storage.scenes import (
    ORIGIN,
    PLAN,
    PREVIEW,
    cloud,
    frames,
    manifests_that_list_what_is_not_there,
    record,
    second_sequence,
)
from tests.appliance.storage.volatile import HastyDisk, PowerCut, VolatileDisk

ROOT = Path("data") / "storage"
"""Below the disk's top: the folders above the scans are made by the instrument too."""


@dataclass
class Dive:
    """What was promised to the diver until the power went."""

    saved: list[str] = field(default_factory=list)
    rejected: list[str] = field(default_factory=list)
    with_second: list[str] = field(default_factory=list)
    with_cloud: list[str] = field(default_factory=list)

    def go(self, top: Path, disk: AllocatingFileSystem, *, allocated: bool) -> None:
        """Scans: one with a cloud, a rejected one, one of two exposures that gets its cloud afterwards; with or
        without space allocated beforehand."""
        root = top / ROOT
        room = Room(root, disk)
        library = Library(root, room)
        library.prepare()
        library.recover()
        kinds: Sequence[int] = (0, 2) if allocated else (0, 1, 2)  # the room is the same for one that is rejected
        for k in kinds:
            if allocated:
                room.hold(PLAN)
            scan = library.begin(frames(k), record(), ORIGIN)
            match k:
                case 0:
                    scan.publish(record(), cloud(seed=k), PREVIEW)
                    self.saved.append(scan.scan_id)
                    self.with_cloud.append(scan.scan_id)
                case 1:
                    scan.reject("moved")
                    self.rejected.append(scan.scan_id)
                case _:
                    both = replace(record(), second=second_sequence())
                    scan.add_second(frames(k + 10), both)
                    scan.publish(both)
                    self.saved.append(scan.scan_id)
                    self.with_second.append(scan.scan_id)
                    library.add_cloud(scan.scan_id, cloud(seed=k), PREVIEW, both)
                    self.with_cloud.append(scan.scan_id)


def calls_of_a_dive(top: Path, *, allocated: bool) -> int:
    top.mkdir()
    disk = VolatileDisk(top)
    Dive().go(top, disk, allocated=allocated)
    return disk.calls


def ends_of_a_dive(tmp_path: Path, *, allocated: bool) -> Iterator[tuple[Dive, Path, str]]:
    """What was promised, and what is found, for every call before which the power may go and every disk it may leave."""
    seen = set()
    for cut_at in range(calls_of_a_dive(tmp_path / "count", allocated=allocated) + 1):
        top = tmp_path / f"before-{cut_at}"
        top.mkdir()
        disk, dive = VolatileDisk(top, cut_at), Dive()
        with suppress(PowerCut):
            dive.go(top, disk, allocated=allocated)
        for fate in disk.fates(cut_at):
            key = (repr(dive), disk.state(fate))
            if key not in seen:
                seen.add(key)
                yield dive, disk.survivors(tmp_path / "after", fate) / ROOT, f"power cut before call {cut_at}"


@pytest.mark.parametrize("allocated", [False, pytest.param(True, marks=pytest.mark.dive)])
def test_power_cut_before_every_single_call_of_a_dive(tmp_path: Path, allocated: bool) -> None:
    ends = recovered = set_aside = 0
    for dive, root, when in ends_of_a_dive(tmp_path, allocated=allocated):
        ends += 1
        assert manifests_that_list_what_is_not_there(root) == [], when
        room = Room(root, HastyDisk())
        library = Library(root, room)
        library.prepare()
        outcome = library.recover()
        assert outcome.failed == ()
        recovered += len(outcome.recovered)
        set_aside += len(outcome.set_aside)

        on_shelf = {entry.scan_id: entry for entry in library.entries()}
        assert set(dive.saved) <= set(on_shelf), f"{when} lost a saved scan"
        for scan_id in dive.saved:
            manifest = on_shelf[scan_id].manifest
            assert manifest is not None
            assert not manifest.recovered
            assert scan_id not in dive.with_cloud or content.CLOUD in manifest.files, f"{when} lost a cloud"
            assert (scan_id in dive.with_second) == (manifest.record.second is not None)
        elsewhere = {
            entry.scan_id
            for shelf in (LibraryFolder.SCANS, LibraryFolder.SET_ASIDE)
            for entry in library.entries(shelf)
        }
        assert set(dive.rejected) <= {entry.scan_id for entry in library.entries(LibraryFolder.REJECTED)}
        assert not elsewhere & set(dive.rejected), f"{when}: what was rejected is there twice"
        for entry in library.entries():
            assert library.verify(entry.scan_id).problems == ()
        assert not list((root / "scans").glob(".*"))

        # numbers go on where they were, and the dive goes on without a word about what was before
        whole = {entry.scan_id for entry in library.entries()}
        seen = {int(entry.scan_id.partition("-")[0]) for shelf in LibraryFolder for entry in library.entries(shelf)}
        if allocated:
            room.hold(PLAN)
        scan = library.begin(frames(9), record(), ORIGIN)
        assert int(scan.scan_id) not in seen
        scan.publish(record(), cloud(), PREVIEW)
        assert [entry.scan_id for entry in library.entries() if not library.verify(entry.scan_id).ok] == []
        assert {entry.scan_id for entry in library.entries()} == whole | {scan.scan_id}
    # the cuts really fell where something had to be recovered or set aside
    assert ends > 60
    assert recovered > 10
    assert set_aside > 10


def test_a_second_power_cut_during_the_recovery_loses_nothing_either(tmp_path: Path) -> None:
    top = tmp_path / "top"
    top.mkdir()
    total = None
    cut_at = 0
    while total is None:
        for child in sorted(top.rglob("*"), reverse=True):
            child.rmdir() if child.is_dir() else child.unlink()
        disk = VolatileDisk(top)
        library = Library(top, disk)
        library.prepare()
        library.begin(frames(1), record(), ORIGIN)  # the power goes before the decision
        disk.cut_at = disk.calls + cut_at
        try:
            assert library.recover().recovered == ("000001",)
            total = cut_at
        except PowerCut:
            pass
        for fate in disk.fates(cut_at):
            after = Library(disk.survivors(tmp_path / "after", fate), HastyDisk())
            after.recover()
            assert [entry.scan_id for entry in after.entries()] == ["000001"]
            assert after.verify("000001").ok
        cut_at += 1
    assert total > 5


def test_what_a_killed_process_left_and_was_set_aside_survives_a_loss_of_power(tmp_path: Path) -> None:
    """The process dies before each call of a recording; the next one puts aside what is not whole, then the power goes."""
    set_aside: set[frozenset[str]] = set()
    killed_at, finished = 0, False
    while not finished:
        top = tmp_path / f"killed-{killed_at}"
        top.mkdir()
        disk = VolatileDisk(top)
        library = Library(top, disk)
        library.prepare()
        disk.cut_at = disk.calls + killed_at
        with suppress(PowerCut):
            library.begin(frames(1), record(), ORIGIN)
            finished = True
        disk.cut_at = None
        outcome = Library(top, disk).recover()
        assert outcome.failed == ()
        for scan_id in outcome.set_aside:
            left = {path.name for path in (top / "set-aside" / scan_id).iterdir()}
            set_aside.add(frozenset(left))
            for fate in disk.fates(killed_at):
                after = disk.survivors(tmp_path / "after", fate)
                assert {path.name for path in (after / "set-aside" / scan_id).iterdir()} == left
                assert not (after / "scans" / f".{scan_id}").exists()
        killed_at += 1
    assert frozenset({"frames_left.npy", "frames_right.npy"}) in set_aside
