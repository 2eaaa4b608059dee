"""Owns the smooth depth error that all scans of one calibration share, as some numbers: what residuals of a merge do not show.

An error of 30 µm, smooth over the view and the same in every scan, fits every pair: each neighbour is only turned a little, always in the
same sense, and twelve scans in a row bend by more than half a millimetre. So the shared error is carried as unknowns with a prior: what
overlaps tell about it (turned or nearer views, loops that close) makes it smaller, and what they do not tell stays in the budget.

``measure/calibration/depth_error.py`` has its shapes φ; c are their coefficients, mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from appliance.measure.calibration.depth_error import BORDER, DISTANCE_MM, POWERS, along_ray, shapes
from appliance.measure.light.volume import STANDARD, WorkingVolume
from appliance.measure.overlap.patches import Array

_USUAL_MM = {2: 0.030, 3: 0.020, 4: 0.010, 5: 0.007}
"""Standard deviations of coefficients by their order in u and v."""
_WITH_DISTANCE = 0.2
"""The same of shapes that go with the distance, over that of those that do not; of a tilt as of what is bent."""
PRIOR_MM2 = np.diag([(_USUAL_MM[max(i + j, 2)] * (_WITH_DISTANCE if k else 1.0)) ** 2 for i, j, k in POWERS])
"""Covariance before any overlap is seen, of a calibration that states none: flatness errors of calibrated instruments
(docs/accuracy.md: worst 0.017 % of the view's diagonal, 46 µm from the highest to the lowest point)."""
CLEARLY_TOLD = 0.5
"""Least share of a direction's variance that overlaps have to take away to tell about it."""
LEAST_MM = 0.006
"""Standard deviation of each coefficient that is added to what a calibration states: of what its model does not say."""


def known_before(stated_mm2: Array | None) -> Array:
    """Return the covariance (k, k), mm², of the shared error before any overlap is seen. ``stated_mm2``: the calibration's own
    (``Calibration.depth_error_mm2``); ``None``: it states none."""
    return PRIOR_MM2 if stated_mm2 is None else np.asarray(stated_mm2 + LEAST_MM**2 * np.eye(len(PRIOR_MM2)))


@dataclass(frozen=True, slots=True, eq=False)
class BowNews:
    """Equations of one pair for the shared error."""

    response: Array
    """(6, k): by how much the pair's pose is wrong per mm of each coefficient."""
    information: Array
    """(k, k), 1/mm²: of the residuals that no pose takes away."""
    gradient: Array
    """(k,), 1/mm: of half the sum of squares, at zero coefficients."""


def bow_score(found_mm: Array, known_mm2: Array, left_mm2: Array) -> float | None:
    """Return how far an estimate (k,) lies from what was known before, in standard deviations; about 1 where that was right, ``None`` where the overlaps
    tell too little.

    ``known_mm2`` and ``left_mm2``: covariances (k, k) before and after. If the prior is right, the estimate scatters by their difference.
    Directions that the overlaps tell little about do not count.
    """
    told = known_mm2 - left_mm2
    # In units of the prior: an eigenvalue is the share of its variance that the overlaps have taken away.
    root = np.linalg.cholesky(known_mm2)
    half = np.linalg.inv(root)
    share, vector = np.linalg.eigh(half @ told @ half.T)
    clear = share > CLEARLY_TOLD
    if not clear.any():
        return None
    along = vector.T @ (half @ found_mm)
    return float(np.sqrt(np.mean(along[clear] ** 2 / share[clear])))


def spread_mm(covariance_mm2: Array) -> float:
    """Return the RMS depth over the view that coefficients of this covariance (k, k) may have, at 525 mm in the standard housing, and
    at as much in proportion in any other."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.75, 0.75, 7))
    points = DISTANCE_MM * np.stack([BORDER * u, BORDER * v, np.ones_like(u)], axis=-1)
    of_view = shapes(points)
    return float(np.sqrt(np.einsum("...i,ij,...j->...", of_view, covariance_mm2, of_view).mean()))


def corrected(points_mm: Array, coefficients_mm: Array, volume: WorkingVolume = STANDARD) -> Array:
    """Return points (…, 3) of a scan's own frame with the shared error taken out."""
    error = shapes(points_mm, volume) @ coefficients_mm
    return np.asarray(points_mm - along_ray(points_mm) * error[..., None])


def derivatives(
    normal_a: Array, at_a_mm: Array, at_b_mm: Array, rotation: Array, volume: WorkingVolume = STANDARD
) -> Array:
    """Return ∂r/∂c (n, k): how the distance of B's patches from A's planes changes with the shared error.

    ``at_a_mm``: the places (n, 3) in A's frame, ``at_b_mm``: the same in B's, ``rotation``: from B's frame into A's.
    """
    of_b = (normal_a * (along_ray(at_b_mm) @ rotation.T)).sum(-1)
    of_a = (normal_a * along_ray(at_a_mm)).sum(-1)
    return np.asarray(of_b[:, None] * shapes(at_b_mm, volume) - of_a[:, None] * shapes(at_a_mm, volume))


def news_of(J: Array, S_inverse: Array, B: Array, w: Array, r: Array, overdispersion: float) -> BowNews:
    """Return a pair's news from its equations.

    ``J`` (n, 6) and ``B`` (n, k) derivatives of residuals ``r`` (n,) by pose and coefficients, ``w`` weights, all of planes alone or
    with zeros in ``B`` where a residual is paint's. ``overdispersion``: variance of sums of residuals over that of independent ones.
    """
    C = J.T @ (w[:, None] * B)
    response = -S_inverse @ C
    rest = B + J @ response
    # Residuals are those at the pose found, where J' w r = 0: what is left for the coefficients alone.
    return BowNews(response, rest.T @ (w[:, None] * rest) / overdispersion, -rest.T @ (w * r) / overdispersion)
