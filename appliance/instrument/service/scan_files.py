"""Disk work for scans: its thread, its tasks, and their values.

    DiskQueue       the thread ``kf-storage``: one task after the other, in the order of the requests
    ScanRoom        reserved space for the next scan: allocated before the capture, counted, tried again if missing
    ScanInMemory    the data of the scan in hand, from its first frame to its folder; values only
    ScanFiles       the tasks: write raw frames, publish or reject a scan, test the disk

Each task of ``ScanFiles`` returns events for the machine. ``ScanController`` (``scans.py``) requests the tasks;
``WorkerReports`` (``worker_reports.py``) enters clouds and verdicts into ``ScanInMemory``. ``appliance.store`` defines
the files and their formats.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.store import FrameStore
from appliance.instrument.machine import events as on
from appliance.instrument.machine.states import Part, PartResult
from appliance.instrument.machine.words import Label, Text
from appliance.measure import SIDES, Cloud, Exposure, Fault, FaultCode, Verdict
from appliance.store import (
    IncompleteRecording,
    Library,
    LocalFileSystem,
    PendingScan,
    Room,
    ScanOrigin,
    ScanRecord,
    SecondSequence,
    StorageError,
    size_bytes,
)
from drivers.api import Clock

Answer = TypeVar("Answer")
NICENESS = 10
"""Steps of priority below the service and the worker.

Where processors are short, the diver gets the cloud first; the frames are durable at about the same time, since both
have to be done.
"""


class DiskQueue:
    """Does disk work in the order of the requests. A context manager; called only by the service's cycle.

    One thread keeps the order: a task can rely on the end of all earlier ones.
    """

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "kf-storage", initializer=_step_back)
        self._answers: list[Future[list[on.Event]]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True)  # pending writes are finished first

    @property
    def busy(self) -> bool:
        """True while a task has not ended, or its events were not fetched."""
        return bool(self._answers)

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Begin work whose result the caller waits for; it does not make the queue ``busy``."""
        return self._executor.submit(work)

    def ask(self, work: Callable[[], list[on.Event]]) -> None:
        """Begin work that ends with events, which ``results`` returns."""
        self._answers.append(self._executor.submit(work))

    def results(self) -> list[list[on.Event]]:
        """Return the events of each task that ended since the last call. Raises the exceptions of tasks."""
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        return [answer.result() for answer in done]


def _step_back() -> None:
    """Lower the priority of this thread; Linux has one for each."""
    thread = threading.get_native_id()
    os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + NICENESS)


log = logging.getLogger("kingfisher")

ASK_AGAIN_S = 5.0
"""Time between two checks whether a full disk has space again."""
FREED_SCANS = 3
"""Number of scans by which free space must grow before the diver sees it.

Logs and other programs take and free some all the time, and a number that grows after a save would not be believed.
"""


@dataclass(frozen=True, slots=True)
class CountedRoom:
    """Space on the disk as it was shown to the diver."""

    scans: int
    """Number of scans on the disk."""
    left: int
    """Number of scans that still fit."""
    scan_bytes: int
    """Size of one scan."""


def steady_count(before: CountedRoom | None, now: CountedRoom) -> CountedRoom:
    """Return the count to show after ``before``: ``now``, without small increases.

    The number of remaining scans grows only after a noticeable change: scans were removed, their size changed, the disk
    was full, or there is space for ``FREED_SCANS`` more.
    """
    if before is None or before.scan_bytes != now.scan_bytes or now.scans < before.scans or before.left == 0:
        return now
    return now if now.left >= before.left + FREED_SCANS else replace(now, left=min(now.left, before.left))


