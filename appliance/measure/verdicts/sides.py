"""The verdict ``sides``: whether the left camera is the left one, by the rays of a scan.

Converging cameras see objects beside the axis at different heights: each sees larger what is nearer to it. If their
images are exchanged, the rays of a point miss each other, with opposite signs at the left and at the right, by
centimetres at the corners, for any object. Depths are mirrored about the point where the axes cross, and most points
exceed the limit on ray gaps. No mounting error does that: in the other order the rays meet, or nearly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import signed_gap_mm
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.verdict import Judgement, Verdict

Array = NDArray[np.float64]

NAME = "sides"
MOST_ASKED = 600
"""Number of correspondences that are used at most: a median of so many is good to some percent."""
FEWEST = 60
LEAST_APART_MM = 1.0
"""Least median difference of the ray gaps of both orders, in the standard housing: objects near the axis alone say
nothing."""
MEETS, MISSES = 0.4, 0.6
"""Shares of that difference: below the first the rays of an order meet, from the second on they do not.

With a nominal calibration rays miss by up to a fifth.
"""


def judge_sides(left_px: Array, right_px: Array, rig: StereoRig, water_index: float) -> Judgement:
    """Judge the order of the cameras by correspondences (n, 2) of those that are taken for left and right.

    Failed with SIDES_EXCHANGED: they are exchanged. Passed: they are not. ``None``: the correspondences do not say.
    Numbers, medians in mm: ``gap_mm``, the ray gap; ``exchanged_mm``, the same with the cameras exchanged;
    ``apart_mm``, the difference that the exchange makes.
    """
    step = max(1, len(left_px) // MOST_ASKED)
    left_px, right_px = left_px[::step], right_px[::step]
    numbers: dict[str, float | None] = {"gap_mm": None, "exchanged_mm": None, "apart_mm": None}
    if len(left_px) < FEWEST:
        return Judgement(Verdict(NAME, None, numbers, "too few points to distinguish left from right"))
    usual = signed_gap_mm(rig, water_index, left_px, right_px)
    exchanged = signed_gap_mm(StereoRig(rig.right, rig.left, rig.volume), water_index, left_px, right_px)
    # A common shift is a tilted camera, and says nothing about its side.
    apart = _spread(usual + exchanged), _spread(usual - exchanged)
    gap_mm, exchanged_mm, apart_mm = _spread(usual), _spread(exchanged), max(apart)
    numbers = {"gap_mm": gap_mm, "exchanged_mm": exchanged_mm, "apart_mm": apart_mm}
    if apart_mm < rig.volume.scaled(LEAST_APART_MM):
        return Judgement(
            Verdict(NAME, None, numbers, "not judged: at this distance left and right give the same points")
        )
    if exchanged_mm < MEETS * apart_mm and gap_mm >= MISSES * apart_mm:
        text = (
            f"ray gaps are {gap_mm:.1f} mm, and {exchanged_mm:.1f} mm with the cameras exchanged: "
            "exchange the serial numbers of "
            "camera.left and camera.right in the rig file"
        )
        fault = Fault(FaultCode.SIDES_EXCHANGED, text, {"gap_mm": gap_mm, "exchanged_mm": exchanged_mm})
        return Judgement(Verdict(NAME, False, numbers, text), fault)
    passed = True if gap_mm < MEETS * apart_mm else None
    return Judgement(
        Verdict(
            NAME,
            passed,
            numbers,
            "left and right are not exchanged" if passed else "the ray gaps are large in either order of the cameras",
        )
    )


def _spread(gap_mm: Array) -> float:
    return float(np.median(np.abs(gap_mm - np.median(gap_mm))))
