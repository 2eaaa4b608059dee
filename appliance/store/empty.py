"""Owns why a reconstruction leaves no points, or nearly none: what was recorded, or the calibration that does not fit it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from appliance.measure import IDENTITY_NAME as IDENTITY
from appliance.measure import Cloud, Judgement, Mask, Pipeline, QualityLimits

LEAST_SHARE = 0.05
"""Least share of the left pixels that were decoded which become points. A calibration that fits leaves more than half of them even in turbid water. One that
does not makes the rays of a point miss each other by millimetres; where that amount changes sign across the picture, a band
of a few hundredths of the pixels passes by chance."""
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
    # The order of blame: nothing was seen; frames of other patterns, in which no rays can meet; rays that do not meet (the calibration);
    # points that meet and were masked.
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
            f"{points} points are left of {decoded} decoded pixels: the rays of both cameras do not meet, so this calibration is "
            "not that of the instrument as it was then; give the right one with --calibration FILE",
            by_calibration=True,
        )
    if points and meet:
        return None
    where = "" if wrong_frames else ", nearer or in clearer water"
    return Empty(
        f"{points or 'no'} points are left of {decoded} decoded pixels{_faults_in_words(judgements)}; scan again{where}",
        by_calibration=False,
    )


def _faults_in_words(judgements: Sequence[Judgement]) -> str:
    faults = [judgement.fault for judgement in judgements if judgement.fault is not None]
    return "".join(f" ({fault.code.value}: {fault.detail})" for fault in faults)
