"""Owns the disk work for scans: the thread that does it, its tasks, and the values that they work on.

    DiskQueue       the thread ``kf-storage``: one task after the other, in the order in which they were asked for
    ScanRoom        the room for the next scan: allocated before the capture, counted, and asked for again if missing
    ScanInMemory    what is known of the scan in hand, from its first frame to its folder; values only
    ScanFiles       the tasks: write raw frames, publish or reject a scan, test the disk

Each task of ``ScanFiles`` returns events for the machine. ``ScanController`` (``scans.py``) asks for the tasks;
``WorkerReports`` (``worker_reports.py``) enters clouds and verdicts into ``ScanInMemory``. What lies on the disk, and
in which form, is the business of ``appliance.store``.
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
"""Steps of priority behind the heartbeat, and so behind the worker, too: where processors are short, the diver has the
cloud first, and the frames are durable at about the same time, since both have to be done."""


class DiskQueue:
    """Does disk work in the order in which it was asked for. A context manager; called by the heartbeat only.

    One thread is what keeps the order: a task may rely on everything that was asked for before it having ended.
    """

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "kf-storage", initializer=_step_back)
        self._answers: list[Future[list[on.Event]]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=True)  # whatever is being written is finished first

    @property
    def busy(self) -> bool:
        """Something that was asked for has not been answered, or its answer was not fetched."""
        return bool(self._answers)

    def submit(self, work: Callable[[], Answer]) -> Future[Answer]:
        """Begin work whose answer somebody else waits for; it does not make the queue ``busy``."""
        return self._executor.submit(work)

    def ask(self, work: Callable[[], list[on.Event]]) -> None:
        """Begin work that is answered by events, which ``answered`` returns."""
        self._answers.append(self._executor.submit(work))

    def answered(self) -> list[list[on.Event]]:
        """Return the events of each task that ended since the last call, and forget it. Raises what a task raised."""
        done = [answer for answer in self._answers if answer.done()]
        self._answers = [answer for answer in self._answers if not answer.done()]
        return [answer.result() for answer in done]


def _step_back() -> None:
    """Let other threads go first; Linux has a priority for each."""
    thread = threading.get_native_id()
    os.setpriority(os.PRIO_PROCESS, thread, os.getpriority(os.PRIO_PROCESS, thread) + NICENESS)


log = logging.getLogger("kingfisher")

ASK_AGAIN_S = 5.0
"""Time between two questions to a full disk whether there is room for a scan by now."""
FREED_SCANS = 3
"""Number of scans from whose room on it is told that some came from nowhere: logs and other programs take and give some
all the time, and a number that goes up after a save would not be believed."""


@dataclass(frozen=True, slots=True)
class CountedRoom:
    """The room on the disk as the diver was told of it."""

    scans: int
    """Scans that were on the disk."""
    left: int
    """Scans that had room besides."""
    scan_bytes: int
    """Bytes that one of them takes."""


def steady(before: CountedRoom | None, now: CountedRoom) -> CountedRoom:
    """Return what to tell after ``before``: ``now``, but no more scans than before while nothing noticeable was freed.

    Scans that were taken away, scans of another size, a disk that was full, and room for ``FREED_SCANS`` more count as
    freed.
    """
    if before is None or before.scan_bytes != now.scan_bytes or now.scans < before.scans or before.left == 0:
        return now
    return now if now.left >= before.left + FREED_SCANS else replace(now, left=min(now.left, before.left))


class ScanRoom:
    """``counted`` runs in the disk's thread, the rest in the heartbeat's; they share one reference at a time."""

    def __init__(self, library: Library, room: Room | None, reserve_bytes: int, clock: Clock) -> None:
        """``room``: the library's file system, where it allocates space; without one, space is only counted."""
        self._library, self._room = library, room
        self.reserve_bytes = reserve_bytes
        """Space that nothing of a scan may take."""
        self._clock = clock
        self._counted_ns = 0
        self._scan_bytes = 1
        self._plan: dict[str, int] = {}
        self._shown: CountedRoom | None = None
        self.missing: Fault | None = None
        """The fault for which no scan may begin; ``None``: there is room."""

    def size(self, frames: int, width_px: int, height_px: int) -> None:
        """Count with scans of another size from now on."""
        self._scan_bytes = size_bytes(frames, width_px, height_px)
        self._plan = Room.plan(frames, width_px, height_px)

    @property
    def due(self) -> bool:
        """It is time to count again: there was no room, and some time has passed."""
        return self.missing is not None and self._clock.now_ns() - self._counted_ns > ASK_AGAIN_S * 1e9

    @property
    def summary(self) -> Label:
        """The self-test's words for the room, after ``counted``."""
        allocates = self._room is not None and self._room.allocates
        return f"{self._scan_bytes / 1e6:.0f} MB / SCAN" if allocates else Text.COUNTED_ONLY

    def counted(self) -> list[on.Event]:
        """Allocate what the next scan needs; how many there are, how many more fit, and what the disk has against it.

        Raises StorageError where the scans cannot be listed.
        """
        fault = self._refused()
        left = self._library.scans_left(self._scan_bytes, self.reserve_bytes)
        # What cannot be allocated is not free, whatever the disk's own count says.
        if fault is not None and fault.code is FaultCode.STORAGE_FULL:
            left = 0
        elif fault is None and left == 0:
            fault = Fault(FaultCode.STORAGE_FULL, "no room for another scan")
        self.missing, self._counted_ns = fault, self._clock.now_ns()
        scans = self._library.count()
        if left is not None:
            self._shown = steady(self._shown, CountedRoom(scans, left, self._scan_bytes))
            left = self._shown.left
        events: list[on.Event] = [on.StorageCounted(scans, self._library.last_id(), left)]
        # STORAGE_FULL is not among them: the machine raises it from the count.
        for code in (FaultCode.DISK_READ_ONLY, FaultCode.DISK_REFUSES):
            there = fault is not None and fault.code is code
            events.append(on.ConditionRaised(fault) if fault is not None and there else on.ConditionCleared(code))
        return events

    def _refused(self) -> Fault | None:
        """Return why the space cannot be allocated; ``None`` where it is."""
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
    """A second sequence of the scan in work, from its first frame until the points of both are one cloud."""

    number: int
    begun_ns: int
    exposure: Exposure
    record: SecondSequence | None = None
    merged: bool = False
    stored: bool = False
    """The second sequence's frames are durable."""


