"""Scans for the gallery, read from the disk in its own thread, so that the screen never waits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine import events as on
from appliance.instrument.screens.views import StoredScan
from appliance.measure import GRADE_NAME, LENGTHS_DOUBTFUL
from appliance.store import Library, ScanEntry, StorageError, UnknownScan

MAX_PREVIEW_BYTES = 20_000_000


class GalleryController:
    """Lists and loads in ``submit``'s thread; a later request replaces the former."""

    def __init__(self, library: Library, submit: Callable[[Callable[[], None]], Future[None]]) -> None:
        self._library, self._submit = library, submit
        self._wanted: str | None = None
        self._tasks: list[Future[None]] = []
        self._listed: tuple[str, ...] | None = None
        self.shown: StoredScan | None = None

    def list_scans(self) -> None:
        """Answer ScansListed."""
        self._tasks.append(self._submit(self._list))

    def show(self, scan_id: str) -> None:
        """Load a scan into ``shown``."""
        self._wanted = scan_id
        self._tasks.append(self._submit(lambda: self._load(scan_id)))

    def status_of(self, scan_id: str | None) -> Mapping[str, Any] | None:
        """Return the status file's entry for the shown scan; ``None`` until it was read."""
        shown = self.shown
        if shown is None or shown.scan_id != scan_id:
            return None
        word = None if shown.grade is None else shown.grade.value
        return {"scan": shown.scan_id, "damaged": shown.damaged, "grade": word, "taken": shown.captured_at}

    def poll(self) -> list[on.Event]:
        """Return the disk's answers since the last call."""
        self._tasks = [task for task in self._tasks if not task.done()]
        listed, self._listed = self._listed, None
        return [] if listed is None else [on.ScansListed(listed)]

    def _list(self) -> None:
        try:
            # One assignment: the service's thread sees the old tuple or the new one.
            self._listed = tuple(reversed(self._library.ids()))
        except StorageError:
            self._listed = ()

    def _load(self, scan_id: str) -> None:
        if scan_id == self._wanted:  # else the diver has gone on meanwhile
            self.shown = read(self._library, scan_id)


def read(library: Library, scan_id: str) -> StoredScan:
    """Read one scan from the disk. Never raises: an unreadable scan counts as damaged."""
    try:
        entry = library.entry(scan_id)
    except (StorageError, UnknownScan):
        return StoredScan(scan_id, damaged=True)
    if entry.manifest is None:
        return StoredScan(scan_id, damaged=True)
    record = entry.manifest.record
    graded = next((verdict for verdict in record.verdicts if verdict.name == GRADE_NAME), None)
    preview, readable = _preview(entry)
    points = record.cloud.get("points")
    return StoredScan(
        scan_id,
        damaged=not entry.ok or not readable,
        preview=preview,
        grade=record.grade,
        corrected=record.compensated,
        lengths_doubtful=graded is not None and graded.numbers.get(LENGTHS_DOUBTFUL) == 1.0,
        points=None if points is None else int(points),
        coverage_percent=record.cloud.get("coverage_percent"),
        noise_mm=record.cloud.get("noise_mm"),
        distance_mm=record.cloud.get("distance_mm"),
        captured_at=record.wall_time if record.clock_trusted else None,
    )


def _preview(entry: ScanEntry) -> tuple[NDArray[np.uint8] | None, bool]:
    """Return the preview image, and False if it is missing or damaged although it was written."""
    path = entry.preview_file
    if path is None:
        return None, True
    try:
        with path.open("rb") as file:
            data = file.read(MAX_PREVIEW_BYTES)
    except OSError:
        return None, False
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if picture is None:
        return None, False
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8), True
