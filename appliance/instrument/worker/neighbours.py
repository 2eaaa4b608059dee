"""Work of the worker in its pauses: comparing scans, and guidance from live images.

    Neighbours    the scan that was kept last and the one in hand, as small copies, and their overlap
    LiveGuide     guidance from live images, by the overlap with the scan that was kept last

A new scan is copied after its full cloud (25 ms at 1600 × 1200). The rest is done in small pieces while the worker is
idle: a message waits for one piece at most, and a new scan ends the work.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.worker.messages import LookAt
from appliance.measure import (
    Calibration,
    Cloud,
    CoarseView,
    Direction,
    Guidance,
    Guide,
    LiveGuidance,
    Overlap,
    PatternSequence,
    ScanOverlap,
    Sight,
    Water,
    coarse_view,
    compare,
    projection_of,
)


class Neighbours:
    """The scan that was kept last and the one in hand, of one object or of none. Used by one thread."""

    def __init__(self, calibration: Calibration, water: Water, sequence: PatternSequence, stride_px: int) -> None:
        """Prepare for one calibration; ``stride_px``: distance of a coarse cloud's points."""
        self._projection = projection_of(calibration.rig.left, water.index, calibration.rig.volume)
        self._sequence, self._stride_px = sequence, stride_px
        self._coarse: Cloud | None = None
        self._kept: CoarseView | None = None
        self._kept_object: int | None = None
        self._new: CoarseView | None = None
        self._object: int | None = None
        self._work: Iterator[Overlap | None] | None = None
        self._spent_s = 0.0

    def begin(self, belongs_to: int | None) -> None:
        """Forget the scan in hand, which was not kept: another one begins, of that object."""
        self._work = self._new = self._coarse = None
        self._object = belongs_to

    def coarse(self, cloud: Cloud) -> None:
        """Store the coarse cloud of the scan in hand."""
        self._coarse = cloud

    def add_full(self, frames: NDArray[np.uint8]) -> None:
        """Store a small copy of the finished scan in hand, and prepare its comparison.

        ``frames``: those of the left camera, (n, h, w).
        """
        if self._coarse is None:
            return
        begun_s = time.process_time()
        # The sum of the four sine frames is evenly illuminated: another image like the bright frame, some tenths of a
        # second later.
        sine_frames = frames[list(self._sequence.axis(Direction.X).sine)]
        self._new = coarse_view(
            self._coarse, self._stride_px, frames[self._sequence.bright], sine_frames, self._projection
        )
        self._coarse = None
        if self._kept is not None and self._kept_object == self._object:
            self._work = compare(self._kept, self._new)
        self._spent_s = time.process_time() - begun_s

    def keep(self) -> None:
        """Compare the next scan with the one in hand, which the diver keeps."""
        if self._new is not None:
            self._kept, self._kept_object = self._new, self._object

    def kept_view(self, belongs_to: int) -> CoarseView | None:
        """Return the scan that was kept last if it belongs to that object, else ``None``."""
        return self._kept if self._kept_object == belongs_to else None

    @property
    def has_work(self) -> bool:
        """True if a piece of work is left."""
        return self._work is not None

    def go_on(self) -> ScanOverlap | None:
        """Do one piece; the last one returns the result."""
        if self._work is None:
            return None
        begun_s = time.process_time()
        overlap = next(self._work)
        self._spent_s += time.process_time() - begun_s
        if overlap is None:
            return None
        self._work = None
        return ScanOverlap(overlap, self._spent_s)


@dataclass(slots=True)
class _GuidanceTask:
    taken_ns: int
    work: Iterator[Guidance | None]
    spent_s: float = 0.0
    guidance: Guidance | None = None


class LiveGuide:
    """Guidance from live images, by the scan that ``neighbours`` have kept. Used by one thread."""

    def __init__(self, calibration: Calibration, water: Water, neighbours: Neighbours) -> None:
        rig = calibration.rig
        left, right = (projection_of(camera, water.index, rig.volume) for camera in (rig.left, rig.right))
        self._guide = Guide(Sight(rig.left, water.index, left, right))
        self._neighbours = neighbours
        self._look: _GuidanceTask | None = None

    def begin(self) -> None:
        """End the current work: a scan begins, after which the instrument is elsewhere."""
        self._look = None
        self._guide.forget()

    def look(self, order: LookAt, picture: NDArray[np.uint8]) -> None:
        """Prepare to evaluate a live ``picture`` (h, w) uint8, in place of the current one."""
        kept_view = self._neighbours.kept_view(order.belongs_to)
        self._look = _GuidanceTask(
            order.taken_ns, iter(()) if kept_view is None else self._guide.look(kept_view, picture)
        )

    @property
    def has_work(self) -> bool:
        """True if a piece of work is left."""
        return self._look is not None

    def go_on(self) -> LiveGuidance | None:
        """Do one piece; the last one returns the result."""
        look = self._look
        if look is None:
            return None
        begun_s = time.process_time()
        ended = False
        try:
            look.guidance = next(look.work) or look.guidance
        except StopIteration:
            ended = True
        look.spent_s += time.process_time() - begun_s
        if not ended:
            return None
        self._look = None
        return LiveGuidance(look.guidance, look.taken_ns, look.spent_s)
