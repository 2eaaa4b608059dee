"""Owns a stored scan run through the instrument's procedure once more: its clouds, its judgements, and why it may have
no points.

It also owns why a reconstruction leaves no points, or nearly none: what was recorded, or the calibration that does not
fit it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.base import Progress
from appliance.measure import IDENTITY_NAME as IDENTITY
from appliance.measure import (
    SPOILS_POINTS,
    SPOILS_SCAN,
    AcquisitionSettings,
    Calibration,
    Cloud,
    Fault,
    FaultCode,
    FullCloud,
    Grade,
    Judgement,
    Mask,
    Pipeline,
    ProcessedSequence,
    QualityLimits,
    SequenceProcessor,
    Verdict,
    Verdicts,
    Water,
    faults_of_both,
    grade,
)
from appliance.store import scan as stored

LEAST_SHARE = 0.05
"""Least share of the left pixels that were decoded which become points.

A calibration that fits leaves more than half of them even in turbid water. One that does not makes the rays of a point
miss each other by millimetres; where that amount changes sign across the picture, a band of a few hundredths of the
pixels passes by chance.
"""
LEAST_DECODED_SHARE = 0.001
"""Least share of the left picture that is decoded: fewer pixels show nothing that could be measured."""
SAMPLED_PIXELS = 5_000


@dataclass(frozen=True, slots=True)
class Empty:
    """Reason why a cloud has (nearly) no points."""

    reason: str
    """The reason in words, with what to do."""
    by_calibration: bool
    """The frames are good; another calibration would find points in them."""


def why_empty(pipeline: Pipeline, cloud: Cloud, judgements: Sequence[Judgement]) -> Empty | None:
    """Return why ``cloud`` has (nearly) no points, and what to do; ``None`` where it has some that mean something.

    ``pipeline`` still holds the decoded scan. Few points whose rays meet are points: of a small or hardly lit thing.
    """
    mask = pipeline.decoded("left").mask
    decoded, points = int(np.count_nonzero(mask == Mask.VALID)), cloud.summary.points
    if points > LEAST_SHARE * decoded:
        return None
    # The order of blame: nothing was seen; frames of other patterns, in which no rays can meet; rays that do not meet
    # (the calibration); points that meet and were masked.
    if decoded < LEAST_DECODED_SHARE * mask.size:
        return Empty(
            f"shows no pattern on anything: {decoded} of {mask.size} pixels of the left camera could be decoded"
            f"{_faults_in_words(judgements)}; scan again, nearer or in clearer water",
            by_calibration=False,
        )
    stride = max(1, round((mask.size / SAMPLED_PIXELS) ** 0.5))
    gaps_mm = pipeline.sample(stride).ray_gap_mm
    # With the instrument's limit, not with the caller's: evaluations ask for points with wide gaps on purpose.
    meet = stride**2 * int(np.count_nonzero(gaps_mm <= QualityLimits().max_gap_mm)) > LEAST_SHARE * decoded
    wrong_frames = any(one.verdict.name == IDENTITY and one.verdict.passed is False for one in judgements)
    if not meet and not wrong_frames:
        return Empty(
            f"{points} points are left of {decoded} decoded pixels: the rays of both cameras do not meet, so this "
            "calibration is "
            "not that of the instrument as it was then; give the right one with --calibration FILE",
            by_calibration=True,
        )
    if points and meet:
        return None
    where = "" if wrong_frames else ", nearer or in clearer water"
    return Empty(
        f"{points or 'no'} points are left of {decoded} decoded pixels{_faults_in_words(judgements)}; scan "
        f"again{where}",
        by_calibration=False,
    )


def _faults_in_words(judgements: Sequence[Judgement]) -> str:
    faults = [judgement.fault for judgement in judgements if judgement.fault is not None]
    return "".join(f" ({fault.code.value}: {fault.detail})" for fault in faults)


@dataclass(frozen=True, slots=True, eq=False)
class ReprocessedScan:
    """A stored scan after everything the instrument does with one."""

    pipeline: Pipeline
    """Closed; it keeps the decoded maps of both cameras, of the second exposure where there are two."""
    cloud: Cloud
    water: Water
    """Water in which it was reconstructed."""
    judgements: tuple[Judgement, ...]
    """Those of the first exposure, of the second, and ``bracket``."""
    empty: Empty | None = None
    """Reason why there are (nearly) no points, and what to do; ``None`` where there are some."""
    bracket: Verdict | None = None
    """Verdict on two exposures as one cloud; ``None``: there is one."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults that are held against the scan."""
        found = tuple(judgement.fault for judgement in self.judgements if judgement.fault is not None)
        return found if self.bracket is None else faults_of_both(found)

    @property
    def grade(self) -> Grade:
        """The grade that the instrument gives such a scan; BAD where it would not keep it."""
        codes = {fault.code for fault in self.faults}
        if not SPOILS_SCAN.isdisjoint(codes):
            return Grade.BAD
        return grade(self.cloud.summary.coverage_percent, self.cloud.summary.noise_mm, codes)

    @property
    def unfit(self) -> Fault | None:
        """Reason why its decoded maps must not calibrate; ``None`` where they may.

        They are those of before any compensation.
        """
        return next((fault for fault in self.faults if _spoils_maps(fault)), None)


