"""The procedure for a sequence: identify → coarse cloud → judge → compensate → full cloud.

It is written once, as the generator ``SequenceProcessor.steps``. The instrument's worker and the desk run it, so that
the same frames get the same points and the same verdicts. Warm-up and benches of one stage use the pipeline alone.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from appliance.measure.bracket import ProcessedSequence, merge_bracket
from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudLocation, CloudSummary
from appliance.measure.decode.decoder import DecodedMaps
from appliance.measure.decode.specks import mask_specks
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.judges import Gatherer, JudgeInput, in_table_order, is_fault, run_judges
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.sides import SIDES, of_side
from appliance.measure.light.water import Water
from appliance.measure.motion.attempt import Attempt, attempt
from appliance.measure.news import (
    Bracket,
    CoarseCloud,
    FullCloud,
    PatternIdentity,
    SequenceFact,
    Verdicts,
    WorkProgress,
)
from appliance.measure.points.crew import WorkItem, WorkList, answers
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import ScanImages
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.causes import with_causes
from appliance.measure.verdicts.holes import grid_step_px, judge_distance, judge_holes
from appliance.measure.verdicts.identity.judge import judge_identity

WORTH_MASKING_PERCENT = 0.02
"""Least share of disturbed pixels for which specks are masked one by one, which takes 20 ms of a scan."""


class SequenceProcessor:
    """Takes one sequence after the other through ``pipeline`` and the judges.

    Call ``begin``, ``push`` for every frame of both sides as they come, then all ``steps``. A second sequence with
    another exposure follows in the same way between ``hold`` and ``merge_with``. The pipeline's helpers work from the
    last frame on until the steps end or another sequence begins.
    """

    def __init__(self, pipeline: Pipeline, calibration: Calibration, water: Water) -> None:
        self._pipeline = pipeline
        self._calibration, self._water = calibration, water
        self._settings = AcquisitionSettings()
        self._frames: dict[str, NDArray[np.uint8]] = {}
        self._gatherers: dict[str, Gatherer]
        """Made by ``begin``: a sequence's own."""
        self._moved = self._compensated = False
        self._full: CloudLocation | None = None
        self._tasks = WorkList(pipeline.crew)
        """Tasks that belong to the sequence in work."""
        self._last_frames: list[WorkItem[None]] = []

    def begin(self, settings: AcquisitionSettings) -> None:
        """Expect frame 0 of a sequence that is captured with ``settings``."""
        # The last steps may have been abandoned without being closed: no thread may use the maps when frames come.
        self._tasks.close()
        self._tasks, self._last_frames = WorkList(self._pipeline.crew), []
        self._settings, self._full = settings, None
        self._moved = self._compensated = False
        self._frames.clear()
        # New gatherers, since an incomplete scan may have left samples in the old ones.
        pipeline, noise = self._pipeline, settings.noise
        self._gatherers = {side: Gatherer(pipeline.sequence, of_side(noise, side)) for side in SIDES}
        self._pipeline.expect(settings.noise)
        self._pipeline.reset()

    def push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        """Decode frame ``index`` of one side's ``frames`` (n, h, w) uint8, and take the judges' samples.

        The frames must not change until the last step. Raises ValueError unless frames come in order; for the last
        frame, with the first step.
        """
        self._frames[side] = frames
        if index == len(self._pipeline.sequence) - 1 and self._pipeline.crew.helpers:
            # The diver waits from now on: both sides run in parallel.
            self._last_frames.append(self._tasks.add(partial(self._push, side, frames, index)))
        else:
            self._push(side, frames, index)

    def _push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        self._pipeline.push(side, frames, index)
        self._gatherers[side].push(frames, index)

    def push_all(self, frames: Mapping[str, NDArray[np.uint8]]) -> Iterator[int]:
        """Push all ``frames`` of a stored sequence, both sides together; yield each index before its frames."""
        for index in range(len(self._pipeline.sequence)):
            yield index
            for side in SIDES:
                self.push(side, frames[side], index)

    def steps(self, *, even_if_wrong: bool = False) -> Iterator[SequenceFact]:
        """Process the sequence after its last frame; yield each fact when it is known.

        The generator may be abandoned at any of them. If a frame shows a wrong pattern, ``PatternIdentity`` is the last
        fact unless ``even_if_wrong``. Raises ValueError if frames are missing.
        """
        begun_s = time.process_time()
        with self._tasks as tasks:
            answers(self._last_frames)
            yield from self._steps(tasks, begun_s, even_if_wrong)

    def _steps(self, tasks: WorkList, reported_s: float, even_if_wrong: bool) -> Iterator[SequenceFact]:
        """Yield the facts; ``reported_s``: processor time up to which facts have reported their time."""
        pipeline, settings, rig = self._pipeline, self._settings, self._calibration.rig
        samples = {side: gatherer.finish() for side, gatherer in self._gatherers.items()}
        lines = {side: result.lines for side, result in samples.items()}

        # Identity first: with a wrong pattern every coordinate would be wrong, and so every other verdict. The coarse
        # cloud is computed beside it, in vain if the pattern is wrong.
        coarse_task = tasks.add(pipeline.find_coarse)
        identity = judge_identity(self._frames, pipeline.sequence, settings.noise, settings.exposure, lines)
        yield PatternIdentity(identity)
        if identity.fault is not None and not even_if_wrong:
            return
        coarse = coarse_task.answer(helping=True)

        images = ScanImages(pipeline.sequence, self._frames, {side: pipeline.decoded(side) for side in SIDES}, settings)
        # Judges use raw frames, maps and the coarse cloud, before compensation or masking changes them.
        judge_input = JudgeInput(
            images, samples, pipeline.table.cloud(coarse), rig, self._water.index, identity, pipeline
        )
        bend = pipeline.bend()
        judging = run_judges(judge_input, tasks)
        now_s = time.process_time()
        yield CoarseCloud(coarse, now_s - reported_s)
        reported_s = now_s

        results: dict[str, Judgement | None] = {}
        judged_s = 0.0
        full_task: Callable[[], CloudLocation] | None = None
        for result in judging:
            results[result.name] = result.judgement
            judged_s += result.cpu_s
            # The full cloud need not wait for the other judges: compensation, too, starts from the plain one. It waits
            # if coordinates will change first, by masked specks or the response correction, since judges read them.
            if result.name == "water" and not bend.counts and not _specks_count(result.judgement):
                full_task = pipeline.begin_full(tasks)
            yield WorkProgress(result.name)
        judgements = in_table_order(results)
        self._moved = is_fault(judgements["motion"])
        # Only the judges' time, since the full cloud may have begun before the last of them.
        reported_s += judged_s
        yield Verdicts((identity, *self._weighed(judgements, coarse.summary)), judged_s, compensating=self._moved)

        full: CloudLocation | None = None
        if self._moved:
            # The full cloud is the compensated one if that is good, else the plain one.
            # The plain cloud is computed first: compensation starts from it, and it is the result if that fails.
            # It is computed without response correction, since compensation compares the maps with the frames.
            plain = full_task() if full_task is not None else pipeline.find_full(straightened=False)
            full_task = None
            motion = judgements["motion"]
            percent = motion.verdict.numbers["added_noise_percent"]
            added = None if percent is None else 0.01 * percent
            attempted = attempt(pipeline, plain, images, self._calibration, self._water, added)
            full = attempted.found or pipeline.find_full()
            if attempted.found is not None:
                self._compensated = True
                judgements["motion"] = replace(motion, fault=Fault(FaultCode.COMPENSATED, motion.verdict.text))
            judgements["compensation"] = Judgement(_compensation(attempted, settings.frame_s))
            now_s = time.process_time()
            yield Verdicts((identity, *self._weighed(judgements, full.summary)), now_s - reported_s)
            reported_s = now_s
        # Not both: specks are detected by differences of frames, which motion makes everywhere.
        elif _specks_count(judgements["water"]):
            pipeline.crew.each(self._mask_specks, SIDES)  # specks make no points
            pipeline.masked()

        full = full or (full_task() if full_task is not None else pipeline.find_full())
        self._full = full
        judgements["holes"], judgements["distance"] = self._judge_holes(full), judge_distance(full.summary, rig.volume)
        # Causes are weighed again, with the full cloud.
        weighed = (identity, *self._weighed(judgements, full.summary))
        yield FullCloud(full, weighed, time.process_time() - reported_s)

    def bracket_steps(self, first: ProcessedSequence) -> Iterator[SequenceFact]:
        """Process the second sequence of a scan after its last frame, and merge it with the ``first``.

        The last fact is the ``Bracket``. The generator may be abandoned at any fact. Raises ValueError if frames are
        missing.
        """
        begun_s = time.process_time()
        judgements: tuple[Judgement, ...] = ()
        for fact in self.steps():
            match fact:
                case PatternIdentity(judgement):
                    judgements = (judgement,)
                case FullCloud():
                    judgements = fact.judgements
                case _:
                    pass
            yield WorkProgress("second exposure")
        if self.finished:
            bracket = self.merge_with(first)
        else:
            verdict = Verdict("pair", False, {}, "the second exposure's frames are not what they should be")
            bracket = Bracket(None, Judgement(verdict, judgements[0].fault))
        yield replace(bracket, second=judgements, cpu_s=time.process_time() - begun_s)

    def _judge_holes(self, full: CloudLocation) -> Judgement:
        """Judge the final cloud, which is in the table, against the left camera's images."""
        pipeline, sequence = self._pipeline, self._pipeline.sequence
        mask = pipeline.decoded("left").mask
        step = grid_step_px(mask.shape[1])
        has_point, before = np.zeros(mask.shape, bool), None
        for first, stop in full.pieces:
            has_point.reshape(-1)[pipeline.table.points.pixel[first:stop]] = True
        grid = np.s_[::step, ::step]
        if self._compensated:
            before = np.zeros(mask.shape, bool)
            before.reshape(-1)[pipeline.sample(step).pixel] = True
            before = before[grid]
        return judge_holes(mask[grid], self._frames["left"][sequence.dark][grid], has_point[grid], before)

    def _mask_specks(self, side: str) -> None:
        decoded, noise = self._pipeline.decoded(side), of_side(self._settings.noise, side)
        mask_specks(self._pipeline.sequence, self._frames[side], decoded, noise)

    def run(self, *, even_if_wrong: bool = False) -> FullCloud | None:
        """Run all ``steps`` at once; return the last one, or ``None`` after wrong patterns.

        Raises ValueError.
        """
        (last,) = deque(self.steps(even_if_wrong=even_if_wrong), maxlen=1)
        return last if isinstance(last, FullCloud) else None

    def process(self, frames: Mapping[str, NDArray[np.uint8]], settings: AcquisitionSettings) -> FullCloud:
        """Process a complete sequence, also with wrong patterns: ``begin``, ``push`` and all ``steps``.

        Raises ValueError if ``frames`` do not fit the sequence.
        """
        self.begin(settings)
        for _ in self.push_all(frames):
            pass
        last = self.run(even_if_wrong=True)
        assert last is not None, "no wrong pattern ends the steps"
        return last

    @property
    def finished(self) -> bool:
        """True if the full cloud is known and no sequence has begun since."""
        return self._full is not None

    def cloud(self, location: CloudLocation) -> Cloud:
        """Return a copy of the points of the last cloud."""
        return self._pipeline.table.cloud(location)

    def hold(self) -> ProcessedSequence:
        """Return a copy of this sequence, to be merged with a second one; ValueError unless ``finished``."""
        return self._processed({side: self._pipeline.decoded(side).copied() for side in SIDES})

    def merge_with(self, first: ProcessedSequence) -> Bracket:
        """Merge this sequence, the second of its scan, with the ``first`` one.

        Raises ValueError unless ``finished``.
        """
        return merge_bracket(self._pipeline, first, self._processed({}))

    def _processed(self, maps: Mapping[str, DecodedMaps]) -> ProcessedSequence:
        if self._full is None:
            raise ValueError("the sequence has no full cloud yet; ask for it before another one is begun")
        bright = self._frames["left"][self._pipeline.sequence.bright]
        return ProcessedSequence(
            self._pipeline.table.cloud(self._full),
            maps,
            bright,
            self._settings.exposure,
            self._settings.noise,
            moved=self._moved,
            spoilt=self._moved and not self._compensated,
        )

    def _weighed(self, judgements: Mapping[str, Judgement], summary: CloudSummary) -> tuple[Judgement, ...]:
        """Return the judgements, with the causes of a poor scan weighed against each other."""
        return with_causes(tuple(judgements.values()), summary, self._settings.exposure, self._settings.steps)


def _specks_count(water: Judgement | None) -> bool:
    """Return True if specks disturb enough pixels to be masked one by one."""
    return water is not None and (water.verdict.numbers["speck_percent"] or 0.0) > WORTH_MASKING_PERCENT


def _compensation(attempted: Attempt, frame_s: float) -> Verdict:
    """Return the verdict ``compensation``; its errors are in units of those of a scan at rest."""
    if attempted.motion is None:
        return Verdict("compensation", False, {}, attempted.why)
    motion = attempted.motion
    # Displacement from the first sine image to the last, over the time between.
    lasted_s = frame_s * (motion.frames[-1] - motion.frames[0])
    x, y, z = (motion.motion_mm[-1, :3] - motion.motion_mm[0, :3]) / lasted_s
    numbers: dict[str, float | None] = {
        "error_before": attempted.error_before,
        "error_after": attempted.error_after,
        "noise_factor": motion.noise_factor,
        "speed_x_mm_s": float(x),
        "speed_y_mm_s": float(y),
        "speed_z_mm_s": float(z),
        "reference_s": motion.reference_s,
    }
    return Verdict("compensation", attempted.found is not None, numbers, attempted.why)
