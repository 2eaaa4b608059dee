"""No scan begins without space that is allocated for it, and the diver reads why."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from appliance.calibration.design import Design, design_calibration
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.machine import events as on
from appliance.machine.alerts import RULES
from appliance.machine.states import Part
from appliance.machine.words import Text
from appliance.optics.water import Water
from appliance.patterns.sequence import build_sequence
from appliance.scan.exposure import Exposure
from appliance.scan.fault import FaultCode
from appliance.service.room import ASK_AGAIN_S, CountedRoom, steady
from appliance.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.storage.filesystem import LocalFileSystem
from appliance.storage.library import Library
from appliance.storage.room import FOLDER, Room
from appliance.storage.scan import size_bytes
from drivers.wall_clock import KernelCalendar
from tests.drivers.clock import SteppedClock


class Disk(LocalFileSystem):
    """Refuses to allocate, with ``error``, as long as there is one; says that ``free`` bytes are free, if that is stated."""

    error: int | None = None
    free: int | None = None

    def free_bytes(self, path: Path) -> int:
        return super().free_bytes(path) if self.free is None else self.free

    def allocate(self, path: Path, length_bytes: int) -> None:
        if self.error is not None:
            raise OSError(self.error, "refused")
        super().allocate(path, length_bytes)


@contextmanager
def desk_on(disk: Disk, root: Path, clock: SteppedClock) -> Iterator[ScanController]:
    """Without the process for points: nothing is recorded here."""
    rig = simulated(load_rig(default_sim_rig()), SimOptions(root=root, size="400x300"))
    calibration = design_calibration(
        Design(11.5, 18.0, 230.0, 12.41, 30.0, 5.0, 1.77), "KF-TEST", 400, 300, Water(20.0, 0.0, 530.0)
    )
    room = Room(root, disk)
    library = Library(root, room)
    library.prepare()
    scans = ScanController(
        rig, MeasuringSetup(calibration, build_sequence(16)), ScanStorage(library, room), clock, KernelCalendar()
    )
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


def told_left(scans: ScanController) -> int | None:
    """How many more scans have room, as it is told now."""
    scans.test_storage()
    return next(event.scans_left for event in answered(scans) if isinstance(event, on.StorageCounted))


def test_the_scans_left_do_not_go_up_after_a_save_by_what_other_programs_give_back(tmp_path: Path) -> None:
    disk = Disk()
    with desk_on(disk, tmp_path, SteppedClock()) as scans:
        scans.test_storage()
        answered(scans)
        one = size_bytes(24, 400, 300)
        disk.free = 2000 * one
        begun = told_left(scans)
        assert begun is not None
        disk.free += one
        assert told_left(scans) == begun, "2001 after 2000, and nothing was freed"
        disk.free -= 7 * one
        less = told_left(scans)
        assert less == begun - 6
        disk.free += 2 * one
        assert told_left(scans) == less
        disk.free += 50 * one
        assert told_left(scans) == begun + 46, "somebody made room: that is told"


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
