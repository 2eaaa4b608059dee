"""Reprocessing of a stored scan, and the reason why its cloud has (nearly) no points."""

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
"""Smallest share of the decoded left pixels that must become points.

With the right calibration more than half of them do even in turbid water. With a wrong one the ray gaps are
millimetres; where the gap changes sign across the image, a band of a few hundredths of the pixels passes by chance.
"""
LEAST_DECODED_SHARE = 0.001
"""Smallest share of the left image that must be decoded: fewer pixels show no surface that could be measured."""
SAMPLED_PIXELS = 5_000


@dataclass(frozen=True, slots=True)
class EmptyCloud:
    """Reason why a cloud has (nearly) no points."""

    reason: str
    """The reason in words, with the remedy."""
    by_calibration: bool
    """True if the frames are good and another calibration would make points of them."""


def why_empty(pipeline: Pipeline, cloud: Cloud, judgements: Sequence[Judgement]) -> EmptyCloud | None:
    """Return the reason why ``cloud`` has (nearly) no points, with the remedy.

    It is ``None`` where the cloud has enough. ``pipeline`` still holds the decoded scan. Few points whose rays meet
    count: they are of a small or hardly lit object.
    """
    mask = pipeline.decoded("left").mask
    decoded, points = int(np.count_nonzero(mask == Mask.VALID)), cloud.summary.points
    if points > LEAST_SHARE * decoded:
        return None
    # Causes in their order: no surface was seen; frames of other patterns, in which no rays can meet; rays that do not
    # meet (the calibration); points that meet and were masked.
    if decoded < LEAST_DECODED_SHARE * mask.size:
        return EmptyCloud(
            f"shows no pattern: {decoded} of {mask.size} pixels of the left camera could be decoded"
            f"{_faults_in_words(judgements)}; scan again, nearer or in clearer water",
            by_calibration=False,
        )
    stride = max(1, round((mask.size / SAMPLED_PIXELS) ** 0.5))
    gaps_mm = pipeline.sample(stride).ray_gap_mm
    # With the instrument's limit, not with the caller's: evaluations set wider limits on purpose.
    meet = stride**2 * int(np.count_nonzero(gaps_mm <= QualityLimits().max_gap_mm)) > LEAST_SHARE * decoded
    wrong_frames = any(
        judgement.verdict.name == IDENTITY and judgement.verdict.passed is False for judgement in judgements
    )
    if not meet and not wrong_frames:
        return EmptyCloud(
            f"{points} points are left of {decoded} decoded pixels: the rays of both cameras do not meet, "
            "so the calibration is not that of the scan; give the right one with --calibration FILE",
            by_calibration=True,
        )
    if points and meet:
        return None
    where = "" if wrong_frames else ", nearer or in clearer water"
    return EmptyCloud(
        f"{points or 'no'} points are left of {decoded} decoded pixels{_faults_in_words(judgements)}; scan "
        f"again{where}",
        by_calibration=False,
    )


def _faults_in_words(judgements: Sequence[Judgement]) -> str:
    faults = [judgement.fault for judgement in judgements if judgement.fault is not None]
    return "".join(f" ({fault.code.value}: {fault.detail})" for fault in faults)


