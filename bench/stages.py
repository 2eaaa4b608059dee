"""Stages of one scan and their cost: pairs of frames as they arrive, then the coarse, then the full cloud."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import pairwise

from appliance.measure.light.sides import SIDES
from appliance.measure.points.pipeline import Pipeline
from bench.scan_frames import ScanFrames


@dataclass(frozen=True, slots=True)
class ScanCost:
    """CPU milliseconds of all threads."""

    pairs_ms: tuple[float, ...]
    """One value for each pair of frames, one of either camera, in order."""
    coarse_ms: float
    """Remaining preparation after the last frame, and the coarse cloud."""
    full_ms: float

    @property
    def recording_ms(self) -> float:
        """All pairs but the last: done while the sequence is still being recorded."""
        return sum(self.pairs_ms[:-1])

    @property
    def to_coarse_ms(self) -> float:
        """From the arrival of the last pair to the coarse cloud."""
        return self.pairs_ms[-1] + self.coarse_ms

    @property
    def to_full_ms(self) -> float:
        """From the arrival of the last pair to the full cloud, the coarse one made on the way."""
        return self.to_coarse_ms + self.full_ms

    @property
    def whole_ms(self) -> float:
        """From the first pair to the full cloud."""
        return self.recording_ms + self.to_full_ms


def one_scan(pipeline: Pipeline, scan: ScanFrames) -> ScanCost:
    """Run one scan, in the order of the worker."""
    pipeline.reset()
    times_s = [time.process_time()]
    for k in range(len(scan.sequence)):
        for side in SIDES:
            pipeline.push(side, scan.frames[side], k)
        times_s.append(time.process_time())
    pipeline.find_coarse()
    times_s.append(time.process_time())
    pipeline.find_full()
    times_s.append(time.process_time())
    *pairs, coarse, full = ((after - before) * 1e3 for before, after in pairwise(times_s))
    return ScanCost(tuple(pairs), coarse, full)


def decode_left(pipeline: Pipeline, scan: ScanFrames) -> None:
    """Decode one camera's whole sequence, as the other programs do."""
    pipeline.reset()
    for k in range(len(scan.sequence)):
        pipeline.push("left", scan.frames["left"], k)
    pipeline.reset()
