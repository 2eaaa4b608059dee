"""Owns the judgement whether a scan's fringes were sines: how much noisier its points are because they were not.

A projector that makes grey by bit planes shows an exposure that takes a part of its frame some of its bits longer than
others. What that bends coordinates by is taken out of them (``appliance.measure.points.straighten``), but where a
coordinate hardly changes with the phase, straightening it multiplies its noise; and where the bend folds, no coordinate
is right. Light that flickers cannot be told from such fringes either.
"""

from __future__ import annotations

import math

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.points.straighten import PhaseBend
from appliance.measure.verdict import Judgement, Verdict

NAME = "fringes"
MOST_NOISIER = 1.2
"""Largest factor by which straightening may multiply the noise of the points: as for a movement that is undone."""


def judge_fringes(bend: PhaseBend, period_px: int) -> Judgement:
    """Judge what the projector's response ``bend`` does to points of a scan with fringes of ``period_px``."""
    noisier = math.sqrt(bend.variance_factor(period_px)) if bend.counts else 1.0
    numbers: dict[str, float | None] = {"bend_px": bend.rms_px, "noise_factor": noisier, "limit": MOST_NOISIER}
    if noisier <= MOST_NOISIER:
        return Judgement(Verdict(NAME, True, numbers, "sines, or nearly so"))
    percent = 100.0 * (noisier - 1.0)
    text = (
        f"this exposure bends the fringes by {bend.rms_px:.2f} px; straightened, points are {percent:.0f} % noisier. "
        "Take another "
        "exposure; kingfisher calibration measure exposures tells which are good"
    )
    return Judgement(
        Verdict(NAME, False, numbers, text), Fault(FaultCode.FRINGES_BENT, text, {"noise_percent": percent})
    )