class ScanRoom:
    """Reserved space for the next scan. ``count`` runs in the disk's thread, the rest in the service's.

    They share one reference at a time.
    """

    def __init__(self, library: Library, room: Room | None, reserve_bytes: int, clock: Clock) -> None:
        """Prepare; ``room``: the library's file system, or ``None`` where space can only be counted."""
        self._library, self._room = library, room
        self.reserve_bytes = reserve_bytes
        """Space that scans must leave free."""
        self._clock = clock
        self._counted_ns = 0
        self._scan_bytes = 1
        self._plan: dict[str, int] = {}
        self._shown: CountedRoom | None = None
        self.missing: Fault | None = None
        """Fault for which no scan may begin; ``None``: there is space."""

    def size(self, frames: int, width_px: int, height_px: int) -> None:
        """Set the size of the scans from now on."""
        self._scan_bytes = size_bytes(frames, width_px, height_px)
        self._plan = Room.plan(frames, width_px, height_px)

    @property
    def due(self) -> bool:
        """True if it is time to count again, after a lack of space."""
        return self.missing is not None and self._clock.now_ns() - self._counted_ns > ASK_AGAIN_S * 1e9

    @property
    def summary(self) -> Label:
        """Text of the self-test about the space, after ``count``."""
        allocates = self._room is not None and self._room.allocates
        return f"{self._scan_bytes / 1e6:.0f} MB / SCAN" if allocates else Text.COUNTED_ONLY

    def count(self) -> list[on.Event]:
        """Allocate space for the next scan; return events with the counts and the disk's conditions.

        Raises StorageError if the scans cannot be listed.
        """
        fault = self._refused()
        left = self._library.scans_left(self._scan_bytes, self.reserve_bytes)
        # Space that cannot be allocated is not free, whatever the disk reports.
        if fault is not None and fault.code is FaultCode.STORAGE_FULL:
            left = 0
        elif fault is None and left == 0:
            fault = Fault(FaultCode.STORAGE_FULL, "no room for another scan")
        self.missing, self._counted_ns = fault, self._clock.now_ns()
        scans = self._library.count()
        if left is not None:
            self._shown = steady_count(self._shown, CountedRoom(scans, left, self._scan_bytes))
            left = self._shown.left
        events: list[on.Event] = [on.StorageCounted(scans, self._library.last_id(), left)]
        # The machine raises STORAGE_FULL itself, from the count.
        for code in (FaultCode.DISK_READ_ONLY, FaultCode.DISK_REFUSES):
            is_present = fault is not None and fault.code is code
            events.append(on.ConditionRaised(fault) if fault is not None and is_present else on.ConditionCleared(code))
        return events

    def _refused(self) -> Fault | None:
        """Return the fault for which the space cannot be allocated; ``None``: it is."""
        if self._room is None:
            return None
        try:
            self._room.hold(self._plan)
        except StorageError as error:
            log.warning("no space for the next scan: %s", error)
            code = FaultCode.DISK_READ_ONLY if error.is_read_only else FaultCode.DISK_REFUSES
            return Fault(FaultCode.STORAGE_FULL if error.is_full else code, str(error))
        return None


@dataclass(slots=True)
class SecondInMemory:
    """A second sequence of the current scan, from its first frame until both are merged."""

    number: int
    begun_ns: int
    exposure: Exposure
    record: SecondSequence | None = None
    merged: bool = False
    stored: bool = False
    """True if the second sequence's frames are durable."""


@dataclass(slots=True)
class ScanInMemory:
    """One scan from its first frame to its folder."""

    number: int
    begun_ns: int
    exposure: Exposure
    origin: ScanOrigin
    """Calibration and rig of the scan."""
    belongs_to: int | None = None
    """Number of its object."""
    record: ScanRecord | None = None
    coarse: Cloud | None = None
    full: Cloud | None = None
    pending: PendingScan | None = None
    raw: Future[PendingScan] | None = None
    second: SecondInMemory | None = None
    times_s: dict[str, float] = field(default_factory=dict)
    """Times since the key press, and processor times, by stage, as ``ScanRecord.stage_times_s``."""

    def enter(self, verdict: Verdict) -> None:
        """Add a verdict, in place of an earlier one of its name."""
        if self.record is not None:
            # A new record each time: the disk's thread may be writing the former one.
            remaining = tuple(earlier for earlier in self.record.verdicts if earlier.name != verdict.name)
            self.record = replace(self.record, verdicts=(*remaining, verdict))

    @property
    def full_record(self) -> ScanRecord:
        """The record to write: with the second sequence, once it is merged."""
        if self.record is None:
            raise ValueError("nothing was recorded")
        second = self.second
        return self.record if second is None or not second.merged else replace(self.record, second=second.record)

    def since_begun_s(self, time_ns: int) -> float:
        """Return seconds from the key press to a moment of the same clock."""
        return (time_ns - self.begun_ns) / 1e9

    @property
    def cloud(self) -> Cloud | None:
        """The best cloud so far."""
        return self.full or self.coarse


PROBE = "self-test"
PROBE_CONTENT = b"written and read back at every start\n"