def _spoils_maps(fault: Fault) -> bool:
    return fault.code in SPOILS_SCAN | SPOILS_POINTS | {FaultCode.COMPENSATED}


def reprocess_scan(
    scan: stored.StoredScan,
    calibration: Calibration,
    settings: AcquisitionSettings,
    progress: Progress,
    limits: QualityLimits | None = None,
) -> ReprocessedScan:
    """Reconstruct and judge a stored scan with ``calibration``, as the instrument does; of a pair, its first sequence.

    ``settings``: how it was taken (``settings_of_scan``). ``limits`` ``None``: those of the instrument. Frames that are
    not what they should be give their points all the same: the judgements say so.
    """
    water = scan.water(calibration)
    with Pipeline(calibration, water, scan.sequence, limits, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = _work_through(processor, scan.frames, settings, len(pipeline.sequence), progress)
        # Copied out of the pipeline's table, which the next scan would write over.
        judgements, cloud = full.judgements, pipeline.table.cloud(full.found)
        return ReprocessedScan(pipeline, cloud, water, judgements, why_empty(pipeline, cloud, judgements))


def reprocess_bracket(
    first: stored.StoredScan,
    second: Mapping[str, NDArray[np.uint8]],
    both: tuple[AcquisitionSettings, AcquisitionSettings],
    calibration: Calibration,
    progress: Progress,
) -> ReprocessedScan:
    """Reconstruct and judge ``first`` and the frames of a ``second`` sequence as one, as the instrument does.

    ``both``: how either was taken. Raises ScanError where frames are not what they should be, or both do not show the
    same.
    """
    water = first.water(calibration)
    with Pipeline(calibration, water, first.sequence, noise=both[0].noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        judgements: list[Judgement] = []
        held: list[ProcessedSequence] = []
        for name, frames, settings in (("first", first.frames, both[0]), ("second", second, both[1])):
            judged = _work_through(processor, frames, settings, len(pipeline.sequence), progress).judgements
            # The identity of the patterns comes first in what was said.
            spoiled = judged[0].fault
            if spoiled is not None:
                raise stored.ScanError(f"{name} sequence: {spoiled.code.value}: {spoiled.detail}")
            judgements += judged
            if not held:
                # The pipeline keeps one sequence only: the first is copied out before the second is pushed over it.
                held.append(processor.hold())
        progress("merging")
        merged = processor.merge_with(held[0])
        verdict = merged.pair.verdict
        if merged.found is None:
            raise stored.ScanError(
                f"{first.folder}: {verdict.text}; two exposures make one cloud where they were taken from one place"
            )
        cloud = pipeline.table.cloud(merged.found)
        empty = why_empty(pipeline, cloud, judged)
        return ReprocessedScan(pipeline, cloud, water, (*judgements, merged.pair), empty, verdict)


def _work_through(
    processor: SequenceProcessor,
    frames: Mapping[str, NDArray[np.uint8]],
    settings: AcquisitionSettings,
    count: int,
    progress: Progress,
) -> FullCloud:
    """Take every step with one stored sequence of ``count`` frames, also where it shows wrong patterns; return the last
    one."""
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
