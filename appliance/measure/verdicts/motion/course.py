"""The ripple of an unsteady motion, by the positions of the fringes before the sines.

Let x₀ x₉₀ x₂₇₀ x₁₈₀ be the positions of the fringes in the four x-sines. The ripple is proportional to the offset of
both pairs of steps, δ = (x₀ + x₁₈₀ − x₉₀ − x₂₇₀)/2. It is 0 for a steady motion, and a for an acceleration of a per
frame squared. For a shaking hand it is largest at the turning points, where there is no drift.

The x-sines do not determine δ, but the Gray images before them show the displacements until then (``edges``). The
motion is modelled as a constant acceleration and a shake of unknown strength, with a frequency of shaking hands. Each
of several frequencies and strengths explains the observations more or less well; δ² is the mean over all, weighted by
their probabilities. With rising steps a steady motion has the largest δ, and this model is not used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm, PairOffset
from appliance.measure.verdicts.motion.scores import EDGE_FLOOR_PX, drift_unit

Array = NDArray[np.float64]

SHAKES_HZ = tuple(float(hz) for hz in range(4, 13))
"""Frequencies of shaking hands."""
STRENGTHS = (0.3, 1.0, 3.0)
"""Speeds of a shake, in units of the typical drift."""
NO_SHAKE = 0.4
"""Prior probability that there is no shake."""
SPEED, GATHERS = 3.0, 0.3
"""Prior standard deviations of the speed and of half of the acceleration, in units of the typical drift and frames."""
EDGE_GAIN = 0.2
"""Relative standard deviation of a shift of the edges: blur takes light beyond the reach of an edge."""
DOUBTFUL = 0.02
"""Standard deviation of the displacement within either pair besides its noise, as a share of the typical drift."""
UNIT_PX = 0.1
"""Typical drift by a hand, pattern px per frame: the unit of a shake if the steps do not rise."""


def pair_offset(
    shift_px: Array,
    sd_px: Array,
    left: DriftMap,
    right: DriftMap,
    harm: Harm,
    sequence: PatternSequence,
    frame_s: float,
) -> PairOffset | None:
    """Return the mean square of δ; ``None`` if no shift of the edges is known.

    ``shift_px`` of the Gray edges and its standard deviation ``sd_px`` (images,) are those of ``edge_course``. If the
    drift of most cells is certain, they are in units of the typical drift, and δ is proportional to the drift of a
    cell; else δ is assumed to be the same everywhere.
    """
    axis = sequence.axis(Direction.X)
    if not np.isfinite(shift_px).any():
        return None
    unit = drift_unit(harm)
    sure, typical_px = (harm.weight > 0.0, UNIT_PX) if unit is None else unit
    if not sure.any():
        return None
    # At the turning points of a shake the drift is small, so that it is no measure of the shake.
    scale_px = max(typical_px, UNIT_PX)
    per_cell = 1.0 / scale_px if unit is None else typical_px / scale_px / harm.drift_px[sure]
    # A moving albedo displaces both pairs in opposite directions: their sum is free of it.
    drift = (left.drift_px - right.drift_px)[sure] * per_cell
    frames = np.array([*axis.gray, *axis.sine], np.float64)
    time = frames - frames[-4:].mean()
    gray_count = len(axis.gray)
    # The observations as combinations of the fringes' positions in the frames: Gray images against the mean of the
    # sines, then the displacement per frame within both pairs.
    m, n = axis.pair_frames
    of_pairs = (m * np.array([-1.0, 0.0, 1.0, 0.0]) + n * np.array([0.0, -1.0, 0.0, 1.0])) / (m * m + n * n)
    observed = np.zeros((gray_count + 1, gray_count + 4))
    observed[:gray_count, :gray_count], observed[:gray_count, gray_count:], observed[gray_count, gray_count:] = (
        np.eye(gray_count),
        -0.25,
        of_pairs,
    )
    values = np.append(shift_px / scale_px, np.median(drift))
    gray2 = (sd_px**2 + EDGE_FLOOR_PX**2 + (EDGE_GAIN * shift_px) ** 2) / scale_px**2
    variance = np.append(gray2, _median_variance(drift))
    is_known = np.isfinite(values) & np.isfinite(variance)
    target = np.zeros(gray_count + 4)
    target[gray_count:] = 0.5, -0.5, 0.5, -0.5
    omega = 2.0 * np.pi * frame_s * np.array([0.0, *SHAKES_HZ])
    offset2 = _expected2(observed[is_known], values[is_known], variance[is_known], target, time, omega)
    if unit is None:
        return PairOffset(0.0, offset2 * scale_px**2)
    return PairOffset(offset2 * (scale_px / typical_px) ** 2)


def _median_variance(steps: Array) -> float:
    """Return the variance of the median of ``steps`` (cells,)."""
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps))))
    return 1.57 * scatter**2 / steps.size + DOUBTFUL**2


def _expected2(observed: Array, values: Array, variance: Array, target: Array, time: Array, omega: Array) -> float:
    """Return the square of the estimate of ``target`` · x, given that ``observed`` · x (n,) is ``values``.

    ``variance``: of the values. The variance of the estimate is not added, since for an unknown offset it would decide
    alone. x is the position of the fringes ``time`` frames after the middle of the sines, in units of the typical drift
    per frame. ``omega``: radians per frame; the first is 0, no shake.
    """
    # Displacements (shakes, frames, 4): steady, accelerated, and two phases of a shake of speed 1.
    displacements = np.stack(
        [np.broadcast_to(w, (len(omega), len(time))) for w in (time, time**2)]
        + [f(np.outer(omega, time)) / np.maximum(omega, 1e-9)[:, None] for f in (np.cos, np.sin)],
        -1,
    )
    shakes = [(0, 0.0, NO_SHAKE)] + [
        (k, strength, (1.0 - NO_SHAKE) / ((len(omega) - 1) * len(STRENGTHS)))
        for k in range(1, len(omega))
        for strength in STRENGTHS
    ]
    shake, strength, probability = (np.array(x) for x in zip(*shakes, strict=True))
    prior = np.stack([np.full(len(shake), SPEED), np.full(len(shake), GATHERS), strength, strength], -1) ** 2
    design, aim = observed @ displacements[shake], target @ displacements[shake]
    spread = design * prior[:, None, :]
    covariance = spread @ design.transpose(0, 2, 1) + np.diag(variance)
    inverse = np.linalg.inv(covariance)
    log = np.log(probability) - 0.5 * (
        np.linalg.slogdet(covariance)[1] + np.einsum("i,kij,j->k", values, inverse, values)
    )
    weight = np.exp(log - log.max())
    gain = np.einsum("kj,kij,kil->kl", aim * prior, design, inverse)
    square = (gain @ values) ** 2
    return float(np.sum(weight * square) / np.sum(weight))
