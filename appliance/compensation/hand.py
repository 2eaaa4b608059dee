"""Owns what is known of a hand before anything is measured: how far, and how smoothly, it can move an instrument.

A Gaussian process per component: steady velocity, steady acceleration, and tremor as a process in the band of 4 to 12 Hz.
Rotation is counted in mm at ``LEVER_MM`` from the middle of the volume, so that all six components have one unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVER_MM = 100.0
UNSMOOTH_MM = 0.002
"""What a frame may deviate from every smooth motion: keeps the covariance regular."""


@dataclass(frozen=True, slots=True)
class Hand:
    """Standard deviations of one component."""

    velocity_mm_s: float
    acceleration_mm_s2: float
    tremor_mm: float
    tremor_hz: float = 7.0
    tremor_lasts_s: float = 0.1


SHIFT = Hand(40.0, 300.0, 0.3)
TURN = Hand(10.0, 80.0, 0.08)
"""At the lever: 6 °/s, 45 °/s², 0.05°."""


def displacement_covariance_mm2(hand: Hand, times_s: Array, reference_s: float) -> Array:
    """Of displacements at ``times_s`` (n,) against the place at ``reference_s``: (n, n)."""
    t = np.append(np.asarray(times_s, np.float64) - reference_s, 0.0)
    apart = t[:, None] - t[None, :]
    tremor = np.exp(-0.5 * (apart / hand.tremor_lasts_s) ** 2) * np.cos(2.0 * math.pi * hand.tremor_hz * apart)
    K = (
        hand.velocity_mm_s**2 * np.outer(t, t)
        + 0.25 * hand.acceleration_mm_s2**2 * np.outer(t**2, t**2)
        + hand.tremor_mm**2 * tremor
    )
    against = K[:-1, :-1] - K[:-1, -1:] - K[-1:, :-1] + K[-1, -1]
    return np.asarray(against + UNSMOOTH_MM**2 * np.eye(len(t) - 1))
