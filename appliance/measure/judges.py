"""Owns the table of judges: what is said of a whole sequence once its coarse cloud is known, and by whom.

A new verdict is one file in ``appliance/measure/verdicts``, one row in ``JUDGES``, and one row in the alerts' table
where the diver is to be told. The judge of identity is not among them: it runs before any cloud, since points of wrong
patterns mean nothing.

It also owns what is taken from each frame for the judges while the next ones are being recorded.

After the last frame somebody waits, before it nobody does. So whatever a judge needs of single frames, or of one
direction alone, is read as soon as it is there; what is left for afterwards is what needs both directions or the
coordinates. There is no other way: a stored sequence is pushed frame by frame as well. A gatherer serves one sequence
and is dropped with it, so that nothing of a scan that was cut off can come into the next one's verdicts.
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
class Gathered:
    """Evidence that one camera's whole sequence left for its judges."""

    lines: Mapping[Direction, Lines]
    """Samples for the identity of the patterns, by direction."""
    sample: Sample
    """Pixels for the judge of light."""
    light: EarlyFit
    """Fit of X to the same pixels, for the same."""
    visible: VisibleFringes
    """Fringes that are seen without decoding."""
    means: Means
    """Images of texture for the judge of motion."""
    water: PixelGrid
    """Pixels for the judge of water."""
    windows: PixelGrid
    """Pixels for the judge of windows."""


class Gatherer:
    """Gathers one sequence of one camera, whose grey values scatter by ``noise``."""

    def __init__(self, sequence: PatternSequence, noise: CameraNoise) -> None:
        self._sequence, self._noise = sequence, noise
        self._lines = LineTaker(sequence, noise)
        self._sampler = Sampler(sequence)
        self._averager = Averager(sequence)
        self._grids = (water_grid(sequence), window_grid(sequence))
        self._of_x: tuple[EarlyFit, VisibleFringes] | None = None
        self._pushed = 0

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take what is wanted of frame ``index`` of ``frames`` (n, h, w) uint8; in order, from 0."""
        self._pushed = index + 1
        self._lines.push(frames, index)
        self._sampler.push(frames, index)
        self._averager.push(frames, index)
        for grid in self._grids:
            grid.push(frames, index)
        if index == self._sequence.axis(Direction.X).last:
            self._of_x = fit_early(self._sampler.grey, self._sequence), see(frames, self._sequence, self._noise)

    def finish(self) -> Gathered:
        """Return what was gathered, after the last frame. Raises ValueError where frames are missing."""
        if self._of_x is None or self._pushed != len(self._sequence):
            raise ValueError(
                f"{self._pushed} of {len(self._sequence)} frames were pushed; push all before asking for verdicts"
            )
        light, visible = self._of_x
        return Gathered(
            self._lines.finish(), self._sampler.finish(), light, visible, self._averager.finish(), *self._grids
        )


def gather(frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise) -> Gathered:
    """Gather whole ``frames`` (n, h, w) uint8 of one camera."""
    gatherer = Gatherer(sequence, noise)
    for index in range(len(frames)):
        gatherer.push(frames, index)
    return gatherer.finish()


CHANGES = frozenset({FaultCode.MOVED, FaultCode.LIGHT_FLICKERS})
"""Faults by which one image of a sequence has another light than the next."""
SIGHT_POINTS = 7_500
"""Left pixels that are asked at what depth, near or far, they see something."""


@dataclass(frozen=True, slots=True)
class JudgeInput:
    """Evidence that every judge is given."""

    images: ScanImages
    gathered: Mapping[str, Gathered]
    """Samples that were taken from the images as they arrived."""
    cloud: Cloud
    """The coarse cloud."""
    rig: StereoRig
    water_index: float
    """Refractive index of the water at the projector's wavelength."""
    identity: Judgement
    """Judgement whether each frame shows the pattern it should."""
    pipeline: Pipeline
    """Pipeline that can be asked for points at any depth, also outside of the measuring volume."""


Earlier = Mapping[str, Judgement | None]
"""Judgements that a judge ``needs``, by their names."""


@dataclass(frozen=True, slots=True)
class Judge:
    """One row of the table."""

    name: str
    """The name of its verdict in the manifest."""
    judge: Callable[[JudgeInput, Earlier], Judgement | None]
    """Returns ``None`` where there is nothing to be said."""
    needs: tuple[str, ...] = ()
    """Judges that must have spoken before; they need none themselves."""


