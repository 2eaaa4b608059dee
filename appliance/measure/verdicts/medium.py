"""The verdict ``medium``: whether the instrument is in the stated water or in air.

Rays that are traced in another medium than the real one miss each other, by an amount that grows with the distance from
each camera's axis. Wrong extrinsics shift or tilt this pattern of ray gaps, but do not make it: with the right index
most of it is gone. The index of air is 1. Fresh and salt water differ by a fiftieth of the difference between water and
air; the calibration health watches that.
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
"""Number of correspondences that are used at most, and the least for a verdict."""
LEAST_APART_MM = 0.1
"""Spread of the ray gaps in the standard housing, below which the stated water is believed.

In water the spread is 0.01 to 0.03 mm with the rig's calibration, 0.1 with the nominal one of a realistic rig; in air
it is 0.3.
"""
MEETS = 0.5
"""Spread in air over the spread in water, below which the medium is air.

In air it is 0.04 to 0.09, with the nominal calibration 0.32 to 0.45; in water 1.6 and more.
"""


def judge_medium(
    left_px: NDArray[np.float64], right_px: NDArray[np.float64], rig: StereoRig, water_index: float
) -> Judgement:
    """Judge the medium by correspondences (n, 2) of both cameras, traced in water of ``water_index``.

    Failed with NOT_IN_WATER: rays meet in air, and not in the water. Numbers: ``water_gap_mm`` and ``air_gap_mm``, the
    median distance of the signed ray gaps from their median in each medium.
    """
    step = max(1, len(left_px) // MOST_ASKED)
    left_px, right_px = left_px[::step], right_px[::step]
    if len(left_px) < FEWEST or water_index == AIR:
        return Judgement(Verdict(NAME, None, {}, "too few points to distinguish water from air"))
    water_mm, air_mm = (_spread_mm(signed_gap_mm(rig, index, left_px, right_px)) for index in (water_index, AIR))
    numbers: dict[str, float | None] = {"water_gap_mm": water_mm, "air_gap_mm": air_mm}
    if water_mm < rig.volume.scaled(LEAST_APART_MM) or air_mm >= MEETS * water_mm:
        return Judgement(
            Verdict(NAME, True if water_mm < air_mm else None, numbers, "the ray gaps do not indicate air")
        )
    text = (
        f"ray gaps are {water_mm:.2f} mm in the stated water, and {air_mm:.2f} mm in air: the "
        "points are wrong; scan under "
        "water"
    )
    fault_numbers = {"water_gap_mm": water_mm, "air_gap_mm": air_mm}
    return Judgement(Verdict(NAME, False, numbers, text), Fault(FaultCode.NOT_IN_WATER, text, fault_numbers))


def _spread_mm(gap_mm: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(gap_mm - np.median(gap_mm))))
