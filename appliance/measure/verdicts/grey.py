"""Owns the judgement whether both cameras see grey alike: which of them bends it, by a gamma or a table.

The mean of a fringe's four steps lies at the same share of the way from dark to bright in every pixel of every camera
whose grey values are proportional to light: surface, water, blur and other light only add and multiply light, and the
share is the projector's alone. It differs between the cameras where one of them bends grey. Such a camera scans, and
its points look good; but its fringes ripple otherwise than the other one's, and whatever is told from grey values
(light, water, noise) is wrong.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.light.sides import SIDES
from appliance.measure.verdict import Judgement, Verdict
from appliance.measure.verdicts.light.levels import Sample

NAME = "grey"
MOST_APART = 0.015
"""Largest difference of the cameras' shares.

In twenty scenes at rest, moving by up to 60 mm/s, in milk, behind drift, with torches and flickering light, with drawn
sensors that bend by up to 2 %, it was 0.005; Gamma 0.8 in one camera makes 0.02 to 0.04, Gamma 0.45 0.08 to 0.11.
"""
LEAST_LIGHT_DN, MOST_DN = 40.0, 245.0
"""Bright minus dark, and bright: what is fainter is noise, and what is brighter may be saturated."""
FEWEST = 200
"""Pixels below which nothing is said."""
SURE = 5.0
"""Least multiple of its standard error that the difference must have."""
PROPORTIONAL = 127.5 / 247.0
"""Share that a projector makes whose light is proportional to the code: mean code of a sine over that of bright."""


@dataclass(frozen=True, slots=True)
class _Share:
    """The shares of one camera, as medians over its pixels."""

    of: Mapping[Direction, float]
    error: float
    """Standard error of the less certain one."""


def judge_grey(samples: Mapping[str, Sample], sequence: PatternSequence) -> Judgement:
    """Judge whether both cameras see the mean of the sines at the same share of their light, by the ``samples`` of
    ``left`` and ``right``.

    Failed with GREY_BENT: one of them, the fault's device, has more of it. ``None``: too little well-lit is seen, or
    the directions contradict each other. Numbers: each camera's share, mean of both directions, and ``limit``, of their
    difference.
    """
    shares = {side: _share(samples[side], sequence) for side in SIDES}
    numbers: dict[str, float | None] = {
        f"{side}_share": None if share is None else _mean(share) for side, share in shares.items()
    }
    numbers["limit"] = MOST_APART
    left, right = shares["left"], shares["right"]
    if left is None or right is None:
        return Judgement(Verdict(NAME, None, numbers, "too little is well lit to compare the cameras' grey"))
    apart = {d: left.of[d] - right.of[d] for d in Direction}
    # Few pixels with much noise must accuse nobody.
    least = max(MOST_APART, SURE * math.hypot(left.error, right.error))
    # What a movement or a lamp makes is another thing in each direction; a camera bends both alike.
    if all(one > least for one in apart.values()) or all(one < -least for one in apart.values()):
        side, other = ("left", "right") if apart[Direction.X] > 0.0 else ("right", "left")
        mine, others = numbers[f"{side}_share"], numbers[f"{other}_share"]
        text = (
            f"camera.{side} sees the mean of the fringes at {mine:.2f} of its light and camera.{other} at {others:.2f} "
            f"(linear: up to {PROPORTIONAL:.2f}): "
            f"it bends grey. Under features of camera.{side} set Gamma = 1.0, GammaEnable and LUTEnable = false, and "
            f"no Gamma above 1 in camera.{other}"
        )
        return Judgement(Verdict(NAME, False, numbers, text), Fault(FaultCode.GREY_BENT, text, device=f"camera.{side}"))
    if all(abs(one) <= least for one in apart.values()):
        return Judgement(Verdict(NAME, True, numbers, "both cameras see grey alike"))
    return Judgement(Verdict(NAME, None, numbers, "what changes between the images hides how the cameras see grey"))


def _share(sample: Sample, sequence: PatternSequence) -> _Share | None:
    # What is faint is noise, and at the top of the scale every camera bends grey by clipping it.
    lit = (sample.contrast_dn >= LEAST_LIGHT_DN) & (sample.top_dn <= MOST_DN)
    count = int(np.count_nonzero(lit))
    if count < FEWEST:
        return None
    dark_dn, light_dn = sample.dark_dn[lit], sample.contrast_dn[lit]
    # Each direction by itself: what changes between the images is another thing in either.
    of, errors = {}, []
    for direction in Direction:
        steps: NDArray[np.float32] = sample.grey[list(sequence.axis(direction).sine)][:, lit].astype(np.float32)
        shares = (steps.mean(axis=0) - dark_dn) / light_dn
        lower, middle, upper = (float(one) for one in np.quantile(shares, (0.25, 0.5, 0.75)))
        of[direction] = middle
        # Standard error of a median of normal values: 1.25 σ/√n, with σ = 0.74 times the distance of the quartiles.
        errors.append(1.25 * 0.74 * (upper - lower) / math.sqrt(count))
    return _Share(of, max(errors))


def _mean(share: _Share) -> float:
    return sum(share.of.values()) / len(share.of)
