"""Owns what the worker keeps of the scan before, to tell how much of a new one lies on it: small copies, never frames
or full clouds.

Nothing here is done while a scan is recorded or computed: the new scan is noted in passing (25 ms at 1600 × 1200,
behind the full cloud) and compared piece by piece while there is nothing else to do. A message that comes waits for one
piece at most, and a new scan ends the comparison for good.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from appliance.measure import (
    Calibration,
    Cloud,
    CoarseView,
    Direction,
    Overlap,
    PatternSequence,
    ScanOverlap,
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