def _look(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge what is there at whatever depth, and fringes too weak to be decoded."""
    left = given.rig.left
    # One pixel in stride² is asked, whatever the camera's size, so that the judge takes the same time.
    stride = math.ceil((left.width_px * left.height_px / SIGHT_POINTS) ** 0.5)
    return Judgement(
        look(
            given.images,
            given.rig,
            given.water_index,
            given.pipeline.sample(stride, any_depth=True),
            given.pipeline.limits,
            given.identity.verdict.numbers.get("parallax_percent"),
            {side: one.visible for side, one in given.gathered.items()},
        )
    )


def _look_at_windows(given: JudgeInput, earlier: Earlier) -> Judgement | None:
    """Judge the windows; nothing where something moved: what moves is soft in one camera and not in the other, too."""
    if is_fault(earlier["motion"]):
        return None
    windows = look_at_windows(given.images, {side: one.windows for side, one in given.gathered.items()})
    return Judgement(windows.verdict(), remembered=windows)


def _judge_fringes(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge the fringes by the bend that the pipeline will take out of them."""
    return judge_fringes(given.pipeline.bend(), given.images.sequence.period_px)


def _judge_light(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge the light, with what is known of the fringes' own bend."""
    settings = given.images.settings
    samples = {side: one.sample for side, one in given.gathered.items()}
    early = {side: one.light for side, one in given.gathered.items()}
    return judge_light(given.images, settings.exposure, settings.steps, given.pipeline.bend().rms_px, samples, early)


def _judge_water(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge the water by what the left camera saw."""
    grid = given.gathered["left"].water
    return judge_water(given.images, given.cloud, given.rig, given.water_index, grid).judgement


def _judge_motion(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge the movement between instrument and scene."""
    means = {side: one.means for side, one in given.gathered.items()}
    return judge_motion(given.images, given.cloud, given.rig, given.water_index, means).judgement


def _judge_grey(given: JudgeInput, earlier: Earlier) -> Judgement | None:
    """Judge the cameras' grey; nothing where something moved, or other light changed: either makes sines that do not
    belong to the bright."""
    if any(one is not None and one.fault is not None and one.fault.code in CHANGES for one in earlier.values()):
        return None
    return judge_grey({side: one.sample for side, one in given.gathered.items()}, given.images.sequence)


def _judge_sides(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge which camera is the left one, by pixels that see the same."""
    return judge_sides(*given.pipeline.matches(), given.rig, given.water_index)


def _judge_medium(given: JudgeInput, _: Earlier) -> Judgement:
    """Judge whether the scan was taken in the water that is stated, by the same pixels."""
    return judge_medium(*given.pipeline.matches(), given.rig, given.water_index)


JUDGES = (
    Judge("light", _judge_light),
    Judge(FRINGES, _judge_fringes),
    Judge("water", _judge_water),
    Judge("sight", _look),
    Judge("windows", _look_at_windows, needs=("motion",)),
    Judge("motion", _judge_motion),
    Judge(GREY, _judge_grey, needs=("motion", "light")),
    Judge(SIDES_NAME, _judge_sides),
    Judge(MEDIUM, _judge_medium),
)
"""Judges in the order in which their verdicts are told and stored."""


@dataclass(frozen=True, slots=True)
class OneSaid:
    """The word of one judge."""

    name: str
    judgement: Judgement | None
    """``None``: it has nothing to say."""
    cpu_s: float
    """Processor time that it took."""


def judged_by_all(given: JudgeInput, tasks: WorkList) -> Iterator[OneSaid]:
    """Ask every judge, those that need others last; yields what each one says as soon as it and those before it have
    said it.

    Whoever else works on ``tasks`` begins at the table's end; it may do so from now on, before anything is yielded.
    """
    # Stable: judges without needs keep the table's order, and one level of needs is all there is (ADR 0038).
    order = sorted(JUDGES, key=lambda judge: len(judge.needs))
    asked: dict[str, WorkItem[Judgement | None]] = {}

    def ask(judge: Judge) -> Judgement | None:
        return judge.judge(given, {name: asked[name].answer() for name in judge.needs})

    # Two that go towards each other share the work evenly, whatever each judge takes. What is needed is added before
    # what needs it.
    by_name = {judge.name: judge for judge in JUDGES}
    for judge in reversed(order):
        for name in (*judge.needs, judge.name):
            if name not in asked:
                asked[name] = tasks.add(partial(ask, by_name[name]))
    return (OneSaid(judge.name, asked[judge.name].answer(), asked[judge.name].cpu_s) for judge in order)


def in_order(said: Earlier) -> dict[str, Judgement]:
    """Return what the judges ``said``, in the table's order; without those that had nothing to say."""
    return {judge.name: one for judge in JUDGES if (one := said.get(judge.name)) is not None}


def is_fault(judgement: Judgement | None) -> bool:
    """Tell whether a judgement holds something against the scan."""
    return judgement is not None and judgement.fault is not None