@dataclass(slots=True)
class ScanInMemory:
    """One scan from its first frame to its folder."""

    number: int
    begun_ns: int
    exposure: Exposure
    origin: ScanOrigin
    """The calibration and the rig it is recorded with."""
    belongs_to: int | None = None
    """Number of its object."""
    record: ScanRecord | None = None
    coarse: Cloud | None = None
    full: Cloud | None = None
    pending: PendingScan | None = None
    raw: Future[PendingScan] | None = None
    second: SecondInMemory | None = None
    times_s: dict[str, float] = field(default_factory=dict)
    """Times since the key press and processor times by stage, as ``ScanRecord.stage_times_s``."""

    def enter(self, verdict: Verdict) -> None:
        """Write a verdict down, in place of an earlier one of its name."""
        if self.record is not None:
            # A new record each time: the disk's thread may be writing the one of before.
            others = tuple(one for one in self.record.verdicts if one.name != verdict.name)
            self.record = replace(self.record, verdicts=(*others, verdict))

    @property
    def whole(self) -> ScanRecord:
        """The record as it is to be written down: with the second sequence, once the scan is of both."""
        if self.record is None:
            raise ValueError("nothing was recorded")
        second = self.second
        return self.record if second is None or not second.merged else replace(self.record, second=second.record)

    def since_begun_s(self, time_ns: int) -> float:
        """Return seconds from the key press to a moment of the same clock."""
        return (time_ns - self.begun_ns) / 1e9

    @property
    def cloud(self) -> Cloud | None:
        """The best cloud there is."""
        return self.full or self.coarse


PROBE = "self-test"
PROBE_CONTENT = b"written and read back at every start\n"


