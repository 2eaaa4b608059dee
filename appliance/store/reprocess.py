"""Owns a stored scan run through the instrument's procedure once more: its clouds, its judgements, and why it may have no points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.measure import (
    SPOILS_POINTS,
    SPOILS_SCAN,
    AcquisitionSettings,
    Calibration,
    Cloud,
    Fault,
    FaultCode,
    FullCloud,
    Judgement,
    PatternSequence,
    Pipeline,
    ProcessedSequence,
    QualityLimits,
    SequenceProcessor,
    Verdicts,
    Water,
    build_sequence,
    faults_in,
    faults_of_both,
)
from appliance.store import scan as stored
from appliance.store.empty import Empty, why_empty


def refuse_empty(folder: Path, empty: Empty | None) -> None:
    """Raises ScanError where ``why_empty`` had a reason."""
    if empty is not None:
        raise stored.ScanError(f"{folder}: {empty.reason}")


@dataclass(frozen=True, slots=True, eq=False)
class ReprocessedScan:
    """A stored scan after everything the instrument does with one."""

    pipeline: Pipeline
    """Closed; it keeps the decoded maps of both cameras, but for a pair."""
    cloud: Cloud
    water: Water
    """Water in which it was reconstructed."""
    judgements: tuple[Judgement, ...]
    empty: Empty | None = None
    """Reason why there are (nearly) no points, and what to do; ``None`` where there are some."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults that are held against the scan."""
        return tuple(judgement.fault for judgement in self.judgements if judgement.fault is not None)

    @property
    def unfit(self) -> Fault | None:
        """Reason why its decoded maps must not calibrate; ``None`` where they may. They are those of before any compensation."""
        return next((fault for fault in self.faults if _spoils_maps(fault)), None)


def _spoils_maps(fault: Fault) -> bool:
    return fault.code in SPOILS_SCAN | SPOILS_POINTS | {FaultCode.COMPENSATED}


def reprocess_scan(
    scan: stored.StoredScan,
    calibration: Calibration,
    settings: AcquisitionSettings,
    progress: Callable[[str], None],
    limits: QualityLimits | None = None,
) -> ReprocessedScan:
    """Reconstruct and judge a stored scan with ``calibration``, as the instrument does; of a pair, its first sequence.

    ``settings``: how it was taken (``settings_of_scan``). ``limits`` ``None``: those of the instrument. Frames that are not
    what they should be give their points all the same: the judgements say so.
    """
    water = water_of_scan(scan, calibration)
    with Pipeline(calibration, water, sequence_of_scan(scan), limits, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = _work_through(processor, scan.frames, settings, len(pipeline.sequence), progress)
        # Copied out of the pipeline's table, which the next scan would write over.
        judgements, cloud = full.judgements, pipeline.table.cloud(full.found)
        return ReprocessedScan(pipeline, cloud, water, judgements, why_empty(pipeline, cloud, judgements))


@dataclass(frozen=True, slots=True, eq=False)
class ReprocessedBracket:
    """Two sequences after everything the instrument does with a pair."""

    cloud: Cloud | None
    """Cloud of both; ``None``: ``pair`` says why not."""
    water: Water
    first: tuple[Judgement, ...]
    second: tuple[Judgement, ...]
    pair: Judgement
    empty: Empty | None = None
    """Reason for (nearly) no points, as ``ReprocessedScan.empty``."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults that are held against the pair."""
        return faults_of_both(faults_in((*self.first, *self.second, self.pair)))


def reprocess_bracket(
    first: stored.StoredScan,
    second: Mapping[str, NDArray[np.uint8]],
    both: tuple[AcquisitionSettings, AcquisitionSettings],
    calibration: Calibration,
    progress: Callable[[str], None],
) -> ReprocessedBracket:
    """Reconstruct and judge ``first`` and the frames of a ``second`` sequence as one, as the instrument does.

    ``both``: how either was taken. Raises ScanError where frames are not what they should be.
    """
    water = water_of_scan(first, calibration)
    with Pipeline(calibration, water, sequence_of_scan(first), noise=both[0].noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        judged = []
        held: list[ProcessedSequence] = []
        for name, frames, settings in (("first", first.frames, both[0]), ("second", second, both[1])):
            judgements = _work_through(processor, frames, settings, len(pipeline.sequence), progress).judgements
            # The identity of the patterns comes first in what was said.
            spoiled = judgements[0].fault
            if spoiled is not None:
                raise stored.ScanError(f"{name} sequence: {spoiled.code.value}: {spoiled.detail}")
            judged.append(judgements)
            if not held:
                # The pipeline keeps one sequence only: the first is copied out before the second is pushed over it.
                held.append(processor.hold())
        progress("merging")
        merged = processor.merge_with(held[0])
        cloud = None if merged.found is None else pipeline.table.cloud(merged.found)
        empty = None if cloud is None else why_empty(pipeline, cloud, judged[1])
        return ReprocessedBracket(cloud, water, judged[0], judged[1], merged.pair, empty)


def _work_through(
    processor: SequenceProcessor,
    frames: Mapping[str, NDArray[np.uint8]],
    settings: AcquisitionSettings,
    count: int,
    progress: Callable[[str], None],
) -> FullCloud:
    """Take every step with one stored sequence of ``count`` frames, also where it shows wrong patterns; return the last one."""
    progress("loading")
    processor.begin(settings)
    for index in processor.push_all(frames):
        progress(f"decoding frame {index + 1} of {count}")
    progress("judging")
    full: FullCloud | None = None
    for step in processor.steps(even_if_wrong=True):
        match step:
            case Verdicts():
                progress("taking the motion out" if step.compensating else "matching")
            case FullCloud():
                full = step
            case _:
                pass
    assert full is not None, "the last step, since no wrong pattern ends them"
    return full


def sequence_of_scan(scan: stored.StoredScan) -> PatternSequence:
    """Return the patterns it was recorded with."""
    made = scan.manifest.record.sequence
    return build_sequence(made.period_px, made.width_px, made.height_px)


def water_of_scan(scan: stored.StoredScan, calibration: Calibration) -> Water:
    """Return the water the scan was recorded in, as its manifest says; else that of the calibration."""
    water = scan.manifest.record.water
    t, s, w = water.get("temperature_c"), water.get("salinity_psu"), water.get("wavelength_nm")
    if t is None or s is None or w is None:
        return calibration.water
    return Water(t, s, w)
