"""A scan shown as SAVED survives the loss of power one millisecond later; whatever else happens, nothing half is shown."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.store import scan as content
from appliance.store.atomic import LocalFileSystem
from appliance.store.library import Library, LibraryFolder
from appliance.store.room import Room
from tests.appliance.store import scenes
from tests.appliance.store.scenes import ORIGIN, PLAN, PREVIEW, cloud, frames, record
from tests.appliance.store.volatile import HastyDisk, PowerCut, VolatileDisk

ROOT = Path("data") / "storage"
"""Below the disk's top: the folders above the scans are made by the instrument too."""
Promises = dict[str, set[str]]
"""Numbers of scans that the diver was told to be saved, rejected, with a cloud or a second exposure, until the power went."""


def dive(top: Path, disk: LocalFileSystem, allocated: bool, told: Promises) -> None:
    """A scan with a cloud, a rejected one, and one of two exposures that gets its cloud afterwards; with or without space allocated
    beforehand, which is the same for one that is rejected."""
    room = Room(top / ROOT, disk)
    library = Library(top / ROOT, room)
    library.prepare()
    library.recover()
    for k in (0, 2) if allocated else (0, 1, 2):
        if allocated:
            room.hold(PLAN)
        scan = library.begin(frames(k), record(), ORIGIN)
        if k == 0:
            scan.publish(record(), cloud(seed=k), PREVIEW)
            promised = ["saved", "cloud"]
        elif k == 1:
            scan.reject("moved")
            promised = ["rejected"]
        else:
            both = replace(record(), second=scenes.second_sequence())
            scan.add_second(frames(k + 10), both)
            scan.publish(both)
            promised = ["saved", "second"]
        for one in promised:
            told[one].add(scan.scan_id)


def ends_of_a_dive(tmp_path: Path, allocated: bool) -> Iterator[tuple[Promises, Path, str]]:
    """What was promised, and what is found, for every call before which the power may go and every disk it may leave."""
    seen, cut_at, complete = set(), 0, False
    while not complete:
        top, told = tmp_path / f"before-{cut_at}", {one: set[str]() for one in ("saved", "rejected", "cloud", "second")}
        top.mkdir()
        disk = VolatileDisk(top, cut_at)
        with suppress(PowerCut):
            dive(top, disk, allocated, told)
            complete = True
        for fate in disk.fates():
            key = (repr(told), disk.state(fate))
            if key not in seen:
                seen.add(key)
                yield told, disk.survivors(tmp_path / "after", fate) / ROOT, f"power cut before call {cut_at}"
        cut_at += 1


@pytest.mark.parametrize("allocated", [False, True])
def test_power_cut_before_every_single_call_of_a_dive(tmp_path: Path, allocated: bool) -> None:
    ends = recovered = set_aside = 0
    for told, root, when in ends_of_a_dive(tmp_path, allocated):
        ends += 1
        assert scenes.manifests_that_list_what_is_not_there(root) == [], when
        room = Room(root, HastyDisk())
        library = Library(root, room)
        library.prepare()
        outcome = library.recover()
        assert outcome.failed == ()
        recovered += len(outcome.recovered)
        set_aside += len(outcome.set_aside)

        on = {shelf: {entry.scan_id: entry for entry in library.entries(shelf)} for shelf in LibraryFolder}
        scans = on[LibraryFolder.SCANS]
        assert told["saved"] <= set(scans), f"{when} lost a saved scan"
        for scan_id in told["saved"]:
            manifest = scans[scan_id].manifest
            assert manifest is not None
            assert not manifest.recovered
            assert scan_id not in told["cloud"] or content.CLOUD_FILE in manifest.files, f"{when} lost a cloud"
            assert (scan_id in told["second"]) == (manifest.record.second is not None)
        assert told["rejected"] <= set(on[LibraryFolder.REJECTED])
        assert not told["rejected"] & {*scans, *on[LibraryFolder.SET_ASIDE]}, f"{when}: rejected, and there twice"
        assert not list((root / "scans").glob(".*"))

        # numbers go on where they were, and the dive goes on without a word about what was before
        if allocated:
            room.hold(PLAN)
        scan = library.begin(frames(9), record(), ORIGIN)
        assert int(scan.scan_id) not in {int(one.partition("-")[0]) for shelf in on.values() for one in shelf}
        scan.publish(record(), cloud(), PREVIEW)
        assert {entry.scan_id for entry in library.entries()} == {*scans, scan.scan_id}
        assert [one for one in (*scans, scan.scan_id) if not library.verify(one).ok] == []
    # the cuts really fell where something had to be recovered or set aside
    assert ends > 60
    assert recovered > 10
    assert set_aside > 10


def cut_short(tmp_path: Path, cut_at: int, *, recovering: bool) -> tuple[VolatileDisk, Path, bool]:
    """A disk whose power goes before that call of a recording, or of the recovery after one that nobody decided; and whether it
    came that far."""
    top = tmp_path / f"{cut_at}"
    top.mkdir()
    disk = VolatileDisk(top)
    library = Library(top, disk)
    library.prepare()
    if recovering:
        library.begin(frames(1), record(), ORIGIN)
    disk.cut_at = disk.calls + cut_at
    try:
        if recovering:
            assert library.recover().recovered == ("000001",)
        else:
            library.begin(frames(1), record(), ORIGIN)
    except PowerCut:
        return disk, top, True
    return disk, top, False


def test_a_second_power_cut_during_the_recovery_loses_nothing_either(tmp_path: Path) -> None:
    cut_at, cut = 0, True
    while cut:
        disk, _, cut = cut_short(tmp_path, cut_at, recovering=True)
        for fate in disk.fates():
            after = Library(disk.survivors(tmp_path / "after", fate), HastyDisk())
            after.recover()
            assert [entry.scan_id for entry in after.entries()] == ["000001"]
            assert after.verify("000001").ok
        cut_at += 1
    assert cut_at > 6


def test_what_a_killed_process_left_and_was_set_aside_survives_a_loss_of_power(tmp_path: Path) -> None:
    """The process dies before each call of a recording; the next one puts aside what is not whole, then the power goes."""
    set_aside: set[frozenset[str]] = set()
    cut_at, cut = 0, True
    while cut:
        disk, top, cut = cut_short(tmp_path, cut_at, recovering=False)
        disk.cut_at = None
        outcome = Library(top, disk).recover()
        assert outcome.failed == ()
        for scan_id in outcome.set_aside:
            left = {path.name for path in (top / "set-aside" / scan_id).iterdir()}
            set_aside.add(frozenset(left))
            for fate in disk.fates():
                after = disk.survivors(tmp_path / "after", fate)
                assert {path.name for path in (after / "set-aside" / scan_id).iterdir()} == left
                assert not (after / "scans" / f".{scan_id}").exists()
        cut_at += 1
    assert frozenset({"frames_left.npy", "frames_right.npy"}) in set_aside