class ScanFiles:
    """Writes scans into the library. All of it runs in the disk's thread, but for ``use``, and is answered by events.

    A scan that could not be written stays in memory and is written from there when it is published or rejected: every
    method does first what failed before.
    """

    def __init__(self, library: Library, room: ScanRoom, store: FrameStore, clock: Clock) -> None:
        self._library, self._room, self._clock = library, room, clock
        self._store = store
        self._fs = LocalFileSystem()

    def use(self, store: FrameStore) -> None:
        """Take frames from another store from now on. Call when nothing is on its way to the disk."""
        self._store = store

    def raw_stored(self, scan: ScanInMemory) -> list[on.Event]:
        """Answer RawStored or SaveFailed, once ``scan.raw`` has ended, which was asked for before this."""
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
        """Publish with the cloud there is and ``preview`` (h, w, 3) RGB uint8; answer Saved or SaveFailed."""
        assert scan.record is not None
        record = replace(scan.whole, stage_times_s=dict(scan.times_s), cloud=_numbers(scan.full))
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
        """Publish a scan, then let it be ``entered`` by its id; answer Saved and what that answers, or SaveFailed."""
        events = self.publish(scan, None)
        saved = next((event for event in events if isinstance(event, on.Saved)), None)
        if saved is None:
            return events
        try:
            return events + entered(saved.scan_id)
        except StorageError as error:
            return [*events, on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error)))]

    def reject(self, scan: ScanInMemory, reason: str) -> list[on.Event]:
        """Answer that what was NOT_SAVED is cleared, or SaveFailed."""
        try:
            self._pending(scan).reject(reason, None if scan.record is None else scan.whole)
        except (StorageError, ValueError) as error:
            return self._not_saved(scan, error)
        return [on.ConditionCleared(FaultCode.NOT_SAVED), *self.count()]

    def keep_incomplete(
        self, frames: Mapping[str, NDArray[np.uint8]], record: ScanRecord, origin: ScanOrigin, fault: Fault
    ) -> list[on.Event]:
        """Keep what was recorded before ``fault``, if there is room beside the next scan; nobody is told but the log."""
        try:
            kept = IncompleteRecording.keep(
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
        log.info("an incomplete recording was kept: %s", kept)
        return self.count()

    def test(self) -> list[on.Event]:
        """Answer PartTested: whether the disk takes a file and gives it back."""
        probe = self._library.root / PROBE
        try:
            self._fs.replace_file(probe, PROBE_CONTENT)
            # Read from memory, most likely: it shows that the disk takes files, not what the medium holds.
            if probe.read_bytes() != PROBE_CONTENT:
                return _test_failed(f"{probe} does not hold what was written")
            counted = self._room.counted()
        except (StorageError, OSError) as error:
            return _test_failed(str(error))
        return [*counted, PartResult(Part.STORAGE, True, self._room.summary)]

    def count_objects(self) -> list[on.Event]:
        """Answer ObjectsCounted; where manifests cannot be listed, what the diver's choices remember counts alone."""
        try:
            return [on.ObjectsCounted(self._library.largest_object())]
        except OSError as error:
            log.warning("numbers of objects are not looked up: %s", error)
            return [on.ObjectsCounted(0)]

    def count(self) -> list[on.Event]:
        """Answer StorageCounted, or nothing where the scans cannot be listed."""
        try:
            return self._room.counted()
        except StorageError as error:
            log.warning("scans are not counted: %s", error)
            return []

    def _not_saved(self, scan: ScanInMemory, error: Exception) -> list[on.Event]:
        # What it took from the room is allocated again at once: it will be tried again.
        return [on.SaveFailed(scan.number, Fault(FaultCode.NOT_SAVED, str(error))), *self.count()]

    def _pending(self, scan: ScanInMemory) -> PendingScan:
        """Return the scan on the disk, with every sequence it has; what failed before is done again."""
        if scan.pending is None:
            assert scan.record is not None
            frames: dict[str, NDArray[np.uint8]] = {side: self._store.frames(side) for side in SIDES}
            scan.pending = self._library.begin(frames, scan.record, scan.origin)
            scan.times_s["saved"] = scan.since_begun_s(self._clock.now_ns())
        second = scan.second
        if second is not None and second.merged and not second.stored:
            frames = {side: self._store.frames(side, second=True) for side in SIDES}
            scan.pending.add_second(frames, scan.whole)
            # After the return: where it raises, the next attempt writes them again.
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
