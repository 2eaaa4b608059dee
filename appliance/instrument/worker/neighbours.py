"""Owns what the worker does in its pauses: it compares scans, and looks at live images of a diver who aims.

    Neighbours    the scan that was kept last and the one in hand, as small copies: how much of the new one lies on it
    Onlooker      the live images: where the diver aims, with what the neighbours have kept

A new scan is noted in passing (25 ms at 1600 × 1200, behind the full cloud). Everything else is done piece by piece
while there is nothing else to do: a message waits for one piece at most, and a scan that begins ends it.
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
        """``stride_px``: distance of a coarse cloud's points."""
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
        """Note the coarse cloud of the scan in hand, before anything else takes its place."""
        self._coarse = cloud

    def whole(self, frames: NDArray[np.uint8]) -> None:
        """Note the left ``frames`` (n, h, w) of the scan in hand, all of whose work is done, and get ready to compare
        it."""
        if self._coarse is None:
            return
        begun_s = time.process_time()
        # The four steps of a sine add up to even light: another picture like the bright one, some tenths of a second
        # later.
        others = frames[list(self._sequence.axis(Direction.X).sine)]
        self._new = coarse_view(self._coarse, self._stride_px, frames[self._sequence.bright], others, self._projection)
        self._coarse = None
        if self._kept is not None and self._kept_object == self._object:
            self._work = compare(self._kept, self._new)
        self._spent_s = time.process_time() - begun_s

    def keep(self) -> None:
        """Compare the next scan with the one in hand, which the diver keeps."""
        if self._new is not None:
            self._kept, self._kept_object = self._new, self._object

    def kept(self, belongs_to: int) -> CoarseView | None:
        """Return the scan that was kept last where it is of that object; ``None``: there is none."""
        return self._kept if self._kept_object == belongs_to else None

    @property
    def waits(self) -> bool:
        """There is a piece of work left."""
        return self._work is not None

    def go_on(self) -> ScanOverlap | None:
        """Do one piece; returns the answer with the last one."""
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
class _Look:
    taken_ns: int
    work: Iterator[Guidance | None]
    spent_s: float = 0.0
    guidance: Guidance | None = None


class Onlooker:
    """Looks at live pictures with what the ``neighbours`` have kept. Used by one thread."""

    def __init__(self, calibration: Calibration, water: Water, neighbours: Neighbours) -> None:
        rig = calibration.rig
        left, right = (projection_of(camera, water.index, rig.volume) for camera in (rig.left, rig.right))
        self._guide = Guide(Sight(rig.left, water.index, left, right))
        self._neighbours = neighbours
        self._look: _Look | None = None

    def begin(self) -> None:
        """Give up what is in work: a scan begins, and what is seen after it is seen from elsewhere."""
        self._look = None
        self._guide.forget()

    def look(self, order: LookAt, picture: NDArray[np.uint8]) -> None:
        """Get ready to look at a live ``picture`` (h, w) uint8, instead of one that is in work."""
        kept = self._neighbours.kept(order.belongs_to)
        self._look = _Look(order.taken_ns, iter(()) if kept is None else self._guide.look(kept, picture))

    @property
    def waits(self) -> bool:
        """There is a piece of work left."""
        return self._look is not None

    def go_on(self) -> LiveGuidance | None:
        """Do one piece; returns the answer with the last one."""
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
