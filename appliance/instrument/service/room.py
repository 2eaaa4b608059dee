"""Owns whether there is room for the next scan: allocated before the shot, counted, and asked for again where there is
none.

It also owns the disk's thread, ``kf-storage``: one task after the other, and the events that answer those that were
asked for.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self, TypeVar

from appliance.instrument.machine import events as on
from appliance.instrument.machine.words import Label, Text
from appliance.measure import Fault, FaultCode
from appliance.store import (
    Library,
    Room,
    StorageError,
    cloud_bytes,
    frames_bytes,
    plan_room,
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
        self._plan = plan_room(frames_bytes(frames, width_px, height_px), cloud_bytes(width_px, height_px))

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
