"""Owns what is known of the motion before and after it is measured: the prior of a hand, and the trajectory of a scan.

A displacement is six numbers in mm: the shift (x, y, z) of the middle of the volume, and the turn about it, as the way
of a point ``LEVER_MM`` from the middle, so that all six have one unit. Each of the six is a Gaussian process in time: a
steady velocity, a steady acceleration, and the tremor of muscles, which lies between 4 and 12 Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVER_MM = 100.0
"""Distance from the middle of the volume at which a turn is counted in mm."""
UNSMOOTH_MM = 0.002
"""Standard deviation by which one frame may leave every smooth motion; it keeps the covariance regular."""


@dataclass(frozen=True, slots=True)
class MotionPrior:
    """Standard deviations of what one component of a hand's motion does during a scan."""

    velocity_mm_s: float
    acceleration_mm_s2: float
    tremor_mm: float
    tremor_hz: float = 7.0
    tremor_lasts_s: float = 0.1
    """Time after which the tremor has forgotten its phase (σ of a Gaussian)."""


TRANSLATION = MotionPrior(40.0, 300.0, 0.3)
"""The prior of each component of the shift."""
ROTATION = MotionPrior(10.0, 80.0, 0.08)
"""The prior of each component of the turn, in mm at the lever: 6 °/s, 45 °/s², 0.05°."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The displacements of all n frames of a scan as one Gaussian of 6 n numbers, frame by frame."""

    mean_mm: Array
    """(6 n,)."""
    covariance_mm2: Array
    """(6 n, 6 n)."""

    def marginal(self, frames: tuple[int, ...]) -> tuple[Array, Array]:
        """Return mean (6 m,) and covariance (6 m, 6 m) of the m ``frames`` alone."""
        at = parameters_of(frames)
        return self.mean_mm[at], self.covariance_mm2[np.ix_(at, at)]

    def conditional_mm(self, frames: tuple[int, ...], motion_mm: Array) -> Array:
        """Return the most likely displacements (n, 6) of all frames when those of the m ``frames`` are ``motion_mm``
        (m, 6)."""
        at = parameters_of(frames)
        mean, covariance = self.marginal(frames)
        # Conditional mean of a Gaussian: μ + Σ_am Σ_mm⁻¹ (d − μ_m).
        weights = np.linalg.solve(covariance, motion_mm.ravel() - mean)
        return np.asarray(self.mean_mm + self.covariance_mm2[:, at] @ weights).reshape(-1, 6)


def trajectory_prior_precision(times_s: Array, reference_s: float) -> Array:
    """Return the precision (6 n, 6 n) in mm⁻² of displacements at ``times_s`` (n,) against ``reference_s``, by the
    prior alone."""
    n = len(times_s)
    precision = np.zeros((6 * n, 6 * n))
    for prior, components in ((TRANSLATION, (0, 1, 2)), (ROTATION, (3, 4, 5))):
        block = np.linalg.inv(displacement_covariance_mm2(prior, times_s, reference_s))
        for component in components:
            at = component + 6 * np.arange(n)
            precision[np.ix_(at, at)] = block
    return precision


def displacement_covariance_mm2(prior: MotionPrior, times_s: Array, reference_s: float) -> Array:
    """Return the covariance (n, n) of one component's displacements at ``times_s`` (n,) against its place at
    ``reference_s``."""
    t = np.append(np.asarray(times_s, np.float64) - reference_s, 0.0)
    apart = t[:, None] - t[None, :]
    # The tremor: a band around tremor_hz, as wide as it is short-lived.
    tremor = np.exp(-0.5 * (apart / prior.tremor_lasts_s) ** 2) * np.cos(2.0 * math.pi * prior.tremor_hz * apart)
    # x(t) = v t + a t²/2 + tremor(t), all independent.
    K = (
        prior.velocity_mm_s**2 * np.outer(t, t)
        + 0.25 * prior.acceleration_mm_s2**2 * np.outer(t**2, t**2)
        + prior.tremor_mm**2 * tremor
    )
    # Covariance of x(t) − x(reference); the reference is the last row and column.
    against = K[:-1, :-1] - K[:-1, -1:] - K[-1:, :-1] + K[-1, -1]
    return np.asarray(against + UNSMOOTH_MM**2 * np.eye(len(t) - 1))


def parameters_of(frames: tuple[int, ...]) -> NDArray[np.int64]:
    """Return where the 6 m numbers of the m ``frames`` stand in a trajectory's vector."""
    return (6 * np.asarray(frames)[:, None] + np.arange(6)).ravel()
