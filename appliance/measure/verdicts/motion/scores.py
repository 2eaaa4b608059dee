"""Detection of motion: each kind of evidence as a score, scaled by its values at rest.

A score is a statistic over its standard deviation, systematic errors at rest included. The scales below were chosen by
scans at rest (seeds from 10,000) so that no score of theirs exceeds 3.5; ``MOVED`` has a margin above that.
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
"""Least value of the largest score that means motion."""
DRIFT_FLOOR_PX, EDGE_FLOOR_PX = 0.001, 0.025
"""Systematic errors of drift and edges at rest: pattern px per frame, pattern px."""
MIN_EDGE_CELLS = 6
CHANGE, EARLY_CHANGE = (1.045, 0.020), (1.10, 0.07)
"""Differences of means at rest, in units of noise, and their standard deviations, by rounding and phase errors of the
response."""
LOCKED_LEFT = 0.04
"""Standard deviation of a change as a share of the part that followed the phase and was subtracted: blur differs over
the image, and with it the steps of the light."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Scores:
    """Evidence of motion in standard deviations at rest; ``None``: too little to judge by."""

    drift: float | None
    """Mean, or slope across the pattern, of E."""
    texture: float | None
    """Change of the texture."""

    @property
    def largest(self) -> float | None:
        """The largest known score; ``None``: neither is known."""
        scores = [s for s in (self.drift, self.texture) if s is not None]
        return max(scores) if scores else None


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
    is_known = harm.weight > 0.0
    if np.count_nonzero(is_known) < 6:
        return None
    rows, columns = harm.drift_px.shape
    y, x = np.mgrid[-1.0 : 1.0 : rows * 1j, -1.0 : 1.0 : columns * 1j]
    basis = np.stack([np.ones_like(x), x, y], -1)[is_known]
    weight = 1.0 / (harm.sd_px[is_known] ** 2 + DRIFT_FLOOR_PX**2)
    normal = basis.T @ (weight[:, None] * basis) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)
    fit = inverse @ (basis.T @ (weight * harm.drift_px[is_known]))
    # Birge's ratio: if residuals exceed their stated errors, all errors are increased alike. Light from another surface
    # in a corner, for instance, has harmonics of its own.
    beside = weight * (harm.drift_px[is_known] - basis @ fit) ** 2
    birge = np.sqrt(max(1.0, float(np.sum(beside)) / max(beside.size - basis.shape[1], 1)))
    sd = np.sqrt(np.diag(inverse)) * birge
    score = float(np.max(np.abs(fit) / np.hypot(sd, DRIFT_FLOOR_PX)))
    return DriftTrend(float(fit[0]), float(fit[1]), float(fit[2]), (float(sd[0]), float(sd[1]), float(sd[2])), score)


def edge_course(left_px: Array, right_px: Array, harm: Harm) -> tuple[Array, Array]:
    """Return the shift of the Gray edges, left less right, and its standard deviation, in pattern px.

    NaN: too few cells. Both are (images,). ``left_px`` and ``right_px``: by ``edge_shifts``. They are medians over the
    cells. If the drift of most cells is certain, shifts are taken in units of it (and returned for the typical drift):
    a rotation then does not cancel, and does not look different in frames whose edges lie elsewhere.
    """
    # Left less right: lateral motion moves both alike, depth moves them against each other.
    shift = left_px - right_px
    is_known = np.isfinite(shift) & (harm.weight > 0.0)
    unit = drift_unit(harm)
    if unit is not None:
        sure, typical = unit
        is_known &= sure
        shift = shift * np.where(sure, typical / np.where(sure, harm.drift_px, 1.0), 1.0)
    middle, sd = np.full(len(shift), np.nan), np.full(len(shift), np.nan)
    for frame, (values, in_frame) in enumerate(zip(shift, is_known, strict=True)):
        if np.count_nonzero(in_frame) >= MIN_EDGE_CELLS:
            mine = values[in_frame]
            middle[frame] = np.median(mine)
            # Standard error of a median: 1.25 σ / √n, with σ as ``MAD_TO_SIGMA`` times the median deviation.
            sd[frame] = 1.25 * MAD_TO_SIGMA * np.median(np.abs(mine - middle[frame])) / np.sqrt(mine.size)
    return middle, sd


def drift_unit(harm: Harm) -> tuple[NDArray[np.bool_], float] | None:
    """Return the cells with a certain drift that is not too small, and the typical drift, px per frame.

    ``None``: the drift of most cells is uncertain.
    """
    size = np.abs(harm.drift_px)
    sure = (size > 3.0 * harm.sd_px) & (harm.weight > 0.0)
    if not np.count_nonzero(sure) >= 0.5 * np.count_nonzero(harm.weight > 0.0) > 0.0:
        return None
    typical = float(np.median(size[sure]))
    return sure & (size > 0.3 * typical), typical


def texture_score(changes: Mapping[str, TextureChange | None]) -> float | None:
    """Return the largest score of the texture's change, over both cameras and both pairs of images."""
    scores = []
    for change in changes.values():
        if change is not None:
            pairs = ((change.late, CHANGE), (change.early, EARLY_CHANGE))
            scores += [
                (value - usual) / float(np.hypot(sd, LOCKED_LEFT * change.locked)) for value, (usual, sd) in pairs
            ]
    return max(scores) if scores else None
