"""Owns the judgement whether the instrument is in the water that is stated, or in air.

Rays that are refracted in another medium than they are traced in miss each other, by an amount that grows with the
distance from each camera's axis. A mount that is off shifts or tilts this pattern, and no mount makes it: with the
right index most of it is gone. In air it is at the index 1. Fresh and salt water differ by a fiftieth of that, which
the health of the calibration watches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.gaps import signed_gap_mm
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.model import StereoRig
from appliance.measure.verdict import Judgement, Verdict

NAME = "medium"
AIR = 1.0
MOST_ASKED, FEWEST = 600, 60
"""Matches that are looked at, and fewer than which nothing is said."""
LEAST_APART_MM = 0.1
"""Spread of the gaps in the standard housing, below which the stated water is believed.

With the rig's own calibration the spread in water is 0.01 to 0.03 mm, with the drawing of a realistic rig 0.1; in air
it is 0.3.
"""
MEETS = 0.5
"""Share of that spread below which it is the air's.

In air 0.04 to 0.09, with the drawing 0.32 to 0.45; in water 1.6 and more.
"""


def judge_medium(
    left_px: NDArray[np.float64], right_px: NDArray[np.float64], rig: StereoRig, water_index: float
) -> Judgement:
    """Judge matched pixels (n, 2) of both cameras, which are traced in water of ``water_index``.

    Failed with NOT_IN_WATER: rays meet in air, and do not in the water. Numbers, mm: ``water_gap_mm`` and
    ``air_gap_mm``, the median distance of the signed gaps from their median, in either.
    """
    step = max(1, len(left_px) // MOST_ASKED)
    left_px, right_px = left_px[::step], right_px[::step]
    if len(left_px) < FEWEST or water_index == AIR:
        return Judgement(Verdict(NAME, None, {}, "too little is seen to tell water from air"))
    water_mm, air_mm = (_spread_mm(signed_gap_mm(rig, index, left_px, right_px)) for index in (water_index, AIR))
    numbers: dict[str, float | None] = {"water_gap_mm": water_mm, "air_gap_mm": air_mm}
    if water_mm < rig.volume.scaled(LEAST_APART_MM) or air_mm >= MEETS * water_mm:
        return Judgement(Verdict(NAME, True if water_mm < air_mm else None, numbers, "nothing speaks for air"))
    text = (
        f"rays miss each other by {water_mm:.2f} mm in the water that is stated, and by {air_mm:.2f} mm in air: the "
        "points are wrong; scan under "
        "water"
    )
    known = {"water_gap_mm": water_mm, "air_gap_mm": air_mm}
    return Judgement(Verdict(NAME, False, numbers, text), Fault(FaultCode.NOT_IN_WATER, text, known))


def _spread_mm(gap_mm: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(gap_mm - np.median(gap_mm))))