class ScanFiles:
    """Writes scans into the library. Methods run in the disk's thread, except ``use``, and return events.

    A scan that could not be written stays in memory, and is written when it is published or rejected: every method
    first repeats failed writes.
    """

    def __init__(self, library: Library, room: ScanRoom, store: FrameStore, clock: Clock) -> None:
        self._library, self._room, self._clock = library, room, clock
        self._store = store
        self._fs = LocalFileSystem()

    def use(self, store: FrameStore) -> None:
        """Take frames from another store from now on. Call when no task is pending."""
        self._store = store

    def raw_stored(self, scan: ScanInMemory) -> list[on.Event]:
        """Answer RawStored or SaveFailed, after ``scan.raw``, which was requested before, has ended."""
        assert scan.raw is not None
        try:
            scan.pending = scan.raw.result()
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        scan.times_s["saved"] = scan.since_begun_s(self._clock.now_ns())
        return [on.RawStored(scan.number), *self.count()]

    def store_second(self, scan: ScanInMemory) -> list[on.Event]:
        """Write the second sequence's frames; answer RawStored or SaveFailed."""
        try:
            self._pending(scan)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.RawStored(scan.number), *self.count()]

    def publish(self, scan: ScanInMemory, preview: NDArray[np.uint8] | None) -> list[on.Event]:
        """Publish with the best cloud and ``preview`` (h, w, 3) RGB uint8; answer Saved or SaveFailed."""
        assert scan.record is not None
        record = replace(scan.full_record, stage_times_s=dict(scan.times_s), cloud=_numbers(scan.full))
        png = None
        if preview is not None:
            _, encoded = cv2.imencode(".png", cv2.cvtColor(preview, cv2.COLOR_RGB2BGR))
            png = encoded.tobytes()
        try:
            pending = self._pending(scan)
            pending.publish(record, scan.full, png)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.Saved(scan.number, pending.scan_id), *self.count()]

    def accept(self, scan: ScanInMemory, entered: Callable[[str], list[on.Event]]) -> list[on.Event]:
        """Publish a scan, then call ``entered`` with its id; answer Saved and its events, or SaveFailed."""
        events = self.publish(scan, None)
        saved = next((event for event in events if isinstance(event, on.Saved)), None)
        if saved is None:
            return events
        try:
            return events + entered(saved.scan_id)
        except StorageError as error:
            return [*events, on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error)))]

    def reject(self, scan: ScanInMemory, reason: str) -> list[on.Event]:
        """Reject the scan; answer that NOT_SAVED is cleared, or SaveFailed."""
        try:
            self._pending(scan).reject(reason, None if scan.record is None else scan.full_record)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.ConditionCleared(FaultCode.NOT_SAVED), *self.count()]

    def keep_incomplete(
        self, frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord, origin: ScanOrigin, fault: Fault
    ) -> list[on.Event]:
        """Keep frames recorded before ``fault``, if the space suffices; failures are only logged."""
        try:
            path = IncompleteRecording.keep(
                self._fs,
                self._library.root,
                frames,
                record,
                origin,
                f"{fault.code.value}: {fault.detail}",
                self._room.reserve_bytes,
            )
        except (StorageError, ValueError) as error:
            log.warning("the incomplete recording was not kept: %s", error)
            return []
        log.info("an incomplete recording was kept: %s", path)
        return self.count()

    def test_disk(self) -> list[on.Event]:
        """Test whether the disk stores a file and returns it; answer PartResult."""
        probe = self._library.root / PROBE
        try:
            self._fs.replace_file(probe, PROBE_CONTENT)
            # Probably read from the cache: this tests that the disk accepts files, not the medium.
            if probe.read_bytes() != PROBE_CONTENT:
                return _test_failed(f"{probe} does not hold what was written")
            counted = self._room.count()
        except (StorageError, OSError) as error:
            return _test_failed(str(error))
        return [*counted, PartResult(Part.STORAGE, True, self._room.summary)]

    def count_objects(self) -> list[on.Event]:
        """Answer ObjectsCounted; if manifests cannot be listed, only the stored choices count."""
        try:
            return [on.ObjectsCounted(self._library.largest_object())]
        except OSError as error:
            log.warning("numbers of objects are not read: %s", error)
            return [on.ObjectsCounted(0)]

    def count(self) -> list[on.Event]:
        """Answer StorageCounted, or no event if the scans cannot be listed."""
        try:
            return self._room.count()
        except StorageError as error:
            log.warning("scans are not counted: %s", error)
            return []

    def _not_saved(self, scan: ScanInMemory, error: Exception) -> list[on.Event]:
        # The reserved space is allocated again at once, for the next attempt.
        return [on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error))), *self.count()]

    def _pending(self, scan: ScanInMemory) -> PendingScan:
        """Return the scan on the disk, with all its sequences; failed writes are repeated."""
        if scan.pending is None:
            assert scan.record is not None
            frames: dict[str, NDArray[np.uint8]] = {side: self._store.frames(side) for side in SIDES}
            scan.pending = self._library.begin(frames, scan.record, scan.origin)
            scan.times_s["saved"] = scan.since_begun_s(self._clock.now_ns())
        second = scan.second
        if second is not None and second.merged and not second.stored:
            frames = {side: self._store.frames(side, second=True) for side in SIDES}
            scan.pending.add_second(frames, scan.full_record)
            # Set only on success: after an exception the next attempt writes them again.
            second.stored = True
        return scan.pending


def _test_failed(why: str) -> list[on.Event]:
    log.warning("self-test of the storage: %s", why)
    return [PartResult(Part.STORAGE, False, Text.REFUSES_FILES)]


def _numbers(cloud: Cloud | None) -> dict[str, float | None]:
    if cloud is None:
        return {}
    s = cloud.summary
    return {
        "points": s.points,
        "coverage_percent": s.coverage_percent,
        "distance_mm": s.distance_mm,
        "noise_mm": s.noise_mm,
        "gap_mm": s.gap_mm,
    }