@dataclass(frozen=True, slots=True, eq=False)
class ReprocessedScan:
    """A stored scan after all steps of the instrument's procedure."""

    pipeline: Pipeline
    """Closed; it keeps the decoded maps of both cameras, of the second exposure where there are two."""
    cloud: Cloud
    water: Water
    """Water in which it was reconstructed."""
    judgements: tuple[Judgement, ...]
    """Judgements of the first exposure, of the second, and of ``bracket``."""
    empty: EmptyCloud | None = None
    """Reason why there are (nearly) no points, with the remedy; ``None`` where there are enough."""
    bracket: Verdict | None = None
    """Verdict on two exposures as one cloud; ``None``: there is one."""

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults of the scan as the instrument shows them."""
        all_faults = tuple(judgement.fault for judgement in self.judgements if judgement.fault is not None)
        return all_faults if self.bracket is None else faults_of_both(all_faults)

    @property
    def grade(self) -> Grade:
        """The grade that the instrument gives such a scan; BAD where it would not keep it."""
        codes = {fault.code for fault in self.faults}
        if not SPOILS_SCAN.isdisjoint(codes):
            return Grade.BAD
        return grade(self.cloud.summary.coverage_percent, self.cloud.summary.noise_mm, codes)

    @property
    def unfit(self) -> Fault | None:
        """Fault because of which the decoded maps must not calibrate; ``None`` where they may.

        The maps are those before any compensation.
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
    """Reconstruct and judge a stored scan with ``calibration``, as the instrument does.

    Only the first sequence of a bracket is used. ``settings``: those of its capture (``settings_of_scan``). ``limits``
    ``None``: those of the instrument. Faulty frames are reconstructed, too: the judgements name the faults.
    """
    water = scan.water(calibration)
    with Pipeline(calibration, water, scan.sequence, limits, noise=settings.noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = _work_through(processor, scan.frames, settings, len(pipeline.sequence), progress)
        # A copy, since the next scan overwrites the pipeline's table.
        judgements, cloud = full.judgements, pipeline.table.cloud(full.cloud)
        return ReprocessedScan(pipeline, cloud, water, judgements, why_empty(pipeline, cloud, judgements))


def reprocess_bracket(
    first: stored.StoredScan,
    second: Mapping[str, NDArray[np.uint8]],
    both: tuple[AcquisitionSettings, AcquisitionSettings],
    calibration: Calibration,
    progress: Progress,
) -> ReprocessedScan:
    """Reconstruct and judge both sequences of a bracket as one scan, as the instrument does.

    ``second``: frames by side. ``both``: the settings of either capture. Raises ScanError where frames are faulty, or
    the sequences do not show the same scene.
    """
    water = first.water(calibration)
    with Pipeline(calibration, water, first.sequence, noise=both[0].noise) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        judgements: list[Judgement] = []
        first_results: list[ProcessedSequence] = []
        for name, frames, settings in (("first", first.frames, both[0]), ("second", second, both[1])):
            judged = _work_through(processor, frames, settings, len(pipeline.sequence), progress).judgements
            # The judgement on the identity of the patterns comes first.
            spoiled = judged[0].fault
            if spoiled is not None:
                raise stored.ScanError(f"{name} sequence: {spoiled.code.value}: {spoiled.detail}")
            judgements += judged
            if not first_results:
                # The pipeline keeps one sequence only: the first one is copied before the second overwrites it.
                first_results.append(processor.hold())
        progress("merging")
        merged = processor.merge_with(first_results[0])
        verdict = merged.pair.verdict
        if merged.cloud is None:
            raise stored.ScanError(f"{first.folder}: {verdict.text}; merge two exposures from one place")
        cloud = pipeline.table.cloud(merged.cloud)
        empty = why_empty(pipeline, cloud, judged)
        return ReprocessedScan(pipeline, cloud, water, (*judgements, merged.pair), empty, verdict)


def _work_through(
    processor: SequenceProcessor,
    frames: Mapping[str, NDArray[np.uint8]],
    settings: AcquisitionSettings,
    count: int,
    progress: Progress,
) -> FullCloud:
    """Run every step of the procedure on one stored sequence of ``count`` frames, and return the last one.

    Wrong patterns do not end it.
    """
    progress("loading")
    processor.begin(settings)
    for index in processor.push_all(frames):
        progress(f"decoding frame {index + 1} of {count}")
    progress("judging")
    full: FullCloud | None = None
    for step in processor.steps(even_if_wrong=True):
        match step:
            case Verdicts():
                progress("compensating the motion" if step.compensating else "matching")
            case FullCloud():
                full = step
            case _:
                pass
    assert full is not None, "the last step, if no pattern is wrong"
    return full
