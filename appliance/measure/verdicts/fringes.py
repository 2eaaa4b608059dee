"""The verdict ``fringes``: the noise that non-sinusoidal fringes add to the points.

A projector may make grey by bit planes. An exposure shorter than its frame then shows some bits longer than others. The
response correction (``appliance.measure.points.straighten``) removes the phase error. But where the coordinate hardly
changes with the phase it multiplies the noise, and where the coordinate is not monotonic in the phase no coordinate is
right. Flickering light cannot be distinguished from such fringes.
"""

from __future__ import annotations

import math

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.points.straighten import PhaseBend
from appliance.measure.verdict import Judgement, Verdict

NAME = "fringes"
MOST_NOISIER = 1.2
"""Largest factor by which the response correction may multiply the noise of the points, as for motion compensation."""


def judge_fringes(bend: PhaseBend, period_px: int) -> Judgement:
    """Judge the noise that the phase error ``bend`` adds to a scan with fringes of ``period_px``."""
    noisier = math.sqrt(bend.variance_factor(period_px)) if bend.counts else 1.0
    numbers: dict[str, float | None] = {"bend_px": bend.rms_px, "noise_factor": noisier, "limit": MOST_NOISIER}
    if noisier <= MOST_NOISIER:
        return Judgement(Verdict(NAME, True, numbers, "the fringes are sinusoidal"))
    percent = 100.0 * (noisier - 1.0)
    text = (
        f"this exposure distorts the fringes by {bend.rms_px:.2f} px; after response correction, points are "
        f"{percent:.0f} % noisier. "
        "Choose another exposure; `kingfisher calibration measure exposures` lists good ones"
    )
    return Judgement(
        Verdict(NAME, False, numbers, text), Fault(FaultCode.FRINGES_BENT, text, {"noise_percent": percent})
    )
