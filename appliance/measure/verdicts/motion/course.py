"""The ripple of a movement that is not steady, by the course of the fringes before the sines.

With x₀ x₉₀ x₁₈₀ x₂₇₀ where the fringes stand in the four x-sines, the ripple goes with the offset of both pairs,
δ = (x₀ + x₁₈₀ − x₉₀ − x₂₇₀)/2, while the combination that holds no phase tells the ways within the pairs alone,
x₁₈₀ − x₀ and x₂₇₀ − x₉₀ (``drift``), whose mean per frame is ε.

Where the steps rise, |δ| of a steady movement is ε, and so it is of one that gathers speed evenly. Of a shake of ω per
frame that passes its middle just then, δ/ε = cos ω / cos² (ω/2): 0.95 at 4 Hz and 60 frames/s, 0.8 at 8 Hz, 0.5 at
12 Hz. In the order 0°, 90°, 270°, 180° a steady movement has no δ; what gathers speed by a per frame has δ = a, and a
shake has most of it where it turns round, where it does not drift.

δ is not in the x-sines, but the Gray images before them show the way there (``edges``): is it a shake, and how quick?
The way is taken for a steady one that gathers speed, with a shake of unknown strength and of a frequency that hands
have. Each of a number of frequencies and strengths explains what was seen more or less well; δ² is the mean over all,
each counted as likely as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm, PairOffset, steady_offset
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
    course: tuple[Array, Array],
    left: DriftMap,
    right: DriftMap,
    harm: Harm,
    sequence: PatternSequence,
    frame_s: float,
) -> PairOffset | None:
    """Return the mean square of δ; ``None`` where nothing is known but a steady movement.

    ``course`` is the shift of the Gray edges and its standard deviation (``scores.edge_course``), in units of the same
    typical drift. Where most cells are sure of their drift, δ goes with it; else it is taken to be the same everywhere.
    """
    axis, steady = sequence.axis(Direction.X), steady_offset(sequence)
    shift, sd = course
    unit, rising = drift_unit(harm), steady.of_drift2 > 0.0
    # Where the steps rise, a drift that is lost in its noise makes no ripple to speak of; in the other order nothing
    # but the edges tells an offset.
    unknown = unit is None if rising else not np.isfinite(shift).any()
    if unknown:
        return None
    if unit is None:
        sure, scale_px, per_cell = harm.weight > 0.0, UNIT_PX, np.full(harm.drift_px.shape, 1.0 / UNIT_PX)
    else:
        sure, typical_px = unit
        # A shake turns round where it drifts least, so that its drift is no measure of it.
        scale_px = typical_px if rising else max(typical_px, UNIT_PX)
        per_cell = typical_px / scale_px / harm.drift_px
    # Paint that moves is a way of one pair forth and of the other one back: by the other's frames over its own. Where
    # the pairs have one middle, they tell no more apart than together, which is free of it.
    ways = [(left.drift_px, right.drift_px)]
    if rising:
        ways = [(left.cosine_px, right.cosine_px), (left.sine_px, right.sine_px)]
    steps = [((a - b) * per_cell)[sure] for a, b in ways]
    if not steps[0].size:
        return None
    frames = np.array([*axis.gray, *axis.sine], np.float64)
    at = frames - frames[-4:].mean()
    grays = len(axis.gray)
    # What is seen, as combinations of where the fringes stand in the frames: of the Gray images against the mean of the
    # sines, then the ways within the pairs, per frame.
    m, n = axis.pair_frames
    of_pairs = np.array([[-1.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.0]]) / [[m], [n]]
    if not rising:
        of_pairs = (m * m * of_pairs[:1] + n * n * of_pairs[1:]) / (m * m + n * n)
    seen = np.zeros((grays + len(steps), grays + 4))
    seen[:grays, :grays] = np.eye(grays)
    seen[:grays, grays:] = -0.25
    seen[grays:, grays:] = of_pairs
    values = np.append(shift / scale_px, [np.median(one) for one in steps])
    variance = np.append(
        (sd**2 + EDGE_FLOOR_PX**2 + (EDGE_GAIN * shift) ** 2) / scale_px**2, [_doubt2(one) for one in steps]
    )
    known = np.isfinite(values) & np.isfinite(variance)
    wanted = np.zeros(grays + 4)
    wanted[grays:] = 0.5, -0.5, 0.5, -0.5
    omega = 2.0 * np.pi * frame_s * np.array([0.0, *SHAKES_HZ])
    # In the instrument's order a steady movement has no offset, and what is not known of one would be all that is said.
    offset2 = _expected2(seen[known], values[known], variance[known], wanted, at, omega, with_doubt=rising)
    if unit is None:
        return PairOffset(0.0, offset2 * scale_px**2)
    return PairOffset(offset2 * (scale_px / unit[1]) ** 2)


def _doubt2(steps: Array) -> float:
    """Return the variance of the median of ``steps`` (cells,)."""
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps))))
    return 1.57 * scatter**2 / steps.size + DOUBTFUL**2


def _expected2(
    seen: Array, values: Array, variance: Array, wanted: Array, at: Array, omega: Array, *, with_doubt: bool
) -> float:
    """Return the expected square of ``wanted`` · x, given that ``seen`` · x (n,) is ``values`` with ``variance``;
    ``with_doubt``: with its own variance.

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
    if with_doubt:
        left_over = np.sum(aim**2 * prior, -1) - np.einsum("kl,kli,ki->k", gain, design, aim * prior)
        square += np.maximum(left_over, 0.0)
    return float(np.sum(weight * square) / np.sum(weight))
