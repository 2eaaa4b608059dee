"""Owns whether anything moved at all: each sign of movement as a score, scaled by what scans at rest make of it.

A score is a statistic over its own standard deviation and what it may be off at rest. The scales below were chosen on
scans at rest (seeds from 10,000) so that no score of theirs exceeds 3.5; ``MOVED`` leaves room above that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.verdicts.motion.harm import Harm
from appliance.measure.verdicts.motion.texture import TextureChange

MOVED = 4.5
"""The largest score from which on something moved."""
DRIFT_FLOOR_PX, EDGE_FLOOR_PX = 0.001, 0.025
"""Errors of drift and edges at rest beside their noise: pattern px per frame, pattern px."""
MIN_EDGE_CELLS = 6
CHANGE, EARLY_CHANGE = (1.045, 0.020), (1.10, 0.07)
"""The differences of means at rest, in units of noise, and their standard deviations: rounding, and the projector's
bends."""
LOCKED_LEFT = 0.04
"""Share of what was taken out of a change, as following the phase, by which the rest may still be wrong: a light that
has steps is seen through an optics that changes over the picture."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scores:
    """Signs of movement in standard deviations at rest; ``None``: nothing to judge by."""

    drift: float | None
    """Mean, or slope across the pattern, of E."""
    texture: float | None
    """Change of the texture."""

    @property
    def largest(self) -> float | None:
        """The largest score of those there are; ``None``: there is none."""
        known = [s for s in (self.drift, self.texture) if s is not None]
        return max(known) if known else None


@dataclass(frozen=True, slots=True)
class DriftTrend:
    """E = mean + across · x + down · y, with x and y from −1 to 1 over the pattern; pattern px per frame."""

    mean: float
    across: float
    down: float
    sd: tuple[float, float, float]
    score: float


def drift_trend(harm: Harm) -> DriftTrend | None:
    """Fit the drift by least squares over the cells; ``None``: too few."""
    known = harm.weight > 0.0
    if np.count_nonzero(known) < 6:
        return None
    rows, columns = harm.drift_px.shape
    y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    basis = np.stack([np.ones_like(x), x, y], -1)[known]
    weight = 1.0 / (harm.sd_px[known] ** 2 + DRIFT_FLOOR_PX**2)
    normal = basis.T @ (weight[:, None] * basis) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)
    fit = inverse @ (basis.T @ (weight * harm.drift_px[known]))
    # Birge's ratio: cells that scatter about the trend more than they say know it less well, all of them. Light from
    # the next surface in a corner, for one, has harmonics of its own.
    beside = weight * (harm.drift_px[known] - basis @ fit) ** 2
    birge = np.sqrt(max(1.0, float(np.sum(beside)) / max(beside.size - basis.shape[1], 1)))
    sd = np.sqrt(np.diag(inverse)) * birge
    score = float(np.max(np.abs(fit) / np.hypot(sd, DRIFT_FLOOR_PX)))
    return DriftTrend(float(fit[0]), float(fit[1]), float(fit[2]), (float(sd[0]), float(sd[1]), float(sd[2])), score)


def edge_course(left_px: Array, right_px: Array, harm: Harm) -> tuple[Array, Array]:
    """Return the shift of the Gray edges, left less right, and its standard deviation, (images,) each, in pattern px;
    NaN: too few. ``left_px`` and ``right_px``: as ``edge_shifts`` gives them.

    Medians over the cells. Where most are certain of their drift, shifts count in units of it (and are given for the
    typical one), so that a turn neither cancels nor looks different in frames whose edges lie elsewhere.
    """
    # Left less right: lateral movement moves both alike, depth moves them against each other.
    shift = left_px - right_px
    known = np.isfinite(shift) & (harm.weight > 0.0)
    unit = drift_unit(harm)
    if unit is not None:
        sure, typical = unit
        known &= sure
        shift = shift * np.where(sure, typical / np.where(sure, harm.drift_px, 1.0), 1.0)
    middle, sd = np.full(len(shift), np.nan), np.full(len(shift), np.nan)
    for frame, (values, there) in enumerate(zip(shift, known, strict=True)):
        if np.count_nonzero(there) >= MIN_EDGE_CELLS:
            mine = values[there]
            middle[frame] = np.median(mine)
            # Standard error of a median: 1.25 σ / √n, with σ as ``MAD_TO_SIGMA`` times the median deviation.
            sd[frame] = 1.25 * MAD_TO_SIGMA * np.median(np.abs(mine - middle[frame])) / np.sqrt(mine.size)
    return middle, sd


def drift_unit(harm: Harm) -> tuple[NDArray[np.bool_], float] | None:
    """Return the cells that are certain of their drift and have a good part of the typical one, and that one in pattern
    px per frame; ``None`` where most cells are not certain."""
    size = np.abs(harm.drift_px)
    sure = (size > 3.0 * harm.sd_px) & (harm.weight > 0.0)
    if not np.count_nonzero(sure) >= 0.5 * np.count_nonzero(harm.weight > 0.0) > 0.0:
        return None
    typical = float(np.median(size[sure]))
    return sure & (size > 0.3 * typical), typical


def texture_score(changes: Mapping[str, TextureChange | None]) -> float | None:
    """Return the score of the changed texture in the camera that saw more of it, by either pair of images."""
    scores = []
    for one in changes.values():
        if one is not None:
            pairs = ((one.late, CHANGE), (one.early, EARLY_CHANGE))
            scores += [(value - usual) / float(np.hypot(sd, LOCKED_LEFT * one.locked)) for value, (usual, sd) in pairs]
    return max(scores) if scores else None
