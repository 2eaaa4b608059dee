"""What is asked of the disk is done in its order, and no scan begins without space that is allocated for it."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from pathlib import Path

import pytest

from appliance.instrument.machine import events as on
from appliance.instrument.machine.alerts import RULES
from appliance.instrument.machine.states import Part, PartResult
from appliance.instrument.machine.words import Text
from appliance.instrument.service.scan_files import ASK_AGAIN_S, CountedRoom, DiskQueue, steady_count
from appliance.instrument.service.scans import MeasuringSetup, ScanController, ScanStorage
from appliance.measure.fault import FaultCode
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.patterns import build_sequence
from appliance.store.atomic import LocalFileSystem
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from appliance.store.room import FOLDER, Room
from drivers.wall_clock import KernelCalendar
from tests.appliance.instrument.service.scripted import no_process, small_rig
from tests.drivers.clock import SteppedClock

SAVED = on.ConditionCleared(FaultCode.RECONSTRUCTION_FAILED)


def wait_until_answered(queue: DiskQueue) -> list[list[on.Event]]:
    deadline_s = time.monotonic() + 10.0
    while not (found := queue.results()):
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.002)
    return found


def test_a_task_that_is_answered_by_events_keeps_the_queue_busy_until_they_are_fetched_once() -> None:
    gate = threading.Event()
    with DiskQueue() as queue:
        queue.ask(lambda: [SAVED])
        assert wait_until_answered(queue) == [[SAVED]]
        assert (queue.busy, queue.results()) == (False, [])
        queue.ask(lambda: [] if gate.wait(10.0) else [SAVED])
        queue.ask(lambda: [SAVED, SAVED])
        assert queue.results() == [], "nothing of it has ended"
        assert queue.busy
        gate.set()
        found = wait_until_answered(queue)
        while len(found) < 2:
            found += wait_until_answered(queue)
        assert found == [[], [SAVED, SAVED]]


def test_what_is_being_written_is_finished_before_the_program_ends() -> None:
    written = []

    def write(what: str, lasts_s: float) -> list[on.Event]:
        threading.Event().wait(lasts_s)
        written.append(what)
        return []

    with DiskQueue() as queue:
        queue.ask(lambda: write("frames", 0.1))
        queue.ask(lambda: write("cloud", 0.0))
    assert written == ["frames", "cloud"]


def test_what_a_task_raises_is_raised_where_its_answer_is_fetched() -> None:
    def fails() -> list[on.Event]:
        raise OSError("the disk is gone")

    with DiskQueue() as queue:
        queue.ask(fails)
        with pytest.raises(OSError, match="the disk is gone"):
            wait_until_answered(queue)
        assert not queue.busy


def test_the_disk_steps_back_behind_whoever_computes_what_the_diver_waits_for() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    with DiskQueue() as queue:
        assert queue.submit(priority).result(10.0) == priority() + 10


class Disk(LocalFileSystem):
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
    setup = MeasuringSetup(Instrument(rig).design(), build_sequence(16))
    resource_tracker.ensure_running()  # the memory of frames wants it
    with no_process(), ScanController(rig, setup, ScanStorage(library, room), clock, KernelCalendar()) as scans:
        yield scans


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
        *((error, FaultCode.STORAGE_FULL) for error in (errno.ENOSPC, errno.EDQUOT)),
        (errno.EROFS, FaultCode.DISK_READ_ONLY), (errno.EIO, FaultCode.DISK_REFUSES),
    ],
)  # fmt: skip
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
        (CountedRoom(7, 20, 10), CountedRoom(7, 22, 10), 20),  # others take and give some
        (CountedRoom(7, 20, 10), CountedRoom(8, 22, 10), 20),
        (CountedRoom(7, 20, 10), CountedRoom(8, 19, 10), 19),
        (CountedRoom(7, 20, 10), CountedRoom(8, 23, 10), 23),
    ],
)
def test_what_counts_as_freed(before: CountedRoom, now: CountedRoom, left: int) -> None:
    assert steady_count(before, now).left == left
    assert steady_count(None, now) == now


def storage_tested(scans: ScanController) -> PartResult:
    scans.test_storage()
    (found,) = (event for event in answered(scans) if isinstance(event, PartResult))
    assert (found.part, found.passed) == (Part.STORAGE, True)
    return found


def test_after_the_self_test_the_space_of_a_whole_scan_is_allocated(tmp_path: Path) -> None:
    with desk_on(Disk(), tmp_path, SteppedClock()) as scans:
        assert storage_tested(scans).detail is not Text.COUNTED_ONLY
        held = {path.name: path.stat().st_blocks * 512 for path in (tmp_path / FOLDER).iterdir() if path.is_file()}
        assert min(held["frames-left"], held["frames-right"]) >= 24 * 400 * 300
        scans.use_sequence(build_sequence(64))
        answered(scans)
        assert scans.begin(1, Exposure(8000, 0.0)) is None


def test_a_disk_that_cannot_allocate_is_used_and_said_to_be_counted_only(tmp_path: Path) -> None:
    disk = Disk()
    disk.error = errno.EOPNOTSUPP
    with desk_on(disk, tmp_path, SteppedClock()) as scans:
        assert storage_tested(scans).detail is Text.COUNTED_ONLY
        assert scans.begin(1, Exposure(8000, 0.0)) is None
        scans.drop()
        disk.full = True
        storage_tested(scans)
        fault = scans.begin(2, Exposure(8000, 0.0))
        assert fault is not None
        assert fault.code is FaultCode.STORAGE_FULL
