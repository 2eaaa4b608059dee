"""Owns what the worker does with the live pictures of a diver who aims: one at a time, piece by piece, in its pauses.

As with the comparison of scans, a message waits for one piece at most, and a scan that begins ends it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.worker.messages import LookAt
from appliance.instrument.worker.neighbours import Neighbours
from appliance.measure import Calibration, Guidance, Guide, LiveGuidance, Sight, Water, projection_of


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
