"""Examination of one hidden rig: it is calibrated from scans, and judged by other scans.

All scans go through drivers, capture and reconstruction as on the instrument. Frames are dropped with the next scan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.extract import CALIBRATING_GAP_MM, BarCertificate, extract
from appliance.desk.evaluation import JUDGING_GAP_MM
from appliance.measure.accept.points import NotFound
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.points.quality import QualityLimits
from bench.instrument import Instrument, open_instrument
from bench.metrology.air import air_of, start_of
from bench.metrology.judge import ArtefactErrors, Errors, look_at, summed_up
from bench.metrology.poses import Pose, unseen
from bench.metrology.rungs import IN_SALT, LATER, PLACES, WAYS, Made, RungInput, climb, needed
from hw_sim.objects.shapes import BALL_DISTANCE_MM, BALL_RADIUS_MM
from hw_sim.options import WorldOptions
from tests.support.truth import WATER

SALINITY_PSU = 35.0
SALT = Water(WATER.temperature_c, SALINITY_PSU, WATER.wavelength_nm)


@dataclass(frozen=True, slots=True)
class Effort:
    """Compared rungs, and number of unseen scans per rig. Salt water needs the rung ``LATER``."""

    rungs: tuple[str, ...] = tuple(WAYS)
    boards: int = 20
    """Pictures of a board in air."""
    bars: int = 4
    planes: int = 3
    frustums: int = 3
    salt_bars: int = 3
    salt_planes: int = 1
    salt_frustums: int = 1

    @property
    def scans(self) -> int:
        """Number of scans per rig, with those for calibration."""
        fresh = len(needed(self.rungs)) + self.bars + self.planes + self.frustums
        return fresh + self.salt

    @property
    def salt(self) -> int:
        """Scans in salt water."""
        return self.salt_bars + self.salt_planes + self.salt_frustums if LATER in self.rungs else 0


@dataclass(frozen=True, slots=True)
class Row:
    """One rung of one rig."""

    rung: str
    seed: int
    errors: Errors
    recordings: int
    seconds: float


class NotCalibratedError(Exception):
    """Error of a calibration scan that did not become a recording; the text says why."""


def examine(
    truth_set: str, seed: int, width_px: int, height_px: int, effort: Effort, step: Callable[[str], None]
) -> list[Row]:
    """Return the rows of all rungs for rig ``seed`` of a set. ``step(text)`` is called after each scan.

    Raises ScanFailedError, NotCalibratedError and the errors of the solvers.
    """
    options = WorldOptions(truth=truth_set, seed=seed, width_px=width_px, height_px=height_px)
    name = f"{truth_set} {seed}"
    with open_instrument(options) as instrument:
        truth = instrument.world.truth
        start = start_of(air_of(truth, effort.boards))
        recordings = _recorded(instrument, needed(effort.rungs), start, lambda what: step(f"{name}: {what}"))
        results = climb(RungInput(start, recordings, truth), effort.rungs)
        poses = unseen(truth, effort.bars, effort.planes, effort.frustums)
        rows = _judged(instrument, poses, results, seed, lambda what: step(f"{name}: {what}"))
    if not effort.salt:
        return rows
    fresh = next(result for result in results if result.rung == LATER)
    later = [
        Made(rung, fresh.calibration, water, fresh.recordings, fresh.seconds)
        for rung, water in zip(IN_SALT, (SALT, WATER), strict=True)
    ]
    salty = WorldOptions(
        truth=truth_set, seed=seed, width_px=width_px, height_px=height_px, water={"salinity_psu": SALINITY_PSU}
    )
    with open_instrument(salty) as instrument:
        poses = unseen(instrument.world.truth, effort.salt_bars, effort.salt_planes, effort.salt_frustums)
        return rows + _judged(instrument, poses, later, seed, lambda what: step(f"{name}, salt water: {what}"))


def _recorded(
    instrument: Instrument, names: Sequence[str], start: Calibration, step: Callable[[str], None]
) -> dict[str, Recording]:
    recordings = {}
    certificate = BarCertificate(BALL_DISTANCE_MM, radius_mm=BALL_RADIUS_MM)
    with Pipeline(start, WATER, instrument.sequence, QualityLimits(max_gap_mm=CALIBRATING_GAP_MM)) as pipeline:
        for name in names:
            thing, pose = PLACES[name]
            _decoded(instrument, pipeline, thing, pose)
            maps = pipeline.decoded("left"), pipeline.decoded("right")
            stated = certificate if thing == "ballbar" else None
            recording = extract(name, stated, pipeline.full(), *maps, start, WATER)
            if isinstance(recording, NotFound):
                raise NotCalibratedError(f"{name} at {pose}: {recording.reason}")
            recordings[name] = recording
            step(name)
    return recordings


def _judged(
    instrument: Instrument,
    poses: Sequence[tuple[str, Pose]],
    results: Sequence[Made],
    seed: int,
    step: Callable[[str], None],
) -> list[Row]:
    measurements: list[list[ArtefactErrors]] = [[] for _ in results]
    first = results[0]
    with Pipeline(
        first.calibration, first.water, instrument.sequence, QualityLimits(max_gap_mm=JUDGING_GAP_MM)
    ) as pipeline:
        for thing, pose in poses:
            _decoded(instrument, pipeline, thing, pose)
            for result, list_ in zip(results, measurements, strict=True):
                pipeline.recalibrate(result.calibration, result.water)
                list_.append(look_at(pipeline.full(), thing, instrument.world.truth))
            step(thing)
    return [
        Row(result.rung, seed, summed_up(measured), result.recordings, result.seconds)
        for result, measured in zip(results, measurements, strict=True)
    ]  # fmt: skip


def _decoded(instrument: Instrument, pipeline: Pipeline, thing: str, pose: Pose) -> None:
    """Record and decode one scan."""
    instrument.scan(thing, pose)
    pipeline.reset()
    for index in range(len(instrument.sequence)):
        for side in SIDES:
            pipeline.push(side, instrument.store.frames(side), index)
    pipeline.coarse()
