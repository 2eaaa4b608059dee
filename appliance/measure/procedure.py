"""Owns what happens to a sequence: identify → coarse cloud → judge → compensate → full cloud.

It is written once, as the generator ``SequenceProcessor.steps``. The instrument's worker and the desk run it, so that the
same frames get the same points and the same verdicts. Pieces of the warm-up, and benches of one stage, drive the pipeline alone.
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
from appliance.measure.cloud import CloudSummary, Found
from appliance.measure.decode.decoder import DecodedMaps
from appliance.measure.decode.specks import mask_specks
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.judges import Gatherer, JudgeInput, in_order, is_fault, judged_by_all
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
"""Share of the pixels with coordinates; where specks disturb fewer, they are not looked for one by one: 20 ms of a
scan."""


class SequenceProcessor:
    """Takes one sequence after the other through ``pipeline`` and past the judges.

    ``begin``, ``push`` for every frame of both sides as they come, then all ``steps``. A second sequence with another
    exposure follows in the same way between ``hold`` and ``merge_with``. The pipeline's helpers work beside the caller
    from the last frame on, and on nothing any more once the steps have been left, or another sequence was begun.
    """

    def __init__(self, pipeline: Pipeline, calibration: Calibration, water: Water) -> None:
        self._pipeline = pipeline
        self._calibration, self._water = calibration, water
        self._settings = AcquisitionSettings()
        self._frames: dict[str, NDArray[np.uint8]] = {}
        self._gatherers: dict[str, Gatherer]
        """Made by ``begin``: a sequence's own."""
        self._moved = self._compensated = False
        self._full: Found | None = None
        self._tasks = WorkList(pipeline.crew)
        """Tasks that belong to the sequence in work."""
        self._last_frames: list[WorkItem[None]] = []

    def begin(self, settings: AcquisitionSettings) -> None:
        """Expect frame 0 of a sequence that was taken with ``settings``."""
        # Steps of the last one may have been left without being closed: nobody may be at its maps when frames come.
        self._tasks.close()
        self._tasks, self._last_frames = WorkList(self._pipeline.crew), []
        self._settings, self._full = settings, None
        self._moved = self._compensated = False
        self._frames.clear()
        # What a scan that was cut off has left in the old ones is gone with them.
        pipeline, noise = self._pipeline, settings.noise
        self._gatherers = {side: Gatherer(pipeline.sequence, of_side(noise, side)) for side in SIDES}
        self._pipeline.expect(settings.noise)
        self._pipeline.reset()

    def push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        """Decode frame ``index`` of one side's ``frames`` (n, h, w) uint8, which must not change until the last step,
        and take what judges want of it.

        Raises ValueError unless frames come as 0, 1, …; of the last frame, with the first step.
        """
        self._frames[side] = frames
        if index == len(self._pipeline.sequence) - 1 and self._pipeline.crew.helpers:
            # Somebody waits from now on: both sides at once.
            self._last_frames.append(self._tasks.add(partial(self._push, side, frames, index)))
        else:
            self._push(side, frames, index)

    def _push(self, side: str, frames: NDArray[np.uint8], index: int) -> None:
        self._pipeline.push(side, frames, index)
        self._gatherers[side].push(frames, index)

    def push_all(self, frames: Mapping[str, NDArray[np.uint8]]) -> Iterator[int]:
        """Push all ``frames`` of a stored sequence, both sides of one index after the other; yields each index before
        its frames."""
        for index in range(len(self._pipeline.sequence)):
            yield index
            for side in SIDES:
                self.push(side, frames[side], index)

    def steps(self, *, even_if_wrong: bool = False) -> Iterator[SequenceFact]:
        """Work on the sequence after its last frame; yields each fact as soon as it is known. It may be left at any of
        them.

        Where a frame shows another pattern than it should, nothing follows ``PatternIdentity`` unless
        ``even_if_wrong``. Raises ValueError where frames are missing.
        """
        begun_s = time.process_time()
        with self._tasks as tasks:
            answers(self._last_frames)
            yield from self._steps(tasks, begun_s, even_if_wrong)

    def _steps(self, tasks: WorkList, told_s: float, even_if_wrong: bool) -> Iterator[SequenceFact]:
        """``told_s``: processor time up to which facts have said what they took."""
        pipeline, settings, rig = self._pipeline, self._settings, self._calibration.rig
        gathered = {side: gatherer.finish() for side, gatherer in self._gatherers.items()}
        lines = {side: one.lines for side, one in gathered.items()}

        # Identity first of all: with a wrong pattern every coordinate would be wrong, and so every other verdict. The
        # coarse cloud is begun beside it, and then was made in vain.
        finding = tasks.add(pipeline.find_coarse)
        identity = judge_identity(self._frames, pipeline.sequence, settings.noise, settings.exposure, lines)
        yield PatternIdentity(identity)
        if identity.fault is not None and not even_if_wrong:
            return
        coarse = finding.answer(helping=True)

        images = ScanImages(pipeline.sequence, self._frames, {side: pipeline.decoded(side) for side in SIDES}, settings)
        # Judges look at raw frames, maps and the coarse cloud, before anything is changed by compensation or masking.
        given = JudgeInput(images, gathered, pipeline.table.cloud(coarse), rig, self._water.index, identity, pipeline)
        bend = pipeline.bend()
        judging = judged_by_all(given, tasks)
        now_s = time.process_time()
        yield CoarseCloud(coarse, now_s - told_s)
        told_s = now_s

        spoken: dict[str, Judgement | None] = {}
        judged_s = 0.0
        begun: Callable[[], Found] | None = None
        for one in judging:
            spoken[one.name] = one.judgement
            judged_s += one.cpu_s
            # The full cloud need not wait for judges that have nothing to do with it: compensation, too, starts from
            # the plain one. Where coordinates are changed first, specks masked or a bend taken out, it waits: judges
            # read them.
            if one.name == "water" and not bend.counts and not _specks_count(one.judgement):
                begun = pipeline.begin_full(tasks)
            yield WorkProgress(one.name)
        said = in_order(spoken)
        self._moved = is_fault(said["motion"])
        # The judges' own time: the full cloud may be in work before all of them have spoken.
        told_s += judged_s
        yield Verdicts((identity, *self._weighed(said, coarse.summary)), judged_s, compensating=self._moved)

        full: Found | None = None
        if self._moved:
            # The full cloud will be that of one moment of the scan where that makes it good, else the plain one.
            # The plain cloud is made first: compensation starts from it, and it is what remains if that fails.
            # It solves phases from the frames anew, and compares: with maps as they were decoded.
            plain = begun() if begun is not None else pipeline.find_full(straightened=False)
            begun = None
            motion = said["motion"]
            percent = motion.verdict.numbers["added_noise_percent"]
            added = None if percent is None else 0.01 * percent
            tried = attempt(pipeline, plain, images, self._calibration, self._water, added)
            full = tried.found or pipeline.find_full()
            if tried.found is not None:
                self._compensated = True
                said["motion"] = replace(motion, fault=Fault(FaultCode.COMPENSATED, motion.verdict.text))
            said["compensation"] = Judgement(_compensation(tried, settings.frame_s))
            now_s = time.process_time()
            yield Verdicts((identity, *self._weighed(said, full.summary)), now_s - told_s)
            told_s = now_s
        # Not both: specks are told by frames that differ, which they do wherever something moved.
        elif _specks_count(said["water"]):
            pipeline.crew.each(self._mask_specks, SIDES)  # what passed by makes no points
            pipeline.masked()

        full = full or (begun() if begun is not None else pipeline.find_full())
        self._full = full
        said["holes"], said["distance"] = self._judge_holes(full), judge_distance(full.summary, rig.volume)
        # Causes are weighed again, with the full cloud.
        weighed = (identity, *self._weighed(said, full.summary))
        yield FullCloud(full, weighed, time.process_time() - told_s)

    def bracket_steps(self, first: ProcessedSequence) -> Iterator[SequenceFact]:
        """Work on the second sequence of a scan after its last frame, and merge it with the ``first``; the last fact is
        the ``Bracket``.

        It may be left at any of them. Raises ValueError where frames are missing.
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

    def _judge_holes(self, full: Found) -> Judgement:
        """Judge the final cloud, which is in the table, against what the left camera saw."""
        pipeline, sequence = self._pipeline, self._pipeline.sequence
        mask = pipeline.decoded("left").mask
        step = grid_step_px(mask.shape[1])
        there, before = np.zeros(mask.shape, bool), None
        for first, stop in full.pieces:
            there.reshape(-1)[pipeline.table.points.pixel[first:stop]] = True
        grid = np.s_[::step, ::step]
        if self._compensated:
            before = np.zeros(mask.shape, bool)
            before.reshape(-1)[pipeline.sample(step).pixel] = True
            before = before[grid]
        return judge_holes(mask[grid], self._frames["left"][sequence.dark][grid], there[grid], before)

    def _mask_specks(self, side: str) -> None:
        decoded, noise = self._pipeline.decoded(side), of_side(self._settings.noise, side)
        mask_specks(self._pipeline.sequence, self._frames[side], decoded, noise)

    def run(self, *, even_if_wrong: bool = False) -> FullCloud | None:
        """Take all ``steps`` at once; returns the last one, ``None`` where wrong patterns ended them.

        Raises ValueError.
        """
        (last,) = deque(self.steps(even_if_wrong=even_if_wrong), maxlen=1)
        return last if isinstance(last, FullCloud) else None

    def process(self, frames: Mapping[str, NDArray[np.uint8]], settings: AcquisitionSettings) -> FullCloud:
        """Do everything with a whole sequence, also where it shows wrong patterns: ``begin``, ``push`` and all
        ``steps``.

        Raises ValueError where ``frames`` are not of the sequence.
        """
        self.begin(settings)
        for _ in self.push_all(frames):
            pass
        last = self.run(even_if_wrong=True)
        assert last is not None, "no wrong pattern ends the steps"
        return last

    @property
    def finished(self) -> bool:
        """The full cloud was found, and nothing begun since."""
        return self._full is not None

    def cloud(self, found: Found) -> Cloud:
        """Return a copy of the points that were found last."""
        return self._pipeline.table.cloud(found)

    def hold(self) -> ProcessedSequence:
        """Return a copy of this sequence, for a second one to be merged with. Raises ValueError unless ``finished``."""
        return self._processed({side: self._pipeline.decoded(side).copied() for side in SIDES})

    def merge_with(self, first: ProcessedSequence) -> Bracket:
        """Merge this sequence, the second of its scan, with the ``first`` one; raises ValueError unless ``finished``."""
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

    def _weighed(self, said: Mapping[str, Judgement], summary: CloudSummary) -> tuple[Judgement, ...]:
        """Return what the judges said, with the causes of a poor scan weighed against each other."""
        return with_causes(tuple(said.values()), summary, self._settings.exposure, self._settings.steps)


def _specks_count(water: Judgement | None) -> bool:
    """Tell whether particles passed by in so many pixels that these are looked for."""
    return water is not None and (water.verdict.numbers["speck_percent"] or 0.0) > WORTH_MASKING_PERCENT


def _compensation(tried: Attempt, frame_s: float) -> Verdict:
    """Return the verdict ``compensation``; its errors are in units of those of a scan at rest."""
    if tried.motion is None:
        return Verdict("compensation", False, {}, tried.why)
    motion = tried.motion
    # Displacement from the first sine image to the last, over the time between.
    lasted_s = frame_s * (motion.frames[-1] - motion.frames[0])
    x, y, z = (motion.motion_mm[-1, :3] - motion.motion_mm[0, :3]) / lasted_s
    numbers: dict[str, float | None] = {
        "error_before": tried.error_before,
        "error_after": tried.error_after,
        "noise_factor": motion.noise_factor,
        "speed_x_mm_s": float(x),
        "speed_y_mm_s": float(y),
        "speed_z_mm_s": float(z),
        "reference_s": motion.reference_s,
    }
    return Verdict("compensation", tried.found is not None, numbers, tried.why)
