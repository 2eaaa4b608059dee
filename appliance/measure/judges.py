"""The table of judges of a whole sequence, and the samples that they need of single frames.

A new verdict is one file in ``appliance/measure/verdicts``, one row in ``JUDGES``, and, if the diver is to read it, one
row in the alerts' table. The judge of identity is not in the table: it runs before any cloud, since points of wrong
patterns have no meaning.

JUDGES, run_judges        the table, and the run of all its judges
Gatherer, JudgeSamples    samples of the frames, taken while the next ones are captured

The diver waits after the last frame, not before. So a judge's samples of single frames, or of one direction alone, are
taken as soon as possible; only computations that need both directions or the coordinates are left for later. A stored
sequence is pushed frame by frame in the same way. A gatherer serves one sequence, so that nothing of a capture that
broke off can come into the next one's verdicts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.points.crew import WorkItem, WorkList
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.table import Cloud
from appliance.measure.scan_images import PixelGrid, ScanImages
from appliance.measure.verdict import Judgement
from appliance.measure.verdicts.fringes import NAME as FRINGES
from appliance.measure.verdicts.fringes import judge_fringes
from appliance.measure.verdicts.grey import NAME as GREY
from appliance.measure.verdicts.grey import judge_grey
from appliance.measure.verdicts.identity.lines import Lines, LineTaker
from appliance.measure.verdicts.light.changes import EarlyFit, fit_early
from appliance.measure.verdicts.light.judge import judge_light
from appliance.measure.verdicts.light.levels import Sample, Sampler
from appliance.measure.verdicts.medium import NAME as MEDIUM
from appliance.measure.verdicts.medium import judge_medium
from appliance.measure.verdicts.motion.judge import judge_motion
from appliance.measure.verdicts.motion.texture import Averager, Means
from appliance.measure.verdicts.sides import NAME as SIDES_NAME
from appliance.measure.verdicts.sides import judge_sides
from appliance.measure.verdicts.sight.judge import VisibleFringes, look, see
from appliance.measure.verdicts.water.backscatter import water_grid
from appliance.measure.verdicts.water.judge import judge_water
from appliance.measure.verdicts.window import look_at_windows, window_grid


@dataclass(frozen=True, slots=True)
class JudgeSamples:
    """Samples of one camera's sequence for the judges."""

    lines: Mapping[Direction, Lines]
    """Samples for the identity of the patterns, by direction."""
    sample: Sample
    """Pixels for the judge of light."""
    light: EarlyFit
    """Fit of X to the same pixels, for the same judge."""
    visible: VisibleFringes
    """Fringes that are visible without decoding."""
    means: Means
    """Images of texture for the judge of motion."""
    water: PixelGrid
    """Pixels for the judge of water."""
    windows: PixelGrid
    """Pixels for the judge of windows."""


class Gatherer:
    """Takes the samples of one camera's sequence; ``noise`` is the camera's."""

    def __init__(self, sequence: PatternSequence, noise: CameraNoise) -> None:
        self._sequence, self._noise = sequence, noise
        self._lines = LineTaker(sequence, noise)
        self._sampler = Sampler(sequence)
        self._averager = Averager(sequence)
        self._grids = (water_grid(sequence), window_grid(sequence))
        self._results_of_x: tuple[EarlyFit, VisibleFringes] | None = None
        self._pushed = 0

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take the samples of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        self._pushed = index + 1
        self._lines.push(frames, index)
        self._sampler.push(frames, index)
        self._averager.push(frames, index)
        for grid in self._grids:
            grid.push(frames, index)
        if index == self._sequence.axis(Direction.X).last:
            self._results_of_x = fit_early(self._sampler.grey, self._sequence), see(frames, self._sequence, self._noise)

    def finish(self) -> JudgeSamples:
        """Return the samples, after the last frame. Raises ValueError if frames are missing."""
        if self._results_of_x is None or self._pushed != len(self._sequence):
            raise ValueError(
                f"{self._pushed} of {len(self._sequence)} frames were pushed; push all before asking for verdicts"
            )
        light, visible = self._results_of_x
        return JudgeSamples(
            self._lines.finish(), self._sampler.finish(), light, visible, self._averager.finish(), *self._grids
        )


