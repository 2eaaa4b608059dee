"""Cost of each part of a scan, judge by judge: the worker's procedure, timed at each of its steps.

A value that several judges share is computed by the first one, and counted there.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.news import CoarseCloud, FullCloud, PatternIdentity, Verdicts, WorkProgress
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.procedure import SequenceProcessor
from bench.whole_scan.scenes import TimedScene

RECORDING, LAST_PAIR, COARSE, BACKSCATTER = "recording", "last pair", "coarse cloud", "of it: backscatter"
IDENTITY, WEIGHING, COMPENSATION, FULL = "identity", "causes weighed", "compensation", "full cloud"


class Procedure:
    """One scene's pipeline and judges, as the worker has them."""

    def __init__(self, scene: TimedScene, pipeline: Pipeline) -> None:
        self._scene, self._pipeline = scene, pipeline
        self._processor = SequenceProcessor(pipeline, scene.calibration, scene.water)
        self._taken_ms: dict[str, list[float]] = defaultdict(list)

    def parts_ms(self) -> Mapping[str, Sequence[float]]:
        """Return CPU milliseconds of all threads, by part in the order in which they came, one of each round so far."""
        return dict(self._taken_ms)

    def forget(self) -> None:
        """Clear the times of the rounds so far."""
        self._taken_ms.clear()

    def round(self) -> None:
        """Take one whole scan through all steps."""
        clock = _Clock()
        processor, last = self._processor, len(self._scene.sequence) - 1
        processor.begin(self._scene.settings)
        for index in processor.push_all(self._scene.frames):
            if index == last:
                self._note(RECORDING, clock)
        self._note(LAST_PAIR, clock)
        judged = False
        for step in processor.steps():
            match step:
                case PatternIdentity():
                    self._note(IDENTITY, clock)
                case CoarseCloud():
                    self._note(COARSE, clock)
                case WorkProgress(name):
                    self._note(name, clock)
                case Verdicts():
                    self._note(COMPENSATION if judged else WEIGHING, clock)
                    judged = True
                case FullCloud():
                    self._note(FULL, clock)
        self._taken_ms[BACKSCATTER].append(self._backscatter_ms())

    def _backscatter_ms(self) -> float:
        """Return the time that decoders take to read through backscatter, a part of the coarse cloud's step."""
        spent_ms = 0.0
        for side in SIDES:
            frames = self._scene.frames[side]
            decoder = CameraDecoder(self._scene.sequence, frames.shape[2], frames.shape[1])
            for index in range(len(frames)):
                decoder.push(frames, index)
            decoder.finish()
            clock = _Clock()
            decoder.read_again_through_backscatter(frames, of_side(self._scene.settings.noise, side))
            spent_ms += clock.lap_ms()
        return spent_ms

    def _note(self, part: str, clock: _Clock) -> None:
        self._taken_ms[part].append(clock.lap_ms())


@contextmanager
def procedure(scene: TimedScene) -> Iterator[Procedure]:
    """Make the pipeline and the judges of a scene, and run them once, so that all is loaded."""
    # Without helpers: each part is done where it is told, by one thread, and its time is its own.
    with Pipeline(scene.calibration, scene.water, scene.sequence, noise=scene.settings.noise, helpers=0) as pipeline:
        timed = Procedure(scene, pipeline)
        timed.round()
        timed.forget()
        yield timed


class _Clock:
    """CPU time of this process, lap by lap."""

    def __init__(self) -> None:
        self._since_s = time.process_time()

    def lap_ms(self) -> float:
        """Return the time since the last look."""
        before_s, self._since_s = self._since_s, time.process_time()
        return 1e3 * (self._since_s - before_s)
