"""Owns the smooth depth error that all scans of one calibration share, as some numbers: what residuals of a merge do
not show.

An error of 30 µm, smooth over the view and the same in every scan, fits every pair: each neighbour is only turned a
little, always in the same sense, and twelve scans in a row bend by more than half a millimetre. So the shared error is
carried as unknowns with a prior: what overlaps tell about it (turned or nearer views, loops that close) makes it
smaller, and what they do not tell stays in the budget.

``measure/calibration/depth_error.py`` has its shapes φ; c are their coefficients, mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure import BORDER, DISTANCE_MM, POWERS, STANDARD, WorkingVolume, along_ray, shapes

Array = NDArray[np.float64]

_USUAL_MM = {2: 0.030, 3: 0.020, 4: 0.010, 5: 0.007}
"""Standard deviations of coefficients by their order in u and v."""
_WITH_DISTANCE = 0.2
"""The same of shapes that go with the distance, over that of those that do not; of a tilt as of what is bent."""
PRIOR_MM2 = np.diag([(_USUAL_MM[max(i + j, 2)] * (_WITH_DISTANCE if k else 1.0)) ** 2 for i, j, k in POWERS])
"""Covariance before any overlap is seen, of a calibration that states none: flatness errors of calibrated instruments
(docs/calibration.md: worst 0.017 % of the view's diagonal, 46 µm from the highest to the lowest point)."""
CLEARLY_TOLD = 0.5
"""Least share of a direction's variance that overlaps have to take away to tell about it."""
LEAST_MM = 0.006
"""Standard deviation of each coefficient that is added to what a calibration states: of what its model does not say."""


def known_before(stated_mm2: Array | None) -> Array:
    """Return the covariance (k, k), mm², of the shared error before any overlap is seen.

    ``stated_mm2``: the calibration's own (``Calibration.depth_error_mm2``); ``None``: it states none.
    """
    return PRIOR_MM2 if stated_mm2 is None else np.asarray(stated_mm2 + LEAST_MM**2 * np.eye(len(PRIOR_MM2)))


def bow_score(found_mm: Array, known_mm2: Array, left_mm2: Array) -> float | None:
    """Return how far an estimate (k,) lies from what was known before, in standard deviations; about 1 where that was
    right, ``None`` where the overlaps tell too little.

    ``known_mm2`` and ``left_mm2``: covariances (k, k) before and after. If the prior is right, the estimate scatters by
    their difference. Directions that the overlaps tell little about do not count.
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
    """Return the RMS depth over the view that coefficients of this covariance (k, k) may have, at 525 mm in the
    standard housing, and at as much in proportion in any other."""
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.75, 0.75, 7))
    points = DISTANCE_MM * np.stack([BORDER * u, BORDER * v, np.ones_like(u)], axis=-1)
    of_view = shapes(points)
    return float(np.sqrt(np.einsum("...i,ij,...j->...", of_view, covariance_mm2, of_view).mean()))


def corrected(points_mm: Array, coefficients_mm: Array, volume: WorkingVolume = STANDARD) -> Array:
    """Return points (…, 3) of a scan's own frame with the shared error taken out."""
    error = shapes(points_mm, volume) @ coefficients_mm
    return np.asarray(points_mm - along_ray(points_mm) * error[..., None])
