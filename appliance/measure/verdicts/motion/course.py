"""Owns what part of the fringes' drift makes the ripple, where the movement is not steady.

With x₀ … x₃ where the fringes stand in the four x-sines, the ripple that four steps of 90° leave goes with the mean of
the first and the last step, s = (x₁ − x₀ + x₃ − x₂)/2, while the combination that holds no phase tells the two double
steps alone, x₂ − x₀ and x₃ − x₁ (``drift``), whose mean per frame is ε. Of a steady movement, or one that gathers speed
evenly, both are the same. Of a shake of ω per frame that passes its middle just then, s/ε = cos ω / cos² (ω/2): 0.95 at
4 Hz and 60 frames/s, 0.8 at 8 Hz, 0.5 at 12 Hz.

The step between the two is not in the x-sines, but the Gray images before them show the way there (``edges``): is it a
shake, and how quick? The way is taken for a steady one that gathers speed, with a shake of unknown strength and of a
frequency that hands have. Each of a number of frequencies and strengths explains what was seen more or less well; s² is
the mean over all, each counted as likely as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.patterns import Direction, PatternSequence
from appliance.measure.verdicts.motion.drift import DriftMap
from appliance.measure.verdicts.motion.harm import Harm
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
"""Share of the typical drift by which either double step may be wrong beside its scatter."""


def steps2(
    course: tuple[Array, Array],
    left: DriftMap,
    right: DriftMap,
    harm: Harm,
    sequence: PatternSequence,
    frame_s: float,
) -> float | None:
    """Return s² over ε²; ``None`` where the drift is too small to be followed.

    ``course`` is the shift of the Gray edges and its standard deviation (``scores.edge_course``), in units of the same
    typical drift.
    """
    unit = drift_unit(harm)
    if unit is None:
        return None
    sure, typical = unit
    axis = sequence.axis(Direction.X)
    in_units = 1.0 / harm.drift_px[sure]
    early, late = (
        (a - b)[sure] * in_units for a, b in ((left.early_px, right.early_px), (left.late_px, right.late_px))
    )
    frames = np.array([*axis.gray, *axis.sine], np.float64)
    at = frames - frames[-4:].mean()
    grays = len(axis.gray)
    # What is seen, as combinations of where the fringes stand in the frames: of the Gray images against the mean of the
    # sines, then both double steps.
    seen = np.zeros((grays + 2, grays + 4))
    seen[:grays, :grays] = np.eye(grays)
    seen[:grays, grays:] = -0.25
    seen[grays, [grays, grays + 2]] = -0.5, 0.5
    seen[grays + 1, [grays + 1, grays + 3]] = -0.5, 0.5
    shift, sd = course
    values = np.append(shift / typical, [np.median(early), np.median(late)])
    variance = np.append(
        (sd**2 + EDGE_FLOOR_PX**2 + (EDGE_GAIN * shift) ** 2) / typical**2, [_doubt2(early), _doubt2(late)]
    )
    known = np.isfinite(values) & np.isfinite(variance)
    wanted = np.zeros(grays + 4)
    wanted[grays:] = -0.5, 0.5, -0.5, 0.5
    omega = 2.0 * np.pi * frame_s * np.array([0.0, *SHAKES_HZ])
    return _expected2(seen[known], values[known], variance[known], wanted, at, omega)


def _doubt2(steps: Array) -> float:
    """Return the variance of the median of ``steps`` (cells,)."""
    scatter = MAD_TO_SIGMA * float(np.median(np.abs(steps - np.median(steps))))
    return 1.57 * scatter**2 / steps.size + DOUBTFUL**2


def _expected2(seen: Array, values: Array, variance: Array, wanted: Array, at: Array, omega: Array) -> float:
    """Return the expected square of ``wanted`` · x, given that ``seen`` · x (n,) is ``values`` with ``variance``.

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
    left_over = np.sum(aim**2 * prior, -1) - np.einsum("kl,kli,ki->k", gain, design, aim * prior)
    return float(np.sum(weight * ((gain @ values) ** 2 + np.maximum(left_over, 0.0))) / np.sum(weight))
