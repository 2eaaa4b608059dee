"""The sine fringes: the intensity of each 90° step, and the phase convention.

Phase of pattern coordinate p (px, pixel centres at integers) is φ = 2π (p + ½) / period, so that a phase of zero lies
on the edge between two pixels, where the Gray code changes. Step k shows A + B cos(φ + k·90°); therefore I0 − I2 = 2B
cos φ and I3 − I1 = 2B sin φ. Even harmonics of the projector's response cancel in both differences; odd ones do not
(``patterns.response``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PHASE_STEPS = 4
"""Number of phase steps, 90° apart; see ``PatternSequence``."""
STEP_DEG = 360 // PHASE_STEPS
MEAN_CODE = 127.5
AMPLITUDE_CODE = 119.5
"""Amplitude of the codes, which run from 8 to 247: projectors clip near the ends of the scale."""


def fringe(size_px: int, period_px: int, step: int) -> NDArray[np.float64]:
    """Return cos(φ + step·90°) at the pixels' centres: shape (size_px,), −1 … 1."""
    phase = 2.0 * np.pi * (np.arange(size_px, dtype=np.float64) + 0.5) / period_px
    return np.asarray(np.cos(phase + step * (np.pi / 2.0)))


def sine_codes(size_px: int, period_px: int, step: int) -> NDArray[np.uint8]:
    """Return the codes of step ``step`` (0..3) of a fringe pattern: shape (size_px,) uint8, rounded to nearest."""
    return np.rint(MEAN_CODE + AMPLITUDE_CODE * fringe(size_px, period_px, step)).astype(np.uint8)
