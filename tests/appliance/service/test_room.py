"""No scan begins without space that is allocated for it, and the diver reads why."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from appliance.instrument import design_of
from appliance.machine import events as on
from appliance.machine.alerts import RULES
from appliance.machine.states import Part
from appliance.machine.words import Text
from appliance.patterns.sequence import build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.service.room import ASK_AGAIN_S, CountedRoom, steady
from appliance.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library
from appliance.storage.room import FOLDER, Room
from drivers.wall_clock import KernelCalendar
from tests.appliance.service.scripted import small_rig
from tests.drivers.clock import SteppedClock


class Disk(LocalFileSystem):
    """Refuses to allocate, with ``error``, as long as there is one."""

    error: int | None = None
    full = False

    def free_bytes(self, path: Path) -> int:
        return 0 if self.full else super().free_bytes(path)

    def allocate(self, path: Path, length_bytes: int) -> None:
        if self.error is not None:
            raise OSError(self.error, "refused")
        super().allocate(path, length_bytes)


@contextmanager
def desk_on(disk: Disk, root: Path, clock: SteppedClock) -> Iterator[ScanController]:
    """Without the process for points: nothing is recorded here."""
    rig, room = small_rig(root), Room(root, disk)
    library = Library(root, room)
    library.prepare()
    setup = MeasuringSetup(design_of(rig), build_sequence(16))
    scans = ScanController(rig, setup, ScanStorage(library, room), clock, KernelCalendar())
    try:
        yield scans
    finally:
        scans.__exit__(None, None, None)


def answered(scans: ScanController) -> list[on.Event]:
    scans.submit(lambda: None).result(30.0)  # whatever was asked before is through
    return scans.poll()


def raised(events: list[on.Event]) -> set[FaultCode]:
    found = {event.fault.code for event in events if isinstance(event, on.ConditionRaised)}
    full = any(isinstance(event, on.StorageCounted) and event.scans_left == 0 for event in events)
    return found | ({FaultCode.STORAGE_FULL} if full else set())


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (errno.ENOSPC, FaultCode.STORAGE_FULL),
        (errno.EDQUOT, FaultCode.STORAGE_FULL),
        (errno.EROFS, FaultCode.DISK_READ_ONLY),
        (errno.EIO, FaultCode.DISK_REFUSES),
    ],
)
def test_a_scan_for_which_no_space_can_be_allocated_is_refused_until_it_can(
    tmp_path: Path, error: int, code: FaultCode
) -> None:
    disk, clock = Disk(), SteppedClock()
    disk.error = error
    with desk_on(disk, tmp_path, clock) as scans:
        scans.test_storage()
        assert raised(answered(scans)) == {code}
        assert RULES[code].blocks_scan
        fault = scans.begin(1, Exposure(8000, 0.0))
        assert fault is not None
        assert fault.code is code
        disk.error = None
        clock.sleep_s(ASK_AGAIN_S + 0.1)
        scans.poll()
        events = answered(scans)  # it asked again by itself
        assert raised(events) == set()
        assert any(isinstance(event, on.StorageCounted) and event.scans_left for event in events)
        assert scans.begin(1, Exposure(8000, 0.0)) is None


@pytest.mark.parametrize(
    ("before", "now", "left"),
    [
        (CountedRoom(7, 0, 10), CountedRoom(7, 1, 10), 1),  # it was full
        (CountedRoom(7, 20, 10), CountedRoom(6, 21, 10), 21),  # a scan was taken away
        (CountedRoom(7, 20, 10), CountedRoom(7, 22, 9), 22),  # scans of a longer period are smaller
        (CountedRoom(7, 20, 10), CountedRoom(8, 22, 10), 20),
        (CountedRoom(7, 20, 10), CountedRoom(8, 19, 10), 19),
        (CountedRoom(7, 20, 10), CountedRoom(8, 23, 10), 23),
    ],
)
def test_what_counts_as_freed(before: CountedRoom, now: CountedRoom, left: int) -> None:
    assert steady(before, now).left == left
    assert steady(None, now) == now


def test_after_the_self_test_the_space_of_a_whole_scan_is_allocated(tmp_path: Path) -> None:
    with desk_on(Disk(), tmp_path, SteppedClock()) as scans:
        scans.test_storage()
        events = answered(scans)
        (tested,) = (event for event in events if isinstance(event, on.PartTested))
        assert (tested.part, tested.passed) == (Part.STORAGE, True)
        assert tested.detail is not Text.COUNTED_ONLY
        held = {path.name: path.stat().st_blocks * 512 for path in (tmp_path / FOLDER).iterdir() if path.is_file()}
        assert held["frames-left"] >= 24 * 400 * 300
        assert held["frames-right"] >= 24 * 400 * 300
        scans.use_sequence(build_sequence(64))
        answered(scans)
        assert scans.begin(1, Exposure(8000, 0.0)) is None


def test_a_disk_that_cannot_allocate_is_used_and_said_to_be_counted_only(tmp_path: Path) -> None:
    disk = Disk()
    disk.error = errno.EOPNOTSUPP
    with desk_on(disk, tmp_path, SteppedClock()) as scans:
        scans.test_storage()
        events = answered(scans)
        (tested,) = (event for event in events if isinstance(event, on.PartTested))
        assert tested.passed
        assert tested.detail is Text.COUNTED_ONLY
        assert scans.begin(1, Exposure(8000, 0.0)) is None
        scans.drop()
        disk.full = True
        scans.test_storage()
        answered(scans)
        fault = scans.begin(2, Exposure(8000, 0.0))
        assert fault is not None
        assert fault.code is FaultCode.STORAGE_FULL
