"""The verdict ``grey``: whether one camera has non-linear grey values, by a gamma or a table.

The mean of the four phase steps lies at the same share of the range from dark to bright in every pixel of every camera
with linear grey values. Surface, water, blur and ambient light only add and multiply light; the share is the
projector's alone. It differs between the cameras if one of them is non-linear. The points of such a camera look good,
but its phase error differs from that of the other one, and all judgements by grey values (light, water, noise) are
wrong.
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

In twenty scenes at rest, moving by up to 60 mm/s, in turbid water, behind particles, with torches and flickering light,
with random sensors that are non-linear by up to 2 %, it was 0.005. Gamma 0.8 in one camera makes 0.02 to 0.04, Gamma
0.45 0.08 to 0.11.
"""
LEAST_LIGHT_DN, MOST_DN = 40.0, 245.0
"""Least bright minus dark, and largest bright: fainter pixels are noise, and brighter ones may be saturated."""
FEWEST = 200
"""Number of pixels below which there is no verdict."""
SURE = 5.0
"""Least multiple of its standard error that the difference must have."""
PROPORTIONAL = 127.5 / 247.0
"""Share by a projector whose light is proportional to the code: mean code of a sine over that of bright."""


@dataclass(frozen=True, slots=True)
class _Share:
    """The shares of one camera, as medians over its pixels."""

    by_direction: Mapping[Direction, float]
    error: float
    """The larger of the two standard errors."""


def judge_grey(samples: Mapping[str, Sample], sequence: PatternSequence) -> Judgement:
    """Judge whether the mean of the sines is the same share of the light in both cameras.

    ``samples``: of both sides. Failed with GREY_BENT: the fault's device has the larger share. ``None``: too few pixels
    are well illuminated, or the directions contradict each other. Numbers: the share of each camera, as mean of both
    directions, and the ``limit`` of their difference.
    """
    shares = {side: _share(samples[side], sequence) for side in SIDES}
    numbers: dict[str, float | None] = {
        f"{side}_share": None if share is None else _mean(share) for side, share in shares.items()
    }
    numbers["limit"] = MOST_APART
    left, right = shares["left"], shares["right"]
    if left is None or right is None:
        return Judgement(Verdict(NAME, None, numbers, "too few well-lit pixels to compare the cameras' grey values"))
    apart = {d: left.by_direction[d] - right.by_direction[d] for d in Direction}
    # Few pixels with much noise must accuse no camera.
    limit = max(MOST_APART, SURE * math.hypot(left.error, right.error))
    # A non-linear camera changes both directions alike; motion or a lamp does not.
    if all(difference > limit for difference in apart.values()) or all(
        difference < -limit for difference in apart.values()
    ):
        side, other_side = ("left", "right") if apart[Direction.X] > 0.0 else ("right", "left")
        larger_share, smaller_share = numbers[f"{side}_share"], numbers[f"{other_side}_share"]
        text = (
            f"camera.{side} sees the mean of the fringes at {larger_share:.2f} of its light and camera.{other_side} at {smaller_share:.2f} "
            f"(linear: up to {PROPORTIONAL:.2f}): its grey values are not linear. Under features of camera.{side} set Gamma = 1.0, GammaEnable and LUTEnable = false, and "
            f"no Gamma above 1 in camera.{other_side}"
        )
        return Judgement(Verdict(NAME, False, numbers, text), Fault(FaultCode.GREY_BENT, text, device=f"camera.{side}"))
    if all(abs(difference) <= limit for difference in apart.values()):
        return Judgement(Verdict(NAME, True, numbers, "both cameras have the same grey response"))
    return Judgement(
        Verdict(NAME, None, numbers, "not judged: the images change too much to compare the cameras' grey values")
    )


def _share(sample: Sample, sequence: PatternSequence) -> _Share | None:
    # Faint pixels are noise, and at the top of the scale every camera clips.
    is_lit = (sample.contrast_dn >= LEAST_LIGHT_DN) & (sample.top_dn <= MOST_DN)
    count = int(np.count_nonzero(is_lit))
    if count < FEWEST:
        return None
    dark_dn, light_dn = sample.dark_dn[is_lit], sample.contrast_dn[is_lit]
    # Each direction by itself, since changes between the images differ between them.
    by_direction, errors = {}, []
    for direction in Direction:
        steps: NDArray[np.float32] = sample.grey[list(sequence.axis(direction).sine)][:, is_lit].astype(np.float32)
        shares = (steps.mean(axis=0) - dark_dn) / light_dn
        lower, middle, upper = (float(quartile) for quartile in np.quantile(shares, (0.25, 0.5, 0.75)))
        by_direction[direction] = middle
        # Standard error of a median of normal values: 1.25 σ/√n, with σ = 0.74 times the distance of the quartiles.
        errors.append(1.25 * 0.74 * (upper - lower) / math.sqrt(count))
    return _Share(by_direction, max(errors))


def _mean(share: _Share) -> float:
    return sum(share.by_direction.values()) / len(share.by_direction)
