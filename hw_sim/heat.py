"""Owns the temperatures inside the housing: everything warms up from the water's temperature with its own lag."""

from __future__ import annotations

import math

FINAL_RISE_C = {"TCASE": 6.0, "TBOARD": 11.0, "TPROJ": 24.0, "camera": 19.0}
"""Above the water, after hours."""
LAG_S = {"TCASE": 900.0, "TBOARD": 300.0, "TPROJ": 240.0, "camera": 400.0}


def temperature_c(place: str, water_c: float, running_s: float) -> float:
    """Temperature of ``place`` after the instrument has run for ``running_s``; a first-order rise."""
    return water_c + FINAL_RISE_C[place] * -math.expm1(-running_s / LAG_S[place])