def gather(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> JudgeSamples:
    """Return the samples of complete ``frames`` (n, h, w) uint8 of one camera."""
    gatherer = Gatherer(sequence, noise)
    for index in range(len(frames)):
        gatherer.push(frames, index)
    return gatherer.finish()


CHANGES = frozenset({FaultCode.MOVED, FaultCode.LIGHT_FLICKERS})
"""Faults by which the light changes from frame to frame."""
SIGHT_POINTS = 7_500
"""Number of left pixels whose depth is computed for the judge of sight, without limits."""


@dataclass(frozen=True, slots=True)
class JudgeInput:
    """Evidence for every judge."""

    images: ScanImages
    samples: Mapping[str, JudgeSamples]
    """Samples of the frames, by side."""
    cloud: Cloud
    """The coarse cloud."""
    rig: StereoRig
    water_index: float
    """Refractive index of the water at the projector's wavelength."""
    identity: Judgement
    """Judgement whether each frame shows its pattern."""
    pipeline: Pipeline
    """Pipeline for points at any depth, also outside of the working volume."""


Earlier = Mapping[str, Judgement | None]
"""Judgements that a judge ``needs``, by their names."""


@dataclass(frozen=True, slots=True)
class Judge:
    """One row of the table."""

    name: str
    """Name of its verdict in the manifest."""
    judge: Callable[[JudgeInput, Earlier], Judgement | None]
    """The function; it returns ``None`` without a judgement."""
    needs: tuple[str, ...] = ()
    """Judges whose judgements it needs; these need none themselves."""


def _judge_sight(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge objects at any depth, and fringes too weak to be decoded."""
    left = evidence.rig.left
    # The stride makes the number of pixels, and so the time, independent of the camera's size.
    stride = math.ceil((left.width_px * left.height_px / SIGHT_POINTS) ** 0.5)
    return Judgement(
        look(
            evidence.images,
            evidence.rig,
            evidence.water_index,
            evidence.pipeline.sample(stride, any_depth=True),
            evidence.pipeline.limits,
            evidence.identity.verdict.numbers.get("parallax_percent"),
            {side: samples.visible for side, samples in evidence.samples.items()},
        )
    )


def _judge_windows(evidence: JudgeInput, earlier: Earlier) -> Judgement | None:
    """Judge the ports; not after motion, which also makes fringes soft in one camera alone."""
    if is_fault(earlier["motion"]):
        return None
    windows = look_at_windows(evidence.images, {side: samples.windows for side, samples in evidence.samples.items()})
    return Judgement(windows.verdict(), remembered=windows)


def _judge_fringes(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge the fringes by the phase error that the response correction will remove."""
    return judge_fringes(evidence.pipeline.bend(), evidence.images.sequence.period_px)


def _judge_light(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge the light, with the phase error of the fringes."""
    settings = evidence.images.settings
    samples = {side: samples.sample for side, samples in evidence.samples.items()}
    early = {side: samples.light for side, samples in evidence.samples.items()}
    return judge_light(
        evidence.images, settings.exposure, settings.steps, evidence.pipeline.bend().rms_px, samples, early
    )


def _judge_water(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge the water by the left camera's images."""
    grid = evidence.samples["left"].water
    return judge_water(evidence.images, evidence.cloud, evidence.rig, evidence.water_index, grid).judgement


def _judge_motion(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge the motion."""
    means = {side: samples.means for side, samples in evidence.samples.items()}
    return judge_motion(evidence.images, evidence.cloud, evidence.rig, evidence.water_index, means).judgement


def _judge_grey(evidence: JudgeInput, earlier: Earlier) -> Judgement | None:
    """Judge the linearity of the cameras; not after motion or a change of light.

    Either makes sines that do not fit the bright frame.
    """
    if any(
        judgement is not None and judgement.fault is not None and judgement.fault.code in CHANGES
        for judgement in earlier.values()
    ):
        return None
    return judge_grey({side: samples.sample for side, samples in evidence.samples.items()}, evidence.images.sequence)


def _judge_sides(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge which camera is the left one, by matched pixels."""
    return judge_sides(*evidence.pipeline.matches(), evidence.rig, evidence.water_index)


def _judge_medium(evidence: JudgeInput, _: Earlier) -> Judgement:
    """Judge whether the scan was taken in the stated water, by the same pixels."""
    return judge_medium(*evidence.pipeline.matches(), evidence.rig, evidence.water_index)


JUDGES = (
    Judge("light", _judge_light),
    Judge(FRINGES, _judge_fringes),
    Judge("water", _judge_water),
    Judge("sight", _judge_sight),
    Judge("windows", _judge_windows, needs=("motion",)),
    Judge("motion", _judge_motion),
    Judge(GREY, _judge_grey, needs=("motion", "light")),
    Judge(SIDES_NAME, _judge_sides),
    Judge(MEDIUM, _judge_medium),
)
"""Judges in the order in which their verdicts are reported and stored."""


@dataclass(frozen=True, slots=True)
class JudgeResult:
    """The result of one judge."""

    name: str
    judgement: Judgement | None
    """``None``: it made no judgement."""
    cpu_s: float
    """Processor time of the judge."""


def run_judges(evidence: JudgeInput, tasks: WorkList) -> Iterator[JudgeResult]:
    """Run every judge, those with needs last; yield each result when it and those before it are known.

    Helpers take ``tasks`` from the end of the table; they may begin before the first result is yielded.
    """
    # Stable: judges without needs keep the table's order, and one level of needs is all there is (ADR 0038).
    order = sorted(JUDGES, key=lambda judge: len(judge.needs))
    tasks_by_judge: dict[str, WorkItem[Judgement | None]] = {}

    def run_judge(judge: Judge) -> Judgement | None:
        return judge.judge(evidence, {name: tasks_by_judge[name].answer() for name in judge.needs})

    # Caller and helper work from both ends, so that they share the work evenly. A judge is added after its needs.
    by_name = {judge.name: judge for judge in JUDGES}
    for judge in reversed(order):
        for name in (*judge.needs, judge.name):
            if name not in tasks_by_judge:
                tasks_by_judge[name] = tasks.add(partial(run_judge, by_name[name]))
    return (
        JudgeResult(judge.name, tasks_by_judge[judge.name].answer(), tasks_by_judge[judge.name].cpu_s)
        for judge in order
    )


def in_table_order(judgements: Earlier) -> dict[str, Judgement]:
    """Return the judgements in the table's order, without those that are ``None``."""
    return {judge.name: judgement for judge in JUDGES if (judgement := judgements.get(judge.name)) is not None}


def is_fault(judgement: Judgement | None) -> bool:
    """Return True if a judgement has a fault."""
    return judgement is not None and judgement.fault is not None
