"""The ripple of a movement that is not steady, by the course of the fringes before the sines.

With x₀ x₉₀ x₂₇₀ x₁₈₀ where the fringes stand in the four x-sines, the ripple goes with the offset of both pairs of
steps, δ = (x₀ + x₁₈₀ − x₉₀ − x₂₇₀)/2: none of a steady movement, a of one that gathers speed by a per frame. A shake has
most of it where it turns round, where it does not drift.

δ is not in the x-sines, but the Gray images before them show the way there (``edges``): is it a shake, and how quick?
The way is taken for a steady one that gathers speed, with a shake of unknown strength and of a frequency that hands
have. Each of a number of frequencies and strengths explains what was seen more or less well; δ² is the mean over all,
each counted as likely as it is. Where the steps rise, a steady movement has the largest δ, and a shake is not asked
for.
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
"""Frequencies at which hands shake."""
STRENGTHS = (0.3, 1.0, 3.0)
"""Speeds of a shake, in units of the typical drift."""
NO_SHAKE = 0.4
"""Probability, before anything was seen, that there is no shake."""
SPEED, GATHERS = 3.0, 0.3
"""Standard deviations of the steady speed and of half of what it gains per frame, in units of the typical drift."""
EDGE_GAIN = 0.2
"""Share by which a shift of the edges may be wrong as a whole: light that blur takes beyond the reach of an edge."""
DOUBTFUL = 0.02
"""Share of the typical drift by which the way within either pair may be wrong beside its scatter."""
UNIT_PX = 0.1
"""Typical drift of a hand, pattern px per frame: what a shake is measured by where the steps do not rise."""


def pair_offset(
    shift_px: Array,
    sd_px: Array,
    left: DriftMap,
    right: DriftMap,
    harm: Harm,
    sequence: PatternSequence,
    frame_s: float,
) -> PairOffset | None:
    """Return the mean square of δ; ``None`` where the edges tell nothing.

    ``shift_px`` of the Gray edges and its standard deviation ``sd_px`` (images,) as ``edge_course`` gives them, in
    units of the typical drift where most cells are sure of theirs: δ goes with it then, else it is taken to be the same
    everywhere.
    """
    axis = sequence.axis(Direction.X)
    if not np.isfinite(shift_px).any():
        return None
    unit = drift_unit(harm)
    sure, typical_px = (harm.weight > 0.0, UNIT_PX) if unit is None else unit
    if not sure.any():
        return None
    # A shake turns round where it drifts least, so that its drift is no measure of it.
    scale_px = max(typical_px, UNIT_PX)
    per_cell = 1.0 / scale_px if unit is None else typical_px / scale_px / harm.drift_px[sure]
    # Paint that moves is a way of one pair forth and of the other one back: both together are free of it.
    drift = (left.drift_px - right.drift_px)[sure] * per_cell
    frames = np.array([*axis.gray, *axis.sine], np.float64)
    at = frames - frames[-4:].mean()
    grays = len(axis.gray)
    # What is seen, as combinations of where the fringes stand in the frames: of the Gray images against the mean of the
    # sines, then the ways within both pairs, per frame.
    m, n = axis.pair_frames
    of_pairs = (m * np.array([-1.0, 0.0, 1.0, 0.0]) + n * np.array([0.0, -1.0, 0.0, 1.0])) / (m * m + n * n)
    seen = np.zeros((grays + 1, grays + 4))
    seen[:grays, :grays], seen[:grays, grays:], seen[grays, grays:] = np.eye(grays), -0.25, of_pairs
    values = np.append(shift_px / scale_px, np.median(drift))
    gray2 = (sd_px**2 + EDGE_FLOOR_PX**2 + (EDGE_GAIN * shift_px) ** 2) / scale_px**2
    variance = np.append(gray2, _doubt2(drift))
    known = np.isfinite(values) & np.isfinite(variance)
    wanted = np.zeros(grays + 4)
    wanted[grays:] = 0.5, -0.5, 0.5, -0.5
    omega = 2.0 * np.pi * frame_s * np.array([0.0, *SHAKES_HZ])
    offset2 = _expected2(seen[known], values[known], variance[known], wanted, at, omega)
    if unit is None:
        return PairOffset(0.0, offset2 * scale_px**2)
    return PairOffset(offset2 * (scale_px / typical_px) ** 2)


def _doubt2(steps: Array) -> float:
    """Return the variance of the median of ``steps`` (cells,)."""
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps))))
    return 1.57 * scatter**2 / steps.size + DOUBTFUL**2


def _expected2(seen: Array, values: Array, variance: Array, wanted: Array, at: Array, omega: Array) -> float:
    """Return the expected square of ``wanted`` · x, given that ``seen`` · x (n,) is ``values`` with ``variance``,
    without its own variance: what is not known of an offset would be all that is said.

    x is where the fringes stand ``at`` frames from the middle of the sines, in units of the typical drift per frame. Of
    ``omega``, radians per frame, the first is 0: no shake.
    """
    # Ways (shakes, frames, 4): steady, gathering speed, and two phases of a shake whose speed is 1.
    ways = np.stack(
        [np.broadcast_to(w, (len(omega), len(at))) for w in (at, at**2)]
        + [f(np.outer(omega, at)) / np.maximum(omega, 1e-9)[:, None] for f in (np.cos, np.sin)],
        -1,
    )
    quick = [(0, 0.0, NO_SHAKE)] + [
        (k, strength, (1.0 - NO_SHAKE) / ((len(omega) - 1) * len(STRENGTHS)))
        for k in range(1, len(omega))
        for strength in STRENGTHS
    ]
    which, strength, likely = (np.array(x) for x in zip(*quick, strict=True))
    prior = np.stack([np.full(len(which), SPEED), np.full(len(which), GATHERS), strength, strength], -1) ** 2
    design, aim = seen @ ways[which], wanted @ ways[which]
    spread = design * prior[:, None, :]
    covariance = spread @ design.transpose(0, 2, 1) + np.diag(variance)
    inverse = np.linalg.inv(covariance)
    log = np.log(likely) - 0.5 * (np.linalg.slogdet(covariance)[1] + np.einsum("i,kij,j->k", values, inverse, values))
    weight = np.exp(log - log.max())
    gain = np.einsum("kj,kij,kil->kl", aim * prior, design, inverse)
    square = (gain @ values) ** 2
    return float(np.sum(weight * square) / np.sum(weight))
